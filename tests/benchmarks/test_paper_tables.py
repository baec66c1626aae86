"""One test per row of the paper's Tables 1 and 2: the value in the YAML arrives in the object that uses it.

The models learn on the fake environment, with a smaller replay memory and fewer initial steps where a row does not
look at just that.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fake_reach
import numpy as np
import pytest
import torch as th
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import VectorizedActionNoise

from sb3_stereo.building.factory import make_callbacks, make_model, make_training_env
from sb3_stereo.config.schema import load_config

PAPER = Path(__file__).parents[2] / "hyperparams" / "paper"


class Watch(BaseCallback):
    """Calls a function after every environment step."""

    def __init__(self, look: Any) -> None:
        super().__init__()
        self.look = look

    def _on_step(self) -> bool:
        self.look(self.model)
        return True


def make(algo: str, **params: Any) -> tuple[Any, list[BaseCallback]]:
    """Return the paper's model and callbacks; `params` replaces rows that a test does not look at."""
    config = load_config(algo, fake_reach.ENV_ID, PAPER / f"{algo}.yml", params=params)
    return make_model(config, make_training_env(config, seed=0), seed=0, device="cpu"), make_callbacks(config)


@pytest.fixture(params=["ddpg", "dqn"])
def algo(request: pytest.FixtureRequest) -> Iterator[str]:
    yield request.param


SMALL = {"learning_starts": 2, "batch_size": 4}


def test_p_initial_steps_pass_before_the_first_update(algo: str) -> None:
    model, callbacks = make(algo, batch_size=2)
    updates = {}
    watch = Watch(lambda m: updates.update({m.num_timesteps: m._n_updates}))  # looks before the step's update
    model.learn(1003, callback=[*callbacks, watch])
    assert (updates[1000], updates[1001], updates[1002], updates[1003]) == (0, 0, 1, 2)


def test_m_minibatches_hold_a_hundred_transitions(algo: str) -> None:
    model, callbacks = make(algo, learning_starts=2)
    sizes = []
    sample = model.replay_buffer.sample
    model.replay_buffer.sample = lambda size, **kwargs: sizes.append(size) or sample(size, **kwargs)
    model.learn(4, callback=callbacks)
    assert sizes == [100, 100]


def test_epsilon_falls_linearly_from_1_to_a_tenth_over_10_000_steps(algo: str) -> None:
    model, callbacks = make(algo, learning_starts=100_000)
    epsilons = {}
    model.learn(12_000, callback=[*callbacks, Watch(lambda m: epsilons.update({m.num_timesteps: epsilon(m)}))])
    assert epsilons[1] == pytest.approx(1.0, abs=1e-3)
    assert epsilons[5000] == pytest.approx(0.55, abs=1e-3)
    assert epsilons[10_000] == pytest.approx(0.1, abs=1e-3)
    assert epsilons[12_000] == pytest.approx(0.1)


def epsilon(model: Any) -> float:
    noise = getattr(model, "action_noise", None)
    if isinstance(noise, VectorizedActionNoise):
        noise = noise.base_noise
    return float(noise.epsilon if noise is not None else model.exploration_rate)


def test_c_ddpg_targets_move_at_every_step() -> None:
    model, callbacks = make("ddpg", **SMALL)
    moves = count_target_moves(model, model.critic_target, 10, callbacks)
    assert moves == list(range(4, 11))  # the updates after steps 3 to 9, seen one step later


def test_c_dqn_target_moves_every_hundred_steps() -> None:
    model, callbacks = make("dqn", **SMALL)
    moves = count_target_moves(model, model.q_net_target, 301, callbacks)
    assert moves == [101, 201, 301]  # SB3 copies at the end of every hundredth step, seen one step later


def count_target_moves(model: Any, target: th.nn.Module, n_steps: int, callbacks: list[BaseCallback]) -> list[int]:
    """Return the steps after which the target was found to have moved."""
    seen = [flat(target)]
    moves = []

    def look(watched: Any) -> None:
        now = flat(target)
        if not th.equal(now, seen[-1]):
            seen.append(now)
            moves.append(watched.num_timesteps)

    model.learn(n_steps, callback=[*callbacks, Watch(look)])
    return moves


def flat(module: th.nn.Module) -> th.Tensor:
    return th.cat([parameter.detach().flatten() for parameter in module.parameters()]).clone()


def test_d_the_memory_holds_10_000_transitions(algo: str) -> None:
    model, _ = make(algo)
    assert model.replay_buffer.observations.shape[0] == 10_000


def test_alpha_the_learning_rates_hold_during_training() -> None:
    model, callbacks = make("ddpg", **SMALL)
    model.learn(5, callback=callbacks)
    assert step_size(model.actor.optimizer) == pytest.approx(1e-4)
    assert step_size(model.critic.optimizer) == pytest.approx(1e-3)
    model, callbacks = make("dqn", **SMALL)
    model.learn(5, callback=callbacks)
    assert step_size(model.policy.optimizer) == pytest.approx(2.5e-3)


def step_size(optimizer: th.optim.Optimizer) -> float:
    """Return how far Adam moves a parameter: its first step equals the learning rate, whatever the gradient."""
    group = optimizer.param_groups[0]
    decay, group["weight_decay"] = group["weight_decay"], 0.0
    parameter = group["params"][-1]
    optimizer.state[parameter] = {}
    before = parameter.detach().clone()
    optimizer.zero_grad()
    parameter.grad = th.ones_like(parameter)
    optimizer.step()
    group["weight_decay"] = decay
    return float((before - parameter.detach()).abs().max())


@pytest.mark.parametrize(("name", "gamma"), [("ddpg", 0.99), ("dqn", 0.2)])
def test_gamma_discounts_the_target(name: str, gamma: float) -> None:
    model, _ = make(name)
    assert model.gamma == gamma


def test_nu_and_sigma_and_eta_shape_the_noise() -> None:
    model, callbacks = make("ddpg", learning_starts=100_000)
    model.learn(1, callback=callbacks)
    noise = model.action_noise
    noise.schedule = lambda progress: 1.0  # without the annealing
    samples = np.array([noise() for _ in range(40_000)])  # (steps, joints)
    increments = samples[1:] - 0.85 * samples[:-1]  # eta = 0.15 pulls back by 15 % per step
    assert np.abs(samples.mean(axis=0)).max() < 0.1
    assert increments.std(axis=0) == pytest.approx(np.full(4, 0.5), rel=0.03)
    assert samples.std(axis=0) == pytest.approx(np.full(4, 0.5 / np.sqrt(1 - 0.85**2)), rel=0.1)
    correlation = np.corrcoef(samples[1:, 0], samples[:-1, 0])[0, 1]
    assert correlation == pytest.approx(0.85, abs=0.02)


def test_zeta_moves_the_targets_by_a_hundredth_of_the_way() -> None:
    model, callbacks = make("ddpg", **SMALL)
    before = flat(model.critic_target)
    model.learn(3, callback=callbacks)  # one update
    after, online = flat(model.critic_target), flat(model.critic)
    th.testing.assert_close(after, before + 0.01 * (online - before))


def test_section_5_the_actor_alone_has_an_l2_of_a_hundredth() -> None:
    model, _ = make("ddpg")
    assert [group["weight_decay"] for group in model.actor.optimizer.param_groups] == [0.01]
    assert [group["weight_decay"] for group in model.critic.optimizer.param_groups] == [0]


@pytest.mark.parametrize(("name", "n_timesteps"), [("ddpg", 8500), ("dqn", 10_000)])
def test_tables_3_and_4_end_at_the_last_checkpoint(name: str, n_timesteps: int) -> None:
    assert load_config(name, fake_reach.ENV_ID, PAPER / f"{name}.yml").n_timesteps == n_timesteps
