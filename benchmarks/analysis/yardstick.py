"""Accuracy of a task's distance measure: distance in the images against projected distance, by distance in space.

    python -m benchmarks.analysis.yardstick WamStereoReach-v1

puts the arm at random poses and the target at a known distance from the end effector, in a random direction. Writes
`benchmarks/results/yardstick_ENV.csv` and prints it as a table.
"""

import argparse
import csv
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from benchmarks import RESULTS
from sb3_stereo import ENV_IDS
from sb3_stereo.envs.cameras import CameraSpec

Floats = NDArray[np.float64]

DISTANCES = (0.0, 0.01, 0.02, 0.03, 0.035, 0.04, 0.05, 0.06, 0.07, 0.08, 0.1, 0.14, 0.2, 0.3)  # [m]
FAR_AWAY = (0.0, 0.0, -50.0)  # [m], in no view
ENOUGH = 1 / 3  # of a ball; if the arm leaves less of it visible, it hides the marker


@dataclass(frozen=True)
class Looks:
    """What was measured at one distance in space, with one target for each pose.

    Attributes:
        measured: Distance in each view, nan where a marker is hidden, in [px].  # (n_poses, n_views)
        projected: Where the two are in space, projected, in [px].  # (n_poses, n_views)
        success: Whether the task counts it as reached.  # (n_poses,)
        arm_hides: Whether the arm hides a marker in some view, by the renderer's own segmentation.  # (n_poses,)
    """

    measured: Floats
    projected: Floats
    success: NDArray[np.bool_]
    arm_hides: NDArray[np.bool_]

    @property
    def errors(self) -> Floats:
        """|measured - projected| wherever both markers are seen, shape (n,), in [px]."""
        errors = np.abs(self.measured - self.projected)
        return errors[np.isfinite(errors)]

    @property
    def undefined(self) -> NDArray[np.bool_]:
        """Whether some view has no distance, shape (n_poses,)."""
        return np.asarray(np.isnan(self.measured).any(axis=1))

    def row(self) -> dict[str, float]:
        """The columns of the table; shares are from 0 to 1."""
        errors, free = self.errors, ~self.arm_hides
        return {
            "measured_px": float(np.nanmean(self.measured)),
            "projected_px": float(self.projected.mean()),
            "mean_error_px": float(errors.mean()),
            "p95_error_px": float(np.quantile(errors, 0.95)),
            "undefined": float(self.undefined.mean()),
            "arm_hides": float(self.arm_hides.mean()),
            "success": float(self.success.mean()),
            "success_unless_arm_hides": float(self.success[free].mean()) if free.any() else float("nan"),
        }


def look_at(env: Any, distance: float, n_poses: int, seed: int) -> Looks:
    """Measure at one distance.

    Args:
        env: A `StereoReachEnv`.
        distance: From end effector to target, in [m].
        n_poses: Random free ones; each with a target in a random direction.
        seed: Of poses and directions; the poses are the same for every distance.
    """
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(n_poses, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    measured, projected, success, arm_hides = [], [], [], []
    for number, direction in enumerate(directions):
        _, info = env.reset(seed=seed + number)
        hand = info["end_effector_position"]
        target = hand + distance * direction
        pose = env.arm.actuated_positions
        _, info = env.reset(options={"joint_positions": pose, "target_position": target})
        measured.append(info["pixel_distances"])
        success.append(info["is_success"])
        ends = np.stack([hand, target])
        projected.append([np.linalg.norm(np.subtract(*camera.spec.project(ends))) for camera in env.cameras])
        arm_hides.append(_arm_hides(env, ends))
    return Looks(np.array(measured), np.array(projected), np.array(success), np.array(arm_hides))


def _arm_hides(env: Any, ends: Floats) -> bool:
    """Whether a view shows less than `ENOUGH` of the end effector's or the target's ball where that is the only one."""
    rig, alone = env._world.rig, np.where(np.eye(2)[:, :, None], ends, FAR_AWAY)
    shares = []
    for positions, end, body, radius in zip(alone, ends, rig.markers, rig.radii, strict=True):
        rig.place_markers(*positions)
        for camera in env.cameras:
            n_pixels = np.count_nonzero(camera.draw()[2] == body)
            shares.append(n_pixels / (np.pi * _looks_as_large(camera.spec, end, radius) ** 2))
    return bool(min(shares) < ENOUGH)


def _looks_as_large(spec: CameraSpec, centre: Floats, radius: float) -> float:
    """Radius in [px] of a ball's image, the ball's in [m]."""
    aside = np.cross(np.subtract(spec.target, spec.position), spec.up)
    edge = centre + radius * aside / np.linalg.norm(aside)
    return float(np.linalg.norm(spec.project(edge) - spec.project(centre)))


def measure(env_id: str, distances: Sequence[float], n_poses: int, seed: int = 0) -> list[Looks]:
    """Measure a registered environment at every distance in [m]."""
    with closing(gym.make(f"sb3_stereo:{env_id}")) as env:
        return [look_at(env.unwrapped, distance, n_poses, seed) for distance in distances]


def table(distances: Sequence[float], rows: Sequence[dict[str, float]]) -> list[str]:
    """Return the lines of the table."""
    lines = ["     cm  measured (projected)  error mean, 95 %   undefined  arm hides   success  unless arm hides"]
    for distance, row in zip(distances, rows, strict=True):
        lines.append(
            f"{100 * distance:7.1f} {row['measured_px']:9.2f} ({row['projected_px']:.2f}) px"
            f" {row['mean_error_px']:9.2f}, {row['p95_error_px']:.2f} px"
            f" {row['undefined']:10.1%} {row['arm_hides']:10.1%}"
            f" {row['success']:9.1%} {row['success_unless_arm_hides']:9.1%}"
        )
    return lines


def write(env_id: str, distances: Sequence[float], rows: Sequence[dict[str, float]]) -> None:
    """Write the record of one environment."""
    with (RESULTS / f"yardstick_{env_id}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["distance_m", *rows[0]])
        writer.writerows([distance, *(f"{x:.4f}" for x in row.values())] for distance, row in zip(distances, rows))


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.analysis.yardstick", description=__doc__.split("\n")[0])
    parser.add_argument("env_ids", nargs="+", choices=ENV_IDS, metavar="ENV")
    parser.add_argument("--poses", type=int, default=500)
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args(argv)
    with ProcessPoolExecutor(args.workers) as pool:
        for env_id in args.env_ids:
            one = pool.map(measure, *zip(*((env_id, (distance,), args.poses) for distance in DISTANCES)))
            rows = [looks.row() for [looks] in one]
            write(env_id, DISTANCES, rows)
            print(env_id, *table(DISTANCES, rows), sep="\n", flush=True)


if __name__ == "__main__":
    main()
