"""Gradient steps and predictions of a learner, for `benchmarks.speed`.

    python -m benchmarks.updates ddpg|dqn ours|sb3 THREADS

takes them once per "update" or "predict" on standard input. Both learners have the paper's sizes: batches of 100,
84 x 84 pixels, three convolutions of 32 filters with batch normalisation, two layers of 200 (for DQN no
normalisation). "sb3" is Stable-Baselines3 as installed: its own policy, PyTorch's default memory format and allocator,
and none of this package is imported.
"""

import sys
from contextlib import ExitStack
from typing import Any

from benchmarks.timing import Worker, medians, serve, timed

SHAPE = (1, 84, 84)
KERNELS, STRIDES = (3, 3, 3), (2, 2, 2)
BATCH_SIZE, N_STORED = 100, 400
N_UPDATES, N_PREDICTIONS = 2, 50  # per time


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


def make_model(algo: str, whose: str) -> Any:
    """A model with a filled replay buffer."""
    from stable_baselines3 import DDPG, DQN

    is_dqn = algo == "dqn"
    if whose == "ours":
        from sb3_stereo import StereoDDPGPolicy, StereoDQNPolicy

        policy: Any = StereoDQNPolicy if is_dqn else StereoDDPGPolicy
        extractor: dict[str, Any] = {"kernel_sizes": KERNELS, "strides": STRIDES}
        kwargs: dict[str, Any] = {"features_extractor_kwargs": extractor, "net_arch": [200, 200]}
        if is_dqn:
            extractor.update(n_filters=32, features_dim=None)
        else:
            kwargs.update(n_critics=1)
    else:
        policy = "CnnPolicy"
        kwargs = {
            "features_extractor_class": plain_cnn(),
            "features_extractor_kwargs": {"batch_norm": not is_dqn},
            "net_arch": [200, 200],
        }
    model = (DQN if is_dqn else DDPG)(
        policy, make_env(is_dqn), policy_kwargs=kwargs, buffer_size=N_STORED, batch_size=BATCH_SIZE,
        learning_starts=N_STORED, device="cpu", seed=0,
    )  # fmt: skip
    return model.learn(N_STORED)


def measure_updates(rounds: int, threads: int) -> tuple[dict[str, float], dict[str, float]]:
    """Milliseconds per gradient step, and per prediction, of the same networks."""
    names = [(algo, whose) for algo in ("ddpg", "dqn") for whose in ("ours", "sb3")]
    with ExitStack() as stack:
        workers = {
            f"{algo}, {whose}": stack.enter_context(Worker("benchmarks.updates", algo, whose, str(threads)))
            for algo, whose in names
        }
        updates, predictions = (
            medians({name: worker.candidate(what) for name, worker in workers.items()}, rounds)
            for what in ("update", "predict")
        )
    return (
        {name: 1000 * seconds / N_UPDATES for name, seconds in updates.items()},
        {name: 1000 * seconds / N_PREDICTIONS for name, seconds in predictions.items()},
    )


def main() -> None:
    """Command line."""
    algo, whose, threads = sys.argv[1:]
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

    serve({"update": timed(lambda: model.train(N_UPDATES, BATCH_SIZE)), "predict": timed(predict)})


if __name__ == "__main__":
    main()
