"""Cells of the tables: one training of one row with one seed, and its record."""

from __future__ import annotations

import argparse
import csv
import math
import subprocess
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sb3_stereo.config import Config, load_config
from sb3_stereo.files import replacing
from sb3_stereo.progress import Bar, say
from sb3_stereo.runs import EVALUATIONS, has_ended, versions
from sb3_stereo.runtime import available_cores
from sb3_stereo.train import make_parser
from sb3_stereo.tuning.records import find_trial
from sb3_stereo.values import parse_assignments

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True)
class Row:
    """A row of a table: what is trained, the same for every seed.

    Attributes:
        name: Of the record file, and of the row's runs.
        algo: "ddpg" or "dqn".
        label: How the table calls it.
        arguments: Of `train.py`, besides algorithm, seed, length and folder.
        checkpoints: Environment steps at which the agent is scored; the last one ends the training.
    """

    name: str
    algo: str
    label: str
    arguments: tuple[str, ...]
    checkpoints: tuple[int, ...]

    def command(self, seed: int) -> list[str]:
        """What a person would type to train the same cell."""
        length = ["-n", str(self.checkpoints[-1])]
        return ["python", "train.py", "--algo", self.algo, *self.arguments, "--seed", str(seed), *length]

    def config(self) -> Config:
        """What that command learns."""
        args = make_parser().parse_args(self.command(seed=0)[2:])
        params, env_kwargs = parse_assignments(args.hyperparams), parse_assignments(args.env_kwargs)
        return load_config(args.algo, args.env, args.conf_file, params, env_kwargs, args.n_timesteps)

    @property
    def record(self) -> Path:
        """The file with a line per seed and checkpoint."""
        return RESULTS / f"{self.name}.csv"

    def done(self) -> set[int]:
        """Seeds whose training is recorded to its end."""
        return {int(line["seed"]) for line in read(self.record) if int(line["timesteps"]) >= self.checkpoints[-1]}


def read(record: Path, key: Sequence[str] = ("seed", "timesteps")) -> list[dict[str, str]]:
    """The lines of a record in the order of these columns; none if there is no record."""
    if not record.exists():
        return []
    with record.open(newline="", encoding="utf-8") as file:
        return sorted(csv.DictReader(file), key=lambda line: [int(line[column]) for column in key])


def write(record: Path, lines: Iterable[dict[str, str]]) -> None:
    """Write a record anew, sorted, in one step: an interruption leaves the old one or the new one."""
    lines = sorted(lines, key=lambda line: (int(line["seed"]), int(line["timesteps"])))
    record.parent.mkdir(parents=True, exist_ok=True)
    with replacing(record) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(lines[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)


def train_missing(rows: Iterable[Row], seeds: Iterable[int], logs: Path, n_workers: int) -> None:
    """Train every cell that has no record, seed by seed so that all rows grow together, and record each at once.

    A cell that fails is reported and does not stop the others; the next call tries it again.

    Raises:
        RuntimeError: At the end, if a cell failed.
    """
    missing = [(row, seed) for seed in seeds for row in rows if seed not in row.done()]
    failed = []
    bar = Bar(len(missing), "cell", interval=math.inf)  # a cell has a line of its own
    with ThreadPoolExecutor(n_workers) as pool:
        futures = {pool.submit(train_cell, row, seed, logs): (row, seed) for row, seed in missing}
        for number, future in enumerate(as_completed(futures), 1):
            row, seed = futures[future]
            bar.update(number)
            try:
                lines = future.result()
            except (subprocess.CalledProcessError, OSError) as error:
                failed.append(f"{row.name}, seed {seed}: {error}")
                continue
            write(row.record, [line for line in read(row.record) if int(line["seed"]) != seed] + lines)
            say(f"{number}/{len(missing)}: {row.name}, seed {seed}, {describe(lines[-1])}, {bar.left(number)}")
    bar.close()
    if failed:
        raise RuntimeError("some cells failed:\n" + "\n".join(failed))


def parse_arguments(
    parser: argparse.ArgumentParser, argv: Sequence[str] | None, n_seeds: int, rows: Sequence[Row]
) -> Any:
    """Parse the arguments that the scripts of tables share; `rows` becomes the chosen ones."""
    parser.add_argument("--seeds", type=int, default=n_seeds, help=f"seeds per row, from 0 (default: {n_seeds})")
    parser.add_argument("--rows", nargs="+", default=[], metavar="NAME", help="only these (default: all)")
    parser.add_argument("--workers", type=int, default=available_cores(), help="cells at a time (default: the cores)")
    parser.add_argument("--logs", type=Path, default=Path("logs/tables"), help="the cells' runs (default: logs/tables)")
    parser.add_argument("--report", action="store_true", help="train nothing")
    args = parser.parse_args(argv)
    names = [row.name for row in rows]
    for name in set(args.rows) - set(names):
        parser.error(f"unknown row '{name}'; rows are {', '.join(names)}")
    args.rows = [row for row in rows if not args.rows or row.name in args.rows]
    return args


def describe(line: dict[str, str]) -> str:
    """A recorded score as a person says it."""
    return f"{100 * float(line['success_rate']):.0f} % at step {line['timesteps']}"


def train_cell(row: Row, seed: int, logs: Path) -> list[dict[str, str]]:
    """Train one cell in a process of its own, with one thread, and return its scores with where they come from.

    A run of the same settings that was interrupted goes on from its last checkpoint.
    """
    folder = logs / row.name / f"seed_{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    config = row.config()
    run = find_trial(folder, config, seed)
    if run is None:
        flags = ("-f", str(folder), "--num-threads", "1", "--n-eval-envs", "1")
        train([*row.command(seed)[2:], *flags], folder)
    elif not has_ended(run, config):
        train(["--resume", str(run)], folder)
    run = find_trial(folder, config, seed)
    assert run is not None  # else the training would have failed
    provenance = {
        "command": " ".join(row.command(seed)),
        "versions": ", ".join(f"{name} {found}" for name, found in versions().items()),
    }
    with (run / EVALUATIONS).open(newline="", encoding="utf-8") as file:
        return [{"seed": str(seed), **line, **provenance} for line in csv.DictReader(file)]


def train(arguments: Sequence[str], folder: Path) -> None:
    """Call `train.py` and keep what it prints."""
    with (folder / "output.txt").open("a", encoding="utf-8") as output:
        command = [sys.executable, "-m", "sb3_stereo.train", *arguments]
        subprocess.run(command, stdout=output, stderr=output, check=True)
