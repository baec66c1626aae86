"""The report of the tables, a pure function of the records."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from scipy.stats import bootstrap

import benchmarks
from benchmarks.tables.cells import Row, read
from sb3_stereo.evaluation.intervals import Floats, interquartile_mean, interval

matplotlib.use("Agg")
from matplotlib import pyplot as plt

# Tables 3 and 4: success in % and average number of steps at each row's checkpoints.
PUBLISHED = {
    "paper_ddpg_channel_gamma_0.99": ((100, 100, 100, 100, 100), (1.95, 2.92, 2.42, 2.21, 1.98)),
    "paper_ddpg_pixel_gamma_0.99": ((100, 100, 100, 100, 100), (1.95, 2.92, 2.42, 2.21, 1.98)),
    "paper_dqn_gamma_0.2": ((31, 100, 81, 100, 100), (21.31, 2.52, 8.86, 3.15, 2.96)),
    "paper_dqn_gamma_0.5": ((62, 64, 89, 97, 96), (16.19, 12.35, 6.11, 4.7, 6.12)),
}

HEAD = """# Measured results

Written by `python -m benchmarks.tables.paper --report` from the records in `benchmarks/results/`; do not edit.

Every agent is scored on the same 100 test poses, deterministically. Success is the mean over seeds, with the 95 %
bootstrap interval of the mean; steps are averaged over the poses that were reached (failures are not counted), then
over seeds. |a| is the mean absolute action on the way: near 1 the actor is saturated. "Published" are the paper's
numbers. The paper leaves open whether its batch normalisation at the input is per channel or per pixel, and whether DQN
too is trained with Adam or with RMSprop as in Mnih et al. 2015; neither reading is claimed to be the paper's.
"""


def write_report(rows: Sequence[Row], folder: Path) -> Path:
    """Write `RESULTS.md` and the pictures into `folder`, and return the report's path."""
    parts = [HEAD, *optimum()]
    for algo, title in (("ddpg", "DDPG (Table 3)"), ("dqn", "DQN (Table 4)")):
        chosen = [row for row in rows if row.algo == algo and read(row.record)]
        if chosen:
            picture = f"learning_curves_{algo}.svg"
            draw(chosen, folder / picture, title)
            parts.append(f"## {title}\n\n![Success over environment steps]({picture})\n\n{table(chosen)}")
    parts += comparison(rows)
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
    "mean_steps_capped": ("steps, failures as 30", 1, False),
}


def comparison(rows: Sequence[Row]) -> list[str]:
    """DDPG against DQN at the end of their trainings, for the pairs that have two seeds each."""
    by_name = {row.name: row for row in rows}
    pairs = [(by_name[ddpg], by_name[dqn]) for ddpg, dqn in PAIRS if by_name.keys() >= {ddpg, dqn}]
    measured = [pair for pair in pairs if all(len(matrix(row, "success_rate")) > 1 for row in pair)]
    if not measured:
        return []
    head = ["DDPG", "DQN", "seeds", "score", "DDPG minus DQN", "DDPG is better"]
    lines = [head, ["---"] * len(head), *(_verdict(*pair, column) for pair in measured for column in SCORES)]
    text = "\n".join(map(line_of, lines))
    return [f"## Is DDPG better than DQN?\n\nAt the end of their trainings.\n\n{text}\n"]


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


def matrix(row: Row, column: str) -> Floats:
    """One column of a row's record, shape (n_seeds, n_checkpoints)."""
    by_seed: dict[str, dict[int, float]] = {}
    for line in read(row.record):
        by_seed.setdefault(line["seed"], {})[int(line["timesteps"])] = float(line[column])
    finished = [scores for scores in by_seed.values() if row.checkpoints[-1] in scores]
    return np.array([[scores[step] for step in row.checkpoints] for scores in finished])


def table(rows: Iterable[Row]) -> str:
    """A Markdown table per row: a column per checkpoint."""
    return "\n".join(_row_table(row) for row in rows)


def _row_table(row: Row) -> str:
    success, steps = 100 * matrix(row, "success_rate"), matrix(row, "mean_steps_success")
    actions, values = matrix(row, "mean_action"), matrix(row, "mean_q")
    lines = [
        f"### {row.label}, {_seeds(success)}\n",
        line_of(["environment steps", *(f"{step}" for step in row.checkpoints)]),
        line_of(["---"] * (len(row.checkpoints) + 1)),
        line_of(["success, %", *(_with_interval(column) for column in success.T)]),
        line_of(["steps when reached", *(_mean(column) for column in steps.T)]),
        line_of(["mean \\|a\\|", *(_mean(column) for column in actions.T)]),
        line_of(["mean Q", *(_mean(column) for column in values.T)]),
    ]
    if row.name in PUBLISHED:
        published_success, published_steps = PUBLISHED[row.name]
        lines.insert(4, line_of(["published success, %", *map(str, published_success)]))
        lines.insert(6, line_of(["published steps", *map(str, published_steps)]))
    return "\n".join(lines) + f"\n\n`{' '.join(row.command(0))}`\n"


def _seeds(matrix_of_row: Floats) -> str:
    n_seeds = len(matrix_of_row)
    return f"{n_seeds} seed" + "s" * (n_seeds != 1)


def line_of(entries: Sequence[str]) -> str:
    """A line of a Markdown table."""
    return f"| {' | '.join(entries)} |"


def _with_interval(values: Floats) -> str:
    if len(values) == 1:
        return f"{values[0]:.1f}"  # one seed has no interval
    low, high = interval(values)
    return f"{values.mean():.1f} ({low:.0f} to {high:.0f})"


def _mean(values: Floats) -> str:
    """Over the seeds that have a value; a seed that never reached has no steps."""
    known = values[~np.isnan(values)]
    return f"{known.mean():.2f}" if known.size else "–"


def draw(rows: Iterable[Row], file: Path, title: str) -> None:
    """Success over steps: interquartile mean over seeds and its interval."""
    plt.rcParams["svg.hashsalt"] = "sb3_stereo"  # the same bytes from the same records
    figure, axes = plt.subplots(figsize=(7.5, 5.6), layout="constrained")
    for row in rows:
        success = 100 * matrix(row, "success_rate")
        middle = interquartile_mean(success, axis=0)
        low, high = np.transpose([interval(column, interquartile_mean) for column in success.T])
        (curve,) = axes.plot(row.checkpoints, middle, marker="o", label=f"{row.label.strip('*')} ({_seeds(success)})")
        axes.fill_between(row.checkpoints, low, high, alpha=0.2, color=curve.get_color())
    axes.set(title=title, xlabel="environment steps", ylabel="test poses reached [%]", ylim=(-3, 103))
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", fontsize="small")  # inside it would hide curves
    figure.savefig(file, metadata={"Date": None})
    plt.close(figure)


def provenance(rows: Iterable[Row]) -> str:
    """The versions that made the records."""
    known = sorted({line["versions"] for row in rows for line in read(row.record)})
    return "Made with: " + "; ".join(known) + ".\n" if known else "No records yet.\n"
