"""A sweep's parameters as Tune's and as Optuna's search space."""

from typing import Any

from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from ray import tune
from ray.tune.search.repeater import TRIAL_INDEX

from sb3_stereo.tuning.config import Sweep
from sb3_stereo.tuning.parameters import Parameter


def domain(parameter: Parameter) -> Any:
    """Return Tune's domain of a parameter."""
    low, high = parameter.min, parameter.max
    if parameter.distribution == "categorical":
        return tune.choice(list(parameter.values))
    if parameter.distribution == "int_uniform":
        return tune.randint(int(low), int(high) + 1)  # Tune leaves the end out
    if parameter.distribution == "q_uniform":
        return tune.quniform(low, high, parameter.q)
    return tune.loguniform(low, high) if parameter.distribution == "log_uniform_values" else tune.uniform(low, high)


def distribution(parameter: Parameter) -> BaseDistribution:
    """Return Optuna's distribution of a parameter."""
    low, high = parameter.min, parameter.max
    if parameter.distribution == "categorical":
        return CategoricalDistribution(parameter.values)
    if parameter.distribution == "int_uniform":
        return IntDistribution(int(low), int(high))
    step = parameter.q if parameter.distribution == "q_uniform" else None
    return FloatDistribution(low, high, log=parameter.distribution == "log_uniform_values", step=step)


def tune_space(sweep: Sweep) -> dict[str, Any]:
    """Return the space of grid and random: every setting with every seed's index."""
    parameters = {
        p.name: tune.grid_search(list(p.values)) if sweep.method == "grid" else domain(p) for p in sweep.parameters
    }
    return {**parameters, TRIAL_INDEX: tune.grid_search(list(range(len(sweep.seeds))))}


def optuna_space(sweep: Sweep) -> dict[str, BaseDistribution]:
    """Return the space of bayes, without the seeds: `Repeater` adds their index."""
    return {parameter.name: distribution(parameter) for parameter in sweep.parameters}
