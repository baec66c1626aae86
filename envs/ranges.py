"""Ranges that something is drawn from, as fields of a specification."""

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field
from pydantic_core import PydanticCustomError

from sb3_stereo.envs.specs import as_number, quoted, require
from sb3_stereo.envs.validation import Quantity


def _ends(value: Any) -> tuple[Any, ...]:
    """Both ends of a range, which may be given as one number."""
    value = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    if as_number(value) is not None:
        return value, value
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise PydanticCustomError("listed", "a number, or the lowest and the highest one")
    return tuple(value)


Range = Annotated[tuple[Quantity, Quantity], BeforeValidator(_ends)]
Probability = Annotated[Quantity, Field(ge=0, le=1)]


def check_ranges(spec: Any, what: str, bounds: Mapping[str, tuple[float, float]]) -> None:
    """Raise a ValueError if a range of a specification is empty or reaches beyond its bounds.

    Args:
        spec: A dataclass, whose tuples are ranges.
        what: It is, for messages.
        bounds: What a field must stay within; the others begin at 0.
    """
    for field in fields(spec):
        value = getattr(spec, field.name)
        if isinstance(value, tuple):
            low, high = bounds.get(field.name, (0.0, math.inf))
            wanted = f"the lowest and the highest number, from {low:g} to {high:g}"
            ordered = low <= value[0] <= value[1] <= high
            require(ordered, f"{what}: {field.name} is {quoted(list(value))}; give {wanted}")
