"""Whether an arm is symmetric about the plane y = 0."""

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.simulators import SimulatedArm

Floats = NDArray[np.float64]

MIRROR = np.diag((1.0, -1.0, 1.0))  # through the plane y = 0
TINY = 1e-3  # [m] between a link and its mirror image that is the same place
N_POSES = 5  # random ones, and their mirror images


def mirrored_joints(arm: SimulatedArm) -> tuple[str, ...] | None:
    """Return the specification's `mirrored_joints`, or None if the arm is not mounted so that they mirror it."""
    spec = arm.spec
    if spec.mirrored_joints is None or spec.base_position[1] != 0.0:
        return None
    if np.allclose(MIRROR @ arm.base_to_world @ MIRROR, arm.base_to_world, atol=TINY):
        return spec.mirrored_joints  # turned about y, or over: its plane is still y = 0
    signs = np.array([-1.0 if joint in spec.mirrored_joints else 1.0 for joint in spec.joints])
    low, high = arm.limits.T
    poses = np.random.default_rng(0).uniform(low, high, (N_POSES, len(low)))
    return spec.mirrored_joints if mirrors(arm, signs, poses) else None


def mirrors(arm: SimulatedArm, signs: Floats, poses: Floats) -> bool:
    """Whether changing the joints' signs mirrors the places of the links, in every pose.

    Args:
        arm: The arm, which is put back afterwards.
        signs: 1 or -1, shape (n_joints,).
        poses: Shape (n_poses, n_joints).
    """
    with arm.as_it_was():
        for pose in poses:
            arm.rest_at(pose)
            mirrored = arm.chain_positions @ MIRROR
            arm.rest_at(pose * signs)
            if not np.allclose(arm.chain_positions, mirrored, atol=TINY):
                return False
    return True
