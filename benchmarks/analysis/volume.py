"""What an encoder over four views tells in clutter, with all cameras and with one lost, by how it treats the views.

    python -m benchmarks.analysis.volume

collects transitions of random actions in `WamStereoReachClutter-v0` with four cameras, one of them lost in half of the
episodes, trains each encoder on them by the auxiliary losses of our DDPG, and measures on other episodes how far from
the truth the offset is that its head `position` reads. It is recorded in `benchmarks/results/volume.csv`, which
`benchmarks/CLUTTER.md` shows.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch as th
from gymnasium import spaces

import benchmarks
from benchmarks.analysis.baselines import Line, write_lines
from sb3_stereo.commands.flags import Parser, at_least, run_command
from sb3_stereo.console import print_line
from sb3_stereo.envs.cameras import RIGS
from sb3_stereo.policies.dynamics import DynamicsHeads, DynamicsSamples
from sb3_stereo.policies.extractors import StereoCnn
from sb3_stereo.policies.volume import VolumeCnn

N_TRAINING, N_TEST, EPISODE = 1500, 500, 10  # transitions, and those of an episode
N_UPDATES, BATCH_SIZE, LEARNING_RATE = 1500, 50, 1e-3
N_VIEWS = len(RIGS["four"])
COMMON: dict[str, Any] = {  # of hyperparams/ddpg.yml, with half of the filters
    "input_norm": "pixel",
    "hidden_norm": "layer",
    "init": "orthogonal",
    "features_dim": 100,
    "embedding_dim": 12,
    "blur": 3.0,
    "downsample": 3,
    "n_filters": 16,
    "kernel_sizes": [4, 3, 3],
    "strides": [2, 1, 1],
}
ENCODERS: dict[str, tuple[type[StereoCnn | VolumeCnn], Mapping[str, Any]]] = {
    "stack": (StereoCnn, {"strides": [2, 2, 1]}),
    "channels": (StereoCnn, {}),
    "volume, mean, one layer for all views": (VolumeCnn, {"view_layers": "shared"}),
    "volume, mean": (VolumeCnn, {}),
    "volume, attention": (VolumeCnn, {"merge": "attention"}),
}


class Transitions(NamedTuple):
    """Of random actions."""

    samples: DynamicsSamples  # with the views in channels

    def some(self, indices: Any) -> DynamicsSamples:
        """Those of these numbers."""
        return DynamicsSamples(*(column[indices] for column in self.samples))


def collect(n: int, camera_loss: float, seed: int) -> Transitions:
    """Transitions from episodes of random actions."""
    rng = np.random.default_rng(seed)
    columns: list[list[Any]] = [[], [], [], []]
    with closing(
        gym.make("WamStereoReachClutter-v0", cameras="four", composite="channels", camera_loss=camera_loss)
    ) as env:
        for number in range(n):
            if number % EPISODE == 0:
                before, _ = env.reset(seed=int(rng.integers(2**31)))
            action = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
            after, _, _, _, info = env.step(action)
            for column, value in zip(columns, (before, action, after, info["pixel_offsets"]), strict=True):
                column.append(value)
            before = after
    return Transitions(DynamicsSamples(*(th.as_tensor(np.array(column)) for column in columns)))


def as_stack(samples: DynamicsSamples) -> DynamicsSamples:
    """The same with the views in one channel."""
    images = (samples.observations, samples.next_observations)
    before, after = (views.flatten(1, 2)[:, None] for views in images)
    return samples._replace(observations=before, next_observations=after)


def without_view(samples: DynamicsSamples, view: int) -> DynamicsSamples:
    """The same with a black view, of views in channels."""
    after = samples.next_observations.clone()
    after[:, view] = 0
    return samples._replace(next_observations=after)


def errors(name: str, training: Transitions, test: Transitions, n_updates: int) -> Line:
    """Train an encoder; the median error of the offsets with all cameras, and for each that is lost, in [px]."""
    th.manual_seed(0)
    rng = np.random.default_rng(0)
    kind, kwargs = ENCODERS[name]
    arrange = as_stack if name == "stack" else DynamicsSamples._make
    shape = arrange(test.some(slice(1))).observations.shape[1:]
    encoder = kind(spaces.Box(0, 255, shape, np.uint8), **{**COMMON, **kwargs}).eval()
    heads = DynamicsHeads(encoder.features_dim, training.samples.actions.shape[1], N_VIEWS)
    heads.add_optimizer(encoder, LEARNING_RATE)
    for _ in range(n_updates):
        heads.update(encoder, arrange(training.some(rng.integers(len(training.samples.actions), size=BATCH_SIZE))))

    def median_error(samples: DynamicsSamples) -> float:
        with th.no_grad():
            features = encoder(arrange(samples).next_observations.float() / 255.0)
            read = heads.position(features).unflatten(1, (N_VIEWS, 2)) * heads.offset_scale
        return float((read - samples.next_offsets).norm(dim=2).nanmedian())

    found = {"all": median_error(test.samples)}
    found |= {view: median_error(without_view(test.samples, n)) for n, view in enumerate(RIGS["four"])}
    return {"encoder": name} | {view: f"{error:.4g}" for view, error in found.items()}


def volume_command(args: argparse.Namespace) -> int:
    """Measure all encoders, and record them."""
    th.set_num_threads(1)
    training, test = collect(N_TRAINING, camera_loss=0.5, seed=0), collect(N_TEST, camera_loss=0.0, seed=1)
    lines = []
    for name in ENCODERS:
        lines.append(errors(name, training, test, args.updates))
        print_line(", ".join(f"{key} {value}" for key, value in lines[-1].items()))
    write_lines(benchmarks.RESULTS / "volume.csv", lines)
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = Parser(prog="python -m benchmarks.analysis.volume", description=__doc__.splitlines()[0])
    parser.add_argument("--updates", type=at_least(1), default=N_UPDATES, help=f"of each (default: {N_UPDATES})")
    return run_command(volume_command, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
