"""The trials of a sweep on Ray Tune. A trial is an ordinary training in a process of its own."""

import fcntl
import hashlib
import shutil
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
import ray
import yaml
from ray import tune
from ray.tune.experiment import Trial as TuneTrial
from ray.tune.schedulers import ASHAScheduler
from ray.tune.search import BasicVariantGenerator, Repeater
from ray.tune.search.optuna import OptunaSearch
from ray.tune.search.repeater import TRIAL_INDEX

from sb3_stereo import runtime
from sb3_stereo.config import Config, overridden
from sb3_stereo.errors import ConfigError
from sb3_stereo.runs import import_packages
from sb3_stereo.tuning.config import Metric, Resources, Sweep
from sb3_stereo.tuning.records import STOPPED, Setting, defined, find_trial, read_trials, scores, settings, state
from sb3_stereo.tuning.report import shown
from sb3_stereo.tuning.space import optuna_space, tune_space

MODES = {"maximize": "max", "minimize": "min"}
TUNE_FOLDER = "tune"  # what Ray Tune writes, e.g. the errors of failed trials


@dataclass(frozen=True)
class Job:
    """What a trial needs to know, on whichever machine it runs.

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


def run_trial(suggestion: dict[str, Any], job: Job) -> None:
    """Train one setting with one seed, unless it is trained already, and report the scores to Tune.

    Args:
        suggestion: Values of the searched hyper-parameters by name, and the seed's index.
        job: The rest.
    """
    runtime.tune_allocator()
    sys.orig_argv[:] = job.command
    import_packages(job.gym_packages)
    runtime.set_threads(job.num_threads)
    params = {key: _plain(value) for key, value in suggestion.items() if key != TRIAL_INDEX}
    seed = job.sweep.seeds[suggestion[TRIAL_INDEX]]
    config = overridden(job.sweep.base, params)
    with _alone(job.folder, config, seed):
        run = find_trial(job.folder, config, seed)
        if run is None or state(run, config) == "unfinished":
            run = continue_or_train(run, config, seed, params, job)
            steps = [max(scores(run))]  # the earlier ones are reported
        else:
            steps = sorted(scores(run))
        for step in steps:
            report(run, step, job.sweep.metric)


def continue_or_train(run: Path | None, config: Config, seed: int, params: Mapping[str, Any], job: Job) -> Path:
    """Train a trial to its end and return its run; an interrupted one goes on from its last checkpoint."""
    from sb3_stereo.training import Options, resume, train

    def on_score(run: Path) -> None:
        report(run, max(scores(run)), job.sweep.metric)

    if run is not None:
        return resume(run, verbose=0, on_score=on_score).run
    options = Options(
        seed=seed,
        log_folder=str(job.folder),
        eval_freq=job.sweep.eval_freq,
        save_freq=job.save_freq,
        device=job.device,
        progress=False,
        verbose=0,
    )
    record = {"params": dict(params), "num_threads": job.num_threads, "gym_packages": list(job.gym_packages)}
    return train(config, options, record, on_score).run


def report(run: Path, step: int, metric: Metric) -> None:
    """Tell Tune the score at a step; here a trial ends if `early_terminate` stops it."""
    score = defined(scores(run)[step][metric.score], metric)
    tune.report({"run": str(run), "timesteps": step, metric.name: score})


@contextmanager
def _alone(folder: Path, config: Config, seed: int) -> Iterator[None]:
    """Wait until no other process trains the same, e.g. one whose driver was killed; a lock dies with its owner."""
    locks = folder / ".locks"
    locks.mkdir(parents=True, exist_ok=True)
    name = hashlib.sha1(yaml.safe_dump([config.plain(), seed]).encode()).hexdigest()
    with (locks / name).open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _plain(value: Any) -> Any:
    """Return NumPy's numbers, which samplers draw, as Python's."""
    return value.item() if hasattr(value, "item") else value


def optuna_search(sweep: Sweep, known: Sequence[Setting]) -> OptunaSearch:
    """Return Optuna's searcher, which knows the settings that are trained and begins with those that are not quite."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    # Lists cannot be stored in Optuna's data bases; this study is in memory.
    warnings.filterwarnings("ignore", message="Choices for a categorical distribution")
    search = OptunaSearch(
        optuna_space(sweep),
        metric=sweep.metric.name,
        mode=MODES[sweep.metric.goal],
        points_to_evaluate=[dict(setting.params) for setting in known if not setting.is_closed],
        seed=len(known),  # the same seed again would suggest the same settings again
    )
    for setting in known:
        if setting.is_closed:
            search.add_evaluated_point(dict(setting.params), setting.score)
    return search


def tuner_arguments(sweep: Sweep, folder: Path, workers: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the arguments of Tune's `TuneConfig` that choose the settings, and its `param_space`.

    Args:
        sweep: The sweep.
        folder: Its folder.
        workers: Trials at a time; 0 leaves it to the resources.
    """
    if sweep.method != "bayes":
        # Constant: a random setting is the same for all seeds. The fixed state draws the same settings in every call.
        search = BasicVariantGenerator(max_concurrent=workers, constant_grid_search=True, random_state=0)
        return {"search_alg": search, "num_samples": sweep.n_trials or 1}, tune_space(sweep)
    known = settings(sweep, read_trials(sweep, folder))
    n_seeds = len(sweep.seeds)
    return {
        "search_alg": Repeater(optuna_search(sweep, known), repeat=n_seeds),
        "num_samples": (sweep.n_trials - sum(setting.is_closed for setting in known)) * n_seeds,
        "max_concurrent_trials": workers or None,
    }, {}


def scheduler(sweep: Sweep) -> ASHAScheduler | None:
    """Return the scheduler of `early_terminate`."""
    early = sweep.early_terminate
    if early is None:
        return None
    return ASHAScheduler(
        "timesteps", max_t=sweep.base.n_timesteps, grace_period=early.min_iter, reduction_factor=early.eta
    )


def check_resources(resources: Resources) -> None:
    """Raise a ConfigError unless a machine of the cluster can hold a trial; Tune would wait for one for ever."""
    nodes: list[dict[str, Any]] = ray.nodes()  # type: ignore[no-untyped-call]
    machines = [node["Resources"] for node in nodes if node["Alive"]]
    if not any(m.get("CPU", 0) >= resources.cpu and m.get("GPU", 0) >= resources.gpu for m in machines):
        have = "; ".join(f"{m.get('CPU', 0):g} cores and {m.get('GPU', 0):g} GPUs" for m in machines)
        raise ConfigError(
            f"no machine has the {resources.cpu:g} cores and {resources.gpu:g} GPUs that resources ask for; "
            f"there are: {have}"
        )


def fit(job: Job, workers: int, callbacks: Sequence[tune.Callback]) -> None:
    """Run all trials that are missing, on the Ray that is connected."""
    sweep = job.sweep
    config, space = tuner_arguments(sweep, job.folder, workers)
    shutil.rmtree(job.folder / TUNE_FOLDER, ignore_errors=True)
    resources = {"cpu": sweep.resources.cpu, "gpu": sweep.resources.gpu}
    tune.Tuner(
        tune.with_resources(tune.with_parameters(run_trial, job=job), resources),
        param_space=space,
        tune_config=tune.TuneConfig(
            metric=sweep.metric.name, mode=MODES[sweep.metric.goal], scheduler=scheduler(sweep), **config
        ),
        run_config=tune.RunConfig(
            name=TUNE_FOLDER,
            storage_path=str(job.folder),
            failure_config=tune.FailureConfig(max_failures=sweep.retries),
            callbacks=list(callbacks),
            verbose=0,
        ),
    ).fit()


class Watch(tune.Callback):
    """Marks stopped trials, says how trials ended and keeps the failures.

    Args:
        job: The sweep's job.
        verbose: 1 prints a line per trial.
    """

    def __init__(self, job: Job, verbose: int = 1) -> None:
        self.job = job
        self.verbose = verbose
        self.failures: list[str] = []

    def on_trial_complete(self, iteration: int, trials: list[TuneTrial], trial: TuneTrial, **info: Any) -> None:
        """Mark and print."""
        metric, result = self.job.sweep.metric, trial.last_result
        if metric.name not in result:  # Tune itself was interrupted
            return
        run, step = Path(result["run"]), result["timesteps"]
        word = state(run, overridden(self.job.sweep.base, self._params(trial)))
        if word == "unfinished":
            (run / STOPPED).write_text(f"early_terminate stopped this trial at step {step}\n", encoding="utf-8")
            word = "stopped"
        self._say(f"{self._name(trial)}: {word} at step {step}, {metric.name} {result[metric.name]:.4g} ({run.name})")

    def on_trial_recover(self, iteration: int, trials: list[TuneTrial], trial: TuneTrial, **info: Any) -> None:
        """Print."""
        self._say(f"{self._name(trial)}: attempt {trial.num_failures} failed and is repeated; {_reason(trial)}")

    def on_trial_error(self, iteration: int, trials: list[TuneTrial], trial: TuneTrial, **info: Any) -> None:
        """Keep the error."""
        self.failures.append(f"{self._name(trial)}: {_reason(trial)}")

    def _params(self, trial: TuneTrial) -> dict[str, Any]:
        return {key: _plain(value) for key, value in trial.config.items() if key != TRIAL_INDEX}

    def _name(self, trial: TuneTrial) -> str:
        params = ", ".join(f"{key} {shown(value)}" for key, value in self._params(trial).items())
        return f"{params}, seed {self.job.sweep.seeds[trial.config[TRIAL_INDEX]]}"

    def _say(self, line: str) -> None:
        if self.verbose:
            print(line, flush=True)


def _reason(trial: TuneTrial) -> str:
    """Return the last line of a trial's error, and where all of it is."""
    file = Path(trial.error_file or "")
    lines = file.read_text(encoding="utf-8").split("\n") if file.is_file() else []
    last = next((line.strip() for line in reversed(lines) if line.strip()), "the process died")
    return f"{last} (all of it: {file})"
