"""A configuration becomes environments and a model."""

import multiprocessing
import signal
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.noise import ActionNoise, NormalActionNoise, OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from sb3_stereo.building.episodes import ResumableEpisode
from sb3_stereo.config.components import Component, import_class, resolve_classes
from sb3_stereo.config.schema import SCHEDULES, Config, algorithm, policy_class
from sb3_stereo.errors import ConfigError

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

Wrappers = tuple[tuple[type[gym.Wrapper], dict[str, Any]], ...]  # classes with their arguments, innermost first

VEC_ENVS: dict[str, type[DummyVecEnv] | type[SubprocVecEnv]] = {"dummy": DummyVecEnv, "subproc": SubprocVecEnv}


def make_env(env_id: str, env_kwargs: Mapping[str, Any], env_wrapper: Sequence[Component]) -> Callable[[], gym.Env]:
    """Return a function that makes the wrapped environment, in another process as well."""
    return partial(_make, gym.spec(env_id), dict(env_kwargs), _wrappers(env_wrapper))


def _make(spec: gym.envs.registration.EnvSpec, env_kwargs: dict[str, Any], env_wrapper: Wrappers) -> gym.Env:
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the main process, which closes the workers
    return _wrap(spec.make(**env_kwargs), env_wrapper)


def _wrappers(components: Sequence[Component]) -> Wrappers:
    """The classes, which another process imports by itself: what the user has named is known in this one alone."""
    return tuple((import_class(c.path, gym.Wrapper, "env_wrapper"), dict(c.kwargs)) for c in components)


def _wrap(env: gym.Env, env_wrapper: Wrappers) -> gym.Env:
    """Wrap an environment, the first wrapper innermost."""
    for wrapper, kwargs in env_wrapper:
        env = wrapper(env, **kwargs)
    return env


def _wrap_for_training(env: gym.Env, env_wrapper: Wrappers) -> gym.Env:
    return ResumableEpisode(_wrap(env, env_wrapper))


def make_training_env(
    config: Config, seed: int, monitor_dir: str | None = None, vec_env: str = "dummy", append: bool = False
) -> VecEnv:
    """Make the training environments as the zoo does: Monitor inside, wrappers around it.

    Args:
        config: What to make.
        seed: Seeds the environments `seed`, `seed + 1`, …
        monitor_dir: Where the episodes are recorded; None records nothing.
        vec_env: "dummy" steps them in this process, "subproc" each in its own.
        append: Go on with the records that are there.
    """
    if vec_env == "subproc":  # a process could only die of arguments that this one can refuse
        make_env(config.env_id, config.env_kwargs, config.env_wrapper)().close()
    return make_vec_env(
        make_env(config.env_id, config.env_kwargs, ()),
        n_envs=config.n_envs,
        seed=seed,
        monitor_dir=monitor_dir,
        wrapper_class=partial(_wrap_for_training, env_wrapper=_wrappers(config.env_wrapper)),
        vec_env_cls=VEC_ENVS[vec_env],
        monitor_kwargs=resolve_lists(config.monitor_kwargs) | ({"override_existing": False} if append else {}),
    )


def resolve_lists(kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments with lists as tuples."""
    return {key: tuple(value) if isinstance(value, list) else value for key, value in kwargs.items()}


def make_model(
    config: Config,
    env: VecEnv,
    seed: int | None = None,
    device: str = "auto",
    tensorboard_log: str | None = None,
    verbose: int = 0,
) -> "BaseAlgorithm":
    """Make the algorithm with the configured policy, noise and arguments."""
    check_action_space(config, env.action_space)
    algo_class = algorithm(config.algo)
    policy = policy_class(config.algo, config.policy)
    kwargs = resolve_classes(algo_class, config.algo_kwargs)
    for key in SCHEDULES:
        if isinstance(kwargs.get(key), str):
            kwargs[key] = LinearSchedule(float(kwargs[key].removeprefix("lin_")), 0.0, 1.0)
    if config.noise_type:
        kwargs["action_noise"] = make_noise(config, env)
    model: BaseAlgorithm = algo_class(
        policy=policy,
        env=env,
        policy_kwargs=resolve_classes(policy, config.policy_kwargs),
        seed=seed,
        device=device,
        tensorboard_log=tensorboard_log,
        verbose=verbose,
        **kwargs,
    )
    check_hindsight(model, env)
    return model


def check_hindsight(model: "BaseAlgorithm", env: VecEnv) -> None:
    """Raise a ConfigError if SB3's HerReplayBuffer would be sampled before an episode has ended."""
    spec = env.get_attr("spec")[0]
    if not isinstance(getattr(model, "replay_buffer", None), HerReplayBuffer) or not spec or not spec.max_episode_steps:
        return
    needed, given = spec.max_episode_steps * env.num_envs, model.learning_starts  # type: ignore[attr-defined]
    if given < needed:
        raise ConfigError(
            f"learning_starts is {given}, and HerReplayBuffer needs a whole episode, of up to {spec.max_episode_steps} "
            f"steps in each environment; set learning_starts to at least {needed}"
        )


def check_action_space(config: Config, space: gym.Space[Any]) -> None:
    """Raise a ConfigError unless the algorithm can act in this space."""
    if config.algo == "ppo" and isinstance(space, gym.spaces.Box | gym.spaces.Discrete):
        return
    wanted = gym.spaces.Discrete if config.algo == "dqn" else gym.spaces.Box
    if not isinstance(space, wanted):
        change = "add" if config.algo == "dqn" else "remove"
        way_out = f"{change} the env_wrapper sb3_stereo.envs.wrappers.QuantizedActions"
        raise ConfigError(f"{config.algo} needs {wanted.__name__} actions, {config.env_id} has {space}; {way_out}")


def check_evaluated_spaces(config: Config, env: VecEnv) -> None:
    """Raise a ConfigError if what `eval_env_kwargs` change is what an agent of these environments sees or does."""
    if not config.eval_env_kwargs:
        return
    with closing(make_env(config.env_id, config.evaluated.env_kwargs, config.env_wrapper)()) as evaluated:
        for name in ("observation_space", "action_space"):
            trained, found = getattr(env, name), getattr(evaluated, name)
            if trained != found:
                changed = ", ".join(config.eval_env_kwargs)
                raise ConfigError(
                    f"eval_env_kwargs ({changed}) make the {name} {found}, and the agent is trained with {trained}; "
                    "set in env_kwargs what the agent sees or does"
                )


def make_noise(config: Config, env: VecEnv) -> ActionNoise:
    """Make the zoo's action noise; annealing it is a callback's business."""
    assert isinstance(env.action_space, gym.spaces.Box)
    mean = np.zeros(env.action_space.shape[0])
    cls = NormalActionNoise if config.noise_type == "normal" else OrnsteinUhlenbeckActionNoise
    return cls(mean, config.noise_std * np.ones_like(mean))


def make_callbacks(config: Config) -> list[BaseCallback]:
    """Make the configured callbacks."""
    return [import_class(c.path, BaseCallback, "callback")(**c.kwargs) for c in config.callback]
