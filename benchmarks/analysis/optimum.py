"""The smallest number of steps to success: an oracle planner, from the 100 test poses.

    python -m benchmarks.analysis.optimum

searches, for one control step, then two, then more, for joint torques that end in success (cross-entropy method), runs
them in the environment, and writes `benchmarks/results/optimum.csv`. A search can miss a shorter solution, so the mean
is an upper bound of the optimum; do not expect an agent below it.
"""

import argparse
import csv
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks import RESULTS
from benchmarks.analysis.rollouts import BlindSimulation, Floats
from sb3_stereo.evaluation.protocol import InitialState, eval_initial_states
from sb3_stereo.runtime import available_cores

ENV_ID = "WamStereoReach-v0"
MAX_STEPS = 5
N_SAMPLES, N_ELITE, N_ITERATIONS, N_RESTARTS = 64, 8, 8, 3


class Planner:
    """Cross-entropy search over sequences of efforts, by simulating them without drawing.

    Args:
        env_id: Of a `StereoReachEnv`.
        env_kwargs: Of the environment.
    """

    def __init__(self, env_id: str, env_kwargs: Mapping[str, Any]) -> None:
        self.env: Any = gym.make(f"sb3_stereo:{env_id}", **env_kwargs).unwrapped
        self.blind = BlindSimulation(self.env)

    def fewest_steps(self, start_of_episode: InitialState, rng: np.random.Generator) -> int:
        """Steps of the shortest plan found that reaches from a start; `MAX_STEPS + 1` if none does."""
        self.env.reset(**start_of_episode)
        start = self.env.save_state()
        try:
            for n_steps in range(1, MAX_STEPS + 1):
                if any(self._search(start, n_steps, rng) for _ in range(N_RESTARTS)):
                    return n_steps
            return MAX_STEPS + 1
        finally:
            self.env.remove_state(start)

    def _search(self, start: Any, n_steps: int, rng: np.random.Generator) -> bool:
        """Whether a plan (n_steps, n_joints) was found that reaches when it is played."""
        shape = (n_steps, *self.env.action_space.shape)
        mean, spread = rng.uniform(-0.5, 0.5, shape), np.ones(shape)
        for _ in range(N_ITERATIONS):
            plans = np.clip(mean + spread * rng.standard_normal((N_SAMPLES, *shape)), -1, 1)
            distances = np.array([self._distance_after(start, plan) for plan in plans])
            order = np.argsort(distances)
            for best in order[:3]:
                if distances[best] <= self.env.rho and self._reaches(start, plans[best]):
                    return True
            elite = plans[order[:N_ELITE]]
            mean, spread = elite.mean(0), elite.std(0) + 0.02
        return False

    def _distance_after(self, start: Any, plan: Floats) -> float:
        """Mean distance of the projected markers after a plan, in the success frame's [px], whatever hides them."""
        self.env.restore_state(start)
        for action in plan:
            self.blind.push(action)
        return self.blind.distance(start.target_position)

    def _reaches(self, start: Any, plan: Floats) -> bool:
        self.env.restore_state(start)
        return any(self.env.step(action)[2] for action in plan)


def plan_all(
    env_id: str, env_kwargs: Mapping[str, Any], initial_states: Sequence[InitialState], n_workers: int
) -> list[int]:
    """Fewest steps found from each start, every one with its own seed."""
    with ProcessPoolExecutor(n_workers, initializer=_make_planner, initargs=(env_id, env_kwargs)) as pool:
        return list(pool.map(_plan_one, range(len(initial_states)), initial_states))


_planner: Planner  # one per process: making an environment takes longer than many plans


def _make_planner(env_id: str, env_kwargs: Mapping[str, Any]) -> None:
    global _planner
    _planner = Planner(env_id, env_kwargs)


def _plan_one(seed: int, start: InitialState) -> int:
    return _planner.fewest_steps(start, np.random.default_rng(seed))


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.analysis.optimum", description="The fewest steps that reach."
    )
    parser.add_argument("--poses", type=int, default=100, help="how many of the test poses (default: all 100)")
    parser.add_argument("--workers", type=int, default=available_cores())
    args = parser.parse_args(argv)
    steps = plan_all(ENV_ID, {}, eval_initial_states(ENV_ID)[: args.poses], args.workers)
    reached = np.mean(np.array(steps) <= MAX_STEPS)
    print(f"{reached:.0%} reached, {np.mean(steps):.2f} steps on average, counts from 0: {np.bincount(steps)}")
    if args.poses == 100:
        with (RESULTS / "optimum.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerows([("pose", "steps"), *enumerate(steps)])


if __name__ == "__main__":
    main()
