"""The figure of the readings: success of the paper's settings, with the published numbers and the baselines."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib

from benchmarks.analysis.baselines import STRICT, Task, read_lines
from benchmarks.tables.cells import Row, read
from benchmarks.tables.readings import READINGS
from benchmarks.tables.row_tables import PUBLISHED, by_checkpoint, success_of

matplotlib.use("Agg")
from matplotlib import pyplot as plt

DEFAULT = ("paper_ddpg_channel_gamma_0.99", *(f"paper_dqn_gamma_{gamma}" for gamma in (0.2, 0.5, 0.9)))
LABELS = ("DDPG, γ 0.99", "DQN, γ 0.2", "DQN, γ 0.5", "DQN, γ 0.9")
BASELINES = {"random actions": ":", "best constant action": "--"}  # and how they are drawn


def draw_readings(rows: Sequence[Row], file: Path) -> None:
    """Draw a panel for the default task and for each reading: of `rows`, those that are recorded."""
    default = tuple(row for name in DEFAULT for row in rows if row.name == name)
    panels = [(STRICT, "default: ρ = 10 px of 320×240", default)]
    panels += [(reading.task, reading.short, reading.rows[: len(LABELS)]) for reading in READINGS]
    figure, axes = plt.subplots(1, len(panels), figsize=(13, 4.2), sharey=True, layout="constrained")
    for axis, (task, title, chosen) in zip(axes, panels, strict=True):
        _draw_rows(axis, chosen)
        _draw_baselines(axis, task)
        axis.set(title=title, xlabel="environment steps", ylim=(-3, 106))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("test poses reached [%]")
    handles = {label: line for axis in axes for line, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4, fontsize="small")
    figure.savefig(file, metadata={"Date": None})
    plt.close(figure)


def _draw_rows(axis: Any, rows: Iterable[Row]) -> None:
    """Measured rows, the mean over seeds, and as crosses what is published of them."""
    for number, (row, label) in enumerate(zip(rows, LABELS)):
        color = f"C{number}"
        if read(row.record):
            pairs = zip(row.checkpoints, by_checkpoint(row, "success_rate"), strict=True)
            steps, success = zip(*((step, 100 * values.mean()) for step, values in pairs if len(values)), strict=True)
            axis.plot(steps, success, marker="o", color=color, label=label)
        if row.name in PUBLISHED:
            published, _ = PUBLISHED[row.name]
            axis.plot(row.checkpoints, published, "x:", color=color, alpha=0.6, label=f"{label}, published")


def _draw_baselines(axis: Any, task: Task) -> None:
    """What is reached without learning, as level lines."""
    for entry in read_lines(task.record):
        if entry["baseline"] in BASELINES:
            style = BASELINES[entry["baseline"]]
            axis.axhline(success_of(entry), color="black", alpha=0.6, linestyle=style, label=entry["baseline"])
