"""What a sweep searches: W&B's `parameters`, read and checked."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from sb3_stereo.config.components import check_kwargs
from sb3_stereo.errors import ConfigError, unknown

# What each of W&B's distributions needs.
DISTRIBUTIONS = {
    "categorical": ("values",),
    "constant": ("value",),
    "int_uniform": ("min", "max"),
    "log_uniform_values": ("min", "max"),
    "q_uniform": ("min", "max", "q"),
    "uniform": ("min", "max"),
}


@dataclass(frozen=True)
class Parameter:
    """A hyper-parameter that is searched.

    Attributes:
        name: Its key, dotted inside a map or a list of classes.
        distribution: One of `DISTRIBUTIONS`.
        values: The choices of a categorical one, or the value of a constant.
        min: Smallest value.
        max: Largest value, included.
        q: Step between values.
    """

    name: str
    distribution: str
    values: tuple[Any, ...] = ()
    min: float = 0.0
    max: float = 0.0
    q: float = 0.0


def parse_parameters(entries: Mapping[str, Any], prefix: str = "") -> list[Parameter]:
    """Read W&B's `parameters`; a nested map `policy_kwargs: {parameters: ...}` becomes dotted names."""
    found = []
    for key, entry in entries.items():
        name = f"{prefix}{key}"
        if not isinstance(entry, Mapping):
            raise ConfigError(f"parameter '{name}' must be a map, as in {name}: {{values: [...]}}; got {entry!r}")
        if isinstance(entry.get("parameters"), Mapping):
            found += parse_parameters(entry["parameters"], f"{name}.")
        else:
            found.append(_parse_parameter(name, entry))
    return found


def _parse_parameter(name: str, entry: Mapping[str, Any]) -> Parameter:
    distribution = str(entry.get("distribution") or _usual_distribution(entry))
    if distribution not in DISTRIBUTIONS:
        raise unknown(f"distribution of '{name}'", distribution, DISTRIBUTIONS)
    wanted, given = DISTRIBUTIONS[distribution], [str(key) for key in entry if key != "distribution"]
    if sorted(wanted) != sorted(given):
        raise ConfigError(
            f"parameter '{name}': {distribution} takes {', '.join(wanted)}, got {', '.join(given) or 'nothing'}"
        )
    if "value" in wanted:
        return Parameter(name, distribution, (entry["value"],))
    numbers = {key: value for key, value in entry.items() if key not in ("distribution", "values")}
    numbers = check_kwargs(Parameter, numbers, f"parameter '{name}'")
    if "values" not in wanted:
        return _checked_range(Parameter(name, distribution, **numbers))
    values = entry["values"]
    if not isinstance(values, list) or len({yaml.safe_dump(value) for value in values}) < max(len(values), 1):
        raise ConfigError(f"parameter '{name}': values must be a list without repetitions, got {values!r}")
    return Parameter(name, distribution, tuple(values))


def _usual_distribution(entry: Mapping[str, Any]) -> str:
    """Return the distribution of an entry that names none, by W&B's rule."""
    for key, distribution in (("value", "constant"), ("values", "categorical")):
        if key in entry:
            return distribution
    return "int_uniform" if all(isinstance(entry.get(key), int) for key in ("min", "max")) else "uniform"


def _checked_range(parameter: Parameter) -> Parameter:
    """Raise a ConfigError if the range is empty or does not suit the distribution."""
    low, high, name = parameter.min, parameter.max, f"parameter '{parameter.name}'"
    if low >= high:
        raise ConfigError(f"{name}: min must be below max, got {low} and {high}")
    if parameter.distribution == "log_uniform_values" and low <= 0:
        raise ConfigError(f"{name}: log_uniform_values needs a positive min, got {low}")
    if parameter.distribution == "q_uniform" and parameter.q <= 0:
        raise ConfigError(f"{name}: q must be positive, got {parameter.q}")
    if parameter.distribution == "int_uniform" and not (isinstance(low, int) and isinstance(high, int)):
        raise ConfigError(f"{name}: int_uniform needs integers, got {low} and {high}")
    return parameter
