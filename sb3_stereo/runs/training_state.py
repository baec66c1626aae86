"""Everything that the next step of a training run depends on, as plain data: numbers, texts, lists, maps and tensors.

Plain, because `torch.load(weights_only=True)` reads it without running anything.
"""

import math
import random
from collections import deque
from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import ActionNoise, VectorizedActionNoise

from sb3_stereo.building.episodes import episodes, replay
from sb3_stereo.errors import ConfigError
from sb3_stereo.runs.weights import checked_state, checked_tensors

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

State = dict[str, Any]

COUNTERS = (
    "num_timesteps",
    "_episode_num",
    "_n_updates",
    "_n_calls",  # DQN's
    "exploration_rate",  # DQN's
    "_current_progress_remaining",
)
EPISODE_STARTS = "_current_ep_start"  # HerReplayBuffer's, a row per environment
SDE = ("exploration_mat", "exploration_matrices")  # of state-dependent exploration


def capture(model: "BaseAlgorithm", callbacks: Sequence[BaseCallback]) -> State:
    """Return the state of a training between two rollouts."""
    env = model.get_env()
    assert env is not None
    state = {
        "networks": model.get_parameters(),
        "variables": {name: variable.detach() for name, variable in variables(model).items()},
        "counters": {name: getattr(model, name) for name in COUNTERS if hasattr(model, name)},
        "last_obs": model._last_obs,
        "last_episode_starts": model._last_episode_starts,
        "ep_info": list(model.ep_info_buffer or ()),
        "ep_success": list(model.ep_success_buffer or ()),
        "replay_buffer": _buffer_state(getattr(model, "replay_buffer", None)),
        "noise": [_noise_state(noise) for noise in _noises(model)],
        "callbacks": {name: _callback_state(callback) for name, callback in _by_name(callbacks).items()},
        "episodes": episodes(env),
        "explorations": [{name: getattr(found, name).detach() for name in SDE} for found in _explorations(model)],
        "generators": _generators(model),
    }
    plain: State = to_plain(state)
    return plain


def restore(model: "BaseAlgorithm", callbacks: Sequence[BaseCallback], state: State) -> None:
    """Bring a training that has been set up anew, and has not stepped yet, to a captured state.

    `restore_drawn` is the rest of it.
    """
    env = model.get_env()
    assert env is not None
    missing = set(model._get_torch_save_params()[0]) - state["networks"].keys()
    if missing and "policy" in state["networks"]:
        raise ConfigError(
            f"the snapshot lacks {', '.join(sorted(missing))}: it is of a version before 0.1.0, whose training runs "
            "cannot be resumed; evaluate it as it is, or train anew"
        )
    for name in model._get_torch_save_params()[0]:
        owner = attrgetter(name)(model)
        owner.load_state_dict(checked_state(state["networks"][name], owner))
    learnt = variables(model)
    for name, value in checked_tensors(state["variables"], learnt).items():
        learnt[name].data.copy_(value)
    for name in COUNTERS:
        if hasattr(model, name):
            setattr(model, name, _number(state["counters"][name], name))
    model._num_timesteps_at_start = model.num_timesteps  # what SB3 measures its speed from
    model._last_obs = _array(state["last_obs"], model._last_obs, "last_obs")
    model._last_episode_starts = _array(state["last_episode_starts"], model._last_episode_starts, "last_episode_starts")
    model.ep_info_buffer = deque(state["ep_info"], model._stats_window_size)
    model.ep_success_buffer = deque(state["ep_success"], model._stats_window_size)
    _restore_buffer(getattr(model, "replay_buffer", None), state["replay_buffer"])
    for noise, saved in zip(_noises(model), state["noise"], strict=True):
        _restore_noise(noise, saved)
    for name, callback in _by_name(callbacks).items():  # another --verbose makes others
        callback.num_timesteps = model.num_timesteps
        if name in state["callbacks"]:
            _restore_callback(callback, state["callbacks"][name])
    records = to_numpy(state["episodes"])
    if len(records) != env.num_envs:
        raise ValueError(f"it has {len(records)} running episodes, and there are {env.num_envs} environments")
    replay(env, records)


def restore_drawn(model: "BaseAlgorithm", state: State) -> None:
    """Bring back the generators, and the exploration that SB3 has drawn from them for this rollout.

    Call it when the first rollout starts: with `use_sde`, SB3 has drawn once more just before.
    """
    for distribution, saved in zip(_explorations(model), state.get("explorations", ()), strict=True):
        vars(distribution).update({name: saved[name].to(model.device) for name in SDE})
    _restore_generators(model, state["generators"])


def to_plain(value: Any) -> Any:
    """Return nested data with arrays as tensors that share their memory, and NumPy's numbers as Python's."""
    if isinstance(value, Mapping):
        return {key: to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(to_plain(item) for item in value)
    if isinstance(value, np.ndarray):
        return th.as_tensor(value)
    return value.item() if isinstance(value, np.generic) else value


def to_numpy(value: Any) -> Any:
    """Return nested data with tensors as arrays."""
    if isinstance(value, Mapping):
        return {key: to_numpy(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(to_numpy(item) for item in value)
    return value.numpy() if isinstance(value, th.Tensor) else value


def variables(model: "BaseAlgorithm") -> dict[str, th.Tensor]:
    """Return what SB3 learns outside its networks, by name: SAC's entropy coefficient."""
    return {name: attrgetter(name)(model) for name in model._get_torch_save_params()[1]}


def _explorations(model: "BaseAlgorithm") -> list[Any]:
    """The distributions of state-dependent exploration: none without `use_sde`."""
    return [getattr(model, "actor", model.policy).action_dist] if model.use_sde else []


def check_can_be_captured(model: "BaseAlgorithm") -> None:
    """Raise a ConfigError if a training remembers what a snapshot cannot hold."""
    if getattr(getattr(model, "replay_buffer", None), "copy_info_dict", False):
        raise ConfigError(
            "replay_buffer_kwargs: copy_info_dict is true, and a snapshot cannot hold what every step's info is; "
            "train without snapshots (--save-freq -1), or take a reward that needs no info and leave it out"
        )


def _buffer_arrays(buffer: ReplayBuffer) -> dict[str, NDArray[Any]]:
    """What it holds row by row; observations may be several arrays, by name."""
    found: dict[str, Any] = {}
    for name, value in vars(buffer).items():
        found |= {f"{name}.{key}": part for key, part in value.items()} if isinstance(value, dict) else {name: value}
    return {
        name: value
        for name, value in found.items()
        # HerReplayBuffer's infos are objects, empty unless `check_can_be_captured` refuses them.
        if isinstance(value, np.ndarray) and value.shape[:1] == (buffer.buffer_size,) and value.dtype != object
    }


def _buffer_state(buffer: ReplayBuffer | None) -> State | None:
    if buffer is None:
        return None
    n_rows = buffer.size() + 1  # SB3's memory saver keeps the newest next observation one row further
    arrays = {name: array[:n_rows] for name, array in _buffer_arrays(buffer).items()}
    state = {"arrays": arrays, "pos": buffer.pos, "full": buffer.full}
    starts = getattr(buffer, EPISODE_STARTS, None)
    return state if starts is None else state | {"episode_starts": starts}


def _restore_buffer(buffer: ReplayBuffer | None, state: State | None) -> None:
    if buffer is None or state is None:
        return
    pos, full = state["pos"], state["full"]
    if type(pos) is not int or not 0 <= pos < buffer.buffer_size or type(full) is not bool:
        raise ValueError(f"a replay buffer of {buffer.buffer_size} rows is not at row {pos!r}, full: {full!r}")
    buffer.pos, buffer.full = pos, full
    for name, array in _buffer_arrays(buffer).items():
        saved = state["arrays"][name].numpy()
        if saved.dtype != array.dtype or saved.shape[1:] != array.shape[1:] or not len(saved) >= buffer.size():
            raise ValueError(f"the replay buffer's '{name}' is {saved.dtype} {saved.shape}")
        array[: len(saved)] = saved
    starts = getattr(buffer, EPISODE_STARTS, None)
    if starts is not None:
        setattr(buffer, EPISODE_STARTS, _array(state["episode_starts"], starts, EPISODE_STARTS))


def _array(saved: Any, own: Any, name: str) -> Any:
    """An array of the shape of another; observations may also be several, by name."""
    if isinstance(own, Mapping):
        return {key: _array(saved[key], value, name) for key, value in own.items()}
    array = to_numpy(saved)
    if getattr(array, "dtype", None) != own.dtype or array.shape != own.shape:
        raise ValueError(f"'{name}' is not {own.dtype} {own.shape}")
    return array


def _number(value: Any, name: str) -> int | float:
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"'{name}' must be a number, got {value!r}")
    return value


def _noises(model: "BaseAlgorithm") -> list[ActionNoise]:
    noise = getattr(model, "action_noise", None)
    if isinstance(noise, VectorizedActionNoise):
        return list(noise.noises)
    return [] if noise is None else [noise]


def _noise_state(noise: Any) -> State:
    """Ours has a `state_dict`; of SB3's only Ornstein-Uhlenbeck remembers anything."""
    if hasattr(noise, "state_dict"):
        return dict(noise.state_dict())
    return {"noise_prev": noise.noise_prev} if hasattr(noise, "noise_prev") else {}


def _restore_noise(noise: Any, state: State) -> None:
    if hasattr(noise, "load_state_dict"):
        noise.load_state_dict(to_numpy(state))
    elif state:
        noise.noise_prev = to_numpy(state["noise_prev"])


def _by_name(callbacks: Sequence[BaseCallback]) -> dict[str, BaseCallback]:
    """Callbacks by the names of their classes, numbered where there are several of one."""
    found: dict[str, BaseCallback] = {}
    for callback in callbacks:
        name = type(callback).__name__
        n_same = sum(key.partition(" ")[0] == name for key in found)
        found[f"{name} {n_same + 1}" if n_same else name] = callback
    return found


def _callback_state(callback: Any) -> State:
    own = callback.state_dict() if hasattr(callback, "state_dict") else {}
    return {"n_calls": callback.n_calls, "own": own}


def _restore_callback(callback: Any, state: State) -> None:
    callback.n_calls = _number(state["n_calls"], "n_calls")
    if hasattr(callback, "load_state_dict"):
        callback.load_state_dict(state["own"])


def _generators(model: "BaseAlgorithm") -> State:
    cuda = th.cuda.get_rng_state_all() if model.device.type == "cuda" else []
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(),
        "torch": th.get_rng_state(),
        "cuda": cuda,
        "actions": model.action_space.np_random.bit_generator.state,
    }


def _restore_generators(model: "BaseAlgorithm", state: State) -> None:
    random.setstate(state["python"])
    np.random.set_state(to_numpy(state["numpy"]))
    th.set_rng_state(state["torch"])
    if state["cuda"]:
        th.cuda.set_rng_state_all(state["cuda"])
    model.action_space.np_random.bit_generator.state = state["actions"]
