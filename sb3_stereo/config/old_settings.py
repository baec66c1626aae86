"""Settings under the names that they had before version 0.1.0; to be removed with 0.2."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

from sb3_stereo.errors import ConfigError

# Arguments of callbacks that are settings of our algorithms now, and the arguments' defaults.
CALLBACKS: dict[str, dict[str, tuple[str, Any]]] = {
    "AnnealExploration": {
        "n_steps": ("exploration.n_steps", 10_000),
        "initial_epsilon": ("exploration.initial_epsilon", None),
        "final_epsilon": ("exploration.final_epsilon", None),
        "theta": ("exploration.theta", None),
    },
    "StereoReplay": {
        "goal_share": ("replay_buffer_kwargs.success_fraction", 0.0),
        "mirror_probability": ("replay_buffer_kwargs.mirror_probability", None),
        "mirrored_joints": ("replay_buffer_kwargs.mirrored_joints", None),
        "n_joints": ("replay_buffer_kwargs.n_joints", None),
        "n_views": ("replay_buffer_kwargs.n_views", None),
    },
    "LearnFromMotion": {
        "gradient_steps": ("dynamics_steps", 2),
        "replay_ratio": ("pretraining.dynamics", 3.0),
        "learning_rate": ("policy_kwargs.dynamics_learning_rate", None),
    },
    "WarmUp": {"replay_ratio": ("pretraining.agent", None)},
}
KEYS = {
    f"callback.{name}.{argument}": new
    for name, arguments in CALLBACKS.items()
    for argument, (new, _) in arguments.items()
}


def renamed_keys(params: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return overrides by dotted keys under the present names."""
    return {_renamed(key): value for key, value in (params or {}).items()}


def _renamed(key: str) -> str:
    if key in KEYS:
        _hint(key, KEYS[key])
    return KEYS.get(key, key)


def _hint(old: str, new: str) -> None:
    warnings.warn(f"'{old}' is called '{new}' since version 0.1.0; write that", FutureWarning, stacklevel=4)


def renamed_settings(algo: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return one environment's map under the present names.

    Raises:
        ConfigError: If an old callback has an argument that has no present name.
    """
    values = dict(values)
    callbacks = values.get("callback")
    items = callbacks if isinstance(callbacks, list) else [callbacks]
    kept: list[Any] = []
    settings: dict[str, Any] = {}
    for item in items:
        path, kwargs = next(iter(item.items())) if isinstance(item, Mapping) and len(item) == 1 else (item, {})
        name = str(path).rpartition(".")[2]
        if name in CALLBACKS and str(path).startswith("sb3_stereo.") and isinstance(kwargs, Mapping | None):
            settings |= _settings_of(name, kwargs or {})
        else:
            kept.append(item)
    if settings:
        values["callback"] = kept
    if "dynamics_steps" in settings and algo == "dqn":
        settings["policy_kwargs.encoder_loss"] = "critic+dynamics"
    if isinstance(values.get("policy_kwargs"), Mapping) and values["policy_kwargs"].get("encoder_loss") == "motion":
        _hint("encoder_loss: motion", "encoder_loss: dynamics")
        settings["policy_kwargs.encoder_loss"] = "dynamics"
    for key, value in settings.items():
        first, _, inner = key.partition(".")
        values[first] = {**(values.get(first) or {}), inner: value} if inner else value
    return values


def _settings_of(name: str, kwargs: Mapping[str, Any]) -> dict[str, Any]:
    known = CALLBACKS[name]
    for argument in kwargs:
        if argument not in known and argument != "verbose":
            allowed = ", ".join(sorted({new for new, _ in known.values()}))
            raise ConfigError(f"callback {name} has no '{argument}' any more; its settings are {allowed} now")
    values = {argument: kwargs.get(argument, default) for argument, (_, default) in known.items()}
    settings = {known[argument][0]: value for argument, value in values.items() if value is not None}
    _hint(f"callback: {name}", ", ".join(settings))
    return settings
