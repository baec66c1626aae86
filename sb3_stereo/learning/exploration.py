"""Exploration that anneals over a number of environment steps (Tables 1 and 2 of the paper)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from stable_baselines3.common.noise import ActionNoise, OrnsteinUhlenbeckActionNoise, VectorizedActionNoise
from stable_baselines3.common.utils import LinearSchedule


class _StepCount:
    """A number that several noises share."""

    def __init__(self) -> None:
        self.value = 0


class AnnealedOrnsteinUhlenbeckNoise(OrnsteinUhlenbeckActionNoise):
    """Ornstein-Uhlenbeck noise times an epsilon that falls linearly with the environment steps.

    A deep copy, which is what SB3's `VectorizedActionNoise` makes for each environment, has a state and a random
    stream of its own but counts its steps together with the original: epsilon follows the total.

    The random generator is seeded from NumPy's global state at the first draw, hence by SB3's `seed=` even if the
    noise was made before the model.

    Args:
        mean: Of the noise, shape (action_dim,).
        sigma: Scale of the noise, shape (action_dim,).
        theta: Rate of mean reversion (the paper's inertia).
        dt: Time step. 1 counts in environment steps; SB3's 1e-2 would take hundreds of steps to build up.
        initial_epsilon: Factor at the first step.
        final_epsilon: Factor after `n_steps`.
        n_steps: Steps, over all environments, in which epsilon falls.
    """

    def __init__(
        self,
        mean: np.ndarray,
        sigma: np.ndarray,
        theta: float = 0.15,
        dt: float = 1.0,
        initial_epsilon: float = 1.0,
        final_epsilon: float = 0.1,
        n_steps: int = 10_000,
    ) -> None:
        super().__init__(mean, sigma, theta, dt)
        self.schedule = _epsilon_schedule(initial_epsilon, final_epsilon, n_steps)
        self._count = _StepCount()
        self._generator: np.random.Generator | None = None

    @property
    def step_count(self) -> int:
        """Steps so far, over all environments; it can be set."""
        return self._count.value

    @step_count.setter
    def step_count(self, value: int) -> None:
        self._count.value = value

    @property
    def epsilon(self) -> float:
        """The factor at the present step."""
        return self.schedule(1.0 - self.step_count)

    def __call__(self) -> np.ndarray:
        """Return the next noise, shape (action_dim,), and count one environment step."""
        if self._generator is None:
            self._generator = np.random.default_rng(np.random.randint(2**31))
        drift = self._theta * (self._mu - self.noise_prev) * self._dt
        diffusion = self._sigma * np.sqrt(self._dt) * self._generator.normal(size=self._mu.shape)
        self.noise_prev = self.noise_prev + drift + diffusion
        noise: np.ndarray = (self.epsilon * self.noise_prev).astype(self._dtype)
        self.step_count += 1
        return noise

    def state_dict(self) -> dict[str, Any]:
        """Return everything that the next noise depends on."""
        generator = None if self._generator is None else self._generator.bit_generator.state
        return {"noise_prev": self.noise_prev, "step_count": self.step_count, "generator": generator}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a `state_dict`."""
        self.noise_prev, self.step_count = state["noise_prev"], state["step_count"]
        self._generator = None
        if state["generator"] is not None:
            self._generator = np.random.default_rng()
            self._generator.bit_generator.state = state["generator"]

    def __deepcopy__(self, memo: dict[int, Any]) -> AnnealedOrnsteinUhlenbeckNoise:
        copy = type(self).__new__(type(self))
        copy.__dict__.update(self.__dict__, _generator=None)  # arrays are replaced, never written; the count is common
        return copy

    def __repr__(self) -> str:
        return f"AnnealedOrnsteinUhlenbeckNoise(mu={self._mu}, sigma={self._sigma}, epsilon={self.epsilon})"


@dataclass(frozen=True)
class Annealing:
    """Epsilon falls linearly over a number of environment steps, whatever the length of the training.

    Attributes:
        n_steps: Steps, over all environments, in which epsilon falls.
        initial_epsilon: At the first step.
        final_epsilon: After `n_steps`.
        theta: Rate of mean reversion of the noise, per step; no meaning for DQN.
    """

    n_steps: int = 10_000
    initial_epsilon: float = 1.0
    final_epsilon: float = 0.1
    theta: float = 0.15

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> Annealing:
        """Check settings that were written as a map.

        Raises:
            ValueError: If one is unknown or no number.
        """
        known = [field.name for field in fields(cls)]
        for name, value in settings.items():
            if name not in known:
                raise ValueError(f"unknown exploration {name!r}; choices are {', '.join(known)}")
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ValueError(f"exploration: {name} must be a number, got {value!r}")
        annealing = cls(**settings)
        _epsilon_schedule(annealing.initial_epsilon, annealing.final_epsilon, annealing.n_steps)
        return annealing

    def epsilon(self, n_steps: int) -> float:
        """Epsilon after a number of environment steps."""
        return _epsilon_schedule(self.initial_epsilon, self.final_epsilon, self.n_steps)(1.0 - n_steps)


def anneal(model: Any, annealing: Annealing) -> None:
    """Let a model that is about to learn explore by epsilon.

    DQN's exploration rate becomes epsilon. The Ornstein-Uhlenbeck noise of others gives way to an annealed one with
    the same mean and sigma, made anew for the number of environments at hand (a model loaded with another number
    of environments would fail otherwise). Training that goes on goes on with epsilon where it was.

    Raises:
        ValueError: If the model has neither.
    """
    if hasattr(model, "exploration_schedule"):
        _anneal_rate(model, annealing)
    else:
        model.action_noise = _annealed_noise(model, annealing)


def _anneal_rate(model: Any, annealing: Annealing) -> None:
    # DQN asks its schedule with the part of all steps still to do; the fraction turns that into our steps.
    model.exploration_initial_eps = annealing.initial_epsilon
    model.exploration_final_eps = annealing.final_epsilon
    model.exploration_fraction = annealing.n_steps / model._total_timesteps
    model.exploration_schedule = LinearSchedule(
        annealing.initial_epsilon, annealing.final_epsilon, model.exploration_fraction
    )
    model.exploration_rate = annealing.epsilon(model.num_timesteps)


def _annealed_noise(model: Any, annealing: Annealing) -> ActionNoise:
    noise = getattr(model, "action_noise", None)
    base = noise.base_noise if isinstance(noise, VectorizedActionNoise) else noise
    if not isinstance(base, OrnsteinUhlenbeckActionNoise):
        name = type(model).__name__.removeprefix("Stereo")
        raise ValueError(
            "annealed exploration needs DQN or Ornstein-Uhlenbeck action noise "
            f"(noise_type: ornstein-uhlenbeck, noise_std: 0.5), got {name} with {base}"
        )
    annealed = AnnealedOrnsteinUhlenbeckNoise(
        base._mu,
        base._sigma,
        annealing.theta,
        initial_epsilon=annealing.initial_epsilon,
        final_epsilon=annealing.final_epsilon,
        n_steps=annealing.n_steps,
    )
    annealed.step_count = model.num_timesteps
    return VectorizedActionNoise(annealed, model.n_envs) if model.n_envs > 1 else annealed


def _epsilon_schedule(initial: float, final: float, n_steps: int) -> LinearSchedule:
    """SB3's linear schedule, to be asked with 1 - steps in place of the remaining progress."""
    if n_steps <= 0:
        raise ValueError(f"n_steps must be positive, got {n_steps}")
    return LinearSchedule(initial, final, n_steps)
