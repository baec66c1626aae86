"""Cells of the tables: one training run per row and seed, and its record."""

from __future__ import annotations

import argparse
import csv
import math
import shutil
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import benchmarks
from sb3_stereo.commands.train import make_config, make_options, make_parser
from sb3_stereo.config.schema import Config
from sb3_stereo.console import Bar
from sb3_stereo.runs.creation import versions
from sb3_stereo.runs.directory import EVALUATIONS
from sb3_stereo.runs.files import replacing
from sb3_stereo.tuning.cluster import add_cluster_flags, check_cluster_flags, connected
from sb3_stereo.tuning.config import Metric

if TYPE_CHECKING:
    from sb3_stereo.tuning.trials import Training

V0 = "WamStereoReach-v0"  # of rows that name no environment: the paper's scale
SUCCESS = Metric("eval/success_rate", "maximize")
RETRIES = 2


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
        env = [] if "--env" in self.arguments else ["--env", V0]
        return ["python", "train.py", "--algo", self.algo, *env, *self.arguments, "--seed", str(seed), *length]

    def config(self) -> Config:
        """What that command learns."""
        return make_config(make_parser().parse_args(self.command(seed=0)[2:]))

    @property
    def record(self) -> Path:
        """The file with a line per seed and checkpoint."""
        return benchmarks.RESULTS / f"{self.name}.csv"

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
        columns = dict.fromkeys(column for line in reversed(lines) for column in line)  # older lines have fewer
        writer = csv.DictWriter(file, fieldnames=list(columns), restval="nan", lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)


def train_missing(rows: Sequence[Row], seeds: Iterable[int], args: argparse.Namespace) -> list[str]:
    """Train every cell that has no record, seed by seed so that all rows grow together, and record each at once.

    Cells are trials of Ray Tune, like a sweep's: one that was interrupted goes on, one that fails is tried again and
    does not stop the others.

    Args:
        rows: Whose cells.
        seeds: Of every row.
        args: Of `parse_arguments`.

    Returns:
        What failed.
    """
    missing = [(row, seed) for seed in seeds for row in rows if seed not in row.done()]
    if not missing:
        return []
    check_cluster_flags(args)
    logs = args.logs.absolute()
    logs.mkdir(parents=True, exist_ok=True)
    tune_folder = Path(tempfile.mkdtemp(prefix="tune_", dir=logs))  # not shared with a call for other rows
    failures: list[str] = []
    try:
        with connected(args.address), closing(Recorder(missing)) as recorder:
            from sb3_stereo.tuning.trials import fit_listed

            trainings = [cell_training(row, seed, logs) for row, seed in missing]
            failures = fit_listed(trainings, tune_folder, args.workers, RETRIES, recorder.record)
    finally:
        if not failures:  # else their errors are there
            shutil.rmtree(tune_folder, ignore_errors=True)
    return failures


def cell_training(row: Row, seed: int, logs: Path) -> Training:
    """A cell as a trial: an ordinary run, with one thread."""
    from sb3_stereo.tuning.trials import Training

    flags = ["-f", str(logs / row.name / f"seed_{seed}"), "--num-threads", "1", "--n-eval-envs", "1", "--verbose", "0"]
    command = [*row.command(seed), *flags]
    args = make_parser().parse_args(command[2:])
    return Training(cell_name(row, seed), make_config(args), make_options(args), vars(args), command, SUCCESS)


def cell_name(row: Row, seed: int) -> str:
    """What a person calls a cell."""
    return f"{row.name}, seed {seed}"


class Recorder:
    """Writes the records of cells as they end, and counts them.

    Args:
        missing: The cells.
    """

    def __init__(self, missing: Iterable[tuple[Row, int]]) -> None:
        self.cells = {cell_name(row, seed): (row, seed) for row, seed in missing}
        self.bar = Bar(len(self.cells), "cell", interval=math.inf)  # a cell has a line of its own
        self.n_recorded = 0

    def record(self, training: Training, result: Mapping[str, Any]) -> str:
        """Record a cell and return what is said of it."""
        row, seed = self.cells[training.name]
        lines = cell_lines(row, seed, Path(result["run"]))
        write(row.record, [line for line in read(row.record) if int(line["seed"]) != seed] + lines)
        self.n_recorded += 1
        self.bar.update(self.n_recorded)
        count = f"{self.n_recorded}/{self.bar.total}"
        return f"{count}: {training.name}, {describe(lines[-1])}, {self.bar.left(self.n_recorded)}"

    def close(self) -> None:
        """Leave the bar as it stands."""
        self.bar.close()


def cell_lines(row: Row, seed: int, run: Path) -> list[dict[str, str]]:
    """A cell's scores with where they come from."""
    provenance = {
        "command": " ".join(row.command(seed)),
        "versions": ", ".join(f"{name} {found}" for name, found in versions().items()),
    }
    with (run / EVALUATIONS).open(newline="", encoding="utf-8") as file:
        return [{"seed": str(seed), **line, **provenance} for line in csv.DictReader(file)]


def parse_arguments(
    parser: argparse.ArgumentParser, argv: Sequence[str] | None, n_seeds: int, rows: Sequence[Row]
) -> Any:
    """Parse the arguments that the scripts of tables share; `rows` becomes the chosen ones."""
    parser.add_argument("--seeds", type=int, default=n_seeds, help=f"seeds per row, from 0 (default: {n_seeds})")
    parser.add_argument("--rows", nargs="+", default=[], metavar="NAME", help="only these (default: all)")
    add_cluster_flags(parser)
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
