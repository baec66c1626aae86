"""YAML and overrides become one checked, frozen configuration.

The schema is the one of rl-baselines3-zoo: one map per environment id, `default` for all others. YAML is data: nothing
in it is evaluated, and a dotted path is accepted only if it names a class of the right kind.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
from gymnasium.envs.registration import load_env_creator

from sb3_stereo.config import limits
from sb3_stereo.config.components import Component, check_kwargs, coerce, import_class, parameters, parse_components
from sb3_stereo.config.old_settings import renamed_keys, renamed_settings
from sb3_stereo.config.values import flatten, override_all, read_hyperparams
from sb3_stereo.config.zoo_literals import parse_map
from sb3_stereo.errors import ConfigError, setting_up, unknown

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import BasePolicy

DEFAULT_ENV = "WamStereoReach-v1"

# Name to the package whose algorithm it is; the class has the name in capitals, but for CrossQ.
ALGORITHMS = {
    "ddpg": "stable_baselines3",
    "dqn": "stable_baselines3",
    "td3": "stable_baselines3",
    "sac": "stable_baselines3",
    "ppo": "stable_baselines3",
    "crossq": "sb3_contrib",
    "tqc": "sb3_contrib",
}
SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")  # a number, or lin_<number>, which falls to 0
NOISE_TYPES = ("normal", "ornstein-uhlenbeck")
# Keys of the zoo that wrap all environments at once, and what does the same to each.
NOT_SUPPORTED = {
    "normalize": "env_wrapper: [gymnasium.wrappers.NormalizeReward] for rewards; our encoders normalise images",
    "vec_env_wrapper": "env_wrapper, whose wrappers wrap each environment",
}

# Arguments of SB3's constructors that have another source than the YAML: flags, or keys of their own.
_NOT_FROM_YAML = frozenset(
    {"self", "env", "policy", "policy_kwargs", "action_noise", "tensorboard_log", "verbose", "seed", "device"}
    | {"_init_setup_model"}
)
# Arguments that SB3 gives the policy itself.
_GIVEN_TO_POLICY = frozenset({"self", "observation_space", "action_space", "lr_schedule"})


@dataclass(frozen=True)
class Config:
    """Everything that decides a training run, except the flags of the command.

    Attributes:
        algo: One of `ALGORITHMS`.
        env_id: A registered environment.
        n_timesteps: Environment steps to train for, summed over the environments.
        policy: SB3's alias ("CnnPolicy") or the dotted path of a policy class.
        n_envs: Environments that are stepped together.
        policy_kwargs: Arguments of the policy.
        env_kwargs: Arguments of the environment.
        eval_env_kwargs: Those that differ where the agent is evaluated or shown.
        monitor_kwargs: Arguments of SB3's Monitor; the success is recorded by default.
        env_wrapper: Wrappers, innermost first, around the Monitor.
        callback: Callbacks of the training.
        noise_type: One of `NOISE_TYPES`, or None for no action noise.
        noise_std: Standard deviation of the noise's increments, on the action scale of -1 to 1.
        algo_kwargs: All other arguments of the algorithm's constructor.
    """

    algo: str
    env_id: str
    n_timesteps: int
    policy: str
    n_envs: int = 1
    policy_kwargs: Mapping[str, Any] = field(default_factory=dict)
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    eval_env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    monitor_kwargs: Mapping[str, Any] = field(default_factory=lambda: {"info_keywords": ["is_success"]})
    env_wrapper: tuple[Component, ...] = ()
    callback: tuple[Component, ...] = ()
    noise_type: str | None = None
    noise_std: float = 0.0
    algo_kwargs: Mapping[str, Any] = field(default_factory=dict)

    def plain(self) -> dict[str, Any]:
        """Return the configuration in the YAML's schema, as numbers, texts, lists and maps only."""
        noise = {"noise_type": self.noise_type, "noise_std": self.noise_std} if self.noise_type else {}
        evaluated = {"eval_env_kwargs": dict(self.eval_env_kwargs)} if self.eval_env_kwargs else {}
        values = {
            "n_timesteps": self.n_timesteps,
            "n_envs": self.n_envs,
            "policy": self.policy,
            "policy_kwargs": dict(self.policy_kwargs),
            "env_kwargs": dict(self.env_kwargs),
            "monitor_kwargs": dict(self.monitor_kwargs),
            "env_wrapper": [component.plain() for component in self.env_wrapper],
            "callback": [component.plain() for component in self.callback],
        }
        return values | evaluated | noise | dict(self.algo_kwargs)

    @property
    def evaluated(self) -> "Config":
        """The same with the environment in which the agent is evaluated or shown."""
        return replace(self, env_kwargs={**self.env_kwargs, **self.eval_env_kwargs}, eval_env_kwargs={})


def algorithm(name: str) -> "type[BaseAlgorithm]":
    """Return the class of that name: ours, which without our settings trains as the one that it extends, or SB3's.

    Raises:
        ConfigError: If the algorithm is none of ours, or its package is not installed.
    """
    if name not in ALGORITHMS:
        raise unknown("algorithm", name, ALGORITHMS)
    try:
        package = import_module(ALGORITHMS[name])
    except ImportError as error:
        raise ConfigError(
            f"algorithm '{name}' needs {ALGORITHMS[name]}; install it with: pip install 'sb3_stereo[contrib]'"
        ) from error
    class_name = "CrossQ" if name == "crossq" else name.upper()
    ours = getattr(import_module("sb3_stereo"), f"Stereo{class_name}", None)
    cls: type[BaseAlgorithm] = ours or getattr(package, class_name)
    return cls


def policy_class(algo: str, policy: object) -> "type[BasePolicy]":
    """Return the policy class that an alias or a dotted path names, if it is one for this algorithm."""
    aliases = algorithm(algo).policy_aliases
    if isinstance(policy, str) and policy in aliases:
        return aliases[policy]
    if not isinstance(policy, str) or "." not in policy:
        raise unknown("policy", policy, [*aliases, "a dotted path 'package.module.Class'"])
    return import_class(policy, aliases["MlpPolicy"], "policy")


def load_config(
    algo: str,
    env_id: str,
    conf_file: str | Path | None = None,
    params: Mapping[str, Any] | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
    n_timesteps: int = -1,
    eval_env_kwargs: Mapping[str, Any] | None = None,
) -> Config:
    """Read a YAML file, apply the overrides and check the result.

    Args:
        algo: One of `ALGORITHMS`.
        env_id: A registered environment.
        conf_file: The YAML file; by default our own for the algorithm.
        params: Overrides by key; a dotted key reaches inside, see `values.override_all`.
        env_kwargs: Overrides of `env_kwargs`.
        n_timesteps: Override of `n_timesteps`; -1 keeps the file's, as in the zoo.
        eval_env_kwargs: Overrides of `eval_env_kwargs`.

    Raises:
        ConfigError: If anything in it is unknown or of the wrong type.
    """
    algorithm(algo)
    check_env_id(env_id)
    values = override_all(renamed_settings(algo, read_hyperparams(algo, env_id, conf_file)), renamed_keys(params))
    for key, given in (("env_kwargs", env_kwargs), ("eval_env_kwargs", eval_env_kwargs)):
        if given:
            values[key] = {**(values.get(key) or {}), **given}
    if n_timesteps != -1:
        values["n_timesteps"] = n_timesteps
    return parse_config(algo, env_id, values)


def overridden(config: Config, params: Mapping[str, Any]) -> Config:
    """Return the configuration with overrides by key, checked."""
    return parse_config(config.algo, config.env_id, override_all(config.plain(), renamed_keys(params)))


def check_env_id(env_id: str) -> None:
    """Raise a ConfigError unless the environment is registered."""
    if env_id not in gym.registry:
        from sb3_stereo.envs import ENV_IDS, GOAL_ENV_IDS, MUJOCO_ENV_IDS, PICK_ENV_IDS

        close = [name for name in gym.registry if name.lower().startswith(env_id.lower()[:4])]
        raise unknown("environment", env_id, {*ENV_IDS, *GOAL_ENV_IDS, *MUJOCO_ENV_IDS, *PICK_ENV_IDS, *close})


def parse_config(algo: str, env_id: str, values: Mapping[str, Any]) -> Config:
    """Check one environment's map and freeze it."""
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.monitor import Monitor

    algo_class = algorithm(algo)
    values = renamed_settings(algo, values)
    algo_keys = set(parameters(algo_class)) - _NOT_FROM_YAML
    own_keys = {*Config.__dataclass_fields__, "frame_stack"} - {"algo", "env_id", "algo_kwargs"}
    values = {key: value for key, value in values.items() if key not in NOT_SUPPORTED or value}
    for key in values:
        if key in NOT_SUPPORTED:
            raise ConfigError(f"{key} is not supported here; leave it out, and write {NOT_SUPPORTED[key]}")
        if key not in own_keys | algo_keys:
            raise unknown(f"hyper-parameter of {algo}", key, own_keys | algo_keys)
    for key in ("n_timesteps", "policy"):
        if key not in values:
            raise ConfigError(f"the hyper-parameters of {env_id} lack '{key}'; add it to the file or to -params")
    policy = policy_class(algo, values["policy"])
    env_kwargs, eval_env_kwargs = _as_map(values, "env_kwargs"), _as_map(values, "eval_env_kwargs")
    evaluated = check_env_kwargs(env_id, {**env_kwargs, **eval_env_kwargs}) if eval_env_kwargs else {}
    config = Config(
        algo=algo,
        env_id=env_id,
        n_timesteps=_positive(values["n_timesteps"], "n_timesteps"),
        n_envs=_positive(values.get("n_envs", 1), "n_envs"),
        policy=values["policy"],
        policy_kwargs=_policy_kwargs(policy, values),
        env_kwargs=check_env_kwargs(env_id, env_kwargs),
        eval_env_kwargs={name: evaluated[name] for name in eval_env_kwargs},
        env_wrapper=_wrappers(values),
        callback=parse_components(values.get("callback"), BaseCallback, "callback"),
        algo_kwargs=_algo_kwargs(algo_class, {k: v for k, v in values.items() if k in algo_keys}),
        **_noise(values, algo_class),
    )
    if values.get("monitor_kwargs") is None:
        return config
    monitor_kwargs = check_kwargs(Monitor, _as_map(values, "monitor_kwargs"), "Monitor", {"env", "filename"})
    return replace(config, monitor_kwargs=monitor_kwargs)


def check_env_kwargs(env_id: str, kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Check an environment's arguments; `max_episode_steps` is the one that `gym.make` takes for itself.

    Returns:
        The arguments, with files that the environment would read replaced by what they hold: a record is complete.
    """
    kwargs = dict(kwargs)
    cap = {"max_episode_steps": kwargs.pop("max_episode_steps")} if "max_episode_steps" in kwargs else {}
    for key, value in cap.items():
        _positive(value, f"env_kwargs: {key}")
    entry_point = gym.spec(env_id).entry_point
    creator = load_env_creator(entry_point) if isinstance(entry_point, str) else entry_point
    assert creator is not None  # every registered environment has one
    checked = check_kwargs(creator, kwargs, f"env_kwargs of {env_id}", {"render_mode"})
    with setting_up(env_id):
        resolved = creator.plain_kwargs(checked) if hasattr(creator, "plain_kwargs") else checked
    return {**resolved, **cap}


def _policy_kwargs(policy: "type[BasePolicy]", values: Mapping[str, Any]) -> dict[str, Any]:
    """Check the policy's arguments, and those of its features extractor."""
    kwargs = check_kwargs(policy, _as_map(values, "policy_kwargs"), policy.__name__, _GIVEN_TO_POLICY)
    extractor = kwargs.get("features_extractor_class", parameters(policy)["features_extractor_class"].default)
    if isinstance(extractor, str):
        extractor = import_class(extractor, object, "features_extractor_class")
    if kwargs.get("features_extractor_kwargs"):
        inner = check_kwargs(extractor, kwargs["features_extractor_kwargs"], extractor.__name__, {"observation_space"})
        kwargs["features_extractor_kwargs"] = inner
    return kwargs


def _wrappers(values: Mapping[str, Any]) -> tuple[Component, ...]:
    """The wrappers, with the zoo's `frame_stack` as the outermost one."""
    wrappers = parse_components(values.get("env_wrapper"), gym.Wrapper, "env_wrapper")
    if not values.get("frame_stack"):
        return wrappers
    n_frames = _positive(values["frame_stack"], "frame_stack")
    return (*wrappers, Component("sb3_stereo.envs.wrappers.StackFrames", {"n_frames": n_frames}))


def _as_map(values: Mapping[str, Any], key: str) -> dict[str, Any]:
    value = values.get(key)
    if isinstance(value, str):
        try:
            value = parse_map(value)
        except ValueError as error:
            raise ConfigError(f"{key} must be a map: {error}; write it as YAML, {key}: {{name: value}}") from error
    if not isinstance(value, Mapping | None):
        raise ConfigError(f"{key} must be a map, got {value!r}")
    return dict(value or {})


def _positive(value: Any, name: str) -> int:
    number: int = coerce(value, int, name)
    if number < 1:
        raise ConfigError(f"{name} must be positive, got {number}")
    return number


def _noise(values: Mapping[str, Any], algo_class: Any) -> dict[str, Any]:
    noise_type = values.get("noise_type")
    if noise_type is None:
        return {}
    if "action_noise" not in parameters(algo_class):
        raise ConfigError(
            f"noise_type '{noise_type}' needs an off-policy algorithm with continuous actions; "
            f"remove it for {_sb3_name(algo_class)}"
        )
    if noise_type not in NOISE_TYPES:
        raise unknown("noise_type", noise_type, NOISE_TYPES)
    if "noise_std" not in values:
        raise ConfigError(f"noise_type '{noise_type}' needs noise_std; add it, as in noise_std: 0.3")
    noise_std = float(coerce(values["noise_std"], float, "noise_std"))
    limits.check("noise_std", noise_std, "noise_std")
    return {"noise_type": noise_type, "noise_std": noise_std}


def _algo_kwargs(algo_class: Any, kwargs: dict[str, Any]) -> dict[str, Any]:
    for key in SCHEDULES:
        value = kwargs.get(key)
        if isinstance(value, str):
            limits.check(key, _linear(value, key), key)
    for key in ("replay_buffer_kwargs", "pretraining", "exploration", "augmentation"):
        if kwargs.get(key) is not None:
            kwargs[key] = _as_map(kwargs, key)
    return check_kwargs(algo_class, kwargs, _sb3_name(algo_class))


def _sb3_name(algo_class: Any) -> str:
    return str(algo_class.__name__.removeprefix("Stereo"))


def _linear(value: str, key: str) -> float:
    """The number that a schedule `lin_<number>` starts from."""
    try:
        return float(value.removeprefix("lin_") if value.startswith("lin_") else "")
    except ValueError as error:
        raise ConfigError(f"{key} must be a number or 'lin_<number>', got {value!r}") from error


def settings(config: Config) -> dict[str, Any]:
    """Return a configuration with dotted keys, `policy_kwargs.n_critics`; a wrapper or callback by its class."""
    return plain_settings(config.algo, config.plain())


def plain_settings(algo: str, plain: Mapping[str, Any]) -> dict[str, Any]:
    """Return the same of a configuration as YAML holds it.

    Raises:
        AttributeError, TypeError, ValueError: If it holds something else.
    """
    components = [item for key in ("env_wrapper", "callback") for item in plain.get(key) or ()]
    others = {key: value for key, value in plain.items() if key not in ("env_wrapper", "callback")}
    return {"algo": algo, **flatten(others), **dict(map(_component, components))}


def _component(item: str | Mapping[str, Mapping[str, Any]]) -> tuple[str, str]:
    ((path, kwargs),) = item.items() if isinstance(item, Mapping) else [(item, {})]
    return path.rpartition(".")[2], f"({', '.join(f'{name}={value}' for name, value in kwargs.items())})"
