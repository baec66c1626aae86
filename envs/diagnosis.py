"""Checks of an environment before training: joint motion, collisions, visibility, and how rare success is."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sb3_stereo.envs.composite import WIDTH, composite
from sb3_stereo.envs.contacts import always_colliding, shares
from sb3_stereo.envs.mirror import mirrors
from sb3_stereo.envs.reach import StereoReachEnv

Floats = NDArray[np.float64]

Item = TypeVar("Item")
Progress = Callable[[str, int, int], object]

FAR = 8.0  # [px]


@dataclass(frozen=True)
class Diagnosis:
    """Measurements; shares are from 0 to 1.

    Attributes:
        joints: The actuated joints' names.
        sliding: Whether each of them slides; then its limits and travel are in [m].
        limits: Of the joints, in [rad].  # (n_joints, 2)
        travel: Median |displacement| of each joint after a full pulse of it alone, in [rad].  # (n_joints,)
        without_shapes: Links that move and have no collision shape.
        solid: Whether any link that moves has one; if none does, every pose passes for free.
        free: Share of the random poses that do not collide.
        collisions: Pairs of links (or "the floor") that touch, with the share of the random poses, the most first.
        goals: Share of the free poses that are goals.
        random_steps: Environment steps per goal of a random agent; infinite if it reached none.
        seen: Share of the free poses with both markers in every view, and in at least one.
        misplaced: Share of the views of free poses where a marker's blob is more than `FAR` from where it should be: a
            shell of that colour. (What hides half a marker moves its blob less.)
        mirrored_joints: Joints whose sign the mirror image through y = 0 changes; None if no choice mirrors the arm.
        mirror_error: How much images of mirrored poses differ from mirrored images, where 1 is what two random poses
            differ by; NaN without mirrored joints, or where no two poses differ.
    """

    joints: tuple[str, ...]
    sliding: tuple[bool, ...]
    limits: Floats
    travel: Floats
    without_shapes: tuple[str, ...]
    solid: bool
    free: float
    collisions: tuple[tuple[str, float], ...]
    goals: float
    random_steps: float
    seen: tuple[float, float]
    misplaced: float
    mirrored_joints: tuple[str, ...] | None
    mirror_error: float


def diagnose(
    env: StereoReachEnv,
    n_poses: int = 500,
    n_steps: int = 1000,
    seed: int = 0,
    progress: Progress = lambda phase, done, total: None,
) -> Diagnosis:
    """Measure an environment.

    Args:
        env: The environment, without wrappers.
        n_poses: Random poses.
        n_steps: Steps of the random agent, in episodes of at most 30.
        seed: Of everything random.
        progress: Called with a phase's name, how much of it is done, and how much there is.

    Raises:
        ValueError: If no pose is free.
    """
    rng = np.random.default_rng(seed)
    low, high = env.arm.limits.T
    poses = rng.uniform(low, high, (n_poses, len(low)))
    contacts = env.arm.contacts_at(poses)
    free = [pose for pose, pairs in zip(poses, contacts, strict=True) if not pairs]
    if not free:
        raise ValueError(always_colliding(contacts))
    shown = _counted(free, "looking at poses", progress)
    views = [env.reset(options={"joint_positions": pose})[1] for pose in shown]
    seen = np.array([~np.isnan(info["pixel_distances"]) for info in views])
    mirrored = _mirrored_joints(env, poses[:5])
    return Diagnosis(
        joints=env.arm.spec.joints,
        sliding=env.arm.joints.sliding,
        limits=env.arm.limits,
        travel=_travel(env, free[:20], progress),
        without_shapes=tuple(env.arm.without_shapes()),
        solid=env.arm.solid,
        free=len(free) / n_poses,
        collisions=tuple(shares(contacts)),
        goals=float(np.mean([info["is_success"] for info in views])),
        random_steps=_random_steps(env, n_steps, seed, progress),
        seen=(float(seen.all(axis=1).mean()), float(seen.any(axis=1).mean())),
        misplaced=float(np.mean([_misplaced(env, info) for info in views])),
        mirrored_joints=mirrored,
        mirror_error=float("nan") if mirrored is None else _mirror_error(env, mirrored, free[:50]),
    )


def _counted(items: Sequence[Item], phase: str, progress: Progress) -> Iterator[Item]:
    """The items, and tell after each how far it is."""
    for done, item in enumerate(items, start=1):
        yield item
        progress(phase, done, len(items))


def _misplaced(env: StereoReachEnv, info: dict[str, Any]) -> float:
    ends = np.stack([info["end_effector_position"], info["target_position"]])
    projected = [np.subtract(*camera.spec.project(ends)) for camera in env.cameras]
    errors = np.linalg.norm(info["pixel_offsets"] - projected, axis=1)
    return float(np.mean(errors[~np.isnan(errors)] > FAR)) if not np.isnan(errors).all() else 0.0


def _travel(env: StereoReachEnv, poses: list[Floats], progress: Progress) -> Floats:
    """Push every joint alone, towards the middle of its range."""
    middle = env.arm.limits.mean(axis=1)
    moved = np.zeros((len(poses), len(middle)))
    trials = list(product(enumerate(poses), range(len(middle))))
    for (row, pose), joint in _counted(trials, "moving joints", progress):
        env.reset(options={"joint_positions": pose})
        action = np.zeros(len(middle))
        action[joint] = 1.0 if pose[joint] < middle[joint] else -1.0
        env.step(action)
        moved[row, joint] = abs(env.arm.actuated_positions[joint] - pose[joint])
    return np.asarray(np.median(moved, axis=0))


def _random_steps(env: StereoReachEnv, n_steps: int, seed: int, progress: Progress) -> float:
    rng, goals, steps = np.random.default_rng(seed), 0, 30
    for _ in _counted(range(n_steps), "random agent", progress):
        if steps == 30:
            env.reset(seed=int(rng.integers(2**31)))
            steps = 0
        terminated = env.step(rng.uniform(-1, 1, len(env.arm.limits)))[2]
        goals, steps = goals + terminated, 30 if terminated else steps + 1
    return n_steps / goals if goals else float("inf")


def _mirrored_joints(env: StereoReachEnv, poses: Floats) -> tuple[str, ...] | None:
    """Try every choice of signs on where the links are, the fewest changes first."""
    joints = env.arm.spec.joints
    for signs in sorted(product((1.0, -1.0), repeat=len(joints)), reverse=True):
        if mirrors(env.arm, np.array(signs), poses):
            return tuple(joint for joint, sign in zip(joints, signs, strict=True) if sign < 0)
    return None


def _mirror_error(env: StereoReachEnv, mirrored_joints: tuple[str, ...], poses: list[Floats]) -> float:
    signs = np.array([-1.0 if joint in mirrored_joints else 1.0 for joint in env.arm.spec.joints])

    def views(pose: Floats) -> Floats:
        env.arm.rest_at(pose)
        return composite(env.draw()).reshape(len(env.cameras), -1, WIDTH).astype(float)

    images = np.array([views(pose) for pose in poses])  # (n_poses, n_views, height, width)
    mirrored = np.array([views(pose * signs) for pose in poses])[:, ::-1, :, ::-1]
    apart = np.abs(images - np.roll(images, 1, axis=0)).mean()
    return float(np.abs(images - mirrored).mean() / apart) if apart else float("nan")  # one pose, or out of sight


def describe(result: Diagnosis) -> str:
    """Return the measurements as human-readable lines."""
    lines = ["joint                      lower   upper   a full action moves it by"]
    for joint, sliding, *numbers in zip(result.joints, result.sliding, *result.limits.T, result.travel, strict=True):
        low, high, travel = (f"{1000 * n:8.0f}" if sliding else f"{n:8.2f}" for n in numbers)
        lines.append(f"{joint:<24}{low}{high}{travel} {'mm' if sliding else 'rad'}")
    mirrored = "null: no choice of signs mirrors the arm"
    if result.mirrored_joints is not None:
        mirrored = f"{', '.join(result.mirrored_joints) or 'none of them'}, with images that differ from the mirrored "
        mirrored += f"ones by {result.mirror_error:.0%} of what two poses differ by"
    (everywhere, somewhere), random_steps = result.seen, result.random_steps
    lines += [
        _collisions(result),
        f"both markers seen: {everywhere:.1%} of the collision-free poses in every view, {somewhere:.1%} in some view",
        f"blobs away from their markers: {result.misplaced:.1%} of the views",
        f"success: {result.goals:.2%} of the collision-free poses; a random agent needs {random_steps:.0f} steps",
        f"mirrored_joints: {mirrored}",
    ]
    return "\n".join(lines)


def _collisions(result: Diagnosis) -> str:
    if not result.solid:
        return (
            "free of collisions: not known, as no link that moves has a collision shape and nothing stops it; "
            "add <collision> to the links of the URDF"
        )
    lines = [f"free of collisions: {result.free:.1%} of random poses"]
    lines += [f"  {pair}: {share:.1%}" for pair, share in result.collisions[:8]]
    if result.without_shapes:
        lines.append(f"  without a collision shape: {', '.join(result.without_shapes)}")
    return "\n".join(lines)
