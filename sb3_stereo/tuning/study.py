"""A sweep as an Optuna study: for Optuna's plots, its dashboard and its importances.

The run directories remain the only record; the study is written anew from them with every report.
"""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.study import StudyDirection

from sb3_stereo.tuning.config import Sweep
from sb3_stereo.tuning.parameters import Choice, Parameter
from sb3_stereo.tuning.records import Setting
from sb3_stereo.tuning.space import distribution, point

JOURNAL = "optuna.log"
MAX_PANELS = 10


def write_study(sweep: Sweep, found: Sequence[Setting], folder: Path) -> optuna.Study:
    """Write the complete settings into an Optuna journal, `optuna-dashboard optuna.log` opens it, and return the study.

    Args:
        sweep: What is searched.
        found: Its settings; the value of each is the mean over its seeds.
        folder: Where the journal lies.
    """
    file = folder / JOURNAL
    file.unlink(missing_ok=True)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    direction = StudyDirection[sweep.metric.goal.upper()]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        storage = JournalStorage(JournalFileBackend(str(file)))
        study = optuna.create_study(storage=storage, study_name=folder.name, direction=direction)
    space = {parameter.name: _plain(parameter) for parameter in sweep.parameters}
    for setting in sorted(found, key=_first_run):
        params = {p.name: _named(p, value) for p, value in _values(sweep, setting)}
        attributes = {
            "seeds": [trial.seed for trial in setting.trials],
            "runs": [trial.run.name for trial in setting.trials],
            "scores": [trial.score for trial in setting.trials],
        }
        study.add_trial(
            optuna.create_trial(params=params, distributions=space, value=setting.score, user_attrs=attributes)
        )
    return study


def draw_slices(study: optuna.Study, sweep: Sweep, file: Path) -> None:
    """Draw the metric over each parameter, Optuna's slice plot; later trials are darker."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from optuna.visualization.matplotlib import plot_slice

    names = [parameter.name for parameter in sweep.parameters][:MAX_PANELS]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that it is experimental, and that an axis with one value has no length
        axes: Any = plot_slice(study, params=names, target_name=sweep.metric.name)
    figure: Any = (axes if len(names) == 1 else axes[0]).get_figure()
    figure.set_size_inches(3.2 * len(names) + 1.6, 3.8)
    figure.savefig(file, dpi=120, bbox_inches="tight")
    plt.close(figure)


def _first_run(setting: Setting) -> int:
    """The number of a setting's first run, in whose order they were begun."""
    return min(int(trial.run.name.rpartition("_")[2]) for trial in setting.trials)


def _values(sweep: Sweep, setting: Setting) -> list[tuple[Parameter, Any]]:
    values = point(sweep, setting.params)
    return [(parameter, values[parameter.name]) for parameter in sweep.parameters]


def _plain(parameter: Parameter) -> BaseDistribution:
    """The distribution of a parameter; choices by their names, because Optuna stores neither lists nor maps."""
    if isinstance(parameter, Choice):
        return CategoricalDistribution([str(value) for value in parameter.values])
    return distribution(parameter)


def _named(parameter: Parameter, value: Any) -> Any:
    return str(value) if isinstance(parameter, Choice) else value
