"""A training with `hyperparams/ddpg.yml` after its pre-training, in its parts, for `benchmarks.speed`.

    python -m benchmarks.speed.trainings THREADS

takes `N_STEPS` environment steps, with all that is learnt after each, once per "all" on standard input, tells what the
latest parts of them took, and the process's peak "memory" with a full replay buffer.
"""

import sys
from collections.abc import Callable
from typing import Any

from benchmarks.speed.timing import Candidate, Parts, Worker, medians, peak_memory, serve

N_STEPS = 4  # per time
N_RANDOM = 150  # transitions before the first action: what a later step takes does not depend on their number
NO_PRETRAINING = {"pretraining": {"dynamics": 0, "agent": 0}}


def make_training(n_random: int = N_RANDOM) -> Any:
    """The model, with as many random transitions."""
    from sb3_stereo.building.factory import make_model, make_training_env
    from sb3_stereo.config.schema import DEFAULT_ENV, load_config

    config = load_config("ddpg", DEFAULT_ENV, params={"learning_starts": n_random, **NO_PRETRAINING})
    model = make_model(config, make_training_env(config, seed=0), seed=0, device="cpu")
    return model.learn(n_random)


def training_parts(model: Any) -> dict[str, Candidate]:
    """The training, with a stopwatch at each part of a step."""
    parts = Parts()
    model.env.step = parts.watch("environment", model.env.step)
    model.predict = parts.watch("choosing the action", model.predict)
    model._train_agent = parts.watch("gradient steps", model._train_agent)
    model._train_dynamics = parts.watch("dynamics updates", model._train_dynamics)
    return parts.candidates(lambda: model.learn(N_STEPS, reset_num_timesteps=False))


def memory(model: Any) -> Callable[[], float]:
    """A call that fills the replay buffer and tells the peak: the system gives memory out when it is written to."""

    def peak() -> float:
        buffer = model.replay_buffer
        for images in (buffer.observations, buffer.next_observations):
            images += 0
        return peak_memory()

    return peak


def measure_training(rounds: int, threads: int) -> tuple[dict[str, float], float]:
    """Milliseconds per environment step and per part of it, and the peak memory in [MiB]."""
    with Worker("benchmarks.speed.trainings", str(threads)) as worker:
        parts = {name: worker.candidate(name) for name in worker.names if name != "memory"}
        found = {name: 1000 * seconds / N_STEPS for name, seconds in medians(parts, rounds).items()}
        return found, worker.ask("memory")


def main() -> None:
    """Command line."""
    from sb3_stereo.runtime import set_threads, tune_allocator

    tune_allocator()
    set_threads(int(sys.argv[1]))
    model = make_training()
    serve({**training_parts(model), "memory": memory(model)})


if __name__ == "__main__":
    main()
