"""Two runs that should be the same."""

import csv
from pathlib import Path
from typing import Any

import torch as th


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
