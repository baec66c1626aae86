"""Plain values against pydantic's types; what pydantic finds becomes one sentence of ours."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import cache, wraps
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic_core import PydanticCustomError

from sb3_stereo.envs.specs import as_number, quoted, require, require_known

T = TypeVar("T")

STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)
MAX_NUMBER = 1e4  # of a specification's, in SI units: far above any robot's, far below where physics ends in NaN
PAIRS = "a map or a list of pairs"


def _without_numpy(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _number(value: Any) -> Any:
    value = _without_numpy(value)
    number = as_number(value)
    return value if number is None else number


def _whole(value: Any) -> Any:
    value = _without_numpy(value)
    return int(value) if isinstance(value, float) and value.is_integer() else value


def listed(wanted: str, length: int | None = None) -> BeforeValidator:
    """Let a tuple be given as a list, as an array, and one of `PAIRS` as a map.

    Args:
        wanted: What it is, for messages.
        length: How many items it has; None for any number.
    """

    def as_tuple(value: Any) -> tuple[Any, ...]:
        value = _without_numpy(value)
        if wanted == PAIRS and isinstance(value, Mapping):
            value = list(value.items())
        if not isinstance(value, list | tuple) or length not in (None, len(value)):
            raise PydanticCustomError("listed", wanted)
        return tuple(value)

    return BeforeValidator(as_tuple)


# A number may be written as a text such as 1e-3, which YAML does not read as one; it is finite, by `STRICT`.
Number = Annotated[float, BeforeValidator(_number)]
Quantity = Annotated[Number, Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]
PositiveQuantity = Annotated[Quantity, Field(gt=0)]
# A whole float is one, as in 3e3; beyond 2**53 a float is no longer exact.
Integer = Annotated[int, BeforeValidator(_whole), Field(ge=-(2**53), le=2**53)]
Text = Annotated[str, BeforeValidator(_without_numpy)]
Flag = Annotated[bool, BeforeValidator(_without_numpy)]
Vector = Annotated[tuple[Quantity, Quantity, Quantity], listed("3 numbers", 3)]
Texts = Annotated[tuple[Text, ...], listed("a list of texts")]
Numbers = Annotated[tuple[T, ...], listed("a list of numbers")]
Pairs = Annotated[tuple[Annotated[tuple[Text, T], listed("a pair", 2)], ...], listed(PAIRS)]

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
    "greater_than": "more than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    "listed": "{}",
}


def sentence(
    error: ValidationError, name: str, form: str = "{place} is {value}; give {wanted}", positional: Sequence[str] = ()
) -> str:
    """Return what pydantic found first.

    Args:
        error: What it found.
        name: What was checked.
        form: How a sentence about a value goes.
        positional: Names of arguments that pydantic knows by their places.
    """
    found = error.errors(include_url=False)
    first, place = found[0], name
    reason = first.get("ctx", {}).get("error")
    if isinstance(reason, ValueError):  # a check of ours, whose sentence is whole
        return str(reason)
    missing = [f"'{one['loc'][-1]}'" for one in found if one["type"] == "missing"]
    if missing:
        return f"{name} lacks {', '.join(missing)}; add {'it' if len(missing) == 1 else 'them'}"
    if first["type"] == "unexpected_keyword_argument":
        return f"{name} has no {quoted(first['loc'][-1])}; leave it out"
    for depth, part in enumerate(first["loc"]):
        named = positional[part] if isinstance(part, int) and part < len(positional) else part
        place += f"[{part}]" if depth else f": {named}"
    return form.format(place=place, value=quoted(first["input"]), wanted=_wanted(first))


def _wanted(found: Any) -> str:
    """Say what a value should have been."""
    kind, limits = found["type"], found.get("ctx", {})
    if kind == "greater_than" and limits["gt"] == 0:
        return "a positive number"
    spelled = {key: f"{limit:g}" if isinstance(limit, float) else limit for key, limit in limits.items()}
    wanted = _WANTED.get(kind) or _WANTED.get(kind.partition("_")[0]) or "something else ({})"
    return wanted.format(found["msg"], **spelled)


def fit(value: Any, hint: Any, name: str) -> Any:
    """Return a value as a type wants it.

    Raises:
        ValueError: If it does not fit.
    """
    try:
        return adapter(hint).validate_python(value)
    except ValidationError as error:
        raise ValueError(sentence(error, name)) from error


@cache
def adapter(hint: Any) -> TypeAdapter[Any]:
    """Return what checks values against a type, made once: a type's `Field` equals no other, so keep it."""
    return TypeAdapter(hint, config=STRICT)


def explained(what: str) -> Callable[[type[T]], type[T]]:
    """Let a pydantic dataclass say in one sentence what is wrong with it, also where it is made or replaced directly.

    Args:
        what: What it specifies; one with a `name` is called by that as well.
    """

    def decorate(cls: type[T]) -> type[T]:
        check: Any = cls.__init__
        names = [field.name for field in fields(cls)]  # type: ignore[arg-type]

        @wraps(check)
        def __init__(self: T, *args: Any, **kwargs: Any) -> None:
            try:
                check(self, *args, **kwargs)
            except ValidationError as error:
                given = dict(zip(names, args, strict=False)) | kwargs
                called = f"{what} {quoted(given['name'])}" if "name" in given else what
                raise ValueError(sentence(error, called, positional=names)) from error

        cls.__init__ = __init__  # type: ignore[assignment]
        return cls

    return decorate


def from_map(cls: type[T], values: Any, what: str) -> T:
    """Make an `explained` dataclass from a plain map.

    Args:
        cls: The dataclass.
        values: Its fields.
        what: What it specifies, for messages.

    Raises:
        ValueError: If a field is unknown, missing, or not of its type.
    """
    require(isinstance(values, Mapping), f"{what} is {quoted(values)}; give a map")
    for key in values:
        require_known(f"field of {what}", key, [field.name for field in fields(cls)], "fields")  # type: ignore[arg-type]
    try:
        return cls(**values)
    except ValueError as error:
        found = error.__cause__
        raise ValueError(sentence(found, what) if isinstance(found, ValidationError) else str(error)) from found


def named(cls: type[T], values: Any, names: Mapping[str, T], what: str, whose: str) -> T:
    """Return what is given as itself, as a map of its fields, or by a name.

    Args:
        cls: An `explained` dataclass.
        values: An instance of it, a map, or a name.
        names: Instances by their names.
        what: What it specifies, for messages.
        whose: The same in the plural.

    Raises:
        ValueError: If there is none of the name, or a field is wrong.
    """
    if isinstance(values, cls):
        return values
    if isinstance(values, str):
        require_known(what, values, names, whose)
        return names[values]
    return from_map(cls, values, what)
