"""Environments side by side, ours by parts, and ours in several processes, for `benchmarks.speed`.

    python -m benchmarks.speed.environments

steps our environment once per "step" on standard input and tells the process's "memory".
"""

import itertools
import os
import sys
from collections.abc import Callable
from contextlib import ExitStack
from importlib import import_module
from typing import Any
from unittest.mock import patch

import gymnasium as gym

from benchmarks.speed.timing import Candidate, Parts, Worker, medians, on_one_core, peak_memory, serve, timed
from sb3_stereo.envs.bullet import pybullet

ENV_ID = "sb3_stereo:WamStereoReach-v0"
N_STEPS = 10  # per time, to even out resets and what the candidate before left in the caches


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


def step_parts() -> dict[str, Candidate]:
    """Our environment again, with a stopwatch at each part of a step."""
    env = gym.make(ENV_ID)
    inner: Any = env.unwrapped
    parts = Parts()
    watched = [
        patch.object(owner, name, parts.watch(part, getattr(owner, name)))
        for part, owner, name in (
            ("simulation", inner.arm, "step"),
            ("efforts", pybullet, "setJointMotorControlArray"),
            ("blobs", inner._world.rig, "find"),
        )
    ]
    for camera in inner.cameras:
        camera.draw = parts.watch(f"{camera.spec.name} view", camera.draw)
    inner.composite = parts.watch("composite", inner.composite)
    steps = stepping(env)

    def watched_steps() -> None:
        with ExitStack() as stack:  # only meanwhile: other environments of this process use the same functions
            for patched in watched:
                stack.enter_context(patched)
            steps()

    return parts.candidates(watched_steps)


def bare(parts: dict[str, float]) -> float:
    """What simulating and drawing alone take of a step."""
    return sum(value for name, value in parts.items() if name == "simulation" or name.endswith(" view"))


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
        "ours, a reset": timed(resetting()),
    }
    for name, make in (("panda-gym", panda_gym), ("FetchReach", fetch)):
        try:
            candidates[name] = timed(make())
            candidates[name]()
        except Exception as error:  # a peer fails in its own ways: not installed, no EGL, another MuJoCo
            candidates.pop(name, None)
            reason = f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"
            print(f"{name} is left out: {reason}", file=sys.stderr)
    return candidates


def measure_envs(rounds: int) -> tuple[dict[str, float], dict[str, float]]:
    """Milliseconds per step of every environment on one core, and of the parts of ours."""
    with on_one_core():  # a software OpenGL draws on all cores that it finds
        envs, parts = env_candidates(), step_parts()
        found = {name: 1000 * seconds / N_STEPS for name, seconds in medians({**envs, **parts}, rounds).items()}
    taken = {name: found[name] for name in parts}
    return {name: found[name] for name in envs} | {"ours, bare": bare(taken)}, taken


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


def measure_memory(n_times: int = 20) -> float:
    """Peak of a process that steps our environment, in [MiB]."""
    with Worker("benchmarks.speed.environments") as worker:
        for _ in range(n_times):
            worker.ask("step")
        return worker.ask("memory")


if __name__ == "__main__":
    serve({"step": timed(ours()), "memory": peak_memory})
