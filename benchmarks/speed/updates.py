"""Gradient steps and predictions of an algorithm, for `benchmarks.speed`.

    python -m benchmarks.speed.updates ddpg|dqn ours|sb3 THREADS
    python -m benchmarks.speed.updates dqn_nature ours|sbx THREADS

takes them once per "update" or "predict" on standard input. The algorithms have the paper's sizes: batches of 100,
84 x 84 pixels, three convolutions of 32 filters with batch normalisation, two layers of 200 (for DQN no
normalisation). "sb3" is Stable-Baselines3 as installed: its own policy, PyTorch's default memory format and allocator,
and none of this package is imported. "sbx" is SB3's DQN in JAX (`pip install sbx-rl`), which has no DDPG on images and
one network only, that of Mnih et al. 2015, so that is what "dqn_nature" has.
"""

import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from importlib import import_module
from importlib.util import find_spec
from statistics import median
from typing import Any

from benchmarks.speed.timing import Worker, medians, serve, timed

SHAPE = (1, 84, 84)
KERNELS, STRIDES = (3, 3, 3), (2, 2, 2)
BATCH_SIZE, N_STORED = 100, 400
N_UPDATES, N_PREDICTIONS = 2, 50  # per time
ROUNDS_PER_PROCESS = 4
LEARNERS = [(algo, whose) for algo in ("ddpg", "dqn") for whose in ("ours", "sb3")]
LEARNERS_LIKE_SBX = [("dqn_nature", whose) for whose in ("ours", "sbx")]


def make_env(discrete: bool) -> Any:
    """Noise images."""
    import gymnasium as gym
    import numpy as np

    class Noise(gym.Env[Any, Any]):
        observation_space = gym.spaces.Box(0, 255, SHAPE, np.uint8)
        action_space: gym.Space[Any] = gym.spaces.Discrete(81) if discrete else gym.spaces.Box(-1, 1, (4,), np.float32)

        def reset(self, **_: Any) -> Any:
            return self.observation_space.sample(), {}

        def step(self, action: Any) -> Any:
            return self.observation_space.sample(), 0.0, False, False, {}

    return Noise()


def plain_cnn() -> Any:
    """SB3's way to a network of the same size."""
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from torch import nn

    class PlainCnn(BaseFeaturesExtractor):
        def __init__(self, observation_space: Any, batch_norm: bool) -> None:
            super().__init__(observation_space, 32 * 9 * 9)
            layers: list[nn.Module] = [nn.BatchNorm2d(1)] if batch_norm else []
            for channels, kernel, stride in zip((1, 32, 32), KERNELS, STRIDES, strict=True):
                norms = [nn.BatchNorm2d(32)] if batch_norm else []
                layers += [nn.Conv2d(channels, 32, kernel, stride), *norms, nn.ReLU()]
            self.cnn = nn.Sequential(*layers, nn.Flatten())

        def forward(self, observations: Any) -> Any:
            return self.cnn(observations)

    return PlainCnn


def policy_and_kwargs(algo: str, whose: str) -> tuple[Any, dict[str, Any]]:
    """What the learners of an algorithm differ in, and the sizes that they share."""
    if whose == "sbx":
        return "CnnPolicy", {"net_arch": [512]}
    if whose == "sb3":
        extractor: dict[str, Any] = {"batch_norm": algo == "ddpg"}
        kwargs: dict[str, Any] = {"features_extractor_class": plain_cnn(), "features_extractor_kwargs": extractor}
        return "CnnPolicy", {**kwargs, "net_arch": [200, 200]}
    from sb3_stereo.policies.ddpg import StereoDDPGPolicy
    from sb3_stereo.policies.dqn import StereoDQNPolicy

    if algo == "dqn_nature":
        return StereoDQNPolicy, {}
    extractor = {"kernel_sizes": KERNELS, "strides": STRIDES}
    if algo == "ddpg":
        return StereoDDPGPolicy, {"features_extractor_kwargs": extractor, "net_arch": [200, 200], "n_critics": 1}
    extractor |= {"n_filters": 32, "features_dim": None}
    return StereoDQNPolicy, {"features_extractor_kwargs": extractor, "net_arch": [200, 200]}


def make_model(algo: str, whose: str) -> Any:
    """A model with a filled replay buffer."""
    package = import_module("sbx" if whose == "sbx" else "stable_baselines3")
    learner: Any = package.DDPG if algo == "ddpg" else package.DQN
    policy, kwargs = policy_and_kwargs(algo, whose)
    model: Any = learner(
        policy, make_env(algo != "ddpg"), policy_kwargs=kwargs, buffer_size=N_STORED, batch_size=BATCH_SIZE,
        learning_starts=N_STORED, device="cpu", seed=0,
    )  # fmt: skip
    return model.learn(N_STORED)


def measure_updates(rounds: int, threads: int) -> tuple[dict[str, float], dict[str, float]]:
    """Milliseconds per gradient step, and per prediction, of the same networks: medians over fresh processes.

    It depends on the process, on where glibc happens to put what, whether SB3's gradient step takes 16 000 page faults
    or 150 000, and so 440 ms or 760.
    """
    if find_spec("sbx") is None:
        print("sbx is left out: it is not installed", file=sys.stderr)
    rounds_each = min(rounds, ROUNDS_PER_PROCESS)
    found = [measure_processes(rounds_each, threads) for _ in range(round(rounds / rounds_each))]
    updates, predictions = zip(*found, strict=True)
    return medians_of(updates, 1000 / N_UPDATES), medians_of(predictions, 1000 / N_PREDICTIONS)


def measure_processes(rounds: int, threads: int) -> tuple[dict[str, float], dict[str, float]]:
    """Seconds per candidate's "update" and "predict", with one process for each learner."""
    with ExitStack() as stack:
        workers = {
            f"{algo}, {whose}": stack.enter_context(Worker("benchmarks.speed.updates", algo, whose, str(threads)))
            for algo, whose in LEARNERS + (LEARNERS_LIKE_SBX if find_spec("sbx") else [])
        }
        updates, predictions = (
            medians({name: worker.candidate(what) for name, worker in workers.items()}, rounds)
            for what in ("update", "predict")
        )
    return updates, predictions


def medians_of(tables: Sequence[dict[str, float]], scale: float) -> dict[str, float]:
    """The median of each entry over the tables, times `scale`."""
    return {name: scale * median(table[name] for table in tables) for name in tables[0]}


def main() -> None:
    """Command line."""
    algo, whose, threads = sys.argv[1:]
    if whose == "sbx":  # JAX takes as many threads as it has cores
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: int(threads)])
    if whose == "ours":
        from sb3_stereo.runtime import tune_allocator

        tune_allocator()
    import torch as th

    th.set_num_threads(int(threads))
    model = make_model(algo, whose)
    observation = model.observation_space.sample()

    def predict() -> None:
        for _ in range(N_PREDICTIONS):
            model.predict(observation, deterministic=True)

    serve(
        {
            "update": timed(lambda: model.train(gradient_steps=N_UPDATES, batch_size=BATCH_SIZE)),
            "predict": timed(predict),
        }
    )


if __name__ == "__main__":
    main()
