"""Plain values of YAML files against pydantic's types: `envs.validation` with our error, which names what was meant."""

import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Annotated, Any, TypeVar

from pydantic import ValidationError

from sb3_stereo.envs.validation import STRICT, Integer, Number, adapter, sentence
from sb3_stereo.errors import ConfigError, unknown

__all__ = ["STRICT", "Integer", "Number", "check_limits", "checked", "fits"]

T = TypeVar("T")

_FORM = "{place} must be {wanted}, got {value}"


def checked(kind: type[T], values: Mapping[Any, Any], name: str, of: str = "") -> T:
    """Return what a map describes.

    Args:
        kind: A pydantic dataclass with `STRICT` configuration.
        values: Its fields as YAML gives them.
        name: What they describe, for messages.
        of: More of it, for messages about its keys.

    Raises:
        ConfigError: If a key is unknown or missing, or a value is not allowed.
    """
    known = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    for key in values:
        if key not in known:
            raise unknown(f"argument of {' '.join(filter(None, (name, of)))}", key, known)
    try:
        return kind(**values)
    except ValidationError as error:
        raise ConfigError(sentence(error, name, _FORM)) from error


def check_limits(value: Any, limits: Any, name: str) -> None:
    """Check a number against pydantic's `Field(ge=..., le=...)`.

    Raises:
        ConfigError: If it is outside, or not finite.
    """
    try:
        adapter(Annotated[float, limits]).validate_python(value)
    except ValidationError as error:
        raise ConfigError(sentence(error, name, _FORM)) from error


def fits(value: Any, hint: Any) -> bool:
    """Whether a plain value is one of a type that is made of numbers, texts, lists and maps.

    As JSON it has one kind of list, like YAML, and a date is nothing in it.
    """
    try:
        adapter(hint).validate_json(json.dumps(value), strict=True)
    except (ValidationError, TypeError, ValueError):
        return False
    return True
