"""Configurations: what is read arrives, and what is wrong is named."""

from pathlib import Path
from typing import Any

import fake_reach
import pytest
import yaml

from sb3_stereo.config.schema import ALGORITHMS, Config, load_config, parse_config
from sb3_stereo.config.values import parse_assignments
from sb3_stereo.errors import ConfigError, unknown

MINIMAL = {"n_timesteps": 100, "policy": "CnnPolicy"}


def parse(algo: str = "ddpg", **values: Any) -> Config:
    return parse_config(algo, fake_reach.ENV_ID, MINIMAL | values)


def load(tmp_path: Path, text: str, **kwargs: Any) -> Config:
    file = tmp_path / "conf.yml"
    file.write_text(text)
    return load_config("ddpg", fake_reach.ENV_ID, file, **kwargs)


@pytest.mark.parametrize("name", [*ALGORITHMS, "paper/ddpg", "paper/dqn"])
def test_our_files_are_valid_and_their_plain_form_reads_back_the_same(name: str) -> None:
    file = Path(__file__).parents[2] / "hyperparams" / f"{name}.yml"
    config = load_config(file.stem, "WamStereoReach-v0", file)
    plain = yaml.safe_load(yaml.safe_dump(config.plain()))
    assert parse_config(config.algo, config.env_id, plain) == config


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_the_default_file_comes_with_the_package(algo: str) -> None:
    assert ".Stereo" in load_config(algo, fake_reach.ENV_ID).policy


def test_the_environments_own_section_wins_over_default(tmp_path: Path) -> None:
    text = "default: {n_timesteps: 1, policy: MlpPolicy}\nFakeReach-v0: {n_timesteps: 2, policy: MlpPolicy}"
    assert load(tmp_path, text).n_timesteps == 2


def test_overrides_reach_inside_maps_and_leave_their_neighbours(tmp_path: Path) -> None:
    text = "default: {n_timesteps: 9, policy: sb3_stereo.policies.StereoDDPGPolicy, policy_kwargs: {n_critics: 1}}"
    params = parse_assignments(["policy_kwargs.qf_learning_rate:1e-3", "gamma:0.5", "train_freq:[2, step]"])
    config = load(tmp_path, text, params=params, env_kwargs={"tolerance": 0.5}, n_timesteps=7)
    assert config.policy_kwargs == {"n_critics": 1, "qf_learning_rate": 0.001}
    assert config.algo_kwargs == {"gamma": 0.5, "train_freq": [2, "step"]}
    assert config.env_kwargs == {"tolerance": 0.5}
    assert config.n_timesteps == 7


def test_numbers_may_be_written_as_yaml_reads_texts_and_whole_floats_are_integers(tmp_path: Path) -> None:
    config = load(tmp_path, "default: {n_timesteps: 1e4, policy: MlpPolicy, learning_rate: 1e-3, buffer_size: 1e2}")
    assert (config.n_timesteps, config.algo_kwargs) == (10_000, {"learning_rate": 0.001, "buffer_size": 100})
    assert isinstance(config.n_timesteps, int)


def test_null_switches_noise_callbacks_and_wrappers_off() -> None:
    config = parse(noise_type=None, noise_std=0.5, callback=None, env_wrapper=None)
    assert (config.noise_type, config.callback, config.env_wrapper) == (None, (), ())


def test_success_is_recorded_by_default() -> None:
    assert parse().monitor_kwargs == {"info_keywords": ["is_success"]}


ERRORS = [
    (
        {"gama": 0.9},
        "unknown hyper-parameter of ddpg 'gama' (did you mean 'gamma'?); allowed are: augmentation, batch_size, "
        "buffer_size, callback, dynamics_steps, env_kwargs, env_wrapper, eval_env_kwargs, exploration, frame_stack, "
        "gamma, gradient_steps, learning_rate, learning_starts, monitor_kwargs, n_envs, n_steps, n_timesteps, "
        "noise_std, noise_type, optimize_memory_usage, policy, policy_kwargs, pretraining, replay_buffer_class, "
        "replay_buffer_kwargs, tau, train_freq",
    ),
    ({"gamma": "high"}, "DDPG: gamma must be a number, got 'high'"),
    ({"gamma": True}, "DDPG: gamma must be a number, got True"),
    ({"batch_size": 1.5}, "DDPG: batch_size must be an integer, got 1.5"),
    ({"n_timesteps": 0}, "n_timesteps must be positive, got 0"),
    ({"learning_rate": "fast"}, "learning_rate must be a number or 'lin_<number>', got 'fast'"),
    (
        {"policy": "CnPolicy"},
        "unknown policy 'CnPolicy' (did you mean 'CnnPolicy'?); allowed are: CnnPolicy, MlpPolicy, MultiInputPolicy, "
        "a dotted path 'package.module.Class'",
    ),
    (
        {"policy": "sb3_stereo.StereoCnn"},
        "policy: 'sb3_stereo.StereoCnn' is not a subclass of TD3Policy; name one that is",
    ),
    (
        {"policy": "sb3_stereo.policies.Nothing"},
        "policy: cannot import 'sb3_stereo.policies.Nothing' (module 'sb3_stereo.policies' has no attribute "
        "'Nothing'); the form is package.module.Class",
    ),
    (
        {"policy_kwargs": "dict(net_arch=[64], activation_fn=os.system('true'))"},
        "policy_kwargs must be a map: 'os.system('true')' is neither a constant nor a class of torch; "
        "write it as YAML, policy_kwargs: {name: value}",
    ),
    (
        {"policy_kwargs": {"n_critic": 1}},
        "unknown argument of CnnPolicy 'n_critic' (did you mean 'n_critics'?); allowed are: activation_fn, "
        "features_extractor_class, features_extractor_kwargs, n_critics, net_arch, normalize_images, optimizer_class, "
        "optimizer_kwargs, share_features_extractor",
    ),
    ({"env_wrapper": "os.system"}, "env_wrapper: 'os.system' is not a subclass of Wrapper; name one that is"),
    (
        {"env_wrapper": [{"sb3_stereo.envs.wrappers.QuantizedActions": {"level": 3}}]},
        "unknown argument of env_wrapper QuantizedActions 'level' (did you mean 'levels'?); allowed are: levels",
    ),
    (
        {"exploration": {"n_steps": "many"}},
        "DDPG: exploration must be a map or null, got {'n_steps': 'many'}",
    ),
    (
        {"noise_type": "pink", "noise_std": 0.1},
        "unknown noise_type 'pink'; allowed are: normal, ornstein-uhlenbeck",
    ),
    ({"noise_type": "normal"}, "noise_type 'normal' needs noise_std; add it, as in noise_std: 0.3"),
    (
        {"env_kwargs": {"tolerence": 1}},
        "unknown argument of env_kwargs of FakeReach-v0 'tolerence' (did you mean 'tolerance'?); "
        "allowed are: tolerance",
    ),
    ({"env_kwargs": {"tolerance": "wide"}}, "env_kwargs of FakeReach-v0: tolerance must be a number, got 'wide'"),
]


@pytest.mark.parametrize(("values", "message"), ERRORS)
def test_wrong_values_are_named(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse(**values)
    assert str(error.value) == message


def test_a_missing_key_is_named() -> None:
    with pytest.raises(ConfigError) as error:
        parse_config("ddpg", fake_reach.ENV_ID, {"policy": "CnnPolicy"})
    assert str(error.value) == (
        "the hyper-parameters of FakeReach-v0 lack 'n_timesteps'; add it to the file or to -params"
    )


def test_dqn_takes_no_action_noise() -> None:
    with pytest.raises(ConfigError) as error:
        parse("dqn", noise_type="normal", noise_std=0.1)
    assert str(error.value) == (
        "noise_type 'normal' needs an off-policy algorithm with continuous actions; remove it for DQN"
    )


def test_unknown_algorithms_and_environments_are_named() -> None:
    with pytest.raises(ConfigError) as error:
        load_config("a2c", fake_reach.ENV_ID)
    assert str(error.value) == (
        "unknown algorithm 'a2c' (did you mean 'sac'?); allowed are: crossq, ddpg, dqn, ppo, sac, td3, tqc"
    )
    with pytest.raises(
        ConfigError, match=r"^unknown environment 'WamStereoReach-v9' \(did you mean 'WamStereoReach-v1'\?"
    ):
        load_config("ddpg", "WamStereoReach-v9")


def test_a_very_long_name_is_cut() -> None:
    assert str(unknown("policy", "x" * 5000, ["a"])) == f"unknown policy '{'x' * 100}…'; allowed are: a"


def test_unreadable_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as error:
        load_config("ddpg", fake_reach.ENV_ID, tmp_path / "no.yml")
    assert str(error.value) == f"no hyper-parameter file '{tmp_path / 'no.yml'}'; check the path given with -conf"
    with pytest.raises(ConfigError) as error:
        load(tmp_path, "Other-v0: {n_timesteps: 1}")
    file = tmp_path / "conf.yml"
    assert str(error.value) == f"unknown environment of '{file}' 'FakeReach-v0'; allowed are: Other-v0"


def test_yaml_cannot_make_python_objects(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is not plain YAML: could not determine a constructor for the tag"):
        load(tmp_path, "default: !!python/object/apply:os.getcwd []")


def test_assignments_need_a_colon() -> None:
    with pytest.raises(ConfigError) as error:
        parse_assignments(["gamma=0.9"])
    assert str(error.value) == "'gamma=0.9' is not of the form key:value, as in learning_starts:100"


def test_a_dotted_override_needs_a_map(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as error:
        load(tmp_path, "default: {n_timesteps: 1, policy: MlpPolicy}", params={"policy.x": 1})
    assert str(error.value) == "'policy.x' reaches inside 'policy', which is 'MlpPolicy' and not a map"
