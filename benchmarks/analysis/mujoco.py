"""Agents that were trained in Bullet, played in MuJoCo; and how far the two simulators agree.

    python -m benchmarks.analysis.mujoco RUN --name NAME

plays the run's final model from the test poses in both simulators, undisturbed and with the default randomisation, and
records the scores in `benchmarks/results/mujoco.csv`; without RUN it measures the simulators against each other and
records that in `benchmarks/results/mujoco_agreement.csv`. Either way it prints the tables of docs/robustness.md.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import benchmarks
from benchmarks.analysis.baselines import Line, read_lines, write_lines
from benchmarks.tables.row_tables import line_of
from sb3_stereo.building.factory import make_env
from sb3_stereo.commands.flags import Parser, run_command
from sb3_stereo.console import print_line
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.robots import WAM, ArmSpec
from sb3_stereo.envs.simulators import SIMULATORS
from sb3_stereo.errors import ConfigError
from sb3_stereo.evaluation.protocol import eval_initial_states, evaluate
from sb3_stereo.runs.directory import load_record, model_path
from sb3_stereo.runs.models import load_model

Floats = NDArray[np.float64]

LABELS = {
    "pretrained": "the agent that ships with the package",
    "v1_ours_ddpg": "ours, clean images",
    "v1_robust_ddpg": "ours, augmented images",
    "v1_mujoco_ddpg": "ours, trained in MuJoCo (4 000 steps)",
}
NAMES = {"bullet": "Bullet", "mujoco": "MuJoCo"}
WORLDS: dict[str, dict[str, str]] = {"undisturbed": {}, "randomised": {"randomize": "default"}}
N_POSES, N_FRAMES = 200, 40
N_RANDOMISED = 25  # of the test poses, in randomised worlds, where a frame takes several times as long
FAR_FROM_STOPS = 0.4  # [rad], of poses whose pulses are compared in space without contacts


def scores_record() -> Path:
    """The file with a line per agent, simulator and world."""
    return benchmarks.RESULTS / "mujoco.csv"


def agreement_record() -> Path:
    """The file with a line per quantity."""
    return benchmarks.RESULTS / "mujoco_agreement.csv"


# ---------------------------------------------------------------------------------------------------- agents
def score_run(run: Path, name: str) -> list[Line]:
    """Score a run's final model in both simulators."""
    config, arguments = load_record(run)
    model = load_model(config, model_path(run, config.env_id))
    states = eval_initial_states(config.env_id, config.env_kwargs)
    lines = []
    for simulator in SIMULATORS:
        for world, kwargs in WORLDS.items():
            env_kwargs = {**config.env_kwargs, **kwargs, "simulator": simulator}
            played = states[:N_RANDOMISED] if kwargs else states
            result = evaluate(model, make_env(config.env_id, env_kwargs, config.env_wrapper), played)
            line = {
                "row": name,
                "seed": arguments["seed"],
                "simulator": simulator,
                "world": world,
                "n_poses": len(played),
            }
            numbers = (result.success_rate, result.mean_steps_capped, result.median_distance_success)
            keys = ("success_rate", "mean_steps_capped", "median_distance_success")
            lines.append(line | {key: f"{number:.6g}" for key, number in zip(keys, numbers)})
    return [{key: str(value) for key, value in line.items()} for line in lines]


def add_lines(lines: Sequence[Line]) -> None:
    """Put an agent's lines into the record, in place of those of an earlier scoring."""
    agent = lines[0]["row"], lines[0]["seed"]
    others = [line for line in read_lines(scores_record()) if (line["row"], line["seed"]) != agent]
    order = list(LABELS)
    key = lambda line: (order.index(line["row"]), int(line["seed"]))  # noqa: E731
    write_lines(scores_record(), sorted([*others, *lines], key=key))


def scores_table(lines: Sequence[Line]) -> list[str]:
    """A row per agent with the mean over its seeds, a column per world and simulator."""
    columns = [(world, simulator) for world in WORLDS for simulator in SIMULATORS]
    head = ["agent, seeds", *(f"{world}, {NAMES[simulator]}" for world, simulator in columns)]
    rows = []
    for name in dict.fromkeys(line["row"] for line in lines):
        own = [line for line in lines if line["row"] == name]
        cells = []
        for world, simulator in columns:
            those = [line for line in own if (line["world"], line["simulator"]) == (world, simulator)]
            success, steps = (
                np.mean([float(line[k]) for line in those]) for k in ("success_rate", "mean_steps_capped")
            )
            cells.append(f"{100 * success:.0f} % in {steps:.1f}")
        rows.append([f"{LABELS[name]}, {len({line['seed'] for line in own})}", *cells])
    return [line_of(row) for row in (head, ["---"] * len(head), *rows)]


# ---------------------------------------------------------------------------------------------------- simulators
def agreement() -> list[Line]:
    """How far the simulators agree on the WAM in v1, and what they cost."""
    with _twins(WAM) as (bullet, mujoco):
        lines = [
            *_summary("distance between the end effectors at the same joint angles", "mm", _kinematics(bullet, mujoco)),
            *_summary("difference of the joints' motion in a random control step", "%", _motion(bullet, mujoco)),
        ]
        views = _views(bullet, mujoco)
        costs = [line for name, env in zip(SIMULATORS, (bullet, mujoco), strict=True) for line in _cost(name, env)]
    with _twins(replace(WAM, drive_inertia=())) as (bullet, mujoco):
        lines += _summary("the same without the drives' inertia", "%", _motion(bullet, mujoco))
    return [*lines, *views, *costs]


@contextmanager
def _twins(arm: ArmSpec) -> Iterator[tuple[StereoReachEnv, StereoReachEnv]]:
    """The task of an arm in Bullet, and in MuJoCo."""
    made: list[Any] = [
        gym.make(env_id, arm=arm).unwrapped for env_id in ("WamStereoReach-v1", "WamStereoReachMujoco-v0")
    ]
    try:
        for env in made:
            env.reset(seed=0)
        yield made[0], made[1]
    finally:
        for env in made:
            env.close()


def _summary(quantity: str, unit: str, values: Iterable[float]) -> list[Line]:
    numbers = np.array(list(values))
    parts = {"median": np.median(numbers), "95 % are below": np.quantile(numbers, 0.95), "largest": numbers.max()}
    return [_line(quantity, what, f"{value:.3g}", unit) for what, value in parts.items()]


def _line(quantity: str, what: str, value: str, unit: str) -> Line:
    return {"quantity": quantity, "what": what, "value": value, "unit": unit}


def _poses(env: StereoReachEnv, rng: np.random.Generator, margin: float = 0.0) -> Iterable[Floats]:
    """Random poses that are free in this world."""
    low, high = env.arm.limits.T
    n_found = 0
    while n_found < N_POSES:
        pose = rng.uniform(low + margin, high - margin)
        if env._world.place_arm(pose):
            n_found += 1
            yield pose


def _kinematics(bullet: StereoReachEnv, mujoco: StereoReachEnv) -> Iterable[float]:
    for pose in _poses(bullet, np.random.default_rng(0)):
        mujoco.arm.rest_at(pose)
        yield 1000 * float(np.linalg.norm(bullet.arm.end_effector_position - mujoco.arm.end_effector_position))


def _motion(bullet: StereoReachEnv, mujoco: StereoReachEnv) -> Iterable[float]:
    """Distance of the joints after one control step, over the distance that they went; nothing touches in Bullet."""
    rng = np.random.default_rng(0)
    for pose in _poses(bullet, rng, margin=FAR_FROM_STOPS):
        efforts = (0.3 * rng.uniform(-1.0, 1.0, len(pose)) * bullet.effort_limits).tolist()
        mujoco._world.place_arm(pose)
        bullet.arm.push(efforts, bullet.n_pulse_steps)
        mujoco.arm.push(efforts, mujoco.n_pulse_steps)
        if not bullet.arm.collides():
            went, other = (env.arm.actuated_positions - pose for env in (bullet, mujoco))
            yield 100 * float(np.linalg.norm(went - other) / np.linalg.norm(went))


def _views(bullet: StereoReachEnv, mujoco: StereoReachEnv) -> list[Line]:
    apart, luminance = [], []
    for seed in range(N_FRAMES):
        observation, info = bullet.reset(seed=seed)
        other, others_info = mujoco.reset(options={"joint_positions": bullet.arm.actuated_positions})
        apart += np.linalg.norm(info["pixel_offsets"] - others_info["pixel_offsets"], axis=-1).tolist()
        arm = np.minimum(observation, other) < 250
        luminance.append(float(np.abs(observation.astype(np.int16) - other)[arm].mean()))
    seen = [distance for distance in apart if not np.isnan(distance)]
    return [
        *_summary("difference of the offset between the markers", "px", seen),
        *_summary("mean difference of luminance on the arm and the markers", "of 255", luminance),
    ]


def _cost(simulator: str, env: StereoReachEnv) -> list[Line]:
    """Processor time, of all threads."""
    actions = np.random.default_rng(0).uniform(-1, 1, (N_FRAMES, 4))
    n_pulses = env.n_pulse_steps
    parts: dict[str, Callable[[Any], object]] = {
        "an environment step": env.step,
        "its simulation": lambda action: env.arm.push((action * env.effort_limits).tolist(), n_pulses),
        "its two frames": lambda action: env.draw(),
    }
    lines = []
    for part, work in parts.items():
        env.reset(seed=0)
        times = []
        for action in actions:
            start = time.process_time()
            work(action)
            times.append(1000 * (time.process_time() - start))
        lines.append(_line(f"processor time of {part}", NAMES[simulator], f"{np.median(times):.3g}", "ms"))
    return lines


def agreement_table(lines: Sequence[Line]) -> list[str]:
    """A row per quantity."""
    quantities = dict.fromkeys((line["quantity"], line["unit"]) for line in lines)
    rows = [["quantity", "", "unit"], ["---"] * 3]
    for quantity, unit in quantities:
        values = ", ".join(f"{line['what']} {line['value']}" for line in lines if line["quantity"] == quantity)
        rows.append([quantity, values, unit])
    return [line_of(row) for row in rows]


def mujoco_command(args: argparse.Namespace) -> int:
    """Score a run if one is given, else compare the simulators; print what is recorded."""
    if args.run is None:
        write_lines(agreement_record(), agreement())
    elif args.name not in LABELS:
        raise ConfigError(f"unknown name {args.name!r}; the table's agents are {', '.join(LABELS)}")
    else:
        add_lines(score_run(Path(args.run), args.name))
    for line in (*scores_table(read_lines(scores_record())), "", *agreement_table(read_lines(agreement_record()))):
        print_line(line)
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = Parser(prog="python -m benchmarks.analysis.mujoco", description=__doc__.splitlines()[0])
    parser.add_argument("run", nargs="?", metavar="RUN", help="the run's directory")
    parser.add_argument("--name", help=f"what it is a run of: {', '.join(LABELS)}")
    return run_command(mujoco_command, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
