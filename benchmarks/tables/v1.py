"""Rows on `WamStereoReach-v1` and its variants, where success means about 5 cm in space.

    python -m benchmarks.tables.v1

trains every cell (row x seed) that has no record yet, then writes `benchmarks/V1.md` from the records in
`benchmarks/results/`. It can be interrupted at any time; it loses no finished cell. `--report` only writes the report,
the same bytes from the same records.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks import FOLDER
from benchmarks.tables.cells import Row, parse_arguments, read, train_missing
from benchmarks.tables.readings import DDPG_CHECKPOINTS, DQN_CHECKPOINTS, OUR_CHECKPOINTS
from benchmarks.tables.report import provenance
from benchmarks.tables.row_tables import table
from sb3_stereo.commands.flags import run_command
from sb3_stereo.tuning.report import tell_failures

RANDOM_CHECKPOINTS = (2500, 5000, 10_000, 15_000, 20_000, 30_000)
FREQUENT = ("--eval-freq", "500")
CAMERAS = "docs/examples/turned_cameras.yml"


def on(env_id: str, name: str, algo: str, label: str, *arguments: str, checkpoints: Sequence[int]) -> Row:
    """A row of an environment of version 1."""
    return Row(f"v1_{name}", algo, label, ("--env", f"{env_id}-v1", *arguments), tuple(checkpoints))


def paper(algo: str, gamma: float) -> Row:
    """Table 1 or 2 of the paper, with a discount that it prints."""
    label = f"{algo.upper()}, Table {1 if algo == 'ddpg' else 2}, γ {gamma}"
    arguments = ("-conf", f"hyperparams/paper/{algo}.yml", "-params", f"gamma:{gamma}")
    checkpoints = DDPG_CHECKPOINTS if algo == "ddpg" else DQN_CHECKPOINTS
    return on("WamStereoReach", f"paper_{algo}_gamma_{gamma}", algo, label, *arguments, checkpoints=checkpoints)


OURS = on("WamStereoReach", "ours_ddpg", "ddpg", "**DDPG, ours**", *FREQUENT, checkpoints=OUR_CHECKPOINTS)
AUGMENTATION = ("-params", "augmentation.begin:2000", "augmentation.end:4000")  # docs/robustness.md
ROBUST = on(
    "WamStereoReach",
    "robust_ddpg",
    "ddpg",
    "DDPG, ours, augmented images (at step 1500: 50 of the poses)",
    *FREQUENT,
    *AUGMENTATION,
    checkpoints=OUR_CHECKPOINTS,
)
# What changes between the agent that ships and the task that it is fine-tuned to; all else is as in training.
CHANGES = {
    "target": ("a target 20 cm higher", "--env-kwargs", "target_position:[0.5,0.0,0.8]"),
    "cameras": ("cameras turned by 20 degrees", "--env-kwargs", f"cameras:{CAMERAS}"),
    "efforts": ("efforts half as large again", "--env-kwargs", "effort_limits:[30,45,15,7.5]"),
}
TUNING_CHECKPOINTS = (250, 500, 1000, 1500, 2000)
SHIPPED = "sb3_stereo/pretrained/ddpg/WamStereoReach-v1_1/WamStereoReach-v1.zip"
# The agent acts at once, and explores half as much as one that knows nothing.
TUNING = ("-i", SHIPPED, "--eval-freq", "250", "-params", "learning_starts:100", "exploration.initial_epsilon:0.5")


def changed(name: str, tuned: bool) -> Row:
    """Our DDPG on a changed task, from the agent that ships or from scratch."""
    label, *arguments = CHANGES[name]
    how, settings = ("tuned", TUNING) if tuned else ("scratch", FREQUENT)
    label = f"{label}, {'from the agent that ships' if tuned else 'from scratch'}"
    checkpoints = TUNING_CHECKPOINTS if tuned else OUR_CHECKPOINTS
    return on("WamStereoReach", f"{how}_{name}", "ddpg", label, *arguments, *settings, checkpoints=checkpoints)


SECTIONS = {
    "Fixed target": (
        OURS,
        on("WamStereoReach", "ours_dqn", "dqn", "**DQN, ours**", checkpoints=DQN_CHECKPOINTS),
        paper("ddpg", 0.99),
        *(paper("dqn", gamma) for gamma in (0.2, 0.5, 0.9)),
    ),
    "Augmented images": (ROBUST,),
    "Fine-tuning": tuple(changed(name, tuned) for name in CHANGES for tuned in (True, False)),
    "Randomised targets": (
        on(
            "WamStereoReachRandom",
            "random",
            "ddpg",
            "DDPG, ours",
            *("--eval-freq", "2500"),
            checkpoints=RANDOM_CHECKPOINTS,
        ),
    ),
    "Other arms": tuple(
        on(f"{arm}StereoReach", arm.lower(), "ddpg", f"the {arm}, our DDPG", *FREQUENT, checkpoints=OUR_CHECKPOINTS)
        for arm in ("Kuka", "Panda")
    ),
    "One view or two": tuple(
        on(
            "WamStereoReach",
            f"{view}_twice",
            "ddpg",
            f"the {view} view twice, our DDPG",
            *FREQUENT,
            *("--env-kwargs", f"cameras:[{view},{view}]"),
            checkpoints=OUR_CHECKPOINTS,
        )
        for view in ("left", "right")
    ),
}
ROWS = tuple(row for rows in SECTIONS.values() for row in rows)

HEAD = """# WamStereoReach-v1: measured results

Written by `python -m benchmarks.tables.v1 --report` from the records in `benchmarks/results/`; do not edit.

On version 1 success is judged at ρ = 5 px, about 4.7 cm in space ([The environment](../docs/environment.md)). The rows
give the distance in space at success, and how many of the 100 test poses end in success within 5 cm (– where a seed has
no record of it). Every agent is evaluated on the same 100 test poses, deterministically. Success is the mean over
seeds, with the 95 % bootstrap interval of the mean; the episode length and the distance are those of the successful
episodes. Rows of version 0: [Paper and v0, all rows](RESULTS.md), [Claims, all rows](CLAIMS.md).
"""


def write_v1(folder: Path) -> Path:
    """Write `V1.md` into `folder` and return its path."""
    parts = [HEAD]
    for title, rows in SECTIONS.items():
        measured = [row for row in rows if read(row.record)]
        parts += [f"## {title}\n\n{table(measured)}"] if measured else []
    missing = [row for row in ROWS if not read(row.record)]
    commands = "\n".join(f"- {row.label}: `{' '.join(row.command(0))}`" for row in missing)
    parts += [f"## Not measured yet\n\n{commands}\n"] if missing else []
    report = folder / "V1.md"
    report.write_text("\n".join([*parts, provenance(ROWS)]), encoding="utf-8")
    return report


def v1_command(args: argparse.Namespace) -> int:
    """Train what is missing and write the report."""
    failures = [] if args.report else train_missing(args.rows, range(args.seeds), args)
    print(f"Wrote {write_v1(FOLDER)}")
    return tell_failures(failures)


def main(argv: Sequence[str] | None = None) -> int:
    """Command line; the exit status is that of a sweep."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tables.v1", description="Rows on WamStereoReach-v1.")
    return run_command(v1_command, parse_arguments(parser, argv, 5, ROWS))


if __name__ == "__main__":
    sys.exit(main())
