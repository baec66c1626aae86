"""Soak test: run the environment and the vectorised algorithm for long, and watch for leaks.

    python -m benchmarks.soak --env-steps 100000 --learner-steps 3000

prints, after each tenth of a part, the memory of the process and its workers, their open files, the number of processes
and the time of a step; and at the end the growth since the first tenth, in which caches fill up. The learner part is a
whole training run, with evaluations and snapshots, which its step time includes; its last tenth is not sampled.
`--json` prints the growth as one object.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from tempfile import TemporaryDirectory

import gymnasium as gym
import psutil

import sb3_stereo  # noqa: F401  (registers the environments)
from sb3_stereo.config.schema import DEFAULT_ENV, load_config
from sb3_stereo.evaluation.scores import read_scores
from sb3_stereo.runtime import set_threads, tune_allocator
from sb3_stereo.training import Options, train

N_SAMPLES = 10
N_ENVS = 2
SHORT = 5  # steps of an episode of the learner: a score is of 100 episodes, and there is one per tenth


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

    @property
    def taken(self) -> int:
        """Steps at the last sample."""
        return self.samples[-1].steps if self.samples else 0

    def __call__(self, steps: int) -> None:
        """Take a sample if it is time."""
        if steps - self.taken >= self.interval:
            self.take(steps)

    def take(self, steps: int) -> None:
        """Take a sample."""
        now = time.perf_counter()
        self.samples.append(sample(steps, now - self.before, steps - self.taken))
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


def soak_learner(n_steps: int, show: Callable[[str], None]) -> list[Sample]:
    """Train our DDPG with environments in processes, and sample after each score.

    From 200 steps on, the replay buffer is full, and a checkpoint of it saved, before the first sample: what grows then
    is a leak of the learner, the replay, a score or a checkpoint.
    """
    sampler = Sampler(n_steps, show)
    half = max(10, sampler.interval // 2)
    params = {"n_envs": N_ENVS, "buffer_size": half, "learning_starts": 10, "batch_size": 20}
    config = load_config("ddpg", DEFAULT_ENV, None, params, {"max_episode_steps": SHORT}, n_steps)
    with TemporaryDirectory() as logs:
        options = Options(
            seed=0,
            log_folder=logs,
            eval_freq=sampler.interval,
            n_eval_envs=N_ENVS,
            save_freq=half,
            device="cpu",
            vec_env="subproc",
            verbose=0,
        )
        train(config, options, on_evaluation=lambda run: sampler.take(max(read_scores(run))))
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
    for name in ("env_steps", "learner_steps"):
        if 0 < getattr(args, name) < 2 * N_SAMPLES:
            flag = f"--{name.replace('_', '-')}"
            parser.error(f"{flag} must be 0 or at least {2 * N_SAMPLES}, got {getattr(args, name)}")
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
