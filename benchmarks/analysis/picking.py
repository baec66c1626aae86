"""A scripted policy that picks up by the simulator's state: over the object, down with suction, up.

It sees no image. Joint angles come from inverse kinematics, torques from each joint's travel in a control step.

    python -m benchmarks.analysis.picking docs/images/pick.gif

films it. `benchmarks.analysis.picking_baselines` scores it.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.analysis.jacobian import measured_travel
from benchmarks.analysis.rollouts import Floats
from sb3_stereo.envs.cup_kinematics import joints_for
from sb3_stereo.envs.pick_world import UP
from sb3_stereo.viz.film import film

N_GUESSES = 12  # of joint angles to search from, the present ones first
CLEARANCE = 0.05  # [m] over the object, from where the cup goes straight down
HIGH = 0.20  # [m] over it, on the way there and with the object
PRESS = 0.01  # [m] below the top, where the cup is sent
OVER, UPRIGHT = 0.015, 0.97  # [m] beside the object's axis, and the cosine of the cup's slant, from where it goes down
MOVED = 0.01  # [m] by which the object has moved or sunk, as it has been touched: another plan is needed
PATIENCE = 10  # control steps after which a plan has failed
GOOD = 0.01  # [m], of a solution of the kinematics


@dataclass(frozen=True)
class Plan:
    """Joint angles (n_joints,) in [rad] with the cup pointing down over the object.

    Attributes:
        top: Middle of the object's upper side, (3,) in [m], world.
        high: `HIGH` over it.
        over: `CLEARANCE` over it.
        press: At it.
        error: Of the worst of the three, see `cup_kinematics.joints_for`; infinite if the arm collides there.
    """

    top: Floats
    high: Floats
    over: Floats
    press: Floats
    error: float


class ScriptedPicker:
    """Picks up the target.

    Args:
        env: A `StereoPickEnv`, without wrappers.
        seed: Of the poses from which the joints' travel is measured, and of guesses.
    """

    def __init__(self, env: Any, seed: int = 0) -> None:
        self.env, self.rng = env, np.random.default_rng(seed)
        self.low, self.high = env.arm.limits.T
        self.travel = measured_travel(env, self.rng)
        self._plan: Plan | None = None
        self._n_steps = 0  # with this plan

    def __call__(self, observation: Any, info: Mapping[str, Any]) -> Floats:
        """The action for the present state, shape (n_joints + 1,), in [-1, 1]; a `rollouts.Policy`."""
        joints, suction = self._way_point()
        action = (joints - self.env.arm.actuated_positions) / self.travel
        moves = action / max(1.0, np.abs(action).max())  # all joints arrive together
        return np.asarray([*moves, 1.0 if suction else -1.0], np.float32)

    def predict(self, observation: Any, deterministic: bool = True) -> tuple[Floats, None]:
        """The same as an agent of Stable-Baselines3 has it."""
        return self(observation, {}), None

    def _way_point(self) -> tuple[Floats, bool]:
        """Joint angles to go to, (n_joints,) in [rad], and whether with suction."""
        world = self.env._world
        top = world.target_top
        if self._plan is not None and world.holds_target:
            return self._plan.high, True
        if self._plan is None or np.linalg.norm(self._plan.top - top) > MOVED or self._n_steps == PATIENCE:
            self._plan, self._n_steps = self._best_plan(top), 0
        self._n_steps += 1
        lip, axis = self.env.arm.cup_pose
        aside = np.linalg.norm((lip - top)[:2])
        if aside <= OVER and axis @ -UP >= UPRIGHT and lip[2] < top[2] + 1.5 * CLEARANCE:
            return self._plan.press, True
        return (self._plan.over if aside < HIGH / 2 and axis @ -UP > 0.8 else self._plan.high), False

    def _best_plan(self, top: Floats) -> Plan:
        """Of those that are good, the one with the fewest control steps from here; else the best."""
        here, env = self.env.arm.actuated_positions, self.env
        state = env.save_state()
        guesses = [here, *self.rng.uniform(self.low, self.high, (N_GUESSES - 1, len(here)))]
        plans = [self._plan_from(top, guess) for guess in guesses]
        env.restore_state(state)
        env.remove_state(state)
        limit = max(min(plan.error for plan in plans), GOOD)
        good = [plan for plan in plans if plan.error <= limit]
        return min(good, key=lambda plan: float(np.abs((plan.high - here) / self.travel).max()))

    def _plan_from(self, top: Floats, guess: Floats) -> Plan:
        """The plan that a search from a guess ends in."""
        found: list[Floats] = []
        errors, arm = [], self.env.arm
        for height in (HIGH, CLEARANCE, -PRESS):
            guess, error = joints_for(arm, top + height * UP, -UP, guess)
            arm.rest_at(guess)
            found.append(guess)
            errors.append(np.inf if height > 0.0 and arm.collides() else error)
        high, over, press = found
        return Plan(top, high, over, press, max(errors))


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.analysis.picking", description=__doc__.splitlines()[0])
    parser.add_argument("file", help="an .mp4 or a .gif, as in docs/images")
    parser.add_argument("--n-episodes", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(argv)
    with closing(gym.make("sb3_stereo:WamStereoPick-v0", n_distractors=2)) as env:
        film(ScriptedPicker(env.unwrapped), env, args.file, args.n_episodes, args.seed)
    return 0


if __name__ == "__main__":
    sys.exit(main())
