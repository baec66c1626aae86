"""Picking without learning, and reaching with seven joints: what random actions and scripted policies score.

    python -m benchmarks.analysis.picking_baselines

scores every case of `CASES` that has no record yet, from the initial states that agents are scored from, and prints the
table of docs/pick.md from the record, `benchmarks/results/picking.csv`.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
from scipy.stats import binomtest

import benchmarks
from benchmarks.analysis.baselines import Line, read_lines, write_lines
from benchmarks.analysis.jacobian import JacobianController
from benchmarks.analysis.picking import ScriptedPicker
from benchmarks.analysis.rollouts import Policy, play, random_actions
from sb3_stereo.console import print_line
from sb3_stereo.evaluation.protocol import eval_initial_states
from sb3_stereo.runs.creation import versions

PICK = "WamStereoPick-v0"
POLICIES: dict[str, Callable[[Any], Policy]] = {
    "random": lambda env: random_actions(env, seed=0),
    "scripted": lambda env: ScriptedPicker(env.unwrapped),
    "Jacobian controller": lambda env: JacobianController(env.unwrapped),
}


@dataclass(frozen=True)
class Case:
    """A line of the table.

    Attributes:
        task: How the table calls it.
        policy: Of `POLICIES`.
        env_id: Registered with Gymnasium.
        env_kwargs: Of the environment.
    """

    task: str
    policy: str
    env_id: str = PICK
    env_kwargs: Mapping[str, Any] = field(default_factory=dict, hash=False)


CASES = (
    Case("lift", "random"),
    Case("lift", "scripted"),
    Case("lift, 4 distractors", "scripted", env_kwargs={"n_distractors": 4}),
    Case("lift, all 7 joints", "scripted", env_kwargs={"n_joints": 7}),
    Case("phase reach", "random", env_kwargs={"phase": "reach"}),
    Case("phase grasp", "random", env_kwargs={"phase": "grasp"}),
    Case("phase grasp", "scripted", env_kwargs={"phase": "grasp"}),
    Case("reach, v1, 7 joints", "random", "WamStereoReach-v1", {"n_joints": 7}),
    Case("reach, v1, 7 joints", "Jacobian controller", "WamStereoReach-v1", {"n_joints": 7}),
)
RECORD = benchmarks.RESULTS / "picking.csv"


def score(case: Case) -> Line:
    """Play a case's episodes; a line of the record."""
    with closing(gym.make(f"sb3_stereo:{case.env_id}", **case.env_kwargs)) as env:
        found = play(env, eval_initial_states(case.env_id, case.env_kwargs), POLICIES[case.policy](env))
    return {
        "task": case.task,
        "policy": case.policy,
        "n_successes": str(int(found.success.sum())),
        "n_episodes": str(found.n_poses),
        "mean_steps_success": f"{found.mean_steps_success:.4g}",
        "max_steps_success": str(max(found.steps[found.success], default="")),
        "versions": ", ".join(f"{name} {version}" for name, version in versions().items()),
    }


def table(lines: Sequence[Line]) -> str:
    """The record in Markdown."""
    rows = ["| task | policy | success | 95 % interval | steps per success |", "|---|---|---|---|---|"]
    for line in lines:
        n, total = int(line["n_successes"]), int(line["n_episodes"])
        low, high = binomtest(n, total).proportion_ci(method="wilson")
        steps = f"{line['mean_steps_success']} (at most {line['max_steps_success']})" if n else "–"
        rows.append(
            f"| {line['task']} | {line['policy']} | {n} of {total} | {100 * low:.0f} to {100 * high:.0f} % | {steps} |"
        )
    return "\n".join(rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    prog = "python -m benchmarks.analysis.picking_baselines"
    argparse.ArgumentParser(prog=prog, description=__doc__.splitlines()[0]).parse_args(argv)
    for case in CASES:
        lines = read_lines(RECORD)
        if (case.task, case.policy) not in {(line["task"], line["policy"]) for line in lines}:
            write_lines(RECORD, [*lines, score(case)])
            print_line(f"{case.task}, {case.policy}: recorded")
    print(table(read_lines(RECORD)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
