"""Limits of arguments that SB3's signatures do not tell, and that it would notice in the middle of a training run."""

from typing import Any

from pydantic import Field

from sb3_stereo.config.validation import check_limits

MAX_WIDTH = 65_536  # of a layer: with the 7056 pixels of an image that makes 2 GB of weights

COUNT = Field(ge=1)
FRACTION = Field(ge=0, le=1)
WIDTH = Field(ge=1, le=MAX_WIDTH)
FINITE = Field()

# By the argument's name, which has one meaning in all of SB3.
LIMITS: dict[str, Any] = {
    "batch_size": COUNT,
    "buffer_size": COUNT,
    "clip_range": Field(gt=0),
    "clip_range_vf": Field(gt=0),
    "dynamics_learning_rate": Field(ge=0),
    "dynamics_steps": Field(ge=0),
    "exploration_final_eps": FRACTION,
    "exploration_fraction": Field(gt=0, le=1),
    "exploration_initial_eps": FRACTION,
    "features_dim": WIDTH,
    "embedding_dim": WIDTH,
    "gae_lambda": FRACTION,
    "gamma": FRACTION,
    "gradient_steps": Field(ge=-1),
    "learning_rate": Field(ge=0),
    "learning_starts": Field(ge=0),
    "max_grad_norm": Field(gt=0),
    "n_critics": COUNT,
    "n_epochs": COUNT,
    "n_quantiles": COUNT,
    "n_steps": COUNT,
    "noise_std": Field(ge=0),
    "policy_delay": COUNT,
    "qf_learning_rate": Field(gt=0),
    "actor_weight_decay": Field(ge=0),
    "sde_sample_freq": Field(ge=-1),
    "stats_window_size": COUNT,
    "target_noise_clip": Field(ge=0),
    "target_policy_noise": Field(ge=0),
    "target_update_interval": COUNT,
    "tau": FRACTION,
    "top_quantiles_to_drop_per_net": Field(ge=0),
    "train_freq": COUNT,
}
# Of every number in them, however deep.
WIDTHS = ("net_arch", "n_filters", "kernel_sizes", "strides")


def check(key: str, value: Any, name: str) -> None:
    """Raise a ConfigError for a number outside its limits; texts and null have none."""
    limit = WIDTH if key in WIDTHS else LIMITS.get(key, FINITE)
    for number in _numbers(value):
        check_limits(number, limit, name)


def _numbers(value: Any) -> list[float]:
    """All numbers in a value, however deep; of a train_freq [4, step] the first."""
    if isinstance(value, dict):
        return [number for item in value.values() for number in _numbers(item)]
    if isinstance(value, list | tuple):
        return [number for item in value for number in _numbers(item)]
    return [value] if isinstance(value, int | float) and not isinstance(value, bool) else []
