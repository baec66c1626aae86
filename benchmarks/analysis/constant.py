"""The best constant action: the same joint torques at every step, whatever the cameras see.

It is chosen on random initial states, to be evaluated on others. Candidates are simulated without rendering, which
takes a fifth of the time; the best few are then run in the environment itself.
"""

from collections.abc import Sequence
from contextlib import closing
from itertools import product
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.analysis.rollouts import BlindSimulation, Floats, constant_action, episode_cap, play
from sb3_stereo.evaluation.protocol import InitialState

BLIND_HORIZON = 10  # a joint under a full effort is at its limit after some five steps
N_ROUGH, N_FINE, N_PLAYED = (
    10,
    40,
    50,
)  # initial states: for all quantised actions, for the best of them, for the finalists
N_KEPT, N_FINALISTS = 12, 2
N_SAMPLES, N_ELITE, N_ITERATIONS = 20, 5, 3


def best_constant(env: gym.Env[Any, Any], initial_states: Sequence[InitialState]) -> tuple[Floats, Floats]:
    """Search the constant action with the fewest steps, a failure counted as the cap.

    Args:
        env: A `StereoReachEnv`, registered.
        initial_states: Of training.

    Returns:
        The best action of full efforts and none, which are those of a DQN with 3 levels, and the best of all, from a
        cross-entropy search that begins there. Shape (n_joints,) each.
    """
    with closing(Search(env, initial_states[:N_ROUGH])) as rough:
        kept = sorted(quantised_actions(env), key=rough.mean_steps)[:N_KEPT]
    with closing(Search(env, initial_states[:N_FINE])) as fine:
        scored = [(fine.mean_steps(action), action) for action in kept]
        best_quantised = best_played(env, initial_states[:N_PLAYED], scored)
        scored += fine.refine(best_quantised)
    return best_quantised, best_played(env, initial_states[:N_PLAYED], scored)


def quantised_actions(env: gym.Env[Any, Any]) -> list[Floats]:
    """All actions of full efforts and none, shape (n_joints,) each: those of a DQN with 3 levels."""
    assert env.action_space.shape is not None  # a Box has one
    return [np.array(levels) for levels in product((-1.0, 0.0, 1.0), repeat=env.action_space.shape[0])]


def any_constant(env: gym.Env[Any, Any], initial_states: Sequence[InitialState]) -> Floats:
    """Simulated steps of each quantised action from each start, the cap for a failure, (n_actions, n_starts)."""
    with closing(Search(env, initial_states)) as search:
        return np.array([search.steps(action) for action in quantised_actions(env)])


def best_played(
    env: gym.Env[Any, Any], initial_states: Sequence[InitialState], scored: Sequence[tuple[float, Floats]]
) -> Floats:
    """Of the actions with the fewest simulated steps, the one that needs the fewest in the environment."""
    finalists = [action for _, action in sorted(scored, key=lambda pair: pair[0])[:N_FINALISTS]]
    return min(finalists, key=lambda action: play(env, initial_states, constant_action(action)).mean_steps_capped)


class Search:
    """Scores constant actions by simulating them without drawing.

    Args:
        env: A `StereoReachEnv`, registered.
        initial_states: From which every action is tried.
    """

    def __init__(self, env: gym.Env[Any, Any], initial_states: Sequence[InitialState]) -> None:
        task: Any = env.unwrapped
        self.env = task
        self.blind, self.cap = BlindSimulation(self.env), episode_cap(env)
        self.states = []
        for start in initial_states:
            env.reset(**start)
            self.states.append(self.env.save_state())

    def close(self) -> None:
        """Free the saved initial states."""
        for state in self.states:
            self.env.remove_state(state)

    def mean_steps(self, action: Floats) -> float:
        """Steps to the goal, mean over the initial states."""
        return float(self.steps(action).mean())

    def steps(self, action: Floats) -> Floats:
        """Steps to the goal from each start, shape (n_starts,); the cap where it is not reached in a few."""
        return np.array([self._steps(state, action) for state in self.states])

    def _steps(self, state: Any, action: Floats) -> int:
        self.env.restore_state(state)
        for step in range(1, BLIND_HORIZON + 1):
            self.blind.push(action)
            if self.blind.distance(state.target_position) <= self.env.rho:
                return step
        return self.cap

    def refine(self, mean: Floats) -> list[tuple[float, Floats]]:
        """Score actions around `mean`, shape (n_joints,), ever closer to the best ones (cross-entropy method)."""
        rng, spread = np.random.default_rng(0), np.full(len(mean), 0.5)
        scored: list[tuple[float, Floats]] = []
        for _ in range(N_ITERATIONS):
            actions = np.clip(mean + spread * rng.standard_normal((N_SAMPLES, len(mean))), -1, 1)
            steps = np.array([self.mean_steps(action) for action in actions])
            scored += zip(steps.tolist(), actions, strict=True)
            elite = actions[np.argsort(steps)[:N_ELITE]]
            mean, spread = elite.mean(axis=0), elite.std(axis=0) + 0.02
        return scored
