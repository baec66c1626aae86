"""Does the critic learn the task, or its samples by heart? A short test before a long training.

    python -m benchmarks.generalisation

takes random transitions, trains the critic of `hyperparams/ddpg.yml` on the rewards alone (gamma = 0), with and
without its parts, and prints R^2 on transitions that it has and has not seen. Where the last column is near 0, no
learner works.
"""

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch as th
from gymnasium.spaces import Box
from numpy.typing import NDArray
from stable_baselines3.common.utils import ConstantSchedule

from sb3_stereo.buffers import MirrorReplayBuffer
from sb3_stereo.config import load_config
from sb3_stereo.policies import StereoDDPGPolicy
from sb3_stereo.runtime import available_cores

ENV_ID = "WamStereoReach-v0"
BATCH_SIZE = 100
N_TEST = 2000
EPISODE_LENGTH = 20  # shorter than the environment's: more poses


class Transitions(NamedTuple):
    """Images (n, c, h, w) uint8, actions (n, n_joints), rewards (n, 1)."""

    images: NDArray[np.uint8]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float32]


def collect(n: int, seed: int) -> Transitions:
    """`n` transitions of random actions."""
    env = gym.make(f"sb3_stereo:{ENV_ID}", max_episode_steps=EPISODE_LENGTH)
    env.action_space.seed(seed)
    image, _ = env.reset(seed=seed)
    transitions = []
    for _ in range(n):
        action = env.action_space.sample()
        next_image, reward, terminated, truncated, _ = env.step(action)
        transitions.append((image, action, (float(reward),)))
        image = env.reset()[0] if terminated or truncated else next_image
    env.close()
    images, actions, rewards = map(np.array, zip(*transitions, strict=True))
    return Transitions(images, actions, rewards.astype(np.float32))


def collect_in_parallel(n: int, seed: int, n_workers: int) -> Transitions:
    """`collect` over processes, each with its own seed."""
    with ProcessPoolExecutor(n_workers) as pool:
        parts = pool.map(collect, [n // n_workers] * n_workers, range(seed, seed + n_workers))
    return Transitions(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def fit_rewards(
    policy_kwargs: dict[str, Any], data: Transitions, n_train: int, n_updates: int, mirrored: bool
) -> tuple[float, float]:
    """Train a new critic on the rewards of the first transitions.

    Returns:
        R^2 on the first 1000 of them, and on the last `N_TEST`, unseen.
    """
    th.manual_seed(0)
    env = gym.make(ENV_ID)
    image_space, action_space = env.observation_space, env.action_space
    assert isinstance(action_space, Box)
    env.close()
    policy = StereoDDPGPolicy(image_space, action_space, ConstantSchedule(3e-4), **deepcopy(policy_kwargs))
    mirror = MirrorReplayBuffer(1, image_space, action_space, device="cpu")
    images, actions, rewards = (th.as_tensor(part) for part in data)
    policy.set_training_mode(True)
    for _ in range(n_updates):
        chosen = th.randint(n_train, (BATCH_SIZE,))
        batch, action = images[chosen], actions[chosen]
        if mirrored:
            flip = th.rand(BATCH_SIZE) < 0.5
            batch[flip], action[flip] = mirror.mirror(batch[flip]), mirror.mirror_actions(action[flip])
        errors = [(q - rewards[chosen]).square().mean() for q in policy.critic(batch, action)]
        policy.critic.optimizer.zero_grad()
        th.stack(errors).sum().backward()  # type: ignore[no-untyped-call]
        policy.critic.optimizer.step()
    policy.set_training_mode(False)
    return _r2(policy, images[:1000], actions[:1000], rewards[:1000]), _r2(
        policy, images[-N_TEST:], actions[-N_TEST:], rewards[-N_TEST:]
    )


@th.no_grad()
def _r2(policy: StereoDDPGPolicy, images: th.Tensor, actions: th.Tensor, rewards: th.Tensor) -> float:
    parts = zip(th.split(images, 500), th.split(actions, 500), strict=True)  # in parts, to spare memory
    predicted = th.cat([th.cat(policy.critic(image, action), dim=1).mean(1) for image, action in parts])
    return float(1 - (predicted - rewards[:, 0]).square().mean() / rewards.var())


def variants(policy_kwargs: dict[str, Any]) -> dict[str, tuple[dict[str, Any], bool]]:
    """What is compared: policy arguments, and whether the transitions are mirrored."""
    sharp = deepcopy(policy_kwargs)
    for key in ("blur", "downsample", "kernel_sizes", "strides"):
        sharp["features_extractor_kwargs"].pop(key, None)
    return {
        "ours": (policy_kwargs, True),
        "without the mirror": (policy_kwargs, False),
        "without the blur": (sharp, True),
        "without both": (sharp, False),
    }


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.generalisation", description=__doc__.splitlines()[0])
    parser.add_argument("--transitions", type=int, default=4000, help="to train on (default: 4000)")
    parser.add_argument("--updates", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=available_cores())
    args = parser.parse_args(argv)
    data = collect_in_parallel(args.transitions + N_TEST, args.seed, args.workers)
    policy_kwargs = dict(load_config("ddpg", ENV_ID).policy_kwargs)
    print(f"{args.transitions} transitions, {args.updates} updates: R2 of the reward\n{'':20} seen  unseen")
    for name, (kwargs, mirrored) in variants(policy_kwargs).items():
        seen, unseen = fit_rewards(kwargs, data, args.transitions, args.updates, mirrored)
        print(f"{name:20} {seen:4.2f}  {unseen:6.2f}", flush=True)


if __name__ == "__main__":
    main()
