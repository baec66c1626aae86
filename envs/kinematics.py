"""Joint angles at which an arm's end effector is somewhere, by damped least squares. They move the arm."""

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.simulators import SimulatedArm

Floats = NDArray[np.float64]

N_STEPS, MAX_STEP = 60, 0.3  # of the search for joint angles, and its largest in [rad]
DAMPING = 0.05  # [m], of the least squares: what keeps a step bounded where the arm is stretched
EPSILON = 1e-5  # [rad]
NEAR = 0.005  # [m], where the search ends
N_GUESSES = 4  # of joint angles to search from
N_POSES = 12  # on a way


def joints_reaching(arm: SimulatedArm, target: Floats, guess: Floats) -> tuple[float, Floats]:
    """Search for joint angles with the end effector at a target.

    Args:
        arm: It is left where the search ends.
        target: Shape (3,), in [m], world.
        guess: Of the actuated joints, shape (n_joints,), in [rad], where the search begins.

    Returns:
        How far the end effector is from the target at the angles found, in [m], and the angles, within the limits.
    """
    joints, (low, high) = guess, arm.limits.T
    for _ in range(N_STEPS):
        error = target - end_effector_at(arm, joints)
        if np.linalg.norm(error) < NEAR:
            break
        slope = jacobian(arm, joints)
        step = slope.T @ np.linalg.solve(slope @ slope.T + DAMPING**2 * np.eye(3), error)
        joints = np.clip(joints + step * min(1.0, MAX_STEP / np.abs(step).max()), low, high)
    return float(np.linalg.norm(target - end_effector_at(arm, joints))), joints


def jacobian(arm: SimulatedArm, joints: Floats) -> Floats:
    """Derivative of the end effector's position by the joint angles, shape (3, n_joints)."""
    steps = EPSILON * np.eye(len(joints))
    ahead = [end_effector_at(arm, joints + step) - end_effector_at(arm, joints - step) for step in steps]
    return np.asarray(np.array(ahead).T / (2 * EPSILON))


def end_effector_at(arm: SimulatedArm, joints: Floats) -> Floats:
    """Position of the end effector with the actuated joints at these angles, shape (3,), in [m], world."""
    arm.rest_at(joints)
    return np.asarray(arm.end_effector_position)


def free_way(arm: SimulatedArm, target: Floats, rng: np.random.Generator) -> list[Floats]:
    """Poses on a straight line in joint angles from here to the target, on which the arm touches nothing.

    Args:
        arm: It is left elsewhere.
        target: Shape (3,), in [m], world.
        rng: Where guesses are drawn from.

    Returns:
        Joint angles, shape (n_joints,) each, in [rad], of the shortest way that was found; of none, where the arm is.
    """
    here, (low, high) = arm.actuated_positions, arm.limits.T
    ways = []
    for guess in (here, *rng.uniform(low, high, (N_GUESSES - 1, len(here)))):
        error, there = joints_reaching(arm, target, guess)
        if error < NEAR:
            ways.append(list(np.linspace(here, there, N_POSES)))
    ways.sort(key=lambda way: float(np.abs(way[-1] - here).max()))
    return next((way for way in ways if _is_free(arm, way)), [here])


def _is_free(arm: SimulatedArm, way: list[Floats]) -> bool:
    for pose in way:
        arm.rest_at(pose)
        if arm.collides():
            return False
    return True
