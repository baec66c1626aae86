"""Plain values against pydantic's types; what pydantic finds becomes the one sentence of our errors."""

import json
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from typing import Annotated, Any, TypeVar

from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError

from sb3_stereo.errors import ConfigError, unknown

T = TypeVar("T")

STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


# A whole float is one, as in 3e3; beyond 2**53 a float is no longer exact.
Integer = Annotated[int, BeforeValidator(_whole), Field(ge=-(2**53), le=2**53)]
Number = float  # finite, by `STRICT`; an integer is one

_WANTED = {
    "int": "an integer",
    "float": "a number",
    "finite": "a finite number",
    "bool": "true or false",
    "string": "a text",
    "list": "a list",
    "tuple": "a list",
    "dict": "a map",
    "mapping": "a map",
    "dataclass": "a map",
    "greater_than": "above {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "below {lt}",
    "less_than_equal": "at most {le}",
}


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
        raise _sentence(error, name) from error


def _sentence(error: ValidationError, name: str) -> ConfigError:
    """Return the first of pydantic's errors as ours."""
    first = error.errors(include_url=False)[0]
    context, kind = first.get("ctx", {}), first["type"]
    if kind == "missing":
        return ConfigError(f"{name} lacks '{first['loc'][-1]}'; add it")
    if isinstance(context.get("error"), ConfigError):  # a validator of ours
        return context["error"]  # type: ignore[no-any-return]
    key, *rest = first["loc"]
    place = f"{name}: {key}{''.join(f'[{part}]' for part in rest)}"
    wanted = _WANTED.get(kind) or _WANTED.get(kind.partition("_")[0])
    if wanted is None:
        return ConfigError(f"{place}: {first['msg']}, got {first['input']!r}")
    return ConfigError(f"{place} must be {wanted.format(**context)}, got {first['input']!r}")


def check_limits(value: Any, limits: Any, name: str) -> None:
    """Check a number against pydantic's `Field(ge=..., le=...)`.

    Raises:
        ConfigError: If it is outside, or not finite.
    """
    try:
        _adapter(Annotated[float, limits]).validate_python(value)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        wanted = (_WANTED.get(first["type"]) or _WANTED["finite"]).format(**first.get("ctx", {}))
        raise ConfigError(f"{name} must be {wanted}, got {value!r}") from error


def fits(value: Any, hint: Any) -> bool:
    """Whether a plain value is one of a type that is made of numbers, texts, lists and maps.

    As JSON it has one kind of list, like YAML, and a date is nothing in it.
    """
    try:
        _adapter(hint).validate_json(json.dumps(value), strict=True)
    except (ValidationError, TypeError, ValueError):
        return False
    return True


@cache
def _adapter(hint: Any) -> TypeAdapter[Any]:
    return TypeAdapter(hint, config=ConfigDict(allow_inf_nan=False))
