"""Training runs as trials of Ray Tune, each in a process of its own: trained once, resumed, retried and reported."""

import hashlib
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from filelock import FileLock
from ray import tune
from ray.tune.experiment import Trial as TuneTrial
from ray.tune.search import BasicVariantGenerator

from sb3_stereo import runtime
from sb3_stereo.config.schema import Config
from sb3_stereo.console import print_line
from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.creation import make_numbered
from sb3_stereo.runs.directory import import_packages
from sb3_stereo.runs.status import has_ended
from sb3_stereo.training import Options, resume, train
from sb3_stereo.tuning.cluster import check_resources
from sb3_stereo.tuning.config import Metric, Resources
from sb3_stereo.tuning.progress import Progress
from sb3_stereo.tuning.records import defined, find_trial, scores, state
from sb3_stereo.tuning.stopping import SCORES, STEPS

INDEX = "training"  # what Tune suggests where the runs are known beforehand


@dataclass(frozen=True)
class Training:
    """What a trial does, on whichever machine it runs.

    Attributes:
        name: How reports call it.
        config: What it learns.
        options: How it runs; the log folder is absolute, on a file system that all machines share.
        record: Further arguments for the run's `args.yml`; `num_threads` and `gym_packages` are the trial's.
        command: For the run's records.
        metric: The score that Tune is told.
    """

    name: str
    config: Config
    options: Options
    record: Mapping[str, Any]
    command: Sequence[str]
    metric: Metric


MakeTraining = Callable[[Mapping[str, Any]], Training]
OnEnd = Callable[[Training, Mapping[str, Any]], str]


def run_trial(suggestion: dict[str, Any], make_training: MakeTraining) -> None:
    """Do the training that is suggested, unless that was done already, and report its scores to Tune."""
    training = make_training(suggestion)
    runtime.tune_allocator()
    sys.orig_argv[:] = training.command
    import_packages(training.record["gym_packages"])
    folder, config, seed = Path(training.options.log_folder), training.config, training.options.seed
    with runtime.threads_for(training.record["num_threads"]), _alone(folder, config, seed):
        run = find_trial(folder, config, seed)
        if run is None or state(run, config) == "unfinished":
            run = continue_or_train(run, training)
            steps = [max(scores(run))]  # the earlier ones are reported
        else:
            steps = sorted(scores(run))
        for step in steps:
            report(run, step, training.metric)


def continue_or_train(run: Path | None, training: Training) -> Path:
    """Train to the end and return the run; an interrupted one goes on from its last snapshot.

    A run that has ended, but lost its last scores since, is put aside and trained anew.
    """

    def on_evaluation(run: Path) -> None:
        report(run, max(scores(run)), training.metric)

    if run is not None and has_ended(run, training.config):
        run.rename(make_numbered(run.parent, f"{run.name}.damaged"))
        run = None
    if run is not None:
        return resume(run, verbose=0, on_evaluation=on_evaluation).run
    return train(training.config, training.options, training.record, on_evaluation).run


def report(run: Path, step: int, metric: Metric) -> None:
    """Tell Tune the score at a step; here a trial ends if `early_terminate` stops it."""
    by_step = scores(run)
    score = defined(by_step[step][metric.score], metric)
    n_scores = sum(earlier <= step for earlier in by_step)
    tune.report({"run": str(run), STEPS: step, SCORES: n_scores, metric.name: score})


@contextmanager
def _alone(folder: Path, config: Config, seed: int) -> Iterator[None]:
    """Wait until no other process trains the same, e.g. one whose driver was killed; a lock dies with its owner."""
    locks = folder / ".locks"
    locks.mkdir(parents=True, exist_ok=True)
    name = hashlib.sha1(yaml.safe_dump([config.plain(), seed]).encode()).hexdigest()
    with FileLock(locks / name):
        yield


class Watch(tune.Callback):
    """Says how trials end and keeps the failures.

    Args:
        make_training: As in `run_trial`.
        on_end: Called with a trial's training and its last report when it ends; returns what is said of it.
        verbose: 1 prints a line per trial.
    """

    def __init__(self, make_training: MakeTraining, on_end: OnEnd, verbose: int = 1) -> None:
        self.make_training, self.on_end, self.verbose = make_training, on_end, verbose
        self.failures: list[str] = []

    def on_trial_complete(self, iteration: int, trials: list[TuneTrial], trial: TuneTrial, **info: Any) -> None:
        """Tell of the end."""
        if "run" in trial.last_result:  # else Tune itself was interrupted
            self._say(self.on_end(self.make_training(trial.config), trial.last_result))

    def on_trial_recover(self, iteration: int, trials: list[TuneTrial], trial: TuneTrial, **info: Any) -> None:
        """Tell of the next attempt."""
        self._say(f"{self._name(trial)}: attempt {trial.num_failures} failed and is repeated; {_reason(trial)}")

    def on_trial_error(self, iteration: int, trials: list[TuneTrial], trial: TuneTrial, **info: Any) -> None:
        """Keep the error."""
        self.failures.append(f"{self._name(trial)}: {_reason(trial)}")

    def _name(self, trial: TuneTrial) -> str:
        try:
            return self.make_training(trial.config).name
        except ConfigError:  # values that do not go together
            return ", ".join(f"{key} {value}" for key, value in trial.config.items())

    def _say(self, line: str) -> None:
        if self.verbose:
            print_line(line)


def _reason(trial: TuneTrial) -> str:
    """Return the last line of a trial's error, and where all of it is."""
    file = Path(trial.error_file or "")
    lines = file.read_text(encoding="utf-8").split("\n") if file.is_file() else []
    last = next((line.strip() for line in reversed(lines) if line.strip()), "the process died")
    return f"{last} (all of it: {file})"


def fit(
    watch: Watch,
    param_space: Mapping[str, Any],
    tune_config: Mapping[str, Any],
    folder: Path,
    resources: Resources,
    retries: int,
    n_trials: int,
) -> list[str]:
    """Run trials on the Ray that is connected, and return what failed.

    Args:
        watch: Knows what they do, and is told how they end.
        param_space: Tune's search space.
        tune_config: Arguments of Tune's `TuneConfig`.
        folder: For what Tune writes, e.g. the errors of failed trials; emptied first.
        resources: What a trial occupies.
        retries: How often a trial that fails is tried again.
        n_trials: How many there will be, for the progress.
    """
    check_resources(resources)
    shutil.rmtree(folder, ignore_errors=True)
    trainable = tune.with_parameters(run_trial, make_training=watch.make_training)
    tune.Tuner(
        tune.with_resources(trainable, {"cpu": resources.cpu, "gpu": resources.gpu}),
        param_space=dict(param_space),
        tune_config=tune.TuneConfig(**tune_config),
        run_config=tune.RunConfig(
            name=folder.name,
            storage_path=str(folder.parent),
            failure_config=tune.FailureConfig(max_failures=retries),
            callbacks=[watch, *([Progress(watch.make_training, n_trials)] if watch.verbose else [])],
            verbose=0,
        ),
    ).fit()
    return watch.failures


def fit_listed(
    runs: Sequence[Training],
    folder: Path,
    workers: int,
    retries: int,
    on_end: OnEnd,
    resources: Resources | None = None,
    tune_config: Mapping[str, Any] | None = None,
    verbose: int = 1,
) -> list[str]:
    """Run training runs that are known beforehand, in their order, and return what failed.

    Args:
        runs: What to train.
        folder: As in `fit`.
        workers: Training runs at a time; 0 leaves it to the resources.
        retries: As in `fit`.
        on_end: As in `Watch`.
        resources: What a training occupies; by default one core.
        tune_config: Further arguments of Tune's `TuneConfig`.
        verbose: As in `Watch`.
    """
    watch = Watch(partial(_listed, runs), on_end, verbose)
    param_space = {INDEX: tune.grid_search(list(range(len(runs))))}
    chosen = {"search_alg": BasicVariantGenerator(max_concurrent=workers), **(tune_config or {})}
    return fit(watch, param_space, chosen, folder, resources or Resources(), retries, len(runs))


def _listed(runs: Sequence[Training], suggestion: Mapping[str, Any]) -> Training:
    index: int = suggestion[INDEX]
    return runs[index]
