"""Two runs that should be the same."""

import csv
from pathlib import Path
from typing import Any

import torch as th

from sb3_stereo.runs.directory import EVALUATIONS, load_record
from sb3_stereo.runs.models import checksums, load_model
from sb3_stereo.runs.training_state import variables


def assert_same(one: Any, other: Any) -> None:
    if isinstance(one, th.Tensor):
        assert th.equal(one, other)
    elif isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_same(one[key], other[key])
    else:
        assert one == other


def rows(path: Path, *timed: str) -> list[dict[str, str]]:
    with path.open() as file:
        lines = [line for line in file if not line.startswith("#")]
    return [{key: value for key, value in row.items() if key not in timed} for row in csv.DictReader(lines)]


def weights(run: Path, name: str) -> dict[str, Any]:
    model = load_model(load_record(run)[0], run / name, "cpu")
    return {**model.get_parameters(), **variables(model)}


def assert_same_runs(run: Path, expected: Path) -> None:
    """The same files, with the same in them but for the seconds; every model has its checksum and loads."""

    def names(folder: Path) -> set[str]:
        return {str(path.relative_to(folder)) for path in folder.rglob("*")}

    assert names(run) == names(expected)
    for path in sorted(expected.glob("*.zip")):
        assert_same(weights(run, path.name), weights(expected, path.name))
    assert [name for name, _ in checksums(run)] == [name for name, _ in checksums(expected)]
    assert rows(run / EVALUATIONS, "seconds") == rows(expected / EVALUATIONS, "seconds")
    for path in expected.glob("*monitor.csv"):
        assert rows(run / path.name, "t") == rows(path, "t")
        assert (run / path.name).read_text().startswith("#{") and (run / path.name).read_text().count("#") == 1
