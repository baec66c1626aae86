"""The trials of a sweep: which settings Ray Tune tries, and what it stops early."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
from ray.tune.schedulers import ASHAScheduler
from ray.tune.search import Repeater
from ray.tune.search.optuna import OptunaSearch
from ray.tune.search.repeater import TRIAL_INDEX

from sb3_stereo.config.schema import overridden
from sb3_stereo.runs.directory import import_packages
from sb3_stereo.training import Options
from sb3_stereo.tuning.config import Sweep
from sb3_stereo.tuning.records import STOPPED, Setting, read_trials, settings, state
from sb3_stereo.tuning.report import format_value
from sb3_stereo.tuning.space import optuna_space, point
from sb3_stereo.tuning.trials import Training, Watch, fit, fit_listed

TUNE_FOLDER = "tune"
MODES = {"maximize": "max", "minimize": "min"}


@dataclass(frozen=True)
class Job:
    """A sweep and how its trials run.

    Attributes:
        sweep: The sweep.
        folder: The sweep's folder, absolute, on a file system that all machines share.
        device: PyTorch device.
        num_threads: PyTorch threads of a trial.
        save_freq: Environment steps between checkpoints; not positive saves none.
        gym_packages: Packages that register environments.
        command: What the person typed, for the runs' records.
    """

    sweep: Sweep
    folder: Path
    device: str = "auto"
    num_threads: int = 1
    save_freq: int = 1000
    gym_packages: tuple[str, ...] = ()
    command: tuple[str, ...] = ()

    def training(self, suggestion: Mapping[str, Any]) -> Training:
        """Return the training that Optuna suggests.

        Args:
            suggestion: Values of the searched hyper-parameters by name, and the seed's index.
        """
        import_packages(self.gym_packages)  # the checks of the hyper-parameters ask the environment
        return self.trial(self.sweep.setting(suggestion), self.sweep.seeds[suggestion[TRIAL_INDEX]])

    def listed(self) -> list[Training]:
        """Return the training runs of grid and random: every setting with every seed."""
        return [self.trial(setting, seed) for setting in self.sweep.settings() for seed in self.sweep.seeds]

    def trial(self, params: Mapping[str, Any], seed: int) -> Training:
        """Return one setting with one seed."""
        options = Options(
            seed=seed,
            log_folder=str(self.folder),
            eval_freq=self.sweep.eval_freq,
            save_freq=self.save_freq,
            device=self.device,
            progress=False,
            verbose=0,
        )
        name = ", ".join([*(f"{key} {format_value(value)}" for key, value in params.items()), f"seed {seed}"])
        record = {"params": params, "num_threads": self.num_threads, "gym_packages": list(self.gym_packages)}
        return Training(name, overridden(self.sweep.base, params), options, record, self.command, self.sweep.metric)

    def ended(self, training: Training, result: Mapping[str, Any]) -> str:
        """Mark a trial that was stopped, and return what a person wants to know of its end."""
        run, step, metric = Path(result["run"]), result["timesteps"], training.metric.name
        word = state(run, training.config)
        if word == "unfinished":
            (run / STOPPED).write_text(f"early_terminate stopped this trial at step {step}\n", encoding="utf-8")
            word = "stopped"
        return f"{training.name}: {word} at step {step}, {metric} {result[metric]:.4g} ({run.name})"


def optuna_search(sweep: Sweep, known: Sequence[Setting]) -> OptunaSearch:
    """Return Optuna's searcher, which knows the settings that are trained and begins with those that are not quite."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    # Lists cannot be stored in Optuna's data bases; this study is in memory.
    warnings.filterwarnings("ignore", message="Choices for a categorical distribution")
    search = OptunaSearch(
        optuna_space(sweep),
        metric=sweep.metric.name,
        mode=MODES[sweep.metric.goal],
        points_to_evaluate=[point(sweep, setting.params) for setting in known if not setting.is_closed],
        seed=len(known),  # the same seed again would suggest the same settings again
    )
    for setting in known:
        if setting.is_closed:
            search.add_evaluated_point(point(sweep, setting.params), setting.score)
    return search


def scheduler(sweep: Sweep) -> ASHAScheduler | None:
    """Return the scheduler of `early_terminate`."""
    early = sweep.early_terminate
    if early is None:
        return None
    return ASHAScheduler(
        early.unit,
        max_t=early.last + 0.5,  # type: ignore[arg-type]  # a rung at the very end is one, whatever the rounding
        grace_period=early.first,  # type: ignore[arg-type]
        reduction_factor=early.eta,
        stop_last_trials=False,  # beyond the last rung a trial ends by itself
    )


def fit_sweep(job: Job, workers: int, verbose: int = 1) -> list[str]:
    """Run all trials that are missing, on the Ray that is connected, and return what failed.

    Args:
        job: The sweep and how its trials run.
        workers: Trials at a time; 0 leaves it to the resources.
        verbose: As in `Watch`.
    """
    sweep, folder = job.sweep, job.folder / TUNE_FOLDER
    metric = {"metric": sweep.metric.name, "mode": MODES[sweep.metric.goal], "scheduler": scheduler(sweep)}
    if sweep.method != "bayes":
        return fit_listed(job.listed(), folder, workers, sweep.retries, job.ended, sweep.resources, metric, verbose)
    chosen = {**metric, **bayes_arguments(sweep, job.folder), "max_concurrent_trials": workers or None}
    watch = Watch(job.training, job.ended, verbose)
    return fit(watch, {}, chosen, folder, sweep.resources, sweep.retries, chosen["num_samples"])


def bayes_arguments(sweep: Sweep, folder: Path) -> dict[str, Any]:
    """Return the arguments of Tune's `TuneConfig` that let Optuna choose the settings that are missing."""
    known = settings(sweep, read_trials(sweep, folder))
    n_seeds = len(sweep.seeds)
    return {
        "search_alg": Repeater(optuna_search(sweep, known), repeat=n_seeds),
        "num_samples": (sweep.n_settings - sum(setting.is_closed for setting in known)) * n_seeds,
    }
