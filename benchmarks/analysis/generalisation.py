"""Does the critic learn the task or memorise its samples? A short test before a long training run.

    python -m benchmarks.analysis.generalisation

takes random transitions, trains the encoder and the critic of `hyperparams/ddpg.yml` on them, the critic on the rewards
alone (gamma = 0), with and without some parts, and prints R^2 of the rewards of transitions that it has and has not
seen. Where the last column is near 0, no learner works.
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
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.utils import ConstantSchedule

from sb3_stereo.config.schema import load_config
from sb3_stereo.learning.replay import StereoReplayBuffer
from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.runtime import available_cores
from sb3_stereo.task_interface import OFFSETS

ENV_ID = "WamStereoReach-v0"
WAM_MIRRORED_JOINTS = (0, 2)  # J1 and J3
BATCH_SIZE = 100
N_TEST = 2000
N_PARTS = 4
EPISODE_LENGTH = 20  # shorter than the environment's: more poses


Column = NDArray[Any]


class Transitions(NamedTuple):
    """Columns of a replay buffer; images are (n, c, h, w) and uint8, the others (n, ...) and float32."""

    observations: Column
    next_observations: Column
    actions: Column
    rewards: Column
    offsets: Column


def collect(n: int, seed: int) -> Transitions:
    """`n` transitions of random actions."""
    env = gym.make(f"sb3_stereo:{ENV_ID}", max_episode_steps=EPISODE_LENGTH)
    env.action_space.seed(seed)
    image, _ = env.reset(seed=seed)
    transitions = []
    for _ in range(n):
        action = env.action_space.sample()
        next_image, reward, terminated, truncated, info = env.step(action)
        transitions.append((image, next_image, action, reward, info[OFFSETS]))
        image = env.reset()[0] if terminated or truncated else next_image
    env.close()
    columns = map(np.array, zip(*transitions, strict=True))
    return Transitions(*(c if c.dtype == np.uint8 else c.astype(np.float32) for c in columns))


def collect_in_parallel(n: int, seed: int, n_workers: int) -> Transitions:
    """`collect` in `N_PARTS` parts, each with its own seed, over processes: the same, however many there are."""
    with ProcessPoolExecutor(n_workers) as pool:
        parts = pool.map(collect, [n // N_PARTS] * N_PARTS, range(seed, seed + N_PARTS))
    return Transitions(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def fill_buffer(transitions: Transitions, mirror_probability: float) -> StereoReplayBuffer:
    """A replay buffer with these transitions."""
    n, *shape = transitions.observations.shape
    images, efforts = Box(0, 255, tuple(shape), np.uint8), Box(-1, 1, transitions.actions.shape[1:])
    buffer = StereoReplayBuffer(
        n, images, efforts, device="cpu", mirrored_joints=WAM_MIRRORED_JOINTS, mirror_probability=mirror_probability
    )
    for image, next_image, action, reward, offsets in zip(*transitions, strict=True):
        buffer.add(image[None], next_image[None], action[None], reward[None], np.zeros(1), [{OFFSETS: offsets}])
    return buffer


def fit_rewards(
    policy_kwargs: dict[str, Any], data: Transitions, n_train: int, n_updates: int, mirror_probability: float = 0.5
) -> tuple[float, float]:
    """Train a new encoder and critic on the first transitions.

    Returns:
        R^2 of the reward on the first 1000 of them, and on the last `N_TEST`, unseen.
    """
    th.manual_seed(0)
    np.random.seed(0)
    buffer = fill_buffer(Transitions(*(column[:n_train] for column in data)), mirror_probability)
    spaces = buffer.observation_space, buffer.action_space
    policy = StereoDDPGPolicy(*spaces, ConstantSchedule(3e-4), **deepcopy(policy_kwargs))  # type: ignore[arg-type]
    for _ in range(n_updates):
        if policy.dynamics:
            policy.dynamics.update(policy.encoder, buffer.sample_dynamics(BATCH_SIZE))
        _fit_batch(policy, buffer.sample(BATCH_SIZE))
    return _r2(policy, data, slice(1000)), _r2(policy, data, slice(-N_TEST, None))


def _fit_batch(policy: StereoDDPGPolicy, batch: ReplayBufferSamples) -> None:
    policy.critic.set_training_mode(True)
    errors = [(q - batch.rewards).square().mean() for q in policy.critic(batch.observations, batch.actions)]
    policy.critic.optimizer.zero_grad()
    th.stack(errors).sum().backward()  # type: ignore[no-untyped-call]
    policy.critic.optimizer.step()
    policy.critic.set_training_mode(False)


@th.no_grad()
def _r2(policy: StereoDDPGPolicy, data: Transitions, which: slice) -> float:
    columns = data.observations[which], data.actions[which]
    parts = zip(*(th.split(th.as_tensor(column), 500) for column in columns), strict=True)  # in parts, to spare memory
    predicted = th.cat([th.cat(policy.critic(image, action), dim=1).mean(1) for image, action in parts])
    rewards = th.as_tensor(data.rewards[which])
    return float(1 - (predicted - rewards).square().mean() / rewards.var())


def variants(policy_kwargs: dict[str, Any]) -> dict[str, tuple[dict[str, Any], float]]:
    """What is compared: policy arguments, and the share of mirrored samples."""
    sharp, wide, alone = deepcopy(policy_kwargs), deepcopy(policy_kwargs), deepcopy(policy_kwargs)
    for key in ("blur", "downsample", "kernel_sizes", "strides"):
        sharp["features_extractor_kwargs"].pop(key)
    wide["features_extractor_kwargs"].pop("embedding_dim")
    alone["encoder_loss"] = "critic"
    return {
        "ours": (policy_kwargs, 0.5),
        "without the mirror": (policy_kwargs, 0.0),
        "without the blur": (sharp, 0.5),
        "without the narrow embedding": (wide, 0.5),
        "encoder trained by the critic": (alone, 0.5),
    }


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.analysis.generalisation", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--transitions", type=int, default=4000, help="to train on (default: 4000)")
    parser.add_argument("--updates", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=available_cores())
    args = parser.parse_args(argv)
    data = collect_in_parallel(args.transitions + N_TEST, args.seed, args.workers)
    policy_kwargs = dict(load_config("ddpg", ENV_ID).policy_kwargs)
    print(f"{args.transitions} transitions, {args.updates} updates: R2 of the reward\n{'':30} seen  unseen")
    for name, (kwargs, mirror_probability) in variants(policy_kwargs).items():
        seen, unseen = fit_rewards(kwargs, data, args.transitions, args.updates, mirror_probability)
        print(f"{name:30} {seen:4.2f}  {unseen:6.2f}", flush=True)


if __name__ == "__main__":
    main()
