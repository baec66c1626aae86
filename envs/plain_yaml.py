"""YAML as plain data: nothing in it is evaluated, and a short text cannot become a huge value."""

import re
from pathlib import Path
from typing import Any

import yaml

MAX_BYTES = 2**20  # of a file
MAX_VALUES = 100_000  # that a text stands for, counted with what its aliases repeat; our files have about a hundred


class _Loader(yaml.SafeLoader):
    """YAML 1.1 as PyYAML reads it, with 1e-3 as a number and not as a text."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[+-]?\d+(\.\d*)?[eE][+-]?\d+$"), list("+-0123456789")
)


def parse(text: str) -> Any:
    """Return what a text holds.

    Raises:
        ValueError: If it is not plain YAML, with the reason.
    """
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        if node is None:
            return None
        if _size(node, {}) > MAX_VALUES:  # before anything is made of it: merged maps would grow at once
            raise ValueError(f"it stands for more than {MAX_VALUES} values, counted with what its aliases repeat")
        return loader.construct_document(node)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except (yaml.YAMLError, ValueError, OverflowError, TypeError, AttributeError, LookupError) as error:
        # Of scalars that look like dates, numbers or binaries and are none, PyYAML's constructors raise anything.
        raise ValueError(" ".join(str(error).split())) from error


def read(path: Path) -> Any:
    """Return what a file holds.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is too large or not plain YAML, with the reason.
    """
    with path.open("rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise ValueError(f"it has more than {MAX_BYTES} bytes")
    return parse(content.decode("utf-8"))


def _size(node: yaml.Node, known: dict[int, int]) -> int:
    """Count the values that a node stands for; one that holds itself stands for infinitely many."""
    if id(node) in known:
        if known[id(node)] == 0:
            raise ValueError("it holds an alias of a value inside that value")
        return known[id(node)]
    known[id(node)] = 0
    pairs = node.value if isinstance(node, yaml.MappingNode) else []
    items = node.value if isinstance(node, yaml.SequenceNode) else [item for pair in pairs for item in pair]
    known[id(node)] = 1 + sum(_size(item, known) for item in items)
    return known[id(node)]
