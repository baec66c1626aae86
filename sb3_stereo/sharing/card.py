"""The page of a model on the Hugging Face Hub: scores that it lists, a text that says how to load the model."""

import math
from typing import Any

import yaml

from sb3_stereo import __version__
from sb3_stereo.config.schema import Config
from sb3_stereo.console import command_line
from sb3_stereo.evaluation.callback import describe
from sb3_stereo.evaluation.protocol import Evaluation
from sb3_stereo.runs.directory import env_name
from sb3_stereo.sharing.lerobot_env import has_env_file

TEMPLATE = """---
{metadata}
---

# {algo} on {env_id}

{summary}.

This agent sees images of a robot arm and gives the torques of its joints. It was trained with sb3_stereo {version}, a
plug-in of [Stable-Baselines3](https://github.com/DLR-RM/stable-baselines3).
{film}
## Use it

```console
{commands}
```
{in_lerobot}
## Scores

| | |
|---|---|
{scores}

Deterministic actions, one episode each from {n_poses} initial states.

## Settings

```yaml
{settings}
```
"""
IN_LEROBOT = """
Its environment in [LeRobot](https://github.com/huggingface/lerobot), by this repository's `env.py`:

```python
from lerobot.envs import make_env

envs = make_env("{repo_id}", trust_remote_code=True)
```
"""
FILM = "\n`replay.mp4` shows a few of its episodes.\n"
# The names of the scores and their units; those that the environment does not tell are left out.
SCORES = {
    "success_rate": ("success", 100, "%"),
    "mean_steps_success": ("episode length (successes)", 1, "steps"),
    "mean_return": ("return", 1, ""),
    "median_distance_success": ("distance at success, median", 100, "cm"),
    "p95_distance_success": ("distance at success, 95th percentile", 100, "cm"),
}


def model_card(config: Config, result: Evaluation, repo_id: str, has_film: bool) -> str:
    """Return the text of README.md, with the metadata that the Hub reads.

    Args:
        config: The run's configuration.
        result: The model's scores.
        repo_id: Where it will be.
        has_film: Whether there is a replay.mp4.
    """
    numbers = {key: value for key, value in result.scores().items() if key in SCORES and not math.isnan(value)}
    rows = [
        f"| {name} | {numbers[key] * factor:.2f} {unit} |"
        for key, (name, factor, unit) in SCORES.items()
        if key in numbers
    ]
    load = command_line("load_from_hub", "--repo-id", repo_id, "-f", "logs")
    watch = command_line("enjoy", "--algo", config.algo, "--env", config.env_id, "-f", "logs")
    score = command_line("evaluate", f"logs/{config.algo}/{env_name(config.env_id)}_1")
    return TEMPLATE.format(
        metadata=_metadata(config, result),
        algo=config.algo.upper(),
        env_id=config.env_id,
        in_lerobot=IN_LEROBOT.format(repo_id=repo_id) if has_env_file(config.env_id) else "",
        version=__version__,
        summary=f"The agent {describe(result)}",
        film=FILM if has_film else "",
        commands="\n".join(f"$ {command}" for command in (load, watch, score)),
        scores="\n".join(rows),
        n_poses=result.n_poses,
        settings=yaml.safe_dump(config.plain(), sort_keys=False).strip(),
    )


def _metadata(config: Config, result: Evaluation) -> Any:
    """The YAML on top, by which the Hub finds the model and shows its scores."""
    from huggingface_hub import EvalResult, ModelCardData

    task: dict[str, Any] = {
        "task_type": "reinforcement-learning",
        "dataset_type": config.env_id,
        "dataset_name": config.env_id,
    }
    reward = f"{result.returns.mean():.2f} +/- {result.returns.std():.2f}"
    metrics = [("mean_reward", reward), ("success_rate", f"{result.success_rate:.2f}")]
    return ModelCardData(
        library_name="stable-baselines3",
        model_name=config.algo.upper(),
        tags=[
            config.env_id,
            "deep-reinforcement-learning",
            "reinforcement-learning",
            "stable-baselines3",
            "sb3_stereo",
        ],
        eval_results=[EvalResult(metric_type=kind, metric_value=value, **task) for kind, value in metrics],
    ).to_yaml()
