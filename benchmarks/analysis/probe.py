"""What can be read from a composite image: a small supervised network, trained on random poses.

    python -m benchmarks.analysis.probe

prints R^2 of sin and cos of each actuated joint, and the mean error of the markers' image positions, on poses that
the network has not seen. An agent cannot know more than this about the arm.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import torch as th
from numpy.typing import NDArray
from torch import nn

from sb3_stereo import ENV_IDS

TEST_SHARE = 0.1
N_PARTS = 4
ENV_ID = "WamStereoReach-v0"


@dataclass(frozen=True)
class Poses:
    """Images (n, c, h, w) uint8, sin and cos of the joints (n, 2 * n_joints), marker positions (n, 2 * n_views * 2)."""

    images: NDArray[np.uint8]
    joints: NDArray[np.float32]
    markers: NDArray[np.float32]


def collect(n_poses: int, seed: int, random_target: bool, env_id: str = ENV_ID) -> Poses:
    """Reset to `n_poses` random poses (and targets) and write down what is seen and what is true."""
    env = gym.make(f"sb3_stereo:{env_id}")
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)
    n_joints = env.action_space.shape[0]  # type: ignore[index]
    specs = [camera.spec for camera in env.unwrapped.cameras]  # type: ignore[attr-defined]
    images, joints, markers = [], [], []
    for _ in range(n_poses):
        target = rng.uniform((0.2, -0.5, 0.3), (0.7, 0.5, 1.0)) if random_target else (0.5, 0.0, 0.6)
        image, info = env.reset(options={"target_position": target})
        images.append(image)
        q = info["joint_positions"][:n_joints]
        joints.append(np.concatenate([np.sin(q), np.cos(q)]))
        points = np.stack([info["end_effector_position"], info["target_position"]])
        markers.append(np.concatenate([spec.project(points).ravel() for spec in specs]))
    env.close()
    return Poses(np.array(images), np.array(joints, np.float32), np.array(markers, np.float32))


def collect_in_parallel(n_poses: int, seed: int, random_target: bool, n_workers: int, env_id: str = ENV_ID) -> Poses:
    """`collect` in `N_PARTS` parts, each with its own seed, over processes: the same, however many there are."""
    with ProcessPoolExecutor(n_workers) as pool:
        share = [n_poses // N_PARTS] * N_PARTS
        every = [random_target] * N_PARTS, [env_id] * N_PARTS
        parts = list(pool.map(collect, share, range(seed, seed + N_PARTS), *every))
    return Poses(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("images", "joints", "markers")))


def network(shape: tuple[int, ...], n_outputs: int) -> nn.Sequential:
    """The paper's stem (3 convolutions of 32 filters, two layers of 200) with per-pixel input statistics."""
    stem = nn.Sequential(
        *(nn.Conv2d(shape[0], 32, 8, 4), nn.ReLU(), nn.Conv2d(32, 32, 4, 2), nn.ReLU()),
        *(nn.Conv2d(32, 32, 3, 1), nn.ReLU(), nn.Flatten()),
    )
    n_flat = stem(th.zeros(1, *shape)).shape[1]
    return nn.Sequential(
        stem, nn.Linear(n_flat, 200), nn.LayerNorm(200), nn.ReLU(), nn.Linear(200, 200), nn.ReLU(),
        nn.Linear(200, n_outputs),
    )  # fmt: skip


def fit(images: th.Tensor, targets: th.Tensor, n_updates: int) -> nn.Sequential:
    """Train on normalised images (n, c, h, w) and targets (n, k) with Adam and a cosine schedule."""
    net = network(tuple(images.shape[1:]), targets.shape[1])
    optimizer = th.optim.Adam(net.parameters(), lr=1e-3)
    schedule = th.optim.lr_scheduler.CosineAnnealingLR(optimizer, n_updates)
    for _ in range(n_updates):
        batch = th.randint(len(images), (128,))
        loss = nn.functional.mse_loss(net(images[batch]), targets[batch])
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step()
    return net.eval()


def report(poses: Poses, n_updates: int) -> list[str]:
    """Train on the first poses, test on the last; the lines of the result."""
    targets = np.concatenate([poses.joints, poses.markers], axis=1)
    n_train = int(len(targets) * (1 - TEST_SHARE))
    images = th.as_tensor(poses.images, dtype=th.float32) / 255
    mean, std = images[:n_train].mean(0), images[:n_train].std(0)
    images = ((images - mean) / (std**2 + 1e-2).sqrt()).clamp(-5, 5)
    centre, scale = targets[:n_train].mean(0), targets[:n_train].std(0) + 1e-6
    net = fit(images[:n_train], th.as_tensor((targets[:n_train] - centre) / scale), n_updates)
    with th.no_grad():
        predicted = net(images[n_train:]).numpy() * scale + centre
    truth = targets[n_train:]
    n_joints = poses.joints.shape[1] // 2
    r2 = 1 - ((predicted - truth) ** 2).mean(0) / (truth.var(0) + 1e-12)
    lines = ["joint   R2(sin)  R2(cos)"]
    lines += [f"J{j + 1}      {r2[j]:7.3f}  {r2[n_joints + j]:7.3f}" for j in range(n_joints)]
    offsets = (predicted - truth)[:, 2 * n_joints :].reshape(len(truth), -1, 2, 2)  # (n, views, markers, xy)
    errors = np.linalg.norm(offsets, axis=-1).mean((0, 1))
    lines.append(f"mean error of the image position: end effector {errors[0]:.2f} px, target {errors[1]:.2f} px")
    return lines


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.analysis.probe", description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=20_000)
    parser.add_argument("--updates", type=int, default=6_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--env", default=ENV_ID, choices=ENV_IDS, metavar="ID", help=", ".join(ENV_IDS))
    parser.add_argument("--random-target", action="store_true", help="draw the target too")
    args = parser.parse_args()
    th.manual_seed(args.seed)
    poses = collect_in_parallel(args.poses, args.seed, args.random_target, args.workers, args.env)
    print("\n".join(report(poses, args.updates)))


if __name__ == "__main__":
    main()
