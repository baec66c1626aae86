"""Diagnosis of a run's networks: one line per checkpoint, on images of random poses.

    python -m benchmarks.analysis.diagnosis logs/ddpg/WamStereoReach-v0_1

For DDPG, the effect of batch normalisation: in training, the online critic uses a batch's own statistics and its target
the running ones, and the actor learns with the former and acts with the latter. The columns compare the two. For DQN,
whether the network still distinguishes images.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.dqn.policies import DQNPolicy
from torch import nn

from sb3_stereo.building.factory import make_env
from sb3_stereo.commands.flags import Parser, run_command
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.protocol import random_initial_states
from sb3_stereo.policies.ddpg import StereoDDPGPolicy
from sb3_stereo.runs.directory import checkpoint_steps, load_record, model_path
from sb3_stereo.runs.models import load_model

BATCH_NORMS = (nn.BatchNorm1d, nn.BatchNorm2d)

Images = Sequence[NDArray[np.uint8]]  # each (channels, height, width)


class Gap(NamedTuple):
    """DDPG: means over images; "batch" is by the batch's own statistics, "running" by the running ones.

    Attributes:
        q_batch, q_running: Q of the action that the agent takes.
        q_gap: |difference| of these two, image by image.
        action_batch, action_running: |a|.
        action_gap: |difference| of these two actions, image by image and joint by joint.
    """

    q_batch: float
    q_running: float
    q_gap: float
    action_batch: float
    action_running: float
    action_gap: float


class QStatistics(NamedTuple):
    """DQN: what the network makes of the images.

    Attributes:
        q: Mean over images and actions.
        q_spread: Standard deviation of an action's Q over the images, mean over the actions.
        live_features: Share of the features that are not the same for all images.
        actions: How many actions are the best one for some image.
    """

    q: float
    q_spread: float
    live_features: float
    actions: int


@contextmanager
def batch_statistics(network: nn.Module) -> Iterator[None]:
    """Let the batch normalisations inside use the batch's statistics, and leave the running ones as they are."""
    norms = [module for module in network.modules() if isinstance(module, BATCH_NORMS)]
    momenta = [norm.momentum for norm in norms]
    for norm in norms:
        norm.momentum = 0.0
        norm.train()
    try:
        yield
    finally:
        for norm, momentum in zip(norms, momenta, strict=True):
            norm.momentum = momentum
            norm.eval()


@th.no_grad()
def compare_statistics(policy: StereoDDPGPolicy, images: Images, batch_size: int) -> Gap:
    """Batch statistics against running ones; what is left over after whole batches is not used."""
    policy.set_training_mode(False)
    pairs = []
    for start in range(0, len(images) - batch_size + 1, batch_size):
        tensors, _ = policy.obs_to_tensor(np.stack(images[start : start + batch_size]))
        running = policy.actor(tensors)
        q_running = policy.critic(tensors, running)[0]
        with batch_statistics(policy):
            pairs.append((policy.critic(tensors, running)[0], q_running, policy.actor(tensors), running))
    q_batch, q_running, batch, running = (th.cat(column) for column in zip(*pairs, strict=True))
    columns = q_batch, q_running, (q_batch - q_running).abs(), batch.abs(), running.abs(), (batch - running).abs()
    return Gap(*(float(column.mean()) for column in columns))


@th.no_grad()
def look_at(policy: DQNPolicy, images: Images) -> QStatistics:
    """How differently the network sees the images."""
    policy.set_training_mode(False)
    tensors, _ = policy.obs_to_tensor(np.stack(images))
    network = policy.q_net
    features = network.extract_features(tensors, network.features_extractor)
    q_values = network.q_net(features)
    live = (features != features[0]).any(dim=0).float().mean()
    best = q_values.argmax(dim=1).unique()
    return QStatistics(float(q_values.mean()), float(q_values.std(dim=0).mean()), float(live), len(best))


def diagnose(run: str, n_poses: int, batch_size: int, seed: int) -> Iterator[tuple[int, Gap | QStatistics]]:
    """Every checkpoint of a run: its steps, and what became of its networks.

    Raises:
        ConfigError: If the run has no checkpoints, or other policies than ours for DDPG or one for DQN.
    """
    config, _ = load_record(run)
    steps = checkpoint_steps(Path(run))
    if not steps:
        raise ConfigError(f"no checkpoints in '{run}'; train with --save-freq")
    env = make_env(config.env_id, config.env_kwargs, config.env_wrapper)()
    images = [env.reset(**start)[0] for start in random_initial_states(n_poses, seed)]
    env.close()
    for step in steps:
        policy: Any = load_model(config, model_path(run, config.env_id, checkpoint=step)).policy
        if isinstance(policy, DQNPolicy):
            yield step, look_at(policy, images)
        elif isinstance(policy, StereoDDPGPolicy):
            yield step, compare_statistics(policy, images, batch_size)
        else:
            raise ConfigError(f"'{run}' has a {type(policy).__name__}; take a run of DDPG, TD3 or DQN with our policy")


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(prog="python -m benchmarks.analysis.diagnosis", description="What became of a run's networks.")
    parser.add_argument("run", metavar="RUN", help="the run's directory, e.g. logs/ddpg/WamStereoReach-v0_1")
    parser.add_argument("--poses", type=int, default=1000, metavar="N", help="random poses (default: 1000)")
    parser.add_argument("--batch-size", type=int, default=100, metavar="N", help="as in the training (default: 100)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the poses (default: 0)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


def diagnosis_command(args: argparse.Namespace) -> int:
    """Diagnose a run's checkpoints and print a line for each."""
    if not 1 < args.batch_size <= args.poses or args.seed < 0:
        raise ConfigError(
            "--batch-size must be at least 2 and at most --poses, and --seed not negative, "
            f"got {args.batch_size}, {args.poses} and {args.seed}"
        )
    found = diagnose(args.run, args.poses, args.batch_size, args.seed)
    lines = [{"timesteps": step, **measured._asdict()} for step, measured in found]
    if args.json:
        print(json.dumps(lines))
        return 0
    print(f"| {' | '.join(lines[0])} |\n{'| --- ' * len(lines[0])}|")
    for line in lines:
        print(f"| {' | '.join(str(value) if isinstance(value, int) else f'{value:.3f}' for value in line.values())} |")
    return 0


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and diagnose; return the exit status."""
    return run_command(diagnosis_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
