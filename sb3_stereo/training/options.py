"""The options of a training run, and its result."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

from sb3_stereo.building.factory import VEC_ENVS
from sb3_stereo.config.validation import fits
from sb3_stereo.errors import ConfigError, unknown
from sb3_stereo.evaluation.protocol import Evaluation
from sb3_stereo.training.tracking import TRACKERS


@dataclass(frozen=True)
class Options:
    """How to run a training; none of these changes what is learnt, except the seed.

    Attributes:
        seed: Seeds environments, networks and noise.
        log_folder: Where the run directory is made.
        eval_freq: 0 evaluates at the paper's steps, a positive number every so many steps, a negative one only at
            the end.
        eval_episodes: Of the test poses, how many a score plays; 0 plays all.
        n_eval_envs: Environments that are stepped together in a score.
        save_freq: A model and a snapshot every so many environment steps; not positive saves none.
        tensorboard_log: Folder for TensorBoard; None writes nothing.
        track: "wandb" or "mlflow" is told what TensorBoard would be; None tells neither.
        wandb_project_name: The project, for MLflow the experiment.
        wandb_entity: The user or team, for Weights & Biases.
        wandb_tags: Of the tracker's run.
        device: PyTorch device.
        vec_env: "dummy" or "subproc".
        trained_agent: A saved model whose networks and optimizers to begin with.
        trust: Begin with a model that has no checksum, too.
        progress: True draws a bar, False prints lines, None decides by the terminal.
        verbose: 0 is silent, 1 shows progress and scores, 2 also SB3's tables.
    """

    seed: int
    log_folder: str = "logs"
    eval_freq: int = 0
    eval_episodes: int = 0
    n_eval_envs: int = 1
    save_freq: int = -1
    tensorboard_log: str | None = None
    track: str | None = None
    wandb_project_name: str = "sb3_stereo"
    wandb_entity: str | None = None
    wandb_tags: tuple[str, ...] = ()
    device: str = "auto"
    vec_env: str = "dummy"
    trained_agent: str | None = None
    trust: bool = False
    progress: bool | None = None
    verbose: int = 1


def recorded_options(args: Mapping[str, Any]) -> Options:
    """Return the options in a run's record, which a hand may have changed.

    Raises:
        ConfigError: If one is missing or of the wrong type.
    """
    kinds = {**get_type_hints(Options), "num_threads": int, "tensorboard": str | None}
    for name in kinds.keys() & args.keys():
        if not fits(args[name], kinds[name]):
            raise ConfigError(f"the run's args.yml has {name}: {args[name]!r}; write there what it was trained with")
    for name, least in {"seed": 0, "n_eval_envs": 1, "eval_episodes": 0}.items():
        if args.get(name, 0 if name == "eval_episodes" else -1) < least:  # which older records lack
            raise ConfigError(
                f"the run's args.yml must have {name} of at least {least}; write what it was trained with"
            )
    if args.get("track") not in (None, *TRACKERS):
        raise unknown("track in the run's args.yml", args["track"], TRACKERS)
    if args.get("vec_env", "dummy") not in VEC_ENVS:
        raise unknown("vec_env in the run's args.yml", args["vec_env"], VEC_ENVS)
    return Options(**{name: args[name] for name in Options.__dataclass_fields__ if name in args})


@dataclass(frozen=True)
class Result:
    """What a training leaves.

    Attributes:
        run: The run directory.
        n_timesteps: Environment steps taken.
        evaluation: The last score; None if there was none.
        interrupted: The signal that ended the training early, e.g. "SIGINT"; None if none did.
        model: The file of the model that was saved; None if the training was interrupted before there was one.
    """

    run: Path
    n_timesteps: int
    evaluation: Evaluation | None
    interrupted: str | None
    model: Path | None = None
