"""The paper's Tables 3 and 4 next to ours.

    python -m benchmarks.tables.paper

trains every cell (row x seed) that has no record yet, as a trial of Ray Tune each, then writes `benchmarks/RESULTS.md`
and the learning curves from the records in `benchmarks/results/`. It can be interrupted at any time; it loses no
finished cell. `--report` only writes the report, the same bytes from the same records.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import benchmarks
from benchmarks import FOLDER
from benchmarks.tables.cells import Row, parse_arguments, train_missing
from benchmarks.tables.readings import (
    DDPG_CHECKPOINTS,
    DQN_CHECKPOINTS,
    OUR_CHECKPOINTS,
    READING_ROWS,
    TRAINING_ROWS,
)
from benchmarks.tables.report import write_report
from sb3_stereo.commands.flags import run_command
from sb3_stereo.tuning.report import tell_failures

PIXEL = "policy_kwargs.features_extractor_kwargs.input_norm:pixel"


def paper_ddpg(gamma: float, reading: str) -> Row:
    """Table 1, with one of the two readings of "batch normalisation at the input"."""
    params = (f"gamma:{gamma}", *([PIXEL] if reading == "pixel" else []))
    arguments = ("-conf", "hyperparams/paper/ddpg.yml", "-params", *params)
    label = f"DDPG, Table 1, γ {gamma}, input statistics per {reading}"
    return Row(f"paper_ddpg_{reading}_gamma_{gamma}", "ddpg", label, arguments, DDPG_CHECKPOINTS)


def paper_dqn(gamma: float) -> Row:
    """Table 2. It names no optimizer for DQN; this is Adam, as for DDPG."""
    arguments = ("-conf", "hyperparams/paper/dqn.yml", "-params", f"gamma:{gamma}")
    return Row(f"paper_dqn_gamma_{gamma}", "dqn", f"DQN, Table 2, γ {gamma}, Adam", arguments, DQN_CHECKPOINTS)


ROWS = (
    Row("ours_ddpg", "ddpg", "**DDPG, ours**", ("--eval-freq", "500"), OUR_CHECKPOINTS),
    # The same settings since the update is written out in `StereoDDPG`, which draws its samples in another order.
    Row("ours_stereo_ddpg", "ddpg", "**DDPG, ours, as StereoDDPG**", ("--eval-freq", "500"), OUR_CHECKPOINTS),
    paper_ddpg(0.99, "channel"),
    paper_dqn(0.2),
    Row("ours_dqn", "dqn", "**DQN, ours**", (), DQN_CHECKPOINTS),
    paper_ddpg(0.99, "pixel"),
    paper_dqn(0.5),
    paper_dqn(0.9),
    paper_ddpg(0.9, "channel"),
    paper_ddpg(0.5, "channel"),
    *READING_ROWS,
    *TRAINING_ROWS,
)


def quick(row: Row) -> Row:
    """The same row, so short that all of them take minutes: everything is run and nothing is learnt."""
    params = ("learning_starts:20", "batch_size:8")
    flags = row.arguments if "-params" in row.arguments else (*row.arguments, "-params")
    return replace(row, arguments=(*flags, *params), checkpoints=(30,))


def train_quickly(args: argparse.Namespace) -> int:
    """Run everything in a temporary folder and show the report."""
    with tempfile.TemporaryDirectory() as folder:
        benchmarks.RESULTS, args.logs = Path(folder) / "results", Path(folder) / "logs"
        rows = [quick(row) for row in args.rows]
        failures = train_missing(rows, range(1), args)
        print(write_report(rows, Path(folder)).read_text(encoding="utf-8"))
        return tell_failures(failures)


def tables_command(args: argparse.Namespace) -> int:
    """Train what is missing and write the report."""
    if args.quick:
        return train_quickly(args)
    failures = [] if args.report else train_missing(args.rows, range(args.seeds), args)
    print(f"Wrote {write_report(ROWS, FOLDER)}")
    return tell_failures(failures)


def main(argv: Sequence[str] | None = None) -> int:
    """Command line; the exit status is that of a sweep."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tables.paper", description="Tables 3 and 4 and ours.")
    parser.add_argument("--quick", action="store_true", help="a tiny version of everything, in a temporary folder")
    return run_command(tables_command, parse_arguments(parser, argv, 5, ROWS))


if __name__ == "__main__":
    sys.exit(main())
