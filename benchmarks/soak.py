"""Run the environment and the vectorised learner for long, and watch what a leak would move.

    python -m benchmarks.soak --env-steps 100000 --learner-steps 3000

prints, ten times per part, the memory of the process and its workers, their open files, the number of processes and
the time of a step; and at the end the growth since the first tenth, in which caches fill up. `--json` prints that as
one object.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass

import gymnasium as gym
import psutil
from stable_baselines3.common.callbacks import BaseCallback

import sb3_stereo  # noqa: F401  (registers the environments)
from sb3_stereo.building import make_callbacks, make_model, make_training_env
from sb3_stereo.cli import DEFAULT_ENV
from sb3_stereo.config import load_config
from sb3_stereo.runtime import set_threads, tune_allocator

N_SAMPLES = 10
N_ENVS = 2


@dataclass(frozen=True)
class Sample:
    """What a leak would move.

    Attributes:
        steps: Environment steps so far.
        memory: Of this process and its children, in [MiB].
        files: Open ones, of all of them.
        processes: This one and its children.
        step_time: Mean since the last sample, in [ms].
    """

    steps: int
    memory: float
    files: int
    processes: int
    step_time: float


def sample(steps: int, seconds: float, n_new: int) -> Sample:
    """Look at this process and its children."""
    me = psutil.Process()
    family = [me, *me.children(recursive=True)]
    memory = sum(process.memory_info().rss for process in family) / 2**20
    return Sample(steps, memory, sum(process.num_fds() for process in family), len(family), 1000 * seconds / n_new)


class Sampler:
    """Takes and prints a sample after every tenth of the steps."""

    def __init__(self, n_steps: int, show: Callable[[str], None]) -> None:
        self.interval, self.show = max(1, n_steps // N_SAMPLES), show
        self.samples: list[Sample] = []
        self.before = time.perf_counter()

    def __call__(self, steps: int) -> None:
        """Take a sample if it is time."""
        taken = self.samples[-1].steps if self.samples else 0
        if steps - taken < self.interval:
            return
        now = time.perf_counter()
        self.samples.append(sample(steps, now - self.before, steps - taken))
        self.before = now
        self.show("{steps:8} steps {memory:8.1f} MiB {files:4} files {processes} processes {step_time:7.1f} ms".format(
            **asdict(self.samples[-1])
        ))  # fmt: skip


def soak_environment(n_steps: int, show: Callable[[str], None]) -> list[Sample]:
    """Step the environment with random actions."""
    env, sampler = gym.make(DEFAULT_ENV), Sampler(n_steps, show)
    env.reset(seed=0)
    env.action_space.seed(0)
    for step in range(1, n_steps + 1):
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
        sampler(step)
    env.close()
    return sampler.samples


class SampleCallback(BaseCallback):
    """Samples a training."""

    def __init__(self, sampler: Sampler) -> None:
        super().__init__()
        self.sampler = sampler

    def _on_step(self) -> bool:
        self.sampler(self.num_timesteps)
        return True


def soak_learner(n_steps: int, show: Callable[[str], None]) -> list[Sample]:
    """Train our DDPG on environments in processes, with a replay buffer that is full after a tenth of the steps."""
    params = {"n_envs": N_ENVS, "buffer_size": max(20, n_steps // N_SAMPLES), "learning_starts": 10, "batch_size": 20}
    config = load_config("ddpg", DEFAULT_ENV, params=params, n_timesteps=n_steps)
    env, sampler = make_training_env(config, seed=0, vec_env="subproc"), Sampler(n_steps, show)
    try:
        model = make_model(config, env, seed=0, device="cpu")
        model.learn(n_steps, callback=[*make_callbacks(config), SampleCallback(sampler)])
    finally:
        env.close()
    return sampler.samples


def growth(samples: Sequence[Sample]) -> dict[str, float]:
    """What changed since the first sample: memory and step time as shares, files and processes as numbers."""
    first, last = samples[0], samples[-1]
    return {
        "steps": last.steps,
        "memory_growth": last.memory / first.memory - 1.0,
        "step_time_growth": last.step_time / first.step_time - 1.0,
        "more_files": last.files - first.files,
        "more_processes": last.processes - first.processes,
    }


def parts(args: argparse.Namespace, show: Callable[[str], None]) -> Iterator[tuple[str, dict[str, float]]]:
    """Soak what was asked for."""
    for name, n_steps, soak in (
        ("environment", args.env_steps, soak_environment),
        ("learner", args.learner_steps, soak_learner),
    ):
        if n_steps > 0:
            show(f"{name}:")
            yield name, growth(soak(n_steps, show))


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description="Run for long and watch for leaks.")
    parser.add_argument("--env-steps", type=int, default=100_000, help="of the environment alone (default: 100000)")
    parser.add_argument("--learner-steps", type=int, default=3000, help="of the vectorised learner (default: 3000)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(argv)
    tune_allocator()
    set_threads(1)
    results = dict(parts(args, (lambda line: None) if args.json else print))
    if args.json:
        print(json.dumps(results))
        return
    for name, result in results.items():
        print(f"{name}, {result['steps']} steps: memory {100 * result['memory_growth']:+.2f} %, "
              f"{result['more_files']:+} files, {result['more_processes']:+} processes, "
              f"step time {100 * result['step_time_growth']:+.0f} %")  # fmt: skip


if __name__ == "__main__":
    main()
