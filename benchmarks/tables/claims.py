"""Claims that the paper does not measure: randomised targets, stereo, other observation layouts, other arms.

    python -m benchmarks.tables.claims

trains every cell (row x seed) that has no record yet, asks every trained run for depth (`benchmarks.analysis.depth`),
and writes `benchmarks/CLAIMS.md` from the records in `benchmarks/results/`. It can be interrupted at any time; it loses
no finished cell. `--report` only writes the report, the same bytes from the same records.
"""

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import benchmarks
from benchmarks import FOLDER
from benchmarks.analysis.depth import probe
from benchmarks.tables.cells import Row, parse_arguments, read, train_missing, write
from benchmarks.tables.paper import ROWS
from benchmarks.tables.readings import OUR_CHECKPOINTS
from benchmarks.tables.reference import REFERENCE
from benchmarks.tables.report import provenance
from benchmarks.tables.row_tables import line_of, table
from sb3_stereo.commands.flags import run_command
from sb3_stereo.console import print_line
from sb3_stereo.runs.directory import model_path
from sb3_stereo.tuning.records import find_trial
from sb3_stereo.tuning.report import tell_failures

RANDOM = ("--env", "WamStereoReachRandom-v0", "--eval-freq", "2500")
RANDOM_CHECKPOINTS = (2500, 5000, 7500, 10_000, 15_000, 20_000, 30_000)
HALF = RANDOM_CHECKPOINTS[:5]  # of the agents that are compared with each other and not with the aim
FIXED = ("--eval-freq", "500")
NO_MIRROR = ("-params", "replay_buffer_kwargs.mirror_probability:0")
EXTRACTOR = "policy_kwargs.features_extractor_kwargs"
# The target without its colour, and with the blur and the resolution that leave it more of its contrast.
LUMINANCE = ("--env-kwargs", "composite:stack", "-params", f"{EXTRACTOR}.blur:1.5", f"{EXTRACTOR}.downsample:2")
# A view keeps its 42 rows, which are 14 after the blur: with the default strides the last convolution finds too few.
CHANNELS = ("--env-kwargs", "composite:channels", "-params", f"{EXTRACTOR}.strides:[2,1,1]")


def twice(view: str) -> tuple[str, ...]:
    """Flags that show one view in both places."""
    return "--env-kwargs", f"cameras:[{view},{view}]"


def fixed(name: str, label: str, *arguments: str) -> Row:
    """Our DDPG on the fixed target."""
    return Row(name, "ddpg", f"Fixed target, {label}", (*FIXED, *arguments), OUR_CHECKPOINTS)


def random(name: str, label: str, *arguments: str, checkpoints: tuple[int, ...] = HALF) -> Row:
    """Our DDPG on randomised targets."""
    return Row(name, "ddpg", f"Drawn targets, {label}", (*RANDOM, *arguments), checkpoints)


BOTH = replace(next(row for row in ROWS if row.name == "ours_ddpg"), label="Fixed target, both views")
SECTIONS = {
    "Any target": (
        random("random_both", "both views", checkpoints=RANDOM_CHECKPOINTS),
        random("random_luminance", "both views, luminance only", *LUMINANCE),
    ),
    "Does stereo matter?": (
        BOTH,
        fixed("fixed_both_no_mirror", "both views, nothing mirrored", *NO_MIRROR),
        fixed("fixed_left", "the left view twice", *twice("left")),
        fixed("fixed_right", "the right view twice", *twice("right")),
        random("random_both_no_mirror", "both views, nothing mirrored", *NO_MIRROR),
        random("random_left", "the left view twice", *twice("left")),
        random("random_right", "the right view twice", *twice("right")),
    ),
    "Stack or channels?": (fixed("fixed_channels", "a view in each channel", *CHANNELS),),
    "Does the fast path learn the same?": (BOTH, fixed("fixed_reference", "both views, reference path", *REFERENCE)),
    "Other arms": tuple(
        fixed(f"arm_{arm.lower()}", f"the {arm}", "--env", f"{arm}StereoReach-v0") for arm in ("Kuka", "Panda")
    ),
}
CLAIMS = tuple(dict.fromkeys(row for rows in SECTIONS.values() for row in rows))  # each once

HEAD = """# Claims that the paper does not measure

Written by `python -m benchmarks.tables.claims --report` from the records in `benchmarks/results/`; do not edit.

Success, episode lengths and intervals are those of [Paper and v0, all rows](RESULTS.md). With randomised targets, each
of the 100 test poses has a target of its own. An agent that is given one view twice is rewarded and judged by that view
alone: its goal is a line of sight, and its success is not comparable. What is comparable is the distance in space in
the last table. Such an agent is trained without mirror-symmetry augmentation, so both views are also measured without
it. The reference path is the learner without what makes it fast (`benchmarks/tables/reference.py`): NCHW convolutions,
an Adam that is not fused.
"""


def depth_record(row: Row) -> Path:
    """The file with the row's errors, a line per seed, point and source."""
    return benchmarks.RESULTS / f"{row.name}_depth.csv"


def probe_missing(rows: Iterable[Row], seeds: Iterable[int], logs: Path, n_poses: int = 5000) -> None:
    """Ask the runs of all rows for depth that were not asked yet; a run that is not in `logs` is passed over."""
    for row in rows:
        record, config = depth_record(row), row.config()
        done = {int(line["seed"]) for line in read(record)}
        for seed in set(seeds) - done:
            run = find_trial(logs / row.name / f"seed_{seed}", config, seed)
            if run is None or seed not in row.done():
                continue
            errors = probe(config, model_path(run, config.env_id), n_poses)
            where_from = {"seed": str(seed), "timesteps": str(row.checkpoints[-1])}
            lines = [where_from | {key: str(value) for key, value in error._asdict().items()} for error in errors]
            write(record, [*read(record), *lines])
            print_line(f"{row.name}, seed {seed}: {errors[0].point} {errors[0].median:.1f} cm")


def depth_lines(row: Row) -> list[str]:
    """A line of the depth table for each error of a row, its mean over seeds."""
    by_name: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for line in read(depth_record(row)):
        values = float(line["median"]), float(line["quantile_95"])
        by_name.setdefault((line["point"], line["source"]), []).append(values)
    means = {name: np.mean(values, axis=0) for name, values in by_name.items()}
    label = row.label.strip("*")
    return [
        line_of([label, *name, f"{median:.1f}", f"{quantile_95:.1f}", str(len(by_name[name]))])
        for name, (median, quantile_95) in means.items()
    ]


def depth_table(rows: Iterable[Row]) -> list[str]:
    """What the extractors know of depth, and how far in space the agents end."""
    lines = [line for row in rows for line in depth_lines(row)]
    if not lines:
        return []
    head = [line_of(["agent", "point", "read from", "median, cm", "95 %, cm", "seeds"]), line_of(["---"] * 6)]
    text = "Errors of `python -m benchmarks.analysis.depth RUN` on poses that took no part in its fit, mean over seeds."
    return [f"## Where things are, in space\n\n{text}\n\n" + "\n".join([*head, *lines]) + "\n"]


def write_claims(folder: Path) -> Path:
    """Write `CLAIMS.md` into `folder` and return its path."""
    parts = [HEAD]
    for title, rows in SECTIONS.items():
        measured = [row for row in rows if read(row.record)]
        parts += [f"## {title}\n\n{table(measured)}"] if measured else []
    parts += depth_table(CLAIMS)
    missing = [row for row in CLAIMS if not read(row.record)]
    commands = "\n".join(f"- {row.label}: `{' '.join(row.command(0))}`" for row in missing)
    parts += [f"## Not measured yet\n\n{commands}\n"] if missing else []
    report = folder / "CLAIMS.md"
    report.write_text("\n".join([*parts, provenance(CLAIMS)]), encoding="utf-8")
    return report


def claims_command(args: argparse.Namespace) -> int:
    """Train and probe what is missing, and write the report."""
    failures = []
    if not args.report:
        failures = train_missing(args.rows, range(args.seeds), args)
        probe_missing(args.rows, range(args.seeds), args.logs)
    print(f"Wrote {write_claims(FOLDER)}")
    return tell_failures(failures)


def main(argv: Sequence[str] | None = None) -> int:
    """Command line; the exit status is that of a sweep."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tables.claims", description=__doc__.splitlines()[0])
    return run_command(claims_command, parse_arguments(parser, argv, 3, CLAIMS))


if __name__ == "__main__":
    sys.exit(main())
