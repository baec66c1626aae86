"""The trials of a sweep on disk: run directories are the only record, so no finished trial can be lost."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from sb3_stereo.config.schema import Config, overridden
from sb3_stereo.config.values import read_yaml
from sb3_stereo.envs import plain_yaml
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.scores import read_scores
from sb3_stereo.runs.directory import env_name, find_run, load_record, run_ids
from sb3_stereo.runs.files import replacing
from sb3_stereo.runs.status import has_ended
from sb3_stereo.tuning.config import Metric, Sweep
from sb3_stereo.tuning.settings import key

STOPPED = "stopped.txt"
SWEEP = "sweep.yml"
MAY_CHANGE = ("n_trials", "resources", "retries", "run_cap", "seeds")  # between two calls for the same sweep


@dataclass(frozen=True)
class Trial:
    """A setting trained with one seed.

    Attributes:
        run: Its run directory.
        params: The setting: the searched hyper-parameters by name.
        seed: The seed.
        state: "finished", "stopped" by `early_terminate`, or "unfinished".
        timesteps: Environment steps of the last score; 0 if there is none.
        score: The metric then; its worst value if undefined.
    """

    run: Path
    params: Mapping[str, Any]
    seed: int
    state: str
    timesteps: int
    score: float


@dataclass(frozen=True)
class Setting:
    """The trials of one setting.

    Attributes:
        params: The searched hyper-parameters by name.
        trials: One per seed.
        is_complete: Whether all seeds are trained to the end.
        is_closed: Whether all seeds are trained to the end or stopped, so that nothing is left to train.
    """

    params: Mapping[str, Any]
    trials: tuple[Trial, ...]
    is_complete: bool
    is_closed: bool

    @property
    def score(self) -> float:
        """The mean over seeds."""
        return float(np.mean([trial.score for trial in self.trials]))


def scores(run: Path) -> dict[int, dict[str, float]]:
    """Return a run's scores by step, none if it has none yet or they cannot be read."""
    try:
        return read_scores(run)
    except ConfigError:
        return {}


def state(run: Path, config: Config) -> str:
    """Return "finished", "stopped" or "unfinished"; scores that cannot be read are no end of a trial."""
    last = max(scores(run), default=0)
    if last >= config.n_timesteps and has_ended(run, config):
        return "finished"
    return "stopped" if last and (run / STOPPED).is_file() else "unfinished"


def find_trial(folder: Path, config: Config, seed: int) -> Path | None:
    """Return the run of exactly this configuration and seed, if there is one."""
    text = yaml.safe_dump(config.plain(), sort_keys=False)
    for number in run_ids(folder, config.algo, config.env_id):
        run = find_run(folder, config.algo, config.env_id, number)
        records = run / env_name(config.env_id)
        try:
            if (records / "config.yml").read_text(encoding="utf-8") != text:
                continue
            if plain_yaml.read(records / "args.yml")["seed"] == seed:
                return run
        except (OSError, KeyError, TypeError, ValueError):  # killed while it was made: nobody's run
            continue
    return None


def read_trials(sweep: Sweep, folder: Path) -> list[Trial]:
    """Return all trials of a sweep that have a run."""
    return read_folder(sweep, folder)[0]


def read_folder(sweep: Sweep, folder: Path) -> tuple[list[Trial], list[str]]:
    """Return all trials of a sweep that have a run, and what is said of each run that is none."""
    algo, env_id = sweep.base.algo, sweep.base.env_id
    trials, others = [], []
    for number in run_ids(folder, algo, env_id):
        run = find_run(folder, algo, env_id, number)
        try:
            trials.append(_trial(sweep, run))
        except ConfigError as error:
            others.append(f"{run.name}: {error}")
    return trials, others


def _trial(sweep: Sweep, run: Path) -> Trial:
    """Return a run as a trial.

    Raises:
        ConfigError: If it is none of the sweep's, or was killed while it was made.
    """
    config, args = load_record(run)
    params, seed = args.get("params"), args.get("seed")
    names = {parameter.name for parameter in sweep.parameters}
    if not isinstance(params, Mapping) or set(params) != names or not isinstance(seed, int):
        raise ConfigError("not a trial of this sweep")
    if config.plain() != overridden(sweep.base, params).plain():
        raise ConfigError("a trial of another sweep")
    by_step = scores(run)
    last = max(by_step, default=0)
    score = by_step[last].get(sweep.metric.score, float("nan")) if by_step else float("nan")
    return Trial(run, dict(params), seed, state(run, config), last, defined(score, sweep.metric))


def defined(score: float, metric: Metric) -> float:
    """Return a score, or the worst one if it is undefined: schedulers and searchers cannot rank NaN."""
    return metric.worst if isnan(score) else score


def settings(sweep: Sweep, trials: Sequence[Trial]) -> list[Setting]:
    """Put the sweep's trials together by setting, the best first; complete ones before all others."""
    groups: dict[str, list[Trial]] = {}
    for trial in trials:
        if trial.seed in sweep.seeds:
            groups.setdefault(key(trial.params), []).append(trial)
    found = [_setting(sweep, members) for members in groups.values()]
    sign = -1 if sweep.metric.goal == "maximize" else 1
    return sorted(found, key=lambda setting: (not setting.is_complete, sign * setting.score))


def _setting(sweep: Sweep, trials: Sequence[Trial]) -> Setting:
    finished = {trial.seed for trial in trials if trial.state == "finished"}
    ended = {trial.seed for trial in trials if trial.state != "unfinished"}
    return Setting(trials[0].params, tuple(trials), finished == set(sweep.seeds), ended == set(sweep.seeds))


def is_done(sweep: Sweep, folder: Path) -> bool:
    """Return whether there is nothing left to train."""
    closed = {key(setting.params) for setting in settings(sweep, read_trials(sweep, folder)) if setting.is_closed}
    if sweep.method == "bayes":
        return len(closed) >= sweep.n_settings
    return closed >= {key(setting) for setting in sweep.settings()}


def claim(sweep: Sweep, folder: Path) -> None:
    """Make the sweep's folder, or make sure that it is this sweep's.

    Raises:
        ConfigError: If it belongs to another sweep or cannot be written.
    """
    file = folder / SWEEP
    text = yaml.safe_dump(sweep.plain(), sort_keys=False)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if file.is_file() and _fixed(_described(file)) != _fixed(yaml.safe_load(text)):
            raise ConfigError(
                f"'{folder}' holds another sweep (see {SWEEP}), of which only {', '.join(MAY_CHANGE)} may change; "
                "choose another log folder with -f, or another file name"
            )
        with replacing(file) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot write to '{folder}' ({error.strerror}); choose a log folder with -f") from error


def _described(file: Path) -> Mapping[str, Any]:
    """Return what a sweep's folder says of the sweep."""
    content = read_yaml(file)
    if not isinstance(content, Mapping):
        raise ConfigError(
            f"'{file}' does not say which sweep the folder holds: it is empty or damaged; delete that file if the runs "
            "beside it are this sweep's, or choose another log folder with -f"
        )
    return content


def _fixed(description: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in description.items() if name not in MAY_CHANGE}
