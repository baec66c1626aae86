"""What batch normalisation does to a DDPG agent: the same images through batch statistics and through running ones.

    python -m benchmarks.batch_norm logs/ddpg/WamStereoReach-v0_1

shows a run's checkpoints images of random poses, in batches. In a training the online
critic sees a batch by its own statistics and its target by the running ones, and the actor that learns by the former
acts by the latter. The columns say how far the two are apart: Q of the same images and actions, and the actor's |a|.
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
from torch import nn

from sb3_stereo.building import make_env
from sb3_stereo.cli import Parser, run_command
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation import random_starts
from sb3_stereo.models import load_model
from sb3_stereo.policies import StereoDDPGPolicy
from sb3_stereo.runs import checkpoint_steps, load_record, model_path

BATCH_NORMS = (nn.BatchNorm1d, nn.BatchNorm2d)


class Line(NamedTuple):
    """Means over images; "batch" is by the batch's own statistics, "running" by the running ones.

    Attributes:
        timesteps: Of the checkpoint.
        q_batch, q_running: Q of the action that the agent takes.
        q_gap: |difference| of these two, image by image.
        action_batch, action_running: |a|.
        action_gap: |difference| of these two actions, image by image and joint by joint.
    """

    timesteps: int
    q_batch: float
    q_running: float
    q_gap: float
    action_batch: float
    action_running: float
    action_gap: float


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
def compare(policy: StereoDDPGPolicy, images: Sequence[NDArray[np.uint8]], batch_size: int) -> dict[str, float]:
    """The columns of a `Line` but for its steps.

    Args:
        policy: With an actor and a critic.
        images: Each (channels, height, width).
        batch_size: Of the training; what is left over after whole batches is not used.
    """
    policy.set_training_mode(False)
    pairs = []
    for start in range(0, len(images) - batch_size + 1, batch_size):
        tensors, _ = policy.obs_to_tensor(np.stack(images[start : start + batch_size]))
        running = policy.actor(tensors)
        q_running = policy.critic(tensors, running)[0]
        with batch_statistics(policy):
            pairs.append((policy.critic(tensors, running)[0], q_running, policy.actor(tensors), running))
    q_batch, q_running, batch, running = (th.cat(column) for column in zip(*pairs, strict=True))
    means = {
        "q_batch": q_batch,
        "q_running": q_running,
        "q_gap": (q_batch - q_running).abs(),
        "action_batch": batch.abs(),
        "action_running": running.abs(),
        "action_gap": (batch - running).abs(),
    }
    return {name: float(values.mean()) for name, values in means.items()}


def compare_checkpoints(run: str, n_poses: int, batch_size: int, seed: int) -> Iterator[Line]:
    """Compare every checkpoint of a run, on the same images.

    Raises:
        ConfigError: If the run is none of DDPG or TD3 with our policy, or has no checkpoints.
    """
    config, _ = load_record(run)
    steps = checkpoint_steps(Path(run))
    if not steps:
        raise ConfigError(f"no checkpoints in '{run}'; train with --save-freq")
    env = make_env(config.env_id, config.env_kwargs, config.env_wrapper)()
    images = [env.reset(**start)[0] for start in random_starts(n_poses, seed)]
    env.close()
    for step in steps:
        model: Any = load_model(config, model_path(run, config.env_id, checkpoint=step))
        if not isinstance(model.policy, StereoDDPGPolicy):
            raise ConfigError(f"'{run}' has a {type(model.policy).__name__}; take a run with a StereoDDPGPolicy")
        yield Line(step, **compare(model.policy, images, batch_size))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(prog="python -m benchmarks.batch_norm", description="Batch statistics against running ones.")
    parser.add_argument("run", metavar="RUN", help="the run's directory, e.g. logs/ddpg/WamStereoReach-v0_1")
    parser.add_argument("--poses", type=int, default=1000, metavar="N", help="random poses (default: 1000)")
    parser.add_argument("--batch-size", type=int, default=100, metavar="N", help="as in the training (default: 100)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the poses (default: 0)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


def batch_norm_command(args: argparse.Namespace) -> int:
    """Compare a run's checkpoints and print a line for each."""
    if not 1 < args.batch_size <= args.poses or args.seed < 0:
        raise ConfigError(
            "--batch-size must be at least 2 and at most --poses, and --seed not negative, "
            f"got {args.batch_size}, {args.poses} and {args.seed}"
        )
    lines = list(compare_checkpoints(args.run, args.poses, args.batch_size, args.seed))
    if args.json:
        print(json.dumps([line._asdict() for line in lines]))
        return 0
    print("|".join(["", *(f" {name} " for name in Line._fields), ""]) + "\n" + "| --- " * len(Line._fields) + "|")
    for step, *values in lines:
        print(f"| {step} | " + " | ".join(f"{value:.2f}" for value in values) + " |")
    return 0


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and compare; return the exit status."""
    return run_command(batch_norm_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
