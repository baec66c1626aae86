"""Laws of the annealed noise and of the callback that brings it into SB3's algorithms."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from fake_env import FakeImageEnv
from stable_baselines3 import DDPG, DQN, PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise, OrnsteinUhlenbeckActionNoise, VectorizedActionNoise
from stable_baselines3.common.vec_env import DummyVecEnv

from sb3_stereo.learning.callbacks import AnnealExploration
from sb3_stereo.learning.exploration import AnnealedOrnsteinUhlenbeckNoise
from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.policies.dqn import StereoDQNPolicy

pytestmark = pytest.mark.filterwarnings("ignore:AnnealExploration will go:FutureWarning")
TINY_NET = {"features_extractor_kwargs": {"n_filters": 2}, "net_arch": [4, 4]}
RUN = {"buffer_size": 50, "batch_size": 4, "learning_starts": 10, "seed": 3}


def noise_of(n_processes: int = 4, **kwargs) -> AnnealedOrnsteinUhlenbeckNoise:
    return AnnealedOrnsteinUhlenbeckNoise(np.zeros(n_processes), np.full(n_processes, 0.5), **kwargs)


def vec_env(n_envs: int, **kwargs) -> DummyVecEnv:
    return DummyVecEnv([lambda: FakeImageEnv(**kwargs)] * n_envs)


def ddpg(n_envs: int = 1, **kwargs) -> DDPG:
    sb3_noise = OrnsteinUhlenbeckActionNoise(np.zeros(4), np.full(4, 0.5))
    settings = {**RUN, "action_noise": sb3_noise, "policy_kwargs": TINY_NET, **kwargs}
    return DDPG(StereoDDPGPolicy, vec_env(n_envs), **settings)


def dqn(n_envs: int = 1, **kwargs) -> DQN:
    policy_kwargs = {"features_extractor_kwargs": {"n_filters": 2, "features_dim": 4}}
    return DQN(
        StereoDQNPolicy, vec_env(n_envs, n_actions=3), policy_kwargs=policy_kwargs, train_freq=1, **{**RUN, **kwargs}
    )


class Recorder(BaseCallback):
    """Record epsilon as the model uses it at each step."""

    def __init__(self) -> None:
        super().__init__()
        self.rates: list[float] = []

    def _on_step(self) -> bool:
        self.rates.append(self.model.exploration_rate)  # DQN updates it after the callbacks
        return True


@pytest.mark.parametrize("dt", [1.0, 0.5])
def test_standard_deviation_follows_the_closed_form_of_the_autoregressive_process(dt):
    np.random.seed(0)
    noise = noise_of(20_000, dt=dt, initial_epsilon=1.0, final_epsilon=1.0)
    decay = 1 - 0.15 * dt
    for step in range(1, 9):
        expected = 0.5 * np.sqrt(dt * (1 - decay ** (2 * step)) / (1 - decay**2))
        assert np.std(noise()) == pytest.approx(expected, rel=0.03)


def test_epsilon_scales_the_noise_but_not_its_state():
    def six_steps(noise: AnnealedOrnsteinUhlenbeckNoise) -> np.ndarray:
        np.random.seed(0)
        return np.stack([noise() for _ in range(6)])

    epsilons = np.array([1, 0.75, 0.5, 0.25, 0, 0])[:, None]
    constant = six_steps(noise_of(final_epsilon=1.0))
    np.testing.assert_allclose(six_steps(noise_of(n_steps=4, final_epsilon=0.0)), epsilons * constant, rtol=1e-6)


def test_epsilon_falls_linearly_and_then_stays():
    noise = noise_of(n_steps=10)
    epsilons = []
    for _ in range(13):
        epsilons.append(noise.epsilon)
        noise()
    np.testing.assert_allclose(epsilons, [1 - 0.09 * min(step, 10) for step in range(13)])


@pytest.mark.parametrize("n_envs", [1, 4])
def test_environments_count_their_steps_together(n_envs):
    noise = noise_of(n_steps=100)
    vectorised = VectorizedActionNoise(noise, n_envs)
    for _ in range(10):
        vectorised()
    assert noise.step_count == 10 * n_envs
    assert noise.epsilon == pytest.approx(1 - 0.9 * 10 * n_envs / 100)


def test_environments_have_streams_and_states_of_their_own():
    noise = noise_of()
    noise()  # a noise that has drawn already must not pass on its stream
    vectorised = VectorizedActionNoise(noise, 2)
    first, second = vectorised()
    assert not np.array_equal(first, second)
    vectorised.reset(indices=[0])
    assert not vectorised.noises[0].noise_prev.any() and vectorised.noises[1].noise_prev.any()


def test_reset_forgets_the_state_and_keeps_the_count():
    noise = noise_of()
    noise()
    noise.reset()
    assert not noise.noise_prev.any() and noise.step_count == 1


def test_global_seed_repeats_noise_made_before_it():
    first, second = noise_of(), noise_of()
    np.random.seed(7)
    values = first()
    np.random.seed(7)
    np.testing.assert_array_equal(values, second())


def test_pickled_noise_continues_and_still_shares_its_count():
    vectorised = VectorizedActionNoise(noise_of(), 2)
    vectorised()
    restored = pickle.loads(pickle.dumps(vectorised))
    np.testing.assert_array_equal(restored(), vectorised())
    assert restored.noises[0].step_count == restored.noises[1].step_count == 4


def test_no_steps_to_anneal_is_refused():
    with pytest.raises(ValueError) as error:
        noise_of(n_steps=0)
    assert str(error.value) == "n_steps must be positive, got 0"


@pytest.mark.parametrize("n_envs", [1, 4])
def test_callback_replaces_the_zoos_noise_and_keeps_its_sigma(n_envs):
    model = ddpg(n_envs)
    model.learn(24, callback=AnnealExploration(n_steps=48, theta=0.3))
    noise = model.action_noise.base_noise if n_envs > 1 else model.action_noise
    assert isinstance(noise, AnnealedOrnsteinUhlenbeckNoise)
    assert isinstance(model.action_noise, VectorizedActionNoise) == (n_envs > 1)
    assert (noise._sigma == 0.5).all() and noise._dt == 1.0 and noise._theta == 0.3
    assert noise.step_count == 24
    assert noise.epsilon == pytest.approx(0.55)


@pytest.mark.parametrize("n_envs", [1, 2, 4])
def test_loaded_model_goes_on_annealing_with_any_number_of_environments(n_envs, tmp_path):
    callback = AnnealExploration(n_steps=48)
    ddpg(2).learn(24, callback=callback).save(tmp_path / "model")
    model = DDPG.load(tmp_path / "model", env=vec_env(n_envs))
    model.learn(8, callback=callback, reset_num_timesteps=False)
    noise = model.action_noise.base_noise if n_envs > 1 else model.action_noise
    assert noise.step_count == model.num_timesteps == 32
    assert noise.epsilon == callback.epsilon == pytest.approx(0.4)


def test_training_anew_starts_annealing_anew():
    model, callback = ddpg(), AnnealExploration(n_steps=48)
    model.learn(12, callback=callback)
    model.learn(6, callback=callback)
    assert model.action_noise.step_count == 6


def test_same_seed_gives_the_same_training():
    def final_action() -> np.ndarray:
        model = ddpg()
        model.learn(20, callback=AnnealExploration(n_steps=48))
        return np.concatenate([model.replay_buffer.actions[:20].ravel(), model.predict(np.zeros((1, 36, 36)))[0]])

    np.testing.assert_array_equal(final_action(), final_action())


@pytest.mark.parametrize("n_envs", [1, 4])
@pytest.mark.parametrize("total", [24, 96])
def test_dqn_anneals_over_steps_whatever_the_length_of_training(n_envs, total):
    recorder = Recorder()
    dqn(n_envs).learn(total, callback=[AnnealExploration(n_steps=40), recorder])
    steps = np.arange(total // n_envs) * n_envs  # what was in force for each step's choice
    np.testing.assert_allclose(recorder.rates, 1 - 0.9 * np.minimum(steps / 40, 1))


def test_loaded_dqn_goes_on_annealing(tmp_path):
    callback, recorder = AnnealExploration(n_steps=40), Recorder()
    dqn().learn(20, callback=callback).save(tmp_path / "model")
    model = DQN.load(tmp_path / "model", env=vec_env(1, n_actions=3))
    model.learn(10, callback=[callback, recorder], reset_num_timesteps=False)
    np.testing.assert_allclose(recorder.rates, 1 - 0.9 * np.arange(20, 30) / 40)


def test_epsilon_is_logged():
    model, callback = ddpg(), AnnealExploration(n_steps=48)
    model.learn(12, callback=callback, log_interval=100)
    assert model.logger.name_to_value["rollout/epsilon"] == pytest.approx(1 - 0.9 * 12 / 48)


@pytest.mark.parametrize("action_noise", [None, NormalActionNoise(np.zeros(4), np.ones(4))])
def test_other_noise_is_refused_with_the_way_out(action_noise):
    with pytest.raises(ValueError) as error:
        ddpg(action_noise=action_noise).learn(1, callback=AnnealExploration())
    assert str(error.value) == (
        "annealed exploration needs DQN or Ornstein-Uhlenbeck action noise "
        f"(noise_type: ornstein-uhlenbeck, noise_std: 0.5), got DDPG with {action_noise}"
    )


def test_algorithms_without_noise_are_refused():
    model = PPO("CnnPolicy", FakeImageEnv(), n_steps=4, batch_size=4)
    with pytest.raises(ValueError, match="got PPO with None"):
        model.learn(4, callback=AnnealExploration())
