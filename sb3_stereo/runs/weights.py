"""Saved networks and optimizers, compared with a model's before they are loaded into it."""

import math
from typing import Any

import torch as th
from torch import nn
from torch.optim import Optimizer

from sb3_stereo.config.components import parameters
from sb3_stereo.runs.archives import check_dense

State = dict[str, Any]


def checked_state(found: Any, owner: nn.Module | Optimizer) -> State:
    """Return the state of a network or an optimizer, ready for its `load_state_dict`.

    Raises:
        ValueError: If it is another's.
    """
    return (
        _optimizer_state(found, owner) if isinstance(owner, Optimizer) else checked_tensors(found, owner.state_dict())
    )


def checked_tensors(found: Any, expected: dict[str, Any]) -> State:
    """Return tensors by name, if they are those that are expected: of the same names, shapes and types.

    Half precision, in which the agents that ship are stored, becomes single precision again.

    Raises:
        ValueError: If they are others.
    """
    _check_keys(found, expected, "the networks")
    found = {name: _widened(value, expected[name]) for name, value in found.items()}
    for name, tensor in expected.items():
        if not isinstance(tensor, th.Tensor):  # a module's own extra state
            _check_like(found[name], tensor, f"'{name}'")
        elif _describe(found[name]) != _describe(tensor):
            raise ValueError(f"'{name}' is {_describe(found[name])}, and these networks have {_describe(tensor)}")
        else:
            check_dense(found[name])
    return {name: found[name] for name in expected}


def _widened(value: Any, expected: Any) -> Any:
    if not isinstance(value, th.Tensor) or value.dtype != th.float16 or getattr(expected, "dtype", None) != th.float32:
        return value
    check_dense(value)  # before it takes twice the memory
    return value.float()


def _describe(value: Any) -> str:
    if not isinstance(value, th.Tensor):
        return f"of type {type(value).__name__}"
    return f"{str(value.dtype).removeprefix('torch.')} {list(value.shape)}"


def _optimizer_state(found: Any, optimizer: Optimizer) -> State:
    expected = optimizer.state_dict()
    _check_keys(found, expected, "an optimizer")
    groups = found["param_groups"]
    if not isinstance(groups, list) or len(groups) != len(expected["param_groups"]):
        raise ValueError(f"an optimizer has not {len(expected['param_groups'])} groups of parameters")
    for group, own in zip(groups, expected["param_groups"], strict=True):
        _check_keys(group, own, "an optimizer's group")
        for name, value in own.items():
            _check_like(group[name], value, f"an optimizer's '{name}'")
        if group["params"] != own["params"]:
            raise ValueError("an optimizer is of other parameters")
    weights = [weight for group in optimizer.param_groups for weight in group["params"]]
    return {"param_groups": groups, "state": _moments(found["state"], weights, optimizer)}


def _moments(found: Any, weights: list[th.Tensor], optimizer: Optimizer) -> dict[int, State]:
    """What an optimizer keeps for each weight, such as its mean gradient."""
    if not isinstance(found, dict) or not all(type(key) is int and key in range(len(weights)) for key in found):
        raise ValueError("an optimizer's state is not by the number of the parameter")
    kept = _kept(optimizer) if found else {}
    for index, state in found.items():
        _check_keys(state, kept, "an optimizer's state")
        for name, value in kept.items():
            if not isinstance(value, th.Tensor):
                _check_like(state[name], value, f"an optimizer's '{name}'")
                continue
            shape = weights[index].shape if value.dim() else value.shape
            if not isinstance(state[name], th.Tensor) or state[name].shape != shape or not _is_real(state[name]):
                raise ValueError(f"an optimizer's '{name}' of parameter {index} must be a number each")
            check_dense(state[name])
    return dict(found)


def _is_real(tensor: th.Tensor) -> bool:
    return tensor.is_floating_point() and tensor.element_size() <= 8


def _kept(optimizer: Optimizer) -> State:
    """What an optimizer keeps for a weight: found by one step of another of its kind."""
    known = parameters(type(optimizer))
    weight = nn.Parameter(th.zeros(1, 1, device=optimizer.param_groups[0]["params"][0].device))
    weight.grad = th.zeros_like(weight)
    other = type(optimizer)([weight], **{key: value for key, value in optimizer.defaults.items() if key in known})
    other.step()
    return dict(other.state[weight])


def _check_keys(found: Any, expected: State, what: str) -> None:
    if not isinstance(found, dict):
        raise ValueError(f"{what} must be a map, not of type {type(found).__name__}")
    for name in [*(expected.keys() - found.keys()), *(found.keys() - expected.keys())]:
        raise ValueError(f"{what} {'lacks' if name in expected else 'has an unknown'} {name!r}")


def _check_like(found: Any, expected: Any, what: str) -> None:
    """Raise a ValueError unless a plain value is of the same kind as another: texts, numbers, lists of as many."""
    if isinstance(expected, list | tuple):
        if not isinstance(found, list | tuple) or len(found) != len(expected):
            raise ValueError(f"{what} must be a list of {len(expected)}")
        for one, other in zip(found, expected, strict=True):
            _check_like(one, other, what)
    elif isinstance(expected, bool | str | None):
        if not isinstance(found, bool | str | None):
            raise ValueError(f"{what} must be a text, true, false or null")
    elif not isinstance(found, int | float) or isinstance(found, bool) or not math.isfinite(found):
        raise ValueError(f"{what} must be a number, not of type {type(found).__name__}")
