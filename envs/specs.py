"""Specifications from plain maps, as YAML gives them: checked, with the choices named."""

import math
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, TypeVar

Spec = TypeVar("Spec")

_NAMES = {float: "a number", int: "an integer", str: "a text"}


def require(condition: bool, message: str) -> None:
    """Raise a ValueError unless the condition holds."""
    if not condition:
        raise ValueError(message)


def require_known(kind: str, name: object, names: typing.Iterable[str], whose: str) -> None:
    """Raise a ValueError that lists the names unless `name` is one of them."""
    known = list(names)
    require(name in known, f"unknown {kind} '{name}'; {whose} are {', '.join(known)}")


def read_yaml(path: str, what: str) -> Any:
    """Return what a YAML file holds; nothing in it is evaluated.

    Raises:
        ValueError: If there is no such file, or it is not plain YAML.
    """
    import yaml  # not needed for what comes with the package

    require(Path(path).is_file(), f"no {what} file '{path}'; give the path of a YAML file")
    try:
        return yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"'{path}' is not plain YAML: {' '.join(str(error).split())}") from error


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
    require(isinstance(values, Mapping), f"{what} is {values!r}; give a map")
    hints, known = typing.get_type_hints(cls), {field.name: field for field in fields(typing.cast(Any, cls))}
    for key in values:
        require_known(f"field of {what}", key, known, "fields")
    missing = [name for name, field in known.items() if field.default is MISSING and name not in values]
    require(not missing, f"{what} lacks {', '.join(missing)}; add what is missing")
    return cls(**{key: _fit(value, hints[key], f"{what}: {key}") for key, value in values.items()})


def plain(value: Any) -> Any:
    """Return a dataclass, or a sequence of them, as maps, lists, numbers and texts."""
    if hasattr(value, "__dataclass_fields__"):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return [plain(item) for item in value] if isinstance(value, Sequence) and not isinstance(value, str) else value


def _fit(value: Any, hint: Any, name: str) -> Any:
    """Return the value as the type wants it."""
    if typing.get_origin(hint) is types.UnionType:  # with None, the only one there is
        return None if value is None else _fit(value, typing.get_args(hint)[0], name)
    if typing.get_origin(hint) is tuple:
        return _fit_tuple(value, hint, name)
    if hint is bool:
        require(isinstance(value, bool), f"{name} is {value!r}; give true or false")
        return value
    fitted = _number(value) if hint is float else value
    fits = isinstance(fitted, hint) and not isinstance(fitted, bool)
    require(fits, f"{name} is {value!r}; give {_NAMES[hint]}")
    return fitted


def _number(value: Any) -> float | None:
    """Return the finite number that a value is or spells, or None."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return None if isinstance(value, bool) or not math.isfinite(number) else number


def _fit_tuple(value: Any, hint: Any, name: str) -> tuple[Any, ...]:
    inner, *rest = typing.get_args(hint)
    endless = rest == [Ellipsis]
    if endless and typing.get_origin(inner) is tuple and isinstance(value, Mapping):
        value = list(value.items())
    right = isinstance(value, list | tuple) and (endless or len(value) == 1 + len(rest))
    require(right, f"{name} is {value!r}; give {_spoken(hint)}")
    hints = [inner] * len(value) if endless else [inner, *rest]
    return tuple(_fit(item, item_hint, name) for item, item_hint in zip(value, hints, strict=True))


def _spoken(hint: Any) -> str:
    """Say what a tuple should be."""
    inner, *rest = typing.get_args(hint)
    if typing.get_origin(inner) is tuple:
        return "a map or a list of pairs"
    of = _NAMES[inner].split()[-1] + "s"
    return f"a list of {of}" if rest == [Ellipsis] else f"{1 + len(rest)} {of}"
