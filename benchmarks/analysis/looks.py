"""Whether a trained agent uses the image: its success when it is shown images of other episodes.

    python -m benchmarks.analysis.looks RUN --name NAME

plays the test episodes twice: with the agent's own observations, and with each replaced by one of another episode. An
agent that looks needs its own; one that always does about the same does not notice. The actions' spread says it
directly: 0 is one action whatever is seen. Writes a line of `benchmarks/results/looks.csv`.
"""

import argparse
import json
import sys
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import benchmarks
from benchmarks.analysis.baselines import Line, read_lines, write_lines
from benchmarks.analysis.rollouts import Floats, Policy, play
from sb3_stereo.building.factory import make_env
from sb3_stereo.commands.flags import Parser, run_command
from sb3_stereo.console import print_line
from sb3_stereo.evaluation.protocol import InitialState, eval_initial_states
from sb3_stereo.runs.directory import load_record, model_path
from sb3_stereo.runs.models import load_model

Episode = list[Any]  # its observations


def remembering(model: Any, episode: Episode, actions: list[Any]) -> Policy:
    """The policy of an agent's deterministic actions, which adds what it sees and does to two lists."""

    def act(observation: Any, info: Mapping[str, Any]) -> Any:
        episode.append(observation)
        actions.append(model.predict(observation, deterministic=True)[0])
        return actions[-1]

    return act


def shuffled(model: Any, episodes: Sequence[Episode], rng: np.random.Generator) -> Policy:
    """The policy of an agent that is shown a random observation of a random one of these episodes at each step."""

    def act(observation: Any, info: Mapping[str, Any]) -> Any:
        episode = episodes[int(rng.integers(len(episodes)))]
        return model.predict(episode[int(rng.integers(len(episode)))], deterministic=True)[0]

    return act


def look(model: Any, env: gym.Env[Any, Any], initial_states: Sequence[InitialState], seed: int = 0) -> dict[str, float]:
    """Score an agent with its own observations and with those of other episodes.

    Args:
        model: The agent, with a `predict`.
        env: Its environment, with all wrappers.
        initial_states: At least two.
        seed: Of the shuffling.

    Returns:
        Success and steps (failures as the cap) of both, the spread of the efforts over its own observations (standard
        deviation, mean over joints, 0 to 1), and the share of its most frequent action.
    """
    episodes: list[Episode] = [[] for _ in initial_states]
    actions: list[Any] = []
    own = [
        play(env, [start], remembering(model, seen, actions))
        for start, seen in zip(initial_states, episodes, strict=True)
    ]
    rng = np.random.default_rng(seed)
    others = [
        play(env, [start], shuffled(model, [*episodes[:number], *episodes[number + 1 :]], rng))
        for number, start in enumerate(initial_states)
    ]
    efforts = np.array([efforts_of(env, action) for action in actions])  # (n_observations, n_joints)
    _, counts = np.unique(efforts.round(6), axis=0, return_counts=True)
    return {
        "success_rate": float(np.mean([score.success_rate for score in own])),
        "mean_steps_capped": float(np.mean([score.mean_steps_capped for score in own])),
        "shuffled_success_rate": float(np.mean([score.success_rate for score in others])),
        "shuffled_mean_steps_capped": float(np.mean([score.mean_steps_capped for score in others])),
        "action_spread": float(efforts.std(axis=0).mean()),
        "most_frequent_action": float(counts.max() / counts.sum()),
    }


def efforts_of(env: gym.Env[Any, Any], action: Any) -> Floats:
    """Shares of the effort limits, shape (n_joints,), that an action stands for after the wrappers."""
    while env is not env.unwrapped:
        action = env.action(action) if isinstance(env, gym.ActionWrapper) else action
        env = env.env  # type: ignore[attr-defined]
    return np.clip(np.asarray(action, np.float64), -1.0, 1.0)


def trained_steps(path: Path) -> int:
    """Environment steps that a saved model was trained for."""
    with zipfile.ZipFile(path) as archive:
        return int(json.loads(archive.read("data"))["num_timesteps"])


def looks_record() -> Path:
    """The file with a line per agent."""
    return benchmarks.RESULTS / "looks.csv"


def looks_command(args: argparse.Namespace) -> int:
    """Look into a run and record it."""
    config, arguments = load_record(args.run)
    path = model_path(args.run, config.env_id, args.load_best, args.load_checkpoint)
    model = load_model(config, path)
    with closing(make_env(config.env_id, config.env_kwargs, config.env_wrapper)()) as env:
        scores = look(model, env, eval_initial_states(config.env_id, config.env_kwargs))
    key = {"row": args.name, "seed": str(arguments["seed"]), "timesteps": str(trained_steps(path))}
    line: Line = key | {name: f"{value:.6g}" for name, value in scores.items()}
    others = [known for known in read_lines(looks_record()) if any(known[name] != value for name, value in key.items())]
    lines = sorted([*others, line], key=lambda known: (known["row"], int(known["seed"]), int(known["timesteps"])))
    write_lines(looks_record(), lines)
    print_line(", ".join(f"{name} {value}" for name, value in line.items()))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = Parser(prog="python -m benchmarks.analysis.looks", description=__doc__.splitlines()[0])
    parser.add_argument("run", metavar="RUN", help="the run's directory")
    parser.add_argument("--name", required=True, help="of the table's row that it is a run of")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--load-best", action="store_true", help="the best model instead of the last")
    which.add_argument("--load-checkpoint", type=int, metavar="STEP", help="the checkpoint of this step")
    return run_command(looks_command, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
