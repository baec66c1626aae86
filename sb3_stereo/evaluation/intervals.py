"""Statistics over seeds; needs scipy (extra "plots")."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap, trim_mean

Floats = NDArray[np.float64]


def interquartile_mean(values: Floats, axis: int = -1) -> Floats:
    """The mean of the middle half."""
    return np.asarray(trim_mean(values, 0.25, axis=axis))


def interval(values: Floats, statistic: Callable[..., Any] = np.mean) -> tuple[float, float]:
    """95 % bootstrap interval of a statistic over seeds, shape (n_seeds,); the value itself where all seeds agree."""
    if len(values) < 2 or np.ptp(values) == 0:
        return float(values[0]), float(values[0])
    result = bootstrap((values,), statistic, method="percentile", rng=np.random.default_rng(0))
    return float(result.confidence_interval.low), float(result.confidence_interval.high)
