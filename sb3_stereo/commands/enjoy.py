"""Run a trained agent: `python enjoy.py --algo ddpg`, or `sb3-stereo enjoy --algo ddpg`."""

import argparse
import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sb3_stereo import runtime
from sb3_stereo.commands.flags import (
    Parser,
    add_model_flags,
    add_process_flags,
    add_run_flags,
    at_least,
    check_device,
    check_display,
    file,
    run_command,
)
from sb3_stereo.console import command_line
from sb3_stereo.errors import ConfigError, setting_up

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

DEFAULT_TIMESTEPS, DEFAULT_FILM_EPISODES = 1000, 5
MAX_ZOOM = 20


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line; the flags are the zoo's."""
    parser = Parser(prog=command_line("enjoy"), description="Run a trained agent and report its success rate.")
    add_run_flags(parser)
    add_model_flags(parser)
    parser.add_argument(
        "-n", "--n-timesteps", type=at_least(1), help=f"environment steps (default: {DEFAULT_TIMESTEPS})"
    )
    parser.add_argument(
        "--n-episodes", type=at_least(1), help=f"episodes (default: {DEFAULT_FILM_EPISODES} with --video)"
    )
    parser.add_argument(
        "--pretrained", action="store_true", help="the agent that ships with the package (default: if there is no run)"
    )
    parser.add_argument("--exp-id", type=at_least(0), default=0, help="number of the run (default: 0, the latest)")
    window = parser.add_mutually_exclusive_group()
    window.add_argument("--no-render", action="store_true", help="do not open a window")
    window.add_argument("--gui", action="store_true", help="open Bullet's window (the default without --video)")
    parser.add_argument("--video", type=file, metavar="FILE", help="record a video, .mp4 or .gif")
    parser.add_argument("--zoom", type=zoom, default=1.0, help="magnify the centre of the views (default: 1)")
    parser.add_argument("--stochastic", action="store_true", help="stochastic actions")
    parser.add_argument("--seed", type=at_least(0), default=0, help="random seed of the initial states (default: 0)")
    parser.add_argument("--env-kwargs", nargs="+", metavar="KEY:VALUE", help="arguments of the environment")
    add_process_flags(parser)
    return parser


def zoom(text: str) -> float:
    """argparse's type for a factor by which the middle of the views is shown larger."""
    try:
        factor = float(text)
    except ValueError:
        factor = math.nan
    if not 1.0 <= factor <= MAX_ZOOM:
        raise argparse.ArgumentTypeError(f"{text!r} is no number from 1 to {MAX_ZOOM}")
    return factor


def play(
    model: "BaseAlgorithm",
    env: Any,
    n_timesteps: float,
    seed: int,
    deterministic: bool = True,
    n_episodes: float = math.inf,
) -> list[tuple[bool, int]]:
    """Play, and return success and length of the episodes that ended.

    Args:
        model: The agent.
        env: A Gymnasium environment.
        n_timesteps: Environment steps.
        seed: Of the first reset.
        deterministic: False explores.
        n_episodes: Ends the play too, if it comes earlier.
    """
    episodes: list[tuple[bool, int]] = []
    played = steps = 0
    observation, _ = env.reset(seed=seed)
    while played < n_timesteps:
        action, _ = model.predict(observation, deterministic=deterministic)
        observation, _, terminated, truncated, info = env.step(action)
        played, steps = played + 1, steps + 1
        if terminated or truncated:
            episodes.append((bool(info.get("is_success", terminated)), steps))
            if len(episodes) >= n_episodes:
                break
            observation, _ = env.reset()
            steps = 0
    return episodes


def summary(episodes: list[tuple[bool, int]]) -> str:
    """Return the line at the end."""
    if not episodes:
        return "No episode ended; play longer with -n"
    lengths = [steps for success, steps in episodes if success]
    rate = 100 * len(lengths) / len(episodes)
    steps = f", {sum(lengths) / len(lengths):.2f} steps on average" if lengths else ""
    return f"{len(episodes)} episodes, {len(lengths)} reached the target ({rate:.0f} %){steps}"


def length(args: argparse.Namespace) -> tuple[float, float]:
    """Return how many environment steps and how many episodes to play at most."""
    if args.n_timesteps is None and args.n_episodes is None:
        return (math.inf, DEFAULT_FILM_EPISODES) if args.video else (DEFAULT_TIMESTEPS, math.inf)
    return args.n_timesteps or math.inf, args.n_episodes or math.inf


@contextmanager
def watched(env: Any, window: bool, video: Path | None, zoom: float) -> Iterator[Any]:
    """Wrap an environment so that a person can watch it: in real time on a window, or on film."""
    from sb3_stereo.envs.wrappers import WatchedPulses
    from sb3_stereo.viz.film import N_PARTS, Filmed, make_writer

    if (window or video) and not hasattr(env.unwrapped, "draw"):
        raise ConfigError(f"{env.spec.id} cannot be watched, only environments of sb3_stereo can; add --no-render")
    pause = 1 / (N_PARTS * env.metadata.get("render_fps", 1))
    if window:
        env = WatchedPulses(env, lambda _: time.sleep(pause), N_PARTS)
    if video is None:
        yield env
        return
    writer = make_writer(video, 1 / pause)
    try:
        yield Filmed(env, writer, zoom)
    finally:
        writer.close()
    print(f"Filmed into {video}")


def chosen_run(args: argparse.Namespace) -> Path:
    """Return the run that the flags choose; where there is none yet, the agent that ships with the package.

    Raises:
        ConfigError: If there is no such run, and none ships that could stand in.
    """
    from sb3_stereo.runs.directory import find_run, run_ids
    from sb3_stereo.runs.pretrained import pretrained_run, ships

    if args.pretrained:
        return pretrained_run(args.algo, args.env)
    names_a_model = args.exp_id or args.load_best or args.load_checkpoint is not None
    is_there = bool(run_ids(Path(args.log_folder), args.algo, args.env))
    if is_there or names_a_model or not ships(args.algo, args.env):
        return find_run(args.log_folder, args.algo, args.env, args.exp_id)
    runs = Path(args.log_folder, args.algo)
    print(f"No run of {args.env} in '{runs}': this is the agent that ships with the package")
    return pretrained_run(args.algo, args.env)


def enjoy_command(args: argparse.Namespace) -> int:
    """Load a run, play it and print its success."""
    runtime.tune_allocator()
    from sb3_stereo.building.factory import make_env
    from sb3_stereo.config.schema import check_env_id, check_env_kwargs
    from sb3_stereo.config.values import parse_assignments
    from sb3_stereo.runs.directory import import_packages, load_record, model_path
    from sb3_stereo.runs.models import load_model

    window = args.gui or not (args.no_render or args.video)
    if window:
        check_display("add --no-render or --video FILE.mp4")
    n_timesteps, n_episodes = length(args)
    import_packages(args.gym_packages)
    check_env_id(args.env)
    check_device(args.device)
    run = chosen_run(args)
    config, _ = load_record(run)
    path = model_path(run, config.env_id, args.load_best, args.load_checkpoint)
    runtime.set_threads(args.num_threads)
    print(f"Loading {path}")
    model = load_model(config, path, args.device, args.trust)
    render_mode = {"render_mode": "human"} if window else {}
    given = {**config.evaluated.env_kwargs, **parse_assignments(args.env_kwargs)}
    env_kwargs = {**check_env_kwargs(args.env, given), **render_mode}
    with setting_up(args.env):
        env = make_env(args.env, env_kwargs, config.env_wrapper)()
    try:
        with watched(env, window, args.video, args.zoom) as watched_env:
            episodes = play(model, watched_env, n_timesteps, args.seed, not args.stochastic, n_episodes)
    finally:
        env.close()
    print(summary(episodes))
    return 0


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and play.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(enjoy_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
