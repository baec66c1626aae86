"""The settings of grid and random searches: both are known before anything is trained."""

from collections.abc import Sequence
from itertools import islice, product
from typing import Any

import numpy as np
import yaml

from sb3_stereo.tuning.parameters import Parameter

SEED = 0  # of the random search: every call draws the same settings, so that a sweep can be continued and can grow
MAX_REPETITIONS = 1000  # draws in a row that were drawn before


def listed_settings(parameters: Sequence[Parameter], method: str, n: int) -> list[dict[str, Any]]:
    """Return the first `n` settings of a search, none of them twice.

    Args:
        parameters: What is searched.
        method: "grid", "random", or any other, whose settings are not known beforehand.
        n: How many; random may find fewer if almost none are left.
    """
    if method == "grid":
        steps = [parameter.steps or () for parameter in parameters]
        return [_named(parameters, values) for values in islice(product(*steps), n)]
    return _drawn(parameters, n) if method == "random" else []


def key(setting: Any) -> str:
    """Return a text that is equal for equal settings."""
    return yaml.safe_dump(dict(setting))


def _drawn(parameters: Sequence[Parameter], n: int) -> list[dict[str, Any]]:
    generator = np.random.default_rng(SEED)
    found: dict[str, dict[str, Any]] = {}
    repetitions = 0
    while len(found) < n and repetitions < MAX_REPETITIONS:
        setting = _named(parameters, [parameter.draw(float(generator.random())) for parameter in parameters])
        repetitions = repetitions + 1 if key(setting) in found else 0
        found.setdefault(key(setting), setting)
    return list(found.values())


def _named(parameters: Sequence[Parameter], values: Sequence[Any]) -> dict[str, Any]:
    return {parameter.name: value for parameter, value in zip(parameters, values, strict=True)}
