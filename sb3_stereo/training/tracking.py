"""Experiment trackers: what SB3's logger is told goes to Weights & Biases or MLflow, too."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stable_baselines3.common.logger import KVWriter

from sb3_stereo.config.schema import Config, settings
from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.files import write

if TYPE_CHECKING:
    from sb3_stereo.training.options import Options

TRACKERS = {"wandb": "track", "mlflow": "mlflow"}  # and the extra that installs each
WAYS_OUT = {"wandb": "log in, set WANDB_MODE=offline", "mlflow": "check MLFLOW_TRACKING_URI"}
ID_FILE = "tracker_id.txt"
FORMAT = "tracker"  # what SB3's logger excludes a value from


def make_tracker(run: Path, config: Config, options: Options) -> KVWriter | None:
    """Return the output for SB3's logger that the options ask for, or None.

    A run that is resumed goes on in the tracker's run that it began.

    Raises:
        ConfigError: If the tracker is not installed, or refuses.
    """
    if options.track is None:
        return None
    known = {"algo": config.algo, "env": config.env_id, "seed": options.seed} | settings(config)
    values = {name: value if isinstance(value, int | float) else str(value) for name, value in known.items()}
    try:
        return _Wandb(run, values, options) if options.track == "wandb" else _MLflow(run, values, options)
    except ModuleNotFoundError as error:
        install = f'pip install "sb3_stereo[{TRACKERS[options.track]}]"'
        raise ConfigError(f"--track {options.track} needs {error.name}; install it with: {install}") from error
    except Exception as error:  # of the tracker: no login, no server
        reason = (str(error).splitlines() or ["no reason given"])[0]
        way_out = f"{WAYS_OUT[options.track]}, or leave --track out"
        raise ConfigError(f"{options.track} cannot track this run ({reason}); {way_out}") from error


def known_id(run: Path) -> str | None:
    """The tracker's id of a run that was tracked before."""
    file = run / ID_FILE
    return file.read_text(encoding="utf-8").strip() if file.is_file() else None


def numbers(key_values: Mapping[str, Any], excluded: Mapping[str, tuple[str, ...]]) -> dict[str, float]:
    """What a tracker is told: numbers that are not excluded from trackers."""
    return {
        key: float(value)
        for key, value in key_values.items()
        if isinstance(value, int | float) or hasattr(value, "__float__")
        if FORMAT not in (excluded.get(key) or ())
    }


class _Wandb(KVWriter):
    """A run of Weights & Biases; WANDB_MODE=offline keeps it on this machine."""

    def __init__(self, run: Path, values: Mapping[str, Any], options: Options) -> None:
        import wandb

        number = known_id(run) or uuid.uuid4().hex[:8]
        write(run / ID_FILE, f"{number}\n".encode())
        self._run = wandb.init(
            project=options.wandb_project_name,
            entity=options.wandb_entity,
            tags=list(options.wandb_tags),
            name=f"{run.parent.name}-{run.name}-seed{options.seed}",
            id=number,
            resume="allow",
            config=dict(values),
            dir=str(run),
            settings=wandb.Settings(silent=True),
        )

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Log what SB3 dumps."""
        self._run.log(numbers(key_values, key_excluded), step=step)

    def close(self) -> None:
        """Finish the run."""
        self._run.finish()


class _MLflow(KVWriter):
    """A run of MLflow, at MLFLOW_TRACKING_URI."""

    def __init__(self, run: Path, values: Mapping[str, Any], options: Options) -> None:
        from mlflow.entities import Metric
        from mlflow.tracking import MlflowClient

        self._metric, self._client = Metric, MlflowClient()
        number = known_id(run)
        if number is None:
            experiment = self._client.get_experiment_by_name(options.wandb_project_name)
            experiment_id = experiment and experiment.experiment_id
            experiment_id = experiment_id or self._client.create_experiment(options.wandb_project_name)
            tags = dict.fromkeys(options.wandb_tags, "true")
            name = f"{run.parent.name}-{run.name}-seed{options.seed}"
            number = self._client.create_run(experiment_id, tags=tags, run_name=name).info.run_id
            for key, value in values.items():
                self._client.log_param(number, key, value)
            write(run / ID_FILE, f"{number}\n".encode())
        else:
            self._client.update_run(number, status="RUNNING")
        self._number = number

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Log what SB3 dumps."""
        metrics = [self._metric(key, value, 0, step) for key, value in numbers(key_values, key_excluded).items()]
        self._client.log_batch(self._number, metrics=metrics)

    def close(self) -> None:
        """Finish the run."""
        self._client.set_terminated(self._number)
