"""Play a trained agent: `python enjoy.py --algo ddpg`, or `sb3-stereo enjoy --algo ddpg`."""

import argparse
import os
import sys
from typing import TYPE_CHECKING, Any

from sb3_stereo import runtime
from sb3_stereo.cli import Parser, add_model_flags, add_process_flags, add_run_flags, check_device, run_command
from sb3_stereo.errors import ConfigError

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line; the flags are the zoo's."""
    parser = Parser(prog="enjoy.py", description="Play a trained agent and count its successes.")
    add_run_flags(parser)
    add_model_flags(parser)
    parser.add_argument("-n", "--n-timesteps", type=int, default=1000, help="environment steps (default: 1000)")
    parser.add_argument("--exp-id", type=int, default=0, help="number of the run (default: 0, the latest)")
    parser.add_argument("--no-render", action="store_true", help="do not open a window")
    parser.add_argument("--stochastic", action="store_true", help="explore as in training")
    parser.add_argument("--seed", type=int, default=0, help="seed of the starts (default: 0)")
    parser.add_argument("--env-kwargs", nargs="+", metavar="KEY:VALUE", help="arguments of the environment")
    add_process_flags(parser)
    return parser


def play(
    model: "BaseAlgorithm", env: Any, n_timesteps: int, seed: int, deterministic: bool = True
) -> list[tuple[bool, int]]:
    """Play for a number of steps and return success and length of the episodes that ended.

    Args:
        model: The agent.
        env: A Gymnasium environment.
        n_timesteps: Environment steps.
        seed: Of the first reset.
        deterministic: False explores.
    """
    episodes, steps = [], 0
    observation, _ = env.reset(seed=seed)
    for _ in range(n_timesteps):
        action, _ = model.predict(observation, deterministic=deterministic)
        observation, _, terminated, truncated, info = env.step(action)
        steps += 1
        if terminated or truncated:
            episodes.append((bool(info.get("is_success", terminated)), steps))
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


def enjoy_command(args: argparse.Namespace) -> int:
    """Load a run, play it and print its success."""
    runtime.tune_allocator()
    from sb3_stereo.building import make_env
    from sb3_stereo.config import check_env_id
    from sb3_stereo.models import load_model
    from sb3_stereo.runs import find_run, import_packages, load_record, model_path
    from sb3_stereo.values import parse_assignments

    render = not args.no_render
    if render and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise ConfigError("there is no display to open a window on; add --no-render")
    import_packages(args.gym_packages)
    check_env_id(args.env)
    check_device(args.device)
    run = find_run(args.log_folder, args.algo, args.env, args.exp_id)
    config, _ = load_record(run)
    path = model_path(run, args.env, args.load_best, args.load_checkpoint)
    runtime.set_threads(args.num_threads)
    print(f"Loading {path}")
    model = load_model(config, path, args.device, args.trust)
    window = {"render_mode": "human"} if render else {}
    env_kwargs = {**config.env_kwargs, **parse_assignments(args.env_kwargs), **window}
    env = make_env(config.env_id, env_kwargs, config.env_wrapper)()
    try:
        print(summary(play(model, env, args.n_timesteps, args.seed, not args.stochastic)))
    finally:
        env.close()
    return 0


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and play.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(enjoy_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
