"""The parameters of a sweep: choices and ranges, sampled in the same way by every method."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import ceil, exp, floor, log, prod
from statistics import NormalDist
from typing import Any

from sb3_stereo.errors import ConfigError

N_SIGMA = 4  # a normal distribution is cut here, so that its ends can be checked before a sweep starts
_TAIL = NormalDist().cdf(-N_SIGMA)


@dataclass(frozen=True)
class Choice:
    """A hyper-parameter with listed values.

    Attributes:
        name: Its key, dotted inside a map or a list of classes.
        values: The values.
        weights: How often `method: random` draws each, in any unit; empty draws all equally often.
    """

    name: str
    values: tuple[Any, ...]
    weights: tuple[float, ...] = ()

    @property
    def steps(self) -> tuple[Any, ...]:
        """All values."""
        return self.values

    @property
    def n_values(self) -> float:
        """How many values can be drawn."""
        return sum(weight > 0 for weight in self.weights) or len(self.values)

    def draw(self, u: float) -> Any:
        """Return the value at the quantile `u`, between 0 and 1."""
        weights = self.weights or (1.0,) * len(self.values)
        left = u * sum(weights)
        for value, weight in zip(self.values, weights, strict=True):
            left -= weight
            if left < 0:
                return value
        return [value for value, weight in zip(self.values, weights, strict=True) if weight > 0][-1]

    def settle(self, drawn: Any) -> Any:
        """Return the value that a sampler's draw stands for."""
        return drawn

    def examples(self) -> tuple[Any, ...]:
        """Return values whose check stands for that of all."""
        return self.values


@dataclass(frozen=True)
class Range:
    """A hyper-parameter between two bounds.

    Attributes:
        name: Its key, dotted inside a map or a list of classes.
        distribution: W&B's name for it.
        low: Smallest value.
        high: Largest value, included.
        is_log: Whether the logarithm is distributed, not the value.
        is_normal: Whether the distribution is normal and not uniform, cut at its bounds.
        step: The values are multiples of it; integers, if it is whole. 0 is a continuous range.
    """

    name: str
    distribution: str
    low: float
    high: float
    is_log: bool = False
    is_normal: bool = False
    step: float = 0.0

    @property
    def steps(self) -> tuple[float, ...] | None:
        """All values; None for a continuous range."""
        if not self.step:
            return None
        first, last = self._multiples
        return tuple(self._multiple(number) for number in range(first, last + 1))

    @property
    def n_values(self) -> float:
        """How many values can be drawn."""
        first, last = self._multiples if self.step else (0, float("inf"))
        return last - first + 1

    def draw(self, u: float) -> float:
        """Return the value at the quantile `u`, between 0 and 1."""
        low, high = (log(self.low), log(self.high)) if self.is_log else (self.low, self.high)
        if self.distribution == "int_uniform":  # its ends are as frequent as the others
            low, high = low - 0.5, high + 0.5
        if self.is_normal:
            bell = NormalDist((low + high) / 2, (high - low) / (2 * N_SIGMA))
            drawn = bell.inv_cdf(_TAIL + u * (1 - 2 * _TAIL))
        else:
            drawn = low + u * (high - low)
        return self.settle(exp(min(drawn, high)) if self.is_log else drawn)

    def settle(self, drawn: float) -> float:
        """Return the value that a sampler's draw stands for: W&B's `round(x / q) * q`, kept between the bounds."""
        inside = min(max(drawn, self.low), self.high)
        if not self.step:
            return inside
        first, last = self._multiples
        return self._multiple(min(max(round(inside / self.step), first), last))

    def examples(self) -> tuple[float, ...]:
        """Return values whose check stands for that of all: both ends, and what lies between."""
        if self.step and self.n_values <= 20:
            return self.steps or ()
        ends = (self.settle(self.low), self.settle(self.high))
        if self.step:  # of two neighbours, one at least is a fraction, unless all are whole
            return (*ends, self._multiple(self._multiples[0] + 1), self.draw(0.31))
        return (*ends, self.draw(0.31), self.draw(0.62))

    @property
    def _multiples(self) -> tuple[int, int]:
        """The first and the last multiple of the step between the bounds, up to rounding errors."""
        return ceil(self.low / self.step - 1e-9), floor(self.high / self.step + 1e-9)

    def _multiple(self, number: int) -> float:
        if float(self.step).is_integer():
            return number * int(self.step)
        return float(f"{number * self.step:.12g}")  # 0.3 and not 0.30000000000000004


Parameter = Choice | Range
Check = Callable[[Mapping[str, Any]], Any]  # of a setting


def check_examples(parameters: tuple[Parameter, ...], check: Check) -> None:
    """Let hyper-parameters be checked with every value that stands for others.

    A value must be allowed alone, or where it depends on others (as `noise_type` on `noise_std`) beside their first.

    Args:
        parameters: What is searched.
        check: Raises a ConfigError for a setting that cannot be trained.

    Raises:
        ConfigError: If a parameter can take a value that cannot be used.
    """
    first = {parameter.name: parameter.examples()[0] for parameter in parameters}
    for parameter in parameters:
        for value in parameter.examples():
            error = _refusal({parameter.name: value}, check)
            if error and _refusal({**first, parameter.name: value}, check):
                raise _fractions(parameter, value, check, error) or error


def _refusal(setting: Mapping[str, Any], check: Check) -> ConfigError | None:
    try:
        check(setting)
    except ConfigError as error:
        return error
    return None


def _fractions(parameter: Parameter, value: Any, check: Check, error: ConfigError) -> ConfigError | None:
    """Return the sentence for a hyper-parameter that takes integers alone, if a fraction is all that was wrong."""
    if isinstance(parameter, Choice) or float(value).is_integer() or _refusal({parameter.name: round(value)}, check):
        return None
    way_out = "int_uniform" if parameter.distribution == "uniform" else f"q_{parameter.distribution} with q: 1"
    way_out = "a whole q" if parameter.step else way_out
    name, distribution = parameter.name, parameter.distribution
    return ConfigError(f"parameter '{name}': {distribution} draws fractions, and {error}; use {way_out}")


def n_settings(parameters: tuple[Parameter, ...]) -> float:
    """Return how many different settings there are."""
    return prod(parameter.n_values for parameter in parameters)
