"""Specifications from plain maps, as YAML gives them: checked, with the choices named."""

import math
import os
import reprlib
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

Spec = TypeVar("Spec")

_NAMES = {float: "a number", int: "an integer", str: "a text", bool: "true or false"}
MAX_NUMBER = 1e4  # of a specification's, in SI units: far above any robot's, far below where physics ends in NaN
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


def require_known(kind: str, name: object, names: typing.Iterable[str], whose: str) -> None:
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


def from_map(cls: Callable[..., Spec], values: Any, what: str) -> Spec:
    """Make a frozen dataclass from a plain map.

    Lists become tuples, a map becomes its pairs where pairs are wanted, and numbers may be written as texts such as
    1e-3, which YAML does not read as numbers.

    Args:
        cls: The dataclass.
        values: Its fields.
        what: What it specifies, for messages.

    Raises:
        ValueError: If a field is unknown, missing, or not of its type.
    """
    require(isinstance(values, Mapping), f"{what} is {quoted(values)}; give a map")
    hints, known = typing.get_type_hints(cls), {field.name: field for field in fields(typing.cast(Any, cls))}
    for key in values:
        require_known(f"field of {what}", key, known, "fields")
    missing = [name for name, field in known.items() if field.default is MISSING and name not in values]
    require(not missing, f"{what} lacks {', '.join(missing)}; add what is missing")
    return cls(**{key: fit(value, hints[key], f"{what}: {key}") for key, value in values.items()})


def fit_fields(spec: Any, what: str) -> None:
    """Give every field of a frozen dataclass its type, as `from_map` does.

    Raises:
        ValueError: If a value does not fit.
    """
    for name, hint in typing.get_type_hints(type(spec)).items():
        object.__setattr__(spec, name, fit(getattr(spec, name), hint, f"{what}: {name}"))


def plain(value: Any) -> Any:
    """Return a dataclass, or a sequence of them, as maps, lists, numbers and texts."""
    if hasattr(value, "__dataclass_fields__"):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return [plain(item) for item in value] if isinstance(value, Sequence) and not isinstance(value, str) else value


def fit(value: Any, hint: Any, name: str) -> Any:
    """Return the value as the type wants it; NumPy's numbers and arrays count as numbers and lists.

    Args:
        value: Anything.
        hint: float, int, str, bool, a tuple of such, or one of these or None.
        name: What it is, for the message.

    Raises:
        ValueError: If it does not fit.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if typing.get_origin(hint) is types.UnionType:  # with None, the only one there is
        return None if value is None else fit(value, typing.get_args(hint)[0], name)
    if typing.get_origin(hint) is tuple:
        return _fit_tuple(value, hint, name)
    fitted: Any = as_number(value) if hint is float else value
    fits = isinstance(fitted, hint) and (hint is bool or not isinstance(fitted, bool))
    require(fits, f"{name} is {quoted(value)}; give {_NAMES[hint]}")
    if hint is float:
        require(abs(fitted) <= MAX_NUMBER, f"{name} is {quoted(value)}; give at most {MAX_NUMBER:g}")
    return fitted


def as_number(value: Any) -> float | None:
    """Return the finite number that a value is or spells, or None."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return None if isinstance(value, bool) or not math.isfinite(number) else number


def _fit_tuple(value: Any, hint: Any, name: str) -> tuple[Any, ...]:
    inner, *rest = typing.get_args(hint)
    endless = rest == [Ellipsis]
    if endless and typing.get_origin(inner) is tuple and isinstance(value, Mapping):
        value = list(value.items())
    right = isinstance(value, list | tuple) and (endless or len(value) == 1 + len(rest))
    require(right, f"{name} is {quoted(value)}; give {_spoken(hint)}")
    hints = [inner] * len(value) if endless else [inner, *rest]
    return tuple(fit(item, item_hint, name) for item, item_hint in zip(value, hints, strict=True))


def _spoken(hint: Any) -> str:
    """Say what a tuple should be."""
    inner, *rest = typing.get_args(hint)
    if typing.get_origin(inner) is tuple:
        return "a map or a list of pairs"
    of = _NAMES[inner].split()[-1] + "s"
    return f"a list of {of}" if rest == [Ellipsis] else f"{1 + len(rest)} {of}"
