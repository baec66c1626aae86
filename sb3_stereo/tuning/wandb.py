"""The `parameters` of W&B's sweeps, read and checked: https://docs.wandb.ai/models/sweeps/sweep-config-keys."""

from collections.abc import Mapping
from math import exp, isfinite
from typing import Annotated, Any

import yaml
from pydantic import Field
from pydantic.dataclasses import dataclass as checked_dataclass

from sb3_stereo.config.validation import STRICT, Integer, Number, checked
from sb3_stereo.errors import ConfigError, unknown
from sb3_stereo.tuning.parameters import N_SIGMA, Choice, Parameter, Range


@checked_dataclass(frozen=True, config=STRICT)
class _Constant:
    value: Any

    def parameter(self, name: str, distribution: str) -> Choice:
        return Choice(name, (_defined(name, self.value),))


@checked_dataclass(frozen=True, config=STRICT)
class _Values:
    values: list[Any]
    probabilities: list[Annotated[Number, Field(ge=0)]] | None = None

    def parameter(self, name: str, distribution: str) -> Choice:
        if len({yaml.safe_dump(value) for value in self.values}) < max(len(self.values), 1):
            raise ConfigError(f"parameter '{name}': values must be a list without repetitions, got {self.values!r}")
        weights = tuple(self.probabilities or ())
        if self.probabilities is not None and (len(weights) != len(self.values) or not 0 < sum(weights) < float("inf")):
            raise ConfigError(
                f"parameter '{name}': probabilities must be one per value and not all 0, got {self.probabilities!r} "
                f"for {len(self.values)} values"
            )
        return Choice(name, tuple(_defined(name, value) for value in self.values), weights)


@checked_dataclass(frozen=True, config=STRICT)
class _Integers:
    min: Integer
    max: Integer

    def parameter(self, name: str, distribution: str) -> Range:
        return _range(name, distribution, self.min, self.max, step=1)


@checked_dataclass(frozen=True, config=STRICT)
class _Bounds:
    min: Number
    max: Number

    def parameter(self, name: str, distribution: str, step: float = 0) -> Range:
        is_log = "log" in distribution
        low, high = self.min, self.max
        if is_log and distribution.endswith("_values"):
            if low <= 0:
                raise ConfigError(f"parameter '{name}': {distribution} needs a positive min, got {low:g}")
        elif is_log:  # the bounds are natural logarithms, those of 1/x for the inverse
            low, high = (-high, -low) if distribution.startswith("inv_") else (low, high)
            low, high = _exponential(name, low), _exponential(name, high)
        return _range(name, distribution, low, high, is_log=is_log, step=step)


@checked_dataclass(frozen=True, config=STRICT)
class _SteppedBounds(_Bounds):
    q: Annotated[Number, Field(gt=0)] = 1.0

    def parameter(self, name: str, distribution: str, step: float = 0) -> Range:
        return super().parameter(name, distribution, self.q)


@checked_dataclass(frozen=True, config=STRICT)
class _Normal:
    mu: Number = 0.0
    sigma: Annotated[Number, Field(gt=0)] = 1.0

    def parameter(self, name: str, distribution: str, step: float = 0) -> Range:
        is_log = "log" in distribution
        low, high = self.mu - N_SIGMA * self.sigma, self.mu + N_SIGMA * self.sigma
        low, high = (_exponential(name, low), _exponential(name, high)) if is_log else (low, high)
        return _range(name, distribution, low, high, is_log=is_log, is_normal=True, step=step)


@checked_dataclass(frozen=True, config=STRICT)
class _SteppedNormal(_Normal):
    q: Annotated[Number, Field(gt=0)] = 1.0

    def parameter(self, name: str, distribution: str, step: float = 0) -> Range:
        return super().parameter(name, distribution, self.q)


DISTRIBUTIONS: dict[str, type[Any]] = {
    "constant": _Constant,
    "categorical": _Values,
    "categorical_w_probabilities": _Values,
    "int_uniform": _Integers,
    "uniform": _Bounds,
    "log_uniform": _Bounds,
    "log_uniform_values": _Bounds,
    "inv_log_uniform": _Bounds,
    "inv_log_uniform_values": _Bounds,
    "q_uniform": _SteppedBounds,
    "q_log_uniform": _SteppedBounds,
    "q_log_uniform_values": _SteppedBounds,
    "normal": _Normal,
    "log_normal": _Normal,
    "q_normal": _SteppedNormal,
    "q_log_normal": _SteppedNormal,
}


def parse_parameters(entries: Mapping[str, Any]) -> tuple[dict[str, Any], tuple[Parameter, ...]]:
    """Read W&B's `parameters`; a nested map `policy_kwargs: {parameters: ...}` becomes dotted names.

    Returns:
        The constants by name, and what is searched.
    """
    constants, searched = {}, []
    for name, entry in _flattened(entries).items():
        distribution = str(entry.get("distribution") or _usual_distribution(entry))
        if distribution not in DISTRIBUTIONS:
            raise unknown(f"distribution of '{name}'", distribution, DISTRIBUTIONS)
        given = {key: value for key, value in entry.items() if key != "distribution"}
        parsed = checked(DISTRIBUTIONS[distribution], given, f"parameter '{name}'", f"of {distribution}")
        parameter = parsed.parameter(name, distribution)
        if distribution == "constant":
            constants[name] = parameter.values[0]
        else:
            searched.append(parameter)
    return constants, tuple(searched)


def _flattened(entries: Mapping[str, Any], prefix: str = "") -> dict[str, Mapping[str, Any]]:
    """Return the entries by their dotted names."""
    found: dict[str, Mapping[str, Any]] = {}
    for key, entry in entries.items():
        name = f"{prefix}{key}"
        if not isinstance(entry, Mapping):
            raise ConfigError(f"parameter '{name}' must be a map, as in {name}: {{values: [...]}}; got {entry!r}")
        is_nested = isinstance(entry.get("parameters"), Mapping)
        if is_nested and len(entry) > 1:
            others = ", ".join(sorted(str(other) for other in entry if other != "parameters"))
            raise ConfigError(f"parameter '{name}': nested parameters stand alone, got {others} beside them")
        inner = _flattened(entry["parameters"], f"{name}.") if is_nested else {name: entry}
        for repeated in found.keys() & inner.keys():
            raise ConfigError(f"parameter '{repeated}' is given twice; leave one out")
        found |= inner
    return found


def _usual_distribution(entry: Mapping[str, Any]) -> str:
    """Return the distribution of an entry that names none, by W&B's rule."""
    for key, distribution in (("value", "constant"), ("values", "categorical")):
        if key in entry:
            return distribution
    ends = [entry.get(key) for key in ("min", "max")]
    return "int_uniform" if all(isinstance(end, int) and not isinstance(end, bool) for end in ends) else "uniform"


def _defined(name: str, value: Any) -> Any:
    if value != value:  # NaN
        raise ConfigError(f"parameter '{name}': nan is no value; leave it out")
    return value


def _exponential(name: str, exponent: float) -> float:
    """Return e to the power of a bound."""
    try:
        value = exp(exponent)
    except OverflowError:
        value = float("inf")
    if not 0 < value < float("inf"):
        raise ConfigError(
            f"parameter '{name}': the bounds are exponents of e, and e^{exponent:g} is no number of a computer; "
            "log_uniform_values takes the bounds themselves"
        )
    return value


def _range(name: str, distribution: str, low: float, high: float, **shape: Any) -> Range:
    """Make a range, or raise a ConfigError if nothing is in it."""
    if not low < high:
        raise ConfigError(f"parameter '{name}': min must be below max, got {low:g} and {high:g}")
    made = Range(name, distribution, low, high, **shape)
    if not isfinite(high - low) or (made.step and not isfinite(max(abs(low), abs(high)) / made.step)):
        raise ConfigError(f"parameter '{name}': {low:g} to {high:g} is too wide to draw from")
    if made.n_values < 1:
        raise ConfigError(
            f"parameter '{name}': no multiple of q {made.step:g} lies between {low:g} and {high:g}; choose a smaller q"
        )
    return made
