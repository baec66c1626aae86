"""How fast the environment and the learner are, against what one would use instead.

    python -m benchmarks.speed

times every candidate in every round of one run, prints the ratios of the medians, and writes `benchmarks/SPEED.md`
and `benchmarks/results/speed.json`. Candidates that are not installed (`pip install -e ".[peers]"`) are left out.
"""

import argparse
import itertools
import json
import os
import platform
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import gymnasium as gym
import pybullet

from benchmarks.cells import RESULTS
from benchmarks.timing import Candidate, Worker, medians, timed
from sb3_stereo.runs import versions

HERE = Path(__file__).parent
ENV_ID = "sb3_stereo:WamStereoReach-v0"
N_STEPS = 5  # per time, to even out resets


def stepping(env: gym.Env[Any, Any], look: Callable[[], object] = lambda: None) -> Callable[[], None]:
    """A call that takes `N_STEPS` random steps and looks after each."""
    env.action_space.seed(0)
    env.reset(seed=0)

    def steps() -> None:
        for _ in range(N_STEPS):
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            look()
            if terminated or truncated:
                env.reset()

    return steps


def ours(**kwargs: Any) -> Callable[[], None]:
    """Our environment, which looks twice by itself."""
    return stepping(gym.make(ENV_ID, **kwargs))


def resetting() -> Callable[[], None]:
    """A call that resets our environment into `N_STEPS` random poses."""
    env = gym.make(ENV_ID)
    seeds = itertools.count()

    def resets() -> None:
        for _ in range(N_STEPS):
            env.reset(seed=next(seeds))

    return resets


class Stopwatch:
    """Adds up the time inside some calls."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def of(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """The same call, watched."""

        def watched(*args: Any, **kwargs: Any) -> Any:
            start = time.perf_counter()
            result = call(*args, **kwargs)
            self.seconds += time.perf_counter() - start
            return result

        return watched


def bare() -> Candidate:
    """Our environment again, but only the time inside its simulation steps and its pictures."""
    env = gym.make(ENV_ID)
    inner: Any = env.unwrapped
    watch = Stopwatch()
    simulate = watch.of(pybullet.stepSimulation)
    for camera in inner.cameras:
        camera._draw = watch.of(camera._draw)
    steps = stepping(env)

    def candidate() -> float:
        watch.seconds = 0.0
        with patch.object(pybullet, "stepSimulation", simulate):
            steps()
        return watch.seconds

    return candidate


def panda_gym() -> Callable[[], None]:
    """panda-gym's reaching, with two views of our size."""
    import_module("panda_gym")  # registers

    env = gym.make("PandaReach-v3", render_mode="rgb_array", renderer="Tiny")
    sim: Any = env.unwrapped.sim  # type: ignore[attr-defined]
    return stepping(env, lambda: [sim.render(320, 240, yaw=yaw) for yaw in (45, -45)])


def fetch() -> Callable[[], None]:
    """gymnasium-robotics' reaching (MuJoCo, drawn without a display), with two views of our size."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    gym.register_envs(import_module("gymnasium_robotics"))
    env = gym.make("FetchReach-v4", render_mode="rgb_array", width=320, height=240)
    return stepping(env, lambda: [env.render() for _ in range(2)])


def env_candidates() -> dict[str, Candidate]:
    """Environments by name; peers only where they are installed and can draw."""
    candidates = {
        "ours": timed(ours()),
        "ours, with a floor": timed(ours(floor=True)),
        "ours, bare": bare(),
        "ours, a reset": timed(resetting()),
    }
    for name, make in (("panda-gym", panda_gym), ("FetchReach", fetch)):
        try:
            candidates[name] = timed(make())
            candidates[name]()
        except Exception as error:  # a peer fails in its own ways: not installed, no EGL, another MuJoCo
            candidates.pop(name, None)
            print(f"{name} is left out: {type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}")
    return candidates


def measure_envs(rounds: int) -> dict[str, float]:
    """Milliseconds per environment step."""
    return {name: 1000 * seconds / N_STEPS for name, seconds in medians(env_candidates(), rounds).items()}


def measure_scaling(rounds: int, n_steps: int = 40) -> dict[str, float]:
    """Environment steps per second in 1, 2 and 4 processes."""
    from stable_baselines3.common.vec_env import SubprocVecEnv

    rates, pools = {}, {n: SubprocVecEnv([lambda: gym.make(ENV_ID)] * n) for n in (1, 2, 4)}

    def walk(pool: SubprocVecEnv) -> None:
        for _ in range(n_steps):
            pool.step([pool.action_space.sample() for _ in range(pool.num_envs)])  # type: ignore[arg-type]

    for pool in pools.values():
        pool.reset()
    candidates: dict[str, Candidate] = {str(n): timed(lambda pool=pool: walk(pool)) for n, pool in pools.items()}  # type: ignore[misc]
    for name, seconds in medians(candidates, rounds).items():
        rates[name] = int(name) * n_steps / seconds
    for pool in pools.values():
        pool.close()
    return rates


def measure_updates(rounds: int, threads: int) -> dict[str, float]:
    """Milliseconds per gradient step of the same network."""
    from benchmarks.updates import N_STEPS as N_UPDATES

    names = [(algo, whose) for algo in ("ddpg", "dqn") for whose in ("ours", "sb3")]
    workers = {f"{algo}, {whose}": Worker("benchmarks.updates", algo, whose, str(threads)) for algo, whose in names}
    try:
        return {name: 1000 * seconds / N_UPDATES for name, seconds in medians(workers, rounds).items()}
    finally:
        for worker in workers.values():
            worker.close()


def ratios(envs: dict[str, float], rates: dict[str, float], updates: dict[str, float]) -> dict[str, float | None]:
    """The claims; None where a peer is missing."""

    def over(peer: str, own: str = "ours") -> float | None:
        return round(envs[peer] / envs[own], 2) if peer in envs else None

    return {
        "env_vs_panda_gym": over("panda-gym"),
        "env_with_floor_vs_panda_gym": over("panda-gym", "ours, with a floor"),
        "env_vs_fetch": over("FetchReach"),
        "env_scaling_2": round(rates["2"] / (2 * rates["1"]), 2),
        "env_scaling_4": round(rates["4"] / (4 * rates["1"]), 2),
        "ddpg_update_vs_sb3": round(updates["ddpg, sb3"] / updates["ddpg, ours"], 2),
        "dqn_update_vs_sb3": round(updates["dqn, sb3"] / updates["dqn, ours"], 2),
        "overhead_fraction": round(1 - envs["ours, bare"] / envs["ours"], 3),
        "step_vs_bare": round(envs["ours"] / envs["ours, bare"], 2),
    }


def report(result: dict[str, Any]) -> str:
    """`SPEED.md`."""
    lines = [
        "# Speed",
        "",
        "Written by `python -m benchmarks.speed`; do not edit. Medians of interleaved rounds in one run.",
        "",
    ]
    tables = (
        ("ratio", result["ratios"]),
        ("ms per environment step with two 320 x 240 views", result["ms_per_env_step"]),
        ("environment steps per second in so many processes", result["env_steps_per_second"]),
        (f"ms per gradient step, {result['threads']} thread(s)", result["ms_per_update"]),
    )
    for title, values in tables:
        lines += [f"| {title} | |", "| --- | --- |"]
        lines += [f"| {name} | {'–' if value is None else f'{value:.4g}'} |" for name, value in values.items()] + [""]
    return "\n".join([*lines, f"On {result['machine']}; {result['versions']}.", ""])


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description="Ratios against the alternatives.")
    parser.add_argument("--json", action="store_true", help="print one object with the ratios")
    parser.add_argument("--quick", action="store_true", help="few rounds, and nothing is written")
    parser.add_argument("--threads", type=int, default=1, help="of a gradient step (default: 1)")
    args = parser.parse_args(argv)
    rounds = 3 if args.quick else 21
    envs, rates = measure_envs(rounds), measure_scaling(max(rounds // 3, 1))
    updates = measure_updates(rounds, args.threads)
    result = {
        "ratios": ratios(envs, rates, updates),
        "ms_per_env_step": envs,
        "env_steps_per_second": rates,
        "ms_per_update": updates,
        "threads": args.threads,
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, {platform.system()}",
        "versions": ", ".join(f"{name} {found}" for name, found in versions().items()),
    }
    if not args.quick:
        (RESULTS / "speed.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        (HERE / "SPEED.md").write_text(report(result), encoding="utf-8")
    print(json.dumps(result["ratios"]) if args.json else report(result))


if __name__ == "__main__":
    main()
