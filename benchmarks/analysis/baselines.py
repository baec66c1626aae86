"""Baselines without learning, from the same test initial states as the agents.

    python -m benchmarks.analysis.baselines

scores random actions, the best constant action and a planner on every task of `TASKS` that has no record of them yet,
and measures how near in space a goal is. `benchmarks.tables.report` and `benchmarks.tables.claims` show the records,
`benchmarks/results/baselines_NAME.csv`.
"""

import argparse
import csv
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import benchmarks
from benchmarks.analysis.constant import any_constant, best_constant
from benchmarks.analysis.jacobian import JacobianController
from benchmarks.analysis.optimum import MAX_STEPS, plan_all
from benchmarks.analysis.rollouts import BlindSimulation, Floats, constant_action, episode_cap, play, random_actions
from benchmarks.tables.cells import read
from sb3_stereo.config.schema import Config
from sb3_stereo.console import print_line
from sb3_stereo.envs.specs import plain
from sb3_stereo.evaluation.protocol import (
    Evaluation,
    InitialState,
    eval_initial_states,
    nan_mean,
    random_initial_states,
    summarise,
)
from sb3_stereo.runs.creation import versions
from sb3_stereo.runs.files import replacing
from sb3_stereo.runtime import available_cores

N_RANDOM = 3  # policies of random actions, whose scores are averaged
# A constant action is chosen on these initial states; those on which other arms are evaluated have seed 0.
N_CHOICE, CHOICE_SEED = 50, 1
N_GOAL_POSES = 200_000
NEAR = 5.0  # [cm], the threshold of panda-gym and of Fetch
SCORES = (
    *("success_rate", "mean_steps_success", "mean_steps_capped"),
    *("median_distance_success", "p95_distance_success", "within_5cm"),
)


@dataclass(frozen=True)
class Task:
    """An environment as its agents know it.

    Attributes:
        name: Of the record.
        label: How the tables call it.
        env_id: Registered with Gymnasium.
        env_kwargs: Of the environment.
    """

    name: str
    label: str
    env_id: str = "WamStereoReach-v0"
    env_kwargs: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def make(self) -> gym.Env[Any, Any]:
        """Make the environment."""
        return gym.make(f"sb3_stereo:{self.env_id}", **self.env_kwargs)

    def eval_initial_states(self) -> list[InitialState]:
        """The initial states that its agents are scored from."""
        return eval_initial_states(self.env_id, self.env_kwargs)

    @property
    def record(self) -> Path:
        """The file with a line per baseline."""
        return benchmarks.RESULTS / f"baselines_{self.name}.csv"


STRICT = Task("strict", "fixed target, the default")
TASKS = (
    STRICT,
    Task("observation", "ρ in the observation's pixels", env_kwargs={"success_frame": "observation"}),
    Task(
        "long_pulses",
        "pulses of 1.5 s and another target",
        env_kwargs={"pulse_duration": 1.5, "target_position": (0.634, 0.421, 0.227)},
    ),
    Task(
        "observation_close",
        "ρ in the observation's pixels, close framing",
        env_kwargs={"success_frame": "observation", "framing": "close"},
    ),
    Task("random", "randomised targets", "WamStereoReachRandom-v0"),
    Task("kuka", "fixed target, the Kuka", "KukaStereoReach-v0"),
    Task("panda", "fixed target, the Panda", "PandaStereoReach-v0"),
    Task("v1", "fixed target, v1", "WamStereoReach-v1"),
    Task("v1_random", "randomised targets, v1", "WamStereoReachRandom-v1"),
    Task("v1_kuka", "fixed target, the Kuka, v1", "KukaStereoReach-v1"),
    Task("v1_panda", "fixed target, the Panda, v1", "PandaStereoReach-v1"),
)


def task_of(config: Config) -> Task | None:
    """The task that a configuration learns, if it is one of `TASKS`, however it is shown to the agent."""

    def known(env_id: str, env_kwargs: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
        return env_id, {name: plain(value) for name, value in env_kwargs.items() if name != "composite"}

    of_config = known(config.env_id, config.env_kwargs)
    return next((task for task in TASKS if known(task.env_id, task.env_kwargs) == of_config), None)


Line = dict[str, str]


def line(kind: str, baseline: str, scores: Sequence[Evaluation], action: Iterable[float] = ()) -> Line:
    """A line of a record.

    Args:
        kind: A key of `BASELINES`.
        baseline: How the tables call it.
        scores: Of which the means are recorded; episode lengths over those with a success.
        action: If it is always the same.
    """
    means = {name: nan_mean([getattr(score, name) for score in scores]) for name in SCORES}
    return {
        "kind": kind,
        "baseline": baseline,
        **{name: f"{mean:.6g}" for name, mean in means.items()},
        "n_poses": str(scores[0].n_poses),
        "action": " ".join(f"{value:.4g}" for value in action),
        "versions": ", ".join(f"{name} {found}" for name, found in versions().items()),
    }


def score_random(task: Task, n_workers: int) -> list[Line]:
    """Random actions, the mean over some seeds."""
    with closing(task.make()) as env:
        scores = [play(env, task.eval_initial_states(), random_actions(env, seed)) for seed in range(N_RANDOM)]
    return [line("random", "random actions", scores)]


def score_constant(task: Task, n_workers: int) -> list[Line]:
    """The best constant action, of those of a DQN and of all."""
    with closing(task.make()) as env:
        chosen = best_constant(env, random_initial_states(N_CHOICE, CHOICE_SEED))
        scores = [play(env, task.eval_initial_states(), constant_action(action)) for action in chosen]
    names = "best constant action of DQN's 81", "best constant action"
    return [line("constant", name, [score], action) for name, score, action in zip(names, scores, chosen, strict=True)]


def score_any_constant(task: Task, n_workers: int) -> list[Line]:
    """Each constant action of a DQN's, on average: what a network that ignores the image reaches by chance."""
    with closing(task.make()) as env:
        cap = episode_cap(env)
        every = any_constant(env, task.eval_initial_states())  # (n_actions, n_starts)
    unknown = np.full(every.shape[1], np.nan)
    scores = [summarise(steps < cap, steps, unknown, unknown, cap) for steps in every]
    return [line("any constant", "some constant action of DQN's 81", scores)]


def score_jacobian(task: Task, n_workers: int) -> list[Line]:
    """The controller of `benchmarks.analysis.jacobian`."""
    with closing(task.make()) as env:
        score = play(env, task.eval_initial_states(), JacobianController(env.unwrapped))
    return [line("jacobian", "Jacobian controller that knows the state", [score])]


def score_planner(task: Task, n_workers: int) -> list[Line]:
    """The planner of `benchmarks.analysis.optimum`."""
    with closing(task.make()) as env:
        cap = episode_cap(env)
    steps = np.array(plan_all(task.env_id, task.env_kwargs, task.eval_initial_states(), n_workers))
    unknown = np.full(len(steps), np.nan)
    score = summarise(steps <= MAX_STEPS, steps, unknown, unknown, cap)
    return [line("planner", "planner that knows the simulator", [score])]


BASELINES: dict[str, Callable[[Task, int], list[Line]]] = {
    "random": score_random,
    "any constant": score_any_constant,
    "constant": score_constant,
    "jacobian": score_jacobian,
    "planner": score_planner,
}


def read_lines(record: Path) -> list[Line]:
    """The lines of a record as they were written; none if there is no record."""
    return read(record, key=())


def write_lines(record: Path, lines: Sequence[Line]) -> None:
    """Write a record anew, in one step."""
    record.parent.mkdir(parents=True, exist_ok=True)
    with replacing(record) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        columns = dict.fromkeys(column for known in lines for column in known)  # older lines have fewer
        writer = csv.DictWriter(file, fieldnames=list(columns), restval="nan", lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)


def measure(task: Task, kinds: Iterable[str], n_workers: int) -> None:
    """Score the baselines that the task's record lacks, and record each at once."""
    for kind in kinds:
        lines = read_lines(task.record)
        if kind not in {known["kind"] for known in lines}:
            lines += BASELINES[kind](task, n_workers)
            lines.sort(key=lambda known: list(BASELINES).index(known["kind"]))
            write_lines(task.record, lines)
            print_line(f"{task.label}, {kind}: recorded")


def goal_distances(env: Any, targets: Floats, n_poses: int, seed: int = 0) -> Floats:
    """How far from the target, in [m], the end effector is in space at the goals among random poses.

    Poses are uniform within the joint limits; markers are where they project to, whatever hides them.

    Args:
        env: A `StereoReachEnv` that was reset.
        targets: Positions, shape (n_targets, 3), in [m], world.
        n_poses: How many poses are drawn.
        seed: Of the poses.
    """
    positions, (low, high) = np.empty((n_poses, 3)), env.arm.limits.T
    poses = np.random.default_rng(seed).uniform(low, high, (n_poses, len(low)))
    for position, pose in zip(positions, poses, strict=True):
        env.arm.rest_at(pose)
        position[:] = env.arm.end_effector_position
    blind = BlindSimulation(env)
    goals = [positions[blind.distances(positions, target) <= env.rho] - target for target in targets]
    return np.asarray(np.linalg.norm(np.concatenate(goals), axis=1))


def measure_goal(task: Task) -> None:
    """Record how near in space a goal is, if it is not recorded."""
    lines = read_lines(goal_record())
    if task.name in {known["task"] for known in lines}:
        return
    with closing(task.make()) as env:
        targets = np.unique([env.reset(**start)[1]["target_position"] for start in task.eval_initial_states()], axis=0)
        far = 100 * goal_distances(env.unwrapped, targets, N_GOAL_POSES)
    median, most = np.quantile(far, [0.5, 0.95])
    within = np.mean(far <= NEAR)
    measured = {"median_cm": f"{median:.4g}", "quantile_95_cm": f"{most:.4g}", "within_5_cm": f"{within:.4g}"}
    write_lines(goal_record(), [*lines, {"task": task.name, **measured, "n_goals": str(len(far))}])
    print_line(f"{task.label}: a goal is a median of {median:.1f} cm from the target")


def goal_record() -> Path:
    """The file with a line per task."""
    return benchmarks.RESULTS / "goals_in_space.csv"


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.analysis.baselines", description=__doc__.splitlines()[0]
    )
    names = [task.name for task in TASKS]
    parser.add_argument("--tasks", nargs="+", default=names, choices=names, metavar="NAME", help=", ".join(names))
    kinds = list(BASELINES)
    parser.add_argument("--kinds", nargs="*", default=kinds, choices=kinds, metavar="KIND", help=", ".join(kinds))
    parser.add_argument("--workers", type=int, default=available_cores(), help="processes that plan")
    args = parser.parse_args(argv)
    for task in (task for task in TASKS if task.name in args.tasks):
        measure_goal(task)
        measure(task, args.kinds, args.workers)
    return 0


if __name__ == "__main__":
    sys.exit(main())
