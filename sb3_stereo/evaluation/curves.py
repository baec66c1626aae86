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
    "success_rate": "reached [%]",
    "mean_steps_success": "episode length (successes)",
    "mean_return": "return",
    "mean_q": "Q",
    "mean_action": "|a|",
}


# The same in every figure; further curves of an algorithm are lighter.
COLOURS = {"ddpg": "C0", "dqn": "C1", "td3": "C2", "sac": "C3", "ppo": "C4", "tqc": "C5", "crossq": "C6"}
LIGHTER = (1.0, 0.6, 0.35)  # opacity
MAX_LABEL = 40  # characters of one value
NAMES = ("name", "urdf")  # fields by which a map is called


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
    parts = dict(_part(key, settings, differing) for key in differing)
    return ", ".join([str(settings["algo"]), *(f"{name} {value}" for name, value in parts.items())])


def _part(key: str, settings: Mapping[str, Any], differing: Sequence[str]) -> tuple[str, str]:
    """How a label says one setting; a map of which several fields differ is said once, by its name."""
    parent, _, field = key.rpartition(".")
    fields = {other.removeprefix(f"{parent}.") for other in differing if other.startswith(f"{parent}.")}
    known = next((name for name in NAMES if f"{parent}.{name}" in settings), None)
    if len(fields) > 1 and fields & set(NAMES):
        return parent.rpartition(".")[2], short(settings[f"{parent}.{known}"]) if known else "default"
    return field, short(settings[key]) if key in settings else "default"


def short(value: Any) -> str:
    """Say a value in a few characters: cameras by their names, a file by its stem, others cut off."""
    if isinstance(value, Mapping):
        name = next((value[name] for name in NAMES if name in value), None)
        return f"{len(value)} fields" if name is None else short(name)
    if isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value):
        return "+".join(map(short, value))
    text = Path(value).stem if isinstance(value, str) and value.endswith((".urdf", ".yml")) else str(value)
    return text if len(text) <= MAX_LABEL else f"{text[: MAX_LABEL - 1]}…"


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
    columns["success_rate"] = 100 * columns["success_rate"]
    return [Curves(f"{name} ({len(runs)} run{'s' * (len(runs) > 1)})", np.array(timesteps), columns)]


def draw(groups: Sequence[Curves], file: Path, names: Sequence[str] | None = None) -> None:
    """Draw a panel per score that is known: the mean over runs and its 95 % bootstrap interval.

    Args:
        groups: The curves.
        file: Where the picture goes.
        names: What the curves are called; None takes their labels.

    Raises:
        ConfigError: If the picture cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    known = [c for c in PANELS if c == "success_rate" or any(np.isfinite(group.scores[c]).any() for group in groups)]
    figure, axes = plt.subplots(1, len(known), figsize=(4 * len(known), 3.6), layout="constrained", squeeze=False)
    looks = _looks(groups)
    for column, panel in zip(known, axes[0], strict=True):
        for group, look in zip(groups, looks, strict=True):
            _draw_curve(panel, group, column, look)
        panel.set(title=PANELS[column], xlabel="environment steps")
        panel.grid(alpha=0.3)
    axes[0, 0].set(ylim=(-3, 103))
    labels = [textwrap.fill(name, 28 * len(known)) for name in names or [group.label for group in groups]]
    figure.legend(axes[0, 0].get_lines(), labels, loc="outside lower left", fontsize="small")
    save_figure(figure, file)


def save_figure(figure: Any, file: Path) -> None:
    """Write a matplotlib figure and close it.

    Raises:
        ConfigError: If it cannot be written.
    """
    from matplotlib import pyplot as plt

    try:
        figure.savefig(file, dpi=120)
    except OSError as error:
        raise ConfigError(f"cannot write '{file}' ({error.strerror}); choose another with -o") from error
    finally:
        plt.close(figure)


def _looks(groups: Sequence[Curves]) -> list[dict[str, Any]]:
    """Colour and opacity of every curve: the colour is the algorithm's."""
    algos = [group.label.partition(" ")[0].rstrip(",") for group in groups]
    others = (f"C{number}" for number in range(7, 10))
    colours = {algo: COLOURS.get(algo) or next(others, "C9") for algo in dict.fromkeys(algos)}
    return [
        {"color": colours[algo], "alpha": LIGHTER[algos[:number].count(algo) % len(LIGHTER)]}
        for number, algo in enumerate(algos)
    ]


def _draw_curve(panel: Any, group: Curves, column: str, look: Mapping[str, Any]) -> None:
    values = group.scores[column]
    shown = np.isfinite(values).any(axis=0)  # e.g. no steps before the first success
    steps, known = group.timesteps[shown], [row[np.isfinite(row)] for row in values[:, shown].T]
    panel.plot(steps, [row.mean() for row in known], "o-" if len(steps) > 1 else "s", markersize=4, **look)
    if len(values) > 1 and known:
        from sb3_stereo.evaluation.intervals import interval

        low, high = np.transpose([interval(row) for row in known])
        if len(steps) > 1:
            panel.fill_between(steps, low, high, alpha=0.2 * look["alpha"], color=look["color"])
        else:  # a single score is no curve
            panel.vlines(steps, low, high, **look)
