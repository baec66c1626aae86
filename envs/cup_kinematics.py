"""Inverse kinematics of a suction cup: joint angles that bring its lip somewhere, pointing in a direction."""

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.arm import Arm

Floats = NDArray[np.float64]

N_STEPS, MAX_STEP = 60, 0.3  # of the search, and its largest step in [rad]
DAMPING = 0.05  # [m], of the least squares: what keeps a step bounded where the arm is stretched
ARM_OF_TURN = 0.15  # [m/rad]: what an error of the direction counts
NEAR = 0.002  # [m], where the search ends


def joints_for(arm: Arm, position: Floats, direction: Floats, guess: Floats) -> tuple[Floats, float]:
    """Search by damped least squares from a guess; the arm is left anywhere.

    Args:
        arm: With a suction cup.
        position: Of the lip, (3,) in [m], world.
        direction: Of the cup, (3,), of any length.
        guess: Of the actuated joints, (n_joints,) in [rad].

    Returns:
        Joint angles within the limits, (n_joints,), and how far they are from what is asked for: of the lip in [m], and
        of the direction in what `ARM_OF_TURN` makes of it.
    """
    low, high = arm.limits.T
    joints, wanted = np.clip(guess, low, high), direction / np.linalg.norm(direction)
    for _ in range(N_STEPS):
        error, jacobian = _linearised(arm, joints, position, wanted)
        if np.linalg.norm(error) < NEAR:
            break
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + DAMPING**2 * np.eye(6), error)
        joints = np.clip(joints + step * min(1.0, MAX_STEP / max(np.abs(step).max(), 1e-9)), low, high)
    return joints, float(np.linalg.norm(_linearised(arm, joints, position, wanted)[0]))


def _linearised(arm: Arm, joints: Floats, position: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """What is missing, (6,), and its derivative by the joint angles, (6, n_joints)."""
    arm.rest_at(joints)
    lip, axis = arm.cup_pose
    cross = np.cross(axis, direction)
    sine = np.linalg.norm(cross)
    angle = np.arctan2(sine, axis @ direction)
    turn = cross * (angle / sine if sine > 1e-9 else 1.0)
    linear, angular = arm.cup_jacobian
    across = np.eye(3) - np.outer(axis, axis)  # turns about the cup's own axis do not count
    return (
        np.concatenate([position - lip, ARM_OF_TURN * turn]),
        np.concatenate([linear, ARM_OF_TURN * across @ angular]),
    )
