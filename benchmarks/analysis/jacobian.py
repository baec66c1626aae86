"""A scripted state-based controller: target joint angles from the Jacobian, torques proportional to the error.

It sees no image. What it lacks against the planner is a model of how the joints' motions disturb each other.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.analysis.rollouts import Floats
from sb3_stereo.envs.kinematics import NEAR, joints_reaching

N_PULSES = 10  # per joint, from which its travel is measured
N_GUESSES = 8  # of joint angles to search from, the present ones first


class JacobianController:
    """Reaches by damped least squares on the kinematics, one pulse after another.

    Args:
        env: A `StereoReachEnv`, without wrappers.
        seed: Of the poses from which the joints' travel is measured, and of guesses.
    """

    def __init__(self, env: Any, seed: int = 0) -> None:
        self.env, self.rng = env, np.random.default_rng(seed)
        self.low, self.high = env.arm.limits.T
        self.travel = measured_travel(env, self.rng)

    def __call__(self, observation: Any, info: Mapping[str, Any]) -> Floats:
        """The action for the present state, shape (n_joints,), in [-1, 1]; a `rollouts.Policy`."""
        here = self.env.arm.actuated_positions
        action = (self._joints_at(info["target_position"], here) - here) / self.travel
        return np.asarray(action / max(1.0, np.abs(action).max()), np.float32)  # all joints arrive together

    def _joints_at(self, target: Floats, here: Floats) -> Floats:
        """Joint angles with the end effector at the target, the fewest pulses from `here`; else the nearest found."""
        state = self.env.save_state()
        guesses = [here, *self.rng.uniform(self.low, self.high, (N_GUESSES - 1, len(here)))]
        found = [joints_reaching(self.env.arm, target, guess) for guess in guesses]
        self.env.restore_state(state)
        self.env.remove_state(state)
        nearest = max(min(error for error, _ in found), NEAR)
        return min(
            (joints for error, joints in found if error <= nearest),
            key=lambda joints: float(np.abs((joints - here) / self.travel).max()),
        )


def measured_travel(env: Any, rng: np.random.Generator) -> Floats:
    """Displacement of each joint by a full pulse of it alone, the median, shape (n_joints,), in [rad].

    Args:
        env: A `StereoReachEnv`, without wrappers.
        rng: Of the poses.
    """
    low, high = env.arm.limits.T
    moved = np.zeros((N_PULSES, len(low)))
    for number, joint in np.ndindex(moved.shape):
        env.reset(seed=int(rng.integers(2**31)))
        before = env.arm.actuated_positions
        action = np.zeros(env.action_space.shape)
        action[joint] = 1.0 if before[joint] < (low + high)[joint] / 2 else -1.0
        env.step(action)
        moved[number, joint] = abs(env.arm.actuated_positions[joint] - before[joint])
    return np.asarray(np.median(moved, axis=0))
