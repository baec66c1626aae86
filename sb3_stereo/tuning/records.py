"""The trials of a sweep on disk: run directories are the only record, so nothing that is finished can be forgotten."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isnan, prod
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from sb3_stereo.config.schema import Config
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.scores import read_scores
from sb3_stereo.runs.directory import env_name, find_run, has_ended, load_record, run_ids
from sb3_stereo.runs.files import replacing
from sb3_stereo.tuning.config import Metric, Sweep

STOPPED = "stopped.txt"
SWEEP = "sweep.yml"
MAY_CHANGE = ("n_trials", "resources", "retries", "seeds")  # between two calls for the same sweep


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
    """Return a run's scores by step, none if it has none yet."""
    try:
        return read_scores(run)
    except ConfigError:
        return {}


def state(run: Path, config: Config) -> str:
    """Return "finished", "stopped" or "unfinished"."""
    if has_ended(run, config):
        return "finished"
    return "stopped" if (run / STOPPED).is_file() else "unfinished"


def find_trial(folder: Path, config: Config, seed: int) -> Path | None:
    """Return the run of exactly this configuration and seed, if there is one."""
    text = yaml.safe_dump(config.plain(), sort_keys=False)
    for number in run_ids(folder, config.algo, config.env_id):
        run = find_run(folder, config.algo, config.env_id, number)
        records = run / env_name(config.env_id)
        try:
            if (records / "config.yml").read_text(encoding="utf-8") != text:
                continue
            if yaml.safe_load((records / "args.yml").read_text(encoding="utf-8"))["seed"] == seed:
                return run
        except (OSError, yaml.YAMLError, KeyError, TypeError):  # killed while it was made: nobody's run
            continue
    return None


def read_trials(sweep: Sweep, folder: Path) -> list[Trial]:
    """Return all trials of a sweep that have a run."""
    algo, env_id = sweep.base.algo, sweep.base.env_id
    found = []
    for number in run_ids(folder, algo, env_id):
        run = find_run(folder, algo, env_id, number)
        try:
            config, args = load_record(run)
        except ConfigError:  # as above
            continue
        by_step = scores(run)
        last = max(by_step, default=0)
        score = defined(by_step[last][sweep.metric.score], sweep.metric) if by_step else sweep.metric.worst
        found.append(Trial(run, args["params"], args["seed"], state(run, config), last, score))
    return found


def defined(score: float, metric: Metric) -> float:
    """Return a score, or the worst one if it is undefined: schedulers and searchers cannot rank NaN."""
    return metric.worst if isnan(score) else score


def settings(sweep: Sweep, trials: Sequence[Trial]) -> list[Setting]:
    """Put the sweep's trials together by setting, the best first; complete ones before all others."""
    groups: dict[str, list[Trial]] = {}
    for trial in trials:
        if trial.seed in sweep.seeds:
            groups.setdefault(yaml.safe_dump(dict(trial.params)), []).append(trial)
    found = [_setting(sweep, members) for members in groups.values()]
    sign = -1 if sweep.metric.goal == "maximize" else 1
    return sorted(found, key=lambda setting: (not setting.is_complete, sign * setting.score))


def _setting(sweep: Sweep, trials: Sequence[Trial]) -> Setting:
    finished = {trial.seed for trial in trials if trial.state == "finished"}
    ended = {trial.seed for trial in trials if trial.state != "unfinished"}
    return Setting(trials[0].params, tuple(trials), finished == set(sweep.seeds), ended == set(sweep.seeds))


def is_done(sweep: Sweep, folder: Path) -> bool:
    """Return whether there is nothing left to train."""
    n_settings = sweep.n_trials or prod(len(parameter.values) for parameter in sweep.parameters)
    return sum(setting.is_closed for setting in settings(sweep, read_trials(sweep, folder))) >= n_settings


def claim(sweep: Sweep, folder: Path) -> None:
    """Make the sweep's folder, or make sure that it is this sweep's.

    Raises:
        ConfigError: If it belongs to another sweep or cannot be written.
    """
    file = folder / SWEEP
    text = yaml.safe_dump(sweep.plain(), sort_keys=False)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if file.is_file() and _fixed(file.read_text(encoding="utf-8")) != _fixed(text):
            raise ConfigError(
                f"'{folder}' holds another sweep (see {SWEEP}), of which only {', '.join(MAY_CHANGE)} may change; "
                "choose another log folder with -f, or another file name"
            )
        with replacing(file) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot write to '{folder}' ({error.strerror}); choose a log folder with -f") from error


def _fixed(text: str) -> dict[str, Any]:
    return {key: value for key, value in yaml.safe_load(text).items() if key not in MAY_CHANGE}
