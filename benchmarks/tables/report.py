"""The report of the tables, a pure function of the records."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from scipy.stats import bootstrap

import benchmarks
from benchmarks.tables.cells import Row, read
from benchmarks.tables.reading_curves import draw_readings
from benchmarks.tables.reading_tables import READINGS_PICTURE, reading_sections
from benchmarks.tables.readings import READING_ROWS, TRAINING_ROWS
from benchmarks.tables.row_tables import baseline_table, by_checkpoint, line_of, matrix, n_seeds, table
from sb3_stereo.evaluation.intervals import Floats, interquartile_mean, interval

matplotlib.use("Agg")
from matplotlib import pyplot as plt

HEAD = """# Measured results

Written by `python -m benchmarks.tables.paper --report` from the records in `benchmarks/results/`; do not edit.

Every agent is evaluated on the same 100 test poses, deterministically. Success is the mean over seeds, with the 95 %
bootstrap interval of the mean; steps are averaged over the poses that were reached (failures are not counted), then
over seeds. |a| is the mean absolute action on the way: near 1 the actor is saturated. "Published" are the paper's
numbers. The paper leaves open whether its batch normalisation at the input is per channel or per pixel; neither is
claimed to be the paper's. Where not all seeds of a row have come to its last checkpoint, a line says how many have.
"""


def write_report(rows: Sequence[Row], folder: Path) -> Path:
    """Write `RESULTS.md` and the pictures into `folder`, and return the report's path."""
    parts = [HEAD, *optimum(), *baseline_table()]
    strict = [row for row in rows if row not in (*READING_ROWS, *TRAINING_ROWS)]
    for algo, title in (("ddpg", "DDPG (Table 3)"), ("dqn", "DQN (Table 4)")):
        chosen = [row for row in strict if row.algo == algo and read(row.record)]
        if chosen:
            picture = f"learning_curves_{algo}.svg"
            draw(chosen, folder / picture, title)
            parts.append(f"## {title}\n\n![Success over environment steps]({picture})\n\n{table(chosen)}")
    parts += [*comparison(rows), *reading_sections(rows)]
    if any(read(row.record) for row in rows if row in READING_ROWS):
        draw_readings(rows, folder / READINGS_PICTURE)
    missing = [f"`{row.name}`" for row in rows if not read(row.record)]
    if missing:
        parts.append(f"Not measured yet: {', '.join(missing)}.\n")
    parts.append(provenance(rows))
    report = folder / "RESULTS.md"
    report.write_text("\n".join(parts), encoding="utf-8")
    return report


def optimum() -> list[str]:
    """What the planner of `benchmarks.analysis.optimum` needs, if it is recorded."""
    record = benchmarks.RESULTS / "optimum.csv"
    if not record.exists():
        return []
    steps = np.array([int(line["steps"]) for line in read(record, key=("pose",))])
    counts = ", ".join(f"{np.sum(steps == n)} in {n}" for n in range(1, steps.max() + 1))
    return [
        f"The best possible: a planner that knows the simulator reaches with {steps.mean():.2f} steps on average "
        f"({counts}; a search, so an upper bound; `python -m benchmarks.analysis.optimum`).\n"
    ]


# The paper's claim, for its own settings, with another discount, and for ours: (DDPG's row, DQN's row).
PAIRS = (
    ("paper_ddpg_channel_gamma_0.99", "paper_dqn_gamma_0.2"),
    ("paper_ddpg_pixel_gamma_0.99", "paper_dqn_gamma_0.2"),
    ("paper_ddpg_channel_gamma_0.5", "paper_dqn_gamma_0.2"),
    ("ours_ddpg", "ours_dqn"),
)
# By column of the records: how the table calls it, its unit, and whether more is better.
SCORES = {
    "success_rate": ("success, points", 100, True),
    "mean_steps_capped": ("episode length, failures as 30", 1, False),
}


def comparison(rows: Sequence[Row]) -> list[str]:
    """DDPG against DQN at the end of training, for the pairs that have two seeds each."""
    by_name = {row.name: row for row in rows}
    pairs = [(by_name[ddpg], by_name[dqn]) for ddpg, dqn in PAIRS if by_name.keys() >= {ddpg, dqn}]
    measured = [pair for pair in pairs if all(len(matrix(row, "success_rate")) > 1 for row in pair)]
    if not measured:
        return []
    head = ["DDPG", "DQN", "seeds", "score", "DDPG minus DQN", "DDPG is better"]
    lines = [head, ["---"] * len(head), *(_verdict(*pair, column) for pair in measured for column in SCORES)]
    text = "\n".join(map(line_of, lines))
    return [f"## Is DDPG better than DQN?\n\nAt the end of training.\n\n{text}\n"]


def _verdict(ddpg: Row, dqn: Row, column: str) -> list[str]:
    """A pair's line for one score: the difference of the means with its interval, and what follows."""
    score, unit, more_is_better = SCORES[column]
    ours, other = (unit * matrix(row, column)[:, -1] for row in (ddpg, dqn))
    low, high = difference(ours, other)
    above, below = ("confirmed", "refuted") if more_is_better else ("refuted", "confirmed")
    verdict = above if low > 0 else below if high < 0 else "undecided"
    labels = [row.label.strip("*") for row in (ddpg, dqn)]
    mean = f"{ours.mean() - other.mean():.1f} ({low:.1f} to {high:.1f})"
    return [*labels, f"{len(ours)} and {len(other)}", score, mean, verdict]


def difference(first: Floats, second: Floats) -> tuple[float, float]:
    """95 % bootstrap interval of the difference of two means over seeds."""
    if np.ptp(first) == np.ptp(second) == 0:
        return float(first[0] - second[0]), float(first[0] - second[0])

    def of_means(one: Floats, other: Floats, axis: int) -> Floats:
        return np.asarray(np.mean(one, axis=axis) - np.mean(other, axis=axis))

    result = bootstrap((first, second), of_means, method="percentile", rng=np.random.default_rng(0))
    return float(result.confidence_interval.low), float(result.confidence_interval.high)


def draw(rows: Iterable[Row], file: Path, title: str) -> None:
    """Success over steps: interquartile mean over seeds and its interval."""
    plt.rcParams["svg.hashsalt"] = "sb3_stereo"  # the same bytes from the same records
    figure, axes = plt.subplots(figsize=(7.5, 5.6), layout="constrained")
    for row in rows:
        seeds = by_checkpoint(row, "success_rate")
        scored = [100 * values for values in seeds if len(values)]
        middle = [interquartile_mean(values) for values in scored]
        low, high = np.transpose([interval(values, interquartile_mean) for values in scored])
        steps = [step for step, values in zip(row.checkpoints, seeds, strict=True) if len(values)]
        (curve,) = axes.plot(steps, middle, marker="o", label=f"{row.label.strip('*')} ({n_seeds(seeds)})")
        axes.fill_between(steps, low, high, alpha=0.2, color=curve.get_color())
    axes.set(title=title, xlabel="environment steps", ylabel="test poses reached [%]", ylim=(-3, 103))
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", fontsize="small")  # inside it would hide curves
    figure.savefig(file, metadata={"Date": None})
    plt.close(figure)


def provenance(rows: Iterable[Row]) -> str:
    """The versions that made the records."""
    known = sorted({line["versions"] for row in rows for line in read(row.record)})
    return "Made with: " + "; ".join(known) + ".\n" if known else "No records yet.\n"
