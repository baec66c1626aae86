"""What is wrong with a value, said in one sentence; YAML files; and dataclasses as plain values."""

import math
import os
import reprlib
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

MAX_FILE_SIZE = 16 * 2**20  # [bytes], of what describes a robot or cameras

_QUOTE = reprlib.Repr()  # its depth and lengths are bounded, and so is the time for a list of lists of lists
_QUOTE.maxlevel, _QUOTE.maxstring, _QUOTE.maxother, _QUOTE.maxlong = 3, 300, 300, 40
_QUOTE.maxlist = _QUOTE.maxtuple = _QUOTE.maxdict = _QUOTE.maxset = _QUOTE.maxfrozenset = _QUOTE.maxdeque = 12


def require(condition: bool | np.bool_, message: str) -> None:
    """Raise a ValueError unless the condition holds."""
    if not condition:
        raise ValueError(message)


def quoted(value: object) -> str:
    """Return a value for a message: on one line, whatever it is, and not endless."""
    try:
        return " ".join(_QUOTE.repr(value).split())
    except ValueError:  # Python spells no integer of thousands of digits
        return "a huge number"


def require_known(kind: str, name: object, names: Iterable[str], whose: str) -> None:
    """Raise a ValueError that lists the names unless `name` is one of them."""
    known = list(names)
    require(name in known, f"unknown {kind} {quoted(name)}; {whose} are {', '.join(map(_printable, known))}")


def _printable(name: str) -> str:
    return name if name.isprintable() else quoted(name)


def require_readable(path: str, what: str, way_out: str) -> None:
    """Raise a ValueError unless there is such a file, not empty and not huge."""
    require(os.path.isfile(path), f"no {what} file {quoted(path)}; {way_out}")  # Path.is_file raises for a long name
    size = os.path.getsize(path)
    require(0 < size <= MAX_FILE_SIZE, f"{quoted(path)} has {size} bytes; give a file of 1 to {MAX_FILE_SIZE}")


def read_yaml(path: str, what: str) -> Any:
    """Return what a YAML file holds; nothing in it is evaluated.

    Raises:
        ValueError: If there is no such file, or it is not plain YAML.
    """
    from sb3_stereo.envs import plain_yaml  # not needed for what comes with the package

    path = os.path.expanduser(path)  # a shell leaves the ~ of arm:~/my_arm.yml alone
    require_readable(path, what, "give the path of a YAML file")
    try:
        return plain_yaml.read(Path(path))
    except OSError as error:
        raise ValueError(f"cannot read {quoted(path)} ({error.strerror}); make it readable") from error
    except ValueError as error:
        raise ValueError(f"{quoted(path)} is not plain YAML: {error}") from error


def plain(value: Any) -> Any:
    """Return a dataclass, or a sequence of them, as maps, lists, numbers and texts."""
    if hasattr(value, "__dataclass_fields__"):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return [plain(item) for item in value] if isinstance(value, Sequence) and not isinstance(value, str) else value


def as_number(value: Any) -> float | None:
    """Return the finite number that a value is or spells, or None."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return None if isinstance(value, bool) or not math.isfinite(number) else number
