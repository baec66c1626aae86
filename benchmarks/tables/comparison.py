"""What a user would pick instead of our learner, on `WamStereoReach-v1`, with equal environment steps.

    python -m benchmarks.tables.comparison

trains every cell (row x seed) that has no record yet, then writes `benchmarks/COMPARISON.md` from the records in
`benchmarks/results/`. It can be interrupted at any time; it loses no finished cell. `--report` only writes the report.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks import FOLDER
from benchmarks.analysis.baselines import TASKS, read_lines
from benchmarks.tables.cells import Row, parse_arguments, read, train_missing
from benchmarks.tables.report import provenance
from benchmarks.tables.row_tables import by_checkpoint, line_of, mean, steps_of, success_of, with_interval
from benchmarks.tables.v1 import OURS, ROBUST
from sb3_stereo.commands.flags import run_command
from sb3_stereo.evaluation.intervals import Floats
from sb3_stereo.tuning.report import tell_failures

N_STEPS = 8500
SCORED = (2000, 4000, 6000, N_STEPS)
GOALS, IMAGES = "WamStereoReachGoal-v0", "WamStereoReach-v1"
ENOUGH = 0.95  # success, in the last column


def peer(name: str, algo: str, label: str, *arguments: str, env_id: str = IMAGES) -> Row:
    """A row of the comparison; it is scored rarely, because an agent that fails takes 30 steps from every pose."""
    return Row(f"peer_{name}", algo, label, ("--env", env_id, "--eval-freq", "2000", *arguments), SCORED)


def cnn(algo: str, *arguments: str) -> Row:
    """SB3's algorithm with its own `CnnPolicy`."""
    settings = "ppo" if algo == "ppo" else "cnn"
    return peer(f"cnn_{algo}", algo, algo.upper(), "-conf", f"hyperparams/peers/{settings}.yml", *arguments)


def ours(algo: str) -> Row:
    """The same algorithm with our encoder and replay: the settings of `hyperparams/ALGO.yml`."""
    whole_rollouts = ("-params", "n_steps:125", "batch_size:125") if algo == "ppo" else ()
    name = "CrossQ" if algo == "crossq" else algo.upper()
    return peer(f"encoder_{algo}", algo, f"{name} with our encoder", *whole_rollouts)


def told(name: str, label: str) -> Row:
    """A learner that is told what the image shows."""
    return peer(name, "sac", label, "-conf", f"hyperparams/peers/{name}.yml", env_id=GOALS)


NOISE = ("-params", "noise_type:normal", "noise_std:0.3")
SECTIONS = {
    "SB3's algorithms with their own CnnPolicy": (
        *(cnn(algo, *NOISE) for algo in ("ddpg", "td3")),
        *(cnn(algo) for algo in ("sac", "tqc", "ppo")),
        peer("drq", "sac", "SAC with DrQ-v2's recipe", "-conf", "hyperparams/peers/drq.yml"),
    ),
    "The same with our encoder": tuple(ours(algo) for algo in ("td3", "sac", "tqc", "crossq", "ppo")),
    "Told what the image shows": (
        told("centres", "SAC on the markers' centres"),
        told("state", "SAC on joint angles and centres"),
        told("state_her", "SAC with HER on joint angles and centres"),
    ),
}
ROWS = tuple(row for rows in SECTIONS.values() for row in rows)

HEAD = f"""# What a user would pick instead: measured results

Written by `python -m benchmarks.tables.comparison --report` from the records in `benchmarks/results/`; do not edit.

Every learner has {N_STEPS} environment steps on the same task (`{IMAGES}`, success within about 5 cm), with its own
default settings or the few that `hyperparams/peers/` gives and says why; none of these was tuned, ours was. Success is
that of the deterministic agent on the same 100 test poses, the mean over seeds with the 95 % bootstrap interval.
The last column is the first step at which every seed had been scored with {100 * ENOUGH:.0f} % or more; ours are scored
every 500 steps, the others every 2000.
"""


def entry(row: Row) -> str:
    """A row's line in its section's table."""
    success = [100 * values for values in by_checkpoint(row, "success_rate")]
    cells = [
        row.label,
        str(max(map(len, success))),
        *map(with_interval, success),
        mean(by_checkpoint(row, "mean_steps_success")[-1]),
        near(by_checkpoint(row, "within_5cm")[-1]),
        first_enough(row),
    ]
    return line_of(cells)


def near(shares: Floats) -> str:
    """Success within 5 cm, in %, the mean over seeds."""
    known = 100 * shares[~np.isnan(shares)]
    return f"{known.mean():.1f}" if known.size else "–"


def first_enough(row: Row) -> str:
    """The first step at which every seed had been scored with `ENOUGH`, or a dash."""
    firsts: dict[str, int] = {}
    for line in read(row.record):
        if float(line["success_rate"]) >= ENOUGH:
            firsts.setdefault(line["seed"], int(line["timesteps"]))
    seeds = {line["seed"] for line in read(row.record)}
    return str(int(np.max(list(firsts.values())))) if seeds and firsts.keys() == seeds else "–"


def table(rows: Sequence[Row]) -> str:
    """Of the rows that have a record."""
    steps = [f"{step} steps" for step in SCORED]
    head = ["learner", "seeds", *steps, "episode length", "within 5 cm, %", "95 % from"]
    measured = [entry(row) for row in rows if read(row.record)]
    return "\n".join([line_of(head), line_of(["---"] * len(head)), *measured])


def without_learning() -> str:
    """What needs no learning, on the same poses."""
    task = next(task for task in TASKS if task.name == "v1")
    known = read_lines(task.record)
    lines = [line_of([one["baseline"], f"{success_of(one):.0f}", steps_of(one)[0]]) for one in known]
    head = ["without learning", "success, %", "episode length"]
    return "\n".join([line_of(head), line_of(["---"] * len(head)), *lines])


def write_comparison(folder: Path) -> Path:
    """Write `COMPARISON.md` into `folder` and return its path."""
    parts = [HEAD, f"## Ours\n\n{table((at_scored(OURS), at_scored(ROBUST)))}\n"]
    parts += [f"## {title}\n\n{table(rows)}\n" for title, rows in SECTIONS.items() if any(map(recorded, rows))]
    parts += [f"## Without learning\n\n{without_learning()}\n"]
    commands = [f"- {row.label}: `{' '.join(row.command(0))}`" for row in (OURS, ROBUST, *ROWS)]
    missing = [row.label for row in ROWS if not recorded(row)]
    parts += ["## Commands\n\n" + "\n".join(commands) + "\n"]
    parts += [f"Not measured yet: {', '.join(missing)}.\n"] if missing else []
    report = folder / "COMPARISON.md"
    report.write_text("\n".join([*parts, provenance((OURS, ROBUST, *ROWS))]), encoding="utf-8")
    return report


def recorded(row: Row) -> bool:
    """Whether a row has any score."""
    return bool(read(row.record))


def at_scored(row: Row) -> Row:
    """The same row, shown at the steps of the comparison."""
    return Row(row.name, row.algo, row.label, row.arguments, SCORED)


def comparison_command(args: argparse.Namespace) -> int:
    """Train what is missing and write the report."""
    failures = [] if args.report else train_missing(args.rows, range(args.seeds), args)
    print(f"Wrote {write_comparison(FOLDER)}")
    return tell_failures(failures)


def main(argv: Sequence[str] | None = None) -> int:
    """Command line; the exit status is that of a sweep."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tables.comparison", description="Other learners on v1.")
    return run_command(comparison_command, parse_arguments(parser, argv, 3, ROWS))


if __name__ == "__main__":
    sys.exit(main())
