"""Learning curves of runs: the mean over seeds with its bootstrap interval."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.config.schema import plain_settings
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.scores import read_scores
from sb3_stereo.runs.directory import read_record

Floats = NDArray[np.float64]


PANELS = {
    "success_rate": "reached",
    "mean_steps_success": "episode length (successes)",
    "mean_return": "return",
    "mean_q": "Q",
    "mean_action": "|a|",
}


class Curves(NamedTuple):
    """Runs of one configuration, which differ in their seeds."""

    label: str
    timesteps: NDArray[np.int64]  # (n_checkpoints,), those that all runs have
    scores: dict[str, Floats]  # column: (n_runs, n_checkpoints)


def readable_runs(runs: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """Return the runs that can be drawn, each once, and why each of the others cannot."""
    found, left_out = [], []
    for run in {run.resolve(): run for run in runs}.values():
        try:
            _settings(run)
            read_scores(run)
            found.append(run)
        except ConfigError as error:
            left_out.append(str(error))
    return found, left_out


def _settings(run: Path) -> dict[str, Any]:
    """A run's settings as its record has them: drawing needs no environment, so nothing is imported."""
    record = read_record(run)
    try:
        return plain_settings(record.algo, record.config)
    except (AttributeError, TypeError, ValueError) as error:
        raise ConfigError(f"'{run}' is not the record of a training ({type(error).__name__})") from error


def group_runs(runs: Sequence[Path]) -> list[Curves]:
    """Put runs of equal configuration together, and label the groups by what differs."""
    groups: list[tuple[dict[str, Any], list[Path]]] = []
    for run in runs:
        found = _settings(run)
        members = next((members for known, members in groups if known == found), None)
        if members is None:
            groups.append((found, [run]))
        else:
            members.append(run)
    everything = [settings for settings, _ in groups]
    return [curves for settings, members in groups for curves in _curves(label(settings, everything), members)]


def label(settings: Mapping[str, Any], everything: Sequence[Mapping[str, Any]]) -> str:
    """The algorithm, and the settings that are not the same in all groups."""
    keys = sorted({key for other in everything for key in other} - {"algo"})
    differing = [key for key in keys if any(other.get(key) != everything[0].get(key) for other in everything)]
    return ", ".join([str(settings["algo"]), *(f"{key.rpartition('.')[2]} {settings.get(key)}" for key in differing)])


def _curves(name: str, runs: Sequence[Path]) -> list[Curves]:
    """Return the curves of a group: one of all its runs, or one each if they have no step in common."""
    scores = [read_scores(run) for run in runs]
    timesteps = sorted(set.intersection(*(set(by_step) for by_step in scores)))
    if not timesteps:
        return [curves for run in runs for curves in _curves(f"{name}, {run.name}", [run])]
    columns = {
        column: np.array([[by_step[step].get(column, np.nan) for step in timesteps] for by_step in scores])
        for column in PANELS
    }
    return [Curves(f"{name} ({len(runs)} run{'s' * (len(runs) > 1)})", np.array(timesteps), columns)]


def draw(groups: Sequence[Curves], file: Path) -> None:
    """Draw a panel per score that is known: the mean over runs and its 95 % bootstrap interval."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    known = [c for c in PANELS if c == "success_rate" or any(np.isfinite(group.scores[c]).any() for group in groups)]
    figure, axes = plt.subplots(1, len(known), figsize=(4 * len(known), 3.6), layout="constrained", squeeze=False)
    for column, panel in zip(known, axes[0], strict=True):
        for group in groups:
            _draw_curve(panel, group, column)
        panel.set(title=PANELS[column], xlabel="environment steps")
        panel.grid(alpha=0.3)
    axes[0, 0].set(ylim=(-0.03, 1.03))
    labels = [textwrap.fill(group.label, 28 * len(known)) for group in groups]
    figure.legend(axes[0, 0].get_lines(), labels, loc="outside lower left", fontsize="small")
    try:
        figure.savefig(file, dpi=120)
    except OSError as error:
        raise ConfigError(f"cannot write '{file}' ({error.strerror}); choose another with -o") from error
    finally:
        plt.close(figure)


def _draw_curve(panel: Any, group: Curves, column: str) -> None:
    values = group.scores[column]
    shown = np.isfinite(values).any(axis=0)  # e.g. no steps before the first success
    steps, known = group.timesteps[shown], [row[np.isfinite(row)] for row in values[:, shown].T]
    (curve,) = panel.plot(steps, [row.mean() for row in known], marker="o", markersize=3)
    if len(values) > 1 and known:
        from sb3_stereo.evaluation.intervals import interval

        low, high = np.transpose([interval(row) for row in known])
        panel.fill_between(steps, low, high, alpha=0.2, color=curve.get_color())
