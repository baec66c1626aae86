"""How far a sweep is: trials that have ended and are running, the best score so far, and the time left."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ray import tune
from ray.tune.experiment import Trial as TuneTrial

from sb3_stereo.console import Bar
from sb3_stereo.errors import ConfigError
from sb3_stereo.tuning.records import defined, find_trial

if TYPE_CHECKING:
    from sb3_stereo.tuning.trials import MakeTraining, Training

INTERVAL = 2.0  # [s] between two looks at the trials
MONITORS = "*.monitor.csv"  # SB3's: a line per episode, "return,length,seconds", after two of a head


class Progress(tune.Callback):
    """Shows a bar, or lines, that count the environment steps of all trials.

    Args:
        make_training: From what Tune suggests to a training.
        n_trials: How many there will be.
    """

    def __init__(self, make_training: "MakeTraining", n_trials: int) -> None:
        self.make_training, self.n_trials = make_training, n_trials
        self._bar: Bar | None = None
        self._looked = 0.0
        self._runs: dict[str, Path] = {}

    def on_step_end(self, iteration: int, trials: list[TuneTrial], **info: Any) -> None:
        """Look at the trials now and then."""
        if time.monotonic() - self._looked >= INTERVAL:
            self._looked = time.monotonic()
            self.show(trials)

    def on_experiment_end(self, trials: list[TuneTrial], **info: Any) -> None:
        """Show the end."""
        self.show(trials)
        if self._bar is not None:
            self._bar.close()

    def show(self, trials: Sequence[TuneTrial]) -> None:
        """Update the bar."""
        known = [(trial, training) for trial in trials if (training := self._training(trial)) is not None]
        if not known:
            return
        if self._bar is None:
            total = self.n_trials * known[0][1].config.n_timesteps
            self._bar = Bar(total, "step", done=sum(self._steps(*pair) for pair in known))
        self._bar.update(sum(self._steps(*pair) for pair in known), self.note(known))

    def note(self, known: Sequence[tuple[TuneTrial, "Training"]]) -> str:
        """What is said besides the steps."""
        n_ended = sum(_has_ended(trial) for trial, _ in known)
        n_running = sum(trial.status == TuneTrial.RUNNING for trial, _ in known)
        said = [f"{n_ended} of {self.n_trials} trials ended", f"{n_running} running"]
        metric = known[0][1].metric
        scores = [defined(trial.last_result[metric.name], metric) for trial, _ in known if _told(trial, metric.name)]
        if scores:
            best = max(scores) if metric.goal == "maximize" else min(scores)
            said.append(f"best {metric.name} so far {best:.4g}")
        return ", ".join(said)

    def _training(self, trial: TuneTrial) -> "Training | None":
        try:
            return self.make_training(trial.config)
        except (ConfigError, KeyError):  # values that do not go together; Optuna has not chosen yet
            return None

    def _steps(self, trial: TuneTrial, training: "Training") -> int:
        """Environment steps of a trial; one that has ended needs no more."""
        if _has_ended(trial):
            return training.config.n_timesteps
        run = self._run(trial, training) if trial.status == TuneTrial.RUNNING else None
        return 0 if run is None else min(played_steps(run), training.config.n_timesteps)

    def _run(self, trial: TuneTrial, training: "Training") -> Path | None:
        if trial.trial_id not in self._runs:
            run = find_trial(Path(training.options.log_folder), training.config, training.options.seed)
            if run is None:
                return None
            self._runs[trial.trial_id] = run
        return self._runs[trial.trial_id]


def _has_ended(trial: TuneTrial) -> bool:
    return trial.status in (TuneTrial.TERMINATED, TuneTrial.ERROR)


def _told(trial: TuneTrial, name: str) -> bool:
    result: Mapping[str, Any] = trial.last_result or {}
    return name in result


def played_steps(run: Path) -> int:
    """Environment steps of a run's ended episodes, as its monitors tell."""
    return sum(_episode_steps(file) for file in run.glob(MONITORS))


def _episode_steps(file: Path) -> int:
    """Of one monitor; a line that is not written to its end counts nothing."""
    try:
        _, _, *episodes, _ = file.read_text(encoding="utf-8").split("\n")
        return sum(int(line.split(",")[1]) for line in episodes)
    except (OSError, ValueError, IndexError):  # just made, or just being written
        return 0
