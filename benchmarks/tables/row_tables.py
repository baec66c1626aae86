"""Tables of rows and of baselines, as Markdown: pure functions of the records."""

from collections.abc import Iterable, Sequence

import numpy as np

from benchmarks.analysis.baselines import TASKS, Line, goal_record, read_lines, task_of
from benchmarks.tables.cells import Row, read
from sb3_stereo.evaluation.intervals import Floats, interval

# Success in % and average number of steps at each of a row's checkpoints, by discount.
TABLE_3 = {0.99: ((100, 100, 100, 100, 100), (1.95, 2.92, 2.42, 2.21, 1.98))}
TABLE_4 = {
    0.2: ((31, 100, 81, 100, 100), (21.31, 2.52, 8.86, 3.15, 2.96)),
    0.5: ((62, 64, 89, 97, 96), (16.19, 12.35, 6.11, 4.7, 6.12)),
}
READING_NAMES = ("observation", "long_pulses", "observation_close")
PUBLISHED: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    **{f"paper_ddpg_{norm}_gamma_{gamma}": TABLE_3[gamma] for norm in ("channel", "pixel") for gamma in TABLE_3},
    **{f"{name}_ddpg_gamma_{gamma}": TABLE_3[gamma] for name in READING_NAMES for gamma in TABLE_3},
    **{f"{name}_dqn_gamma_{gamma}": TABLE_4[gamma] for name in ("paper", *READING_NAMES) for gamma in TABLE_4},
}


def by_checkpoint(row: Row, column: str) -> list[Floats]:
    """One column of a row's record: at each checkpoint, the values of the seeds that were scored there."""
    lines = read(row.record)
    return [np.array([float(line[column]) for line in lines if int(line["timesteps"]) == s]) for s in row.checkpoints]


def matrix(row: Row, column: str) -> Floats:
    """One column of a row's record, shape (n_seeds, n_checkpoints), of the seeds that were trained to the end."""
    by_seed: dict[str, dict[int, float]] = {}
    for line in read(row.record):
        by_seed.setdefault(line["seed"], {})[int(line["timesteps"])] = float(line[column])
    finished = [scores for scores in by_seed.values() if row.checkpoints[-1] in scores]
    return np.array([[scores[step] for step in row.checkpoints] for scores in finished])


def table(rows: Iterable[Row], level: int = 3) -> str:
    """A Markdown table per row under a heading of this level: a column per checkpoint."""
    return "\n".join(f"{'#' * level} {_row_table(row)}" for row in rows)


def _row_table(row: Row) -> str:
    success = [100 * values for values in by_checkpoint(row, "success_rate")]
    steps, actions, values = (by_checkpoint(row, name) for name in ("mean_steps_success", "mean_action", "mean_q"))
    lines = [
        f"{row.label}, {n_seeds(success)}\n",
        *without_learning(row),
        line_of(["environment steps", *(f"{step}" for step in row.checkpoints)]),
        line_of(["---"] * (len(row.checkpoints) + 1)),
        line_of(["success, %", *map(with_interval, success)]),
        *_published(row, "published success, %", 0),
        line_of(["episode length (successes)", *map(mean, steps)]),
        *_published(row, "published steps", 1),
        *_distances(row),
        line_of(["mean \\|a\\|", *map(mean, actions)]),
        line_of(["mean Q", *map(mean, values)]),
    ]
    counts = [len(column) for column in success]
    if len(set(counts)) > 1:
        lines.append(line_of(["seeds", *map(str, counts)]))
    return "\n".join(lines) + f"\n\n`{' '.join(row.command(0))}`\n"


def _distances(row: Row) -> list[str]:
    """The lines of the distance in space at success, if the row's records have it."""
    if not all(line.get("median_distance_success") for line in read(row.record)):
        return []
    median, quantile_95, near = (
        [100 * values for values in by_checkpoint(row, name)]
        for name in ("median_distance_success", "p95_distance_success", "within_5cm")
    )
    return [
        line_of(["distance at success, cm: median", *map(mean, median)]),
        line_of(["distance at success, cm: 95 %", *map(mean, quantile_95)]),
        line_of(["success within 5 cm, %", *map(_with_interval_if_known, near)]),
    ]


def _with_interval_if_known(values: Floats) -> str:
    return "–" if np.isnan(values).any() else with_interval(values)


def _published(row: Row, name: str, which: int) -> list[str]:
    """The line of the paper's success (0) or steps (1), if it has this row."""
    return [line_of([name, *map(str, PUBLISHED[row.name][which])])] if row.name in PUBLISHED else []


def n_seeds(columns: Sequence[Floats]) -> str:
    """How many seeds were scored at the checkpoints, in words."""
    most = max(map(len, columns))
    fewest = min(map(len, columns))
    return f"{most} seed" + "s" * (most != 1) + (f", {fewest or 'none'} to the end" if fewest < most else "")


def line_of(entries: Sequence[str]) -> str:
    """A line of a Markdown table."""
    return f"| {' | '.join(entries)} |"


def with_interval(values: Floats) -> str:
    """Mean over seeds and its interval, in %."""
    if len(values) < 2:
        return f"{values[0]:.1f}" if len(values) else "–"  # one seed has no interval
    low, high = interval(values)
    return f"{values.mean():.1f} ({low:.0f} to {high:.0f})"


def mean(values: Floats) -> str:
    """Over the seeds that have a value; a seed that never reached has no steps."""
    known = values[~np.isnan(values)]
    return f"{known.mean():.2f}" if known.size else "–"


def baseline_table() -> list[str]:
    """A section with what needs no learning, on every task where it is recorded."""
    head = ["task", "without learning", "success, %", "episode length (successes)", "episode length, failures as 30"]
    lines = [
        [task.label, entry["baseline"], f"{success_of(entry):.0f}", *steps_of(entry)]
        for task in TASKS
        for entry in read_lines(task.record)
    ]
    if not lines:
        return []
    text = "\n".join(map(line_of, [head, ["---"] * len(head), *lines]))
    return [f"## What a number is worth\n\n{BASELINES_TEXT}\n\n{text}\n", *goal_table()]


BASELINES_TEXT = """What scores without learning, from the same test starts as the agents
(`python -m benchmarks.analysis.baselines`). The constant action is chosen on other starts and repeated whatever the
cameras see."""


def goal_table() -> list[str]:
    """How near in space a goal is, on every task where it is recorded."""
    entries = {entry["task"]: entry for entry in read_lines(goal_record())}
    lines = [
        [task.label, *(f"{float(entry[name]):.1f}" for name in ("median_cm", "quantile_95_cm")), _percent(entry)]
        for task in TASKS
        if (entry := entries.get(task.name))
    ]
    if not lines:
        return []
    head = ["task", "median, cm", "95 %, cm", "within 5 cm, %"]
    text = "\n".join(map(line_of, [head, ["---"] * len(head), *lines]))
    return [f"How far from the target the end effector is in space, over the random poses that are goals:\n\n{text}\n"]


def _percent(entry: Line) -> str:
    """The share of goals that are near, in %."""
    return f"{100 * float(entry['within_5_cm']):.1f}"


def success_of(entry: Line) -> float:
    """A baseline's success in %."""
    return 100 * float(entry["success_rate"])


def steps_of(entry: Line) -> list[str]:
    """A baseline's episode length: of successes, and with failures counted as the cap."""
    return [mean(np.array([float(entry[column])])) for column in ("mean_steps_success", "mean_steps_capped")]


def without_learning(row: Row) -> list[str]:
    """One line with the baselines on a row's task, if they are recorded."""
    task = task_of(row.config())
    entries = read_lines(task.record) if task else []
    told = [f"{entry['baseline']} {success_of(entry):.0f} % in {steps_of(entry)[0]} steps" for entry in entries]
    return [f"Without learning: {'; '.join(told)}.\n"] if told else []
