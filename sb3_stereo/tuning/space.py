"""A sweep's parameters as Optuna's search space."""

from collections.abc import Mapping
from typing import Any

from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution

from sb3_stereo.tuning.config import Sweep
from sb3_stereo.tuning.parameters import Choice, Parameter


def distribution(parameter: Parameter) -> BaseDistribution:
    """Return Optuna's distribution of a parameter; what it draws is rounded to steps by `Sweep.setting`.

    Optuna decides where to look, so of a normal distribution and of probabilities only the bounds and the values count.
    """
    if isinstance(parameter, Choice):
        return CategoricalDistribution(parameter.values)
    if parameter.distribution == "int_uniform":
        return IntDistribution(int(parameter.low), int(parameter.high))
    return FloatDistribution(parameter.low, parameter.high, log=parameter.is_log)


def optuna_space(sweep: Sweep) -> dict[str, BaseDistribution]:
    """Return the space of bayes, without the seeds: `Repeater` adds their index."""
    return {parameter.name: distribution(parameter) for parameter in sweep.parameters}


def point(sweep: Sweep, params: Mapping[str, Any]) -> dict[str, Any]:
    """Return a setting as Optuna's parameters; a multiple of a step may lie a rounding error outside its bounds."""
    return {p.name: params[p.name] if isinstance(p, Choice) else _inside(p, params[p.name]) for p in sweep.parameters}


def _inside(parameter: Parameter, value: float) -> float:
    assert not isinstance(parameter, Choice)
    return min(max(value, parameter.low), parameter.high)
