"""Names that policies had before version 0.1.0, in models and settings; to be removed with 0.2."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import torch as th

RENAMED_CHOICES = {"encoder_loss": {"motion": "dynamics"}}
RENAMED_KEYS = {
    "motion.position.": "dynamics.position.",
    "motion.prediction.": "dynamics.forward_model.",
    "motion.inverse.": "dynamics.inverse_model.",
}


def renamed_choice(name: str, value: str) -> str:
    """Return the present name of a setting's value."""
    new = RENAMED_CHOICES[name].get(value, value)
    if new != value:
        warnings.warn(f"{name} '{value}' is called '{new}' now", stacklevel=2)
    return new


def rename_keys(state: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a policy's state under the present names; whoever trained the old one did pre-train it."""
    old = [name for name in state if isinstance(name, str) and name.startswith("motion.")]
    if not old:
        return state
    new = dict(state)
    for name in old:
        prefix = next(prefix for prefix in RENAMED_KEYS if name.startswith(prefix))
        new[RENAMED_KEYS[prefix] + name.removeprefix(prefix)] = new.pop(name)
    return {**new, "dynamics.n_updates": th.tensor(1)}


def upgraded(state: Mapping[str, Any], present: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a saved policy's state under the present names.

    Args:
        state: The saved one.
        present: That of a new policy, whose heads are taken if the saved one has none: DQN acts without them.
    """
    state = rename_keys(state)
    heads = {name: value for name, value in present.items() if name.startswith("dynamics.")}
    return state if heads.keys() & state.keys() else {**state, **heads}
