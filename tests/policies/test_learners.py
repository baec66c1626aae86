"""Learners of others on our task: the example script, the YAML files, and what each refuses."""

import importlib.util
from pathlib import Path
from typing import Any

import fake_reach
import gymnasium as gym
import numpy as np
import pytest
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm

from sb3_stereo.config.schema import ALGORITHMS, algorithm, load_config
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.protocol import q_value
from sb3_stereo.policies.extractors import StereoCnn
from sb3_stereo.runs.directory import model_path
from sb3_stereo.runs.models import load_model, untrained_model
from sb3_stereo.runs.training_state import variables
from sb3_stereo.training import Options, train

pytest.importorskip("sb3_contrib", reason='pip install -e ".[contrib]"')
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "own_learner.py"
LEARNERS = ["td3", "sac", "tqc", "crossq", "ppo"]
REPLAY = {"buffer_size": 50, "learning_starts": 10, "batch_size": 4}
ROLLOUT = {"n_steps": 10, "batch_size": 5, "n_epochs": 1}


def example() -> Any:
    spec = importlib.util.spec_from_file_location("own_learner", EXAMPLE)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def weights(model: BaseAlgorithm) -> list[th.Tensor]:
    return [parameter.detach().clone() for parameter in model.policy.parameters()]


@pytest.mark.parametrize("name", LEARNERS)
def test_the_examples_learner_learns_through_our_encoder(name: str) -> None:
    settings = {"seed": 0, **(ROLLOUT if name == "ppo" else REPLAY)}
    module = example()
    before, after = (module.train(name, n, fake_reach.ENV_ID, **settings) for n in (1 if name != "ppo" else 0, 40))
    encoders = [m for m in after.policy.modules() if isinstance(m, StereoCnn)]
    assert encoders
    changed = [not th.equal(a, b) for a, b in zip(weights(before), weights(after), strict=True)]
    assert np.mean(changed) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNERS)
@pytest.mark.parametrize("env_id", ["WamStereoReach-v0", "KukaStereoReach-v0"])
def test_the_example_runs_on_the_real_task(env_id: str, name: str) -> None:
    settings = {"n_steps": 100, "batch_size": 50} if name == "ppo" else {"batch_size": 50}
    model = example().train(name, 300, env_id, **settings)
    assert model.num_timesteps == 300
    env = gym.make(env_id)
    action, _ = model.predict(env.reset(seed=0)[0], deterministic=True)
    assert env.action_space.contains(action)


@pytest.mark.slow
@pytest.mark.parametrize("algo", LEARNERS)
def test_our_file_trains_on_the_real_task(algo: str, logs: Path) -> None:
    params = {"n_steps": 50, "batch_size": 50} if algo == "ppo" else {"learning_starts": 150}
    config = load_config(algo, "PandaStereoReach-v0", params=params, n_timesteps=200)
    result = train(config, Options(seed=0, log_folder=str(logs), verbose=0))
    assert result.n_timesteps == 200
    assert result.evaluation is not None and result.evaluation.n_poses == 100


@pytest.mark.parametrize("algo", LEARNERS)
def test_a_run_is_loaded_without_running_its_pickle_as_sb3_loads_it(algo: str, logs: Path) -> None:
    params = ROLLOUT | {"n_envs": 1} if algo == "ppo" else REPLAY
    config = load_config(algo, fake_reach.ENV_ID, params=params, n_timesteps=20)
    run = train(config, Options(seed=0, log_folder=str(logs), eval_freq=-1, verbose=0)).run
    path = model_path(run, config.env_id)
    ours, sb3s = load_model(config, path, "cpu"), load_model(config, path, "cpu", trust=True)
    untrained = untrained_model(config, "cpu", seed=0)
    assert any(not th.equal(a, b) for a, b in zip(weights(ours), weights(untrained), strict=True))
    for a, b in zip(weights(ours), weights(sb3s), strict=True):
        assert th.equal(a, b)
    found = variables(ours)
    assert (algo in ("sac", "tqc", "crossq")) == bool(found)
    assert all(th.equal(value, variables(sb3s)[name]) for name, value in found.items())
    image, _ = gym.make(fake_reach.ENV_ID).reset(seed=0)
    np.testing.assert_array_equal(*(model.predict(image, deterministic=True)[0] for model in (ours, sb3s)))


@pytest.mark.parametrize("name", LEARNERS)
def test_the_value_of_an_action_is_the_critics(name: str) -> None:
    model = example().train(name, 20, fake_reach.ENV_ID, seed=0, **(ROLLOUT if name == "ppo" else REPLAY))
    image, _ = gym.make(fake_reach.ENV_ID).reset(seed=0)
    action = np.array([0.3, -0.2, 0.1, 0.9], np.float32)
    value = q_value(model, image, action)
    if name == "ppo":
        assert np.isnan(value)
        return
    with th.no_grad():
        values = model.policy.critic(th.as_tensor(image)[None], th.as_tensor(action)[None])  # type: ignore[operator,union-attr]
    if name == "tqc":
        values = values.mean(dim=2)[0]  # the quantiles of each critic
    assert value == pytest.approx(min(float(v) for v in values))


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_every_algorithm_is_the_packages_own_class_or_extends_it(algo: str) -> None:
    bases = [cls for cls in algorithm(algo).__mro__ if cls.__module__.split(".")[0] == ALGORITHMS[algo]]
    assert bases[0].__name__.lower() == algo


def test_a_missing_package_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr("sb3_stereo.config.schema.import_module", missing)
    with pytest.raises(ConfigError) as error:
        algorithm("tqc")
    assert str(error.value) == "algorithm 'tqc' needs sb3_contrib; install it with: pip install 'sb3_stereo[contrib]'"


@pytest.mark.parametrize(
    ("algo", "params", "message"),
    [
        (
            "ppo",
            {"buffer_size": 10},
            "unknown hyper-parameter of ppo 'buffer_size'; allowed are: batch_size, callback, clip_range, "
            "clip_range_vf, ent_coef, env_kwargs, env_wrapper, eval_env_kwargs, frame_stack, gae_lambda, gamma, "
            "learning_rate, max_grad_norm, monitor_kwargs, n_envs, n_epochs, n_steps, n_timesteps, noise_std, "
            "noise_type, normalize_advantage, "
            "policy, policy_kwargs, rollout_buffer_class, rollout_buffer_kwargs, sde_sample_freq, stats_window_size, "
            "target_kl, use_sde, vf_coef",
        ),
        (
            "ppo",
            {"noise_type": "normal", "noise_std": 0.1},
            "noise_type 'normal' needs an off-policy algorithm with continuous actions; remove it for PPO",
        ),
        ("ppo", {"clip_range": "small"}, "clip_range must be a number or 'lin_<number>', got 'small'"),
        (
            "sac",
            {"policy": "sb3_stereo.policies.StereoDDPGPolicy"},
            "policy: 'sb3_stereo.policies.StereoDDPGPolicy' is not a subclass of SACPolicy; name one that is",
        ),
    ],
)
def test_what_does_not_go_with_a_learner_is_named(algo: str, params: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as error:
        load_config(algo, fake_reach.ENV_ID, params=params)
    assert str(error.value) == message
