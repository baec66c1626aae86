"""Move the arm by the keyboard, in Bullet's window: `python -m sb3_stereo manual`."""

import argparse
import sys
import time
from collections.abc import Callable
from contextlib import closing, nullcontext
from typing import TYPE_CHECKING, Any

from sb3_stereo.commands.flags import Parser, add_dataset_flags, at_least, check_display, run_command
from sb3_stereo.config.schema import DEFAULT_ENV
from sb3_stereo.console import command_line, print_line
from sb3_stereo.errors import ConfigError, setting_up

if TYPE_CHECKING:
    from sb3_stereo.sharing.recording import DatasetWriter

N_PARTS = 6  # pictures of a control step
WAIT = 0.03  # [s] between two looks at the keyboard
KEYS = """\
keys, in the window:
  q w e r t y u   the joints forward, from the base on
  a s d f g h j   the same joints back
  shift           a quarter of the effort
  n               a new episode
  Esc             the end
"""


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(
        prog=command_line("manual"),
        description="Move the arm to the target yourself: each key is a control step of full effort in one joint.",
        epilog=KEYS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--env", default=DEFAULT_ENV, help=f"environment id (default: {DEFAULT_ENV})")
    parser.add_argument("--env-kwargs", nargs="+", metavar="KEY:VALUE", help="arguments of the environment")
    parser.add_argument("--seed", type=at_least(0), help="random seed of the first episode (default: none)")
    parser.add_argument("--n-episodes", type=at_least(1), metavar="N", help="end after N episodes (default: at Esc)")
    add_dataset_flags(parser, required=False)
    return parser


def manual_command(args: argparse.Namespace) -> int:
    """Open the window and play."""
    check_display("run it where there is one")
    from sb3_stereo.building.factory import make_env
    from sb3_stereo.config.components import Component
    from sb3_stereo.config.schema import check_env_id, check_env_kwargs
    from sb3_stereo.config.values import parse_assignments
    from sb3_stereo.envs.keyboard import legend
    from sb3_stereo.envs.reach import StereoReachEnv
    from sb3_stereo.sharing.formats import open_dataset

    check_env_id(args.env)
    writer = open_dataset(args.format, args.dataset, "a person", args.author) if args.dataset else None
    kwargs = {**check_env_kwargs(args.env, parse_assignments(args.env_kwargs)), "render_mode": "human"}
    with setting_up(args.env):
        env = make_env(args.env, kwargs, (Component(writer.recorder),) if writer else ())()
    with closing(env), closing(writer) if writer else nullcontext():
        task = env.unwrapped
        if not isinstance(task, StereoReachEnv):
            raise ConfigError(f"{args.env} has no window with an arm in it; take an environment of sb3_stereo")
        print_line(legend(task.action_names))
        play(in_real_time(env), args.seed, args.n_episodes, writer)
    if writer is not None and writer.n_episodes:
        print_line(
            f"{writer.n_episodes} episodes in the dataset {args.dataset}, {writer.n_successes} reached the target"
        )
    return 0


def in_real_time(env: Any) -> Any:
    """Wrap an environment so that a control step takes as long as it would on a robot."""
    from sb3_stereo.envs.wrappers import WatchedPulses

    pause = env.unwrapped.pulse_duration / N_PARTS
    return WatchedPulses(env, lambda _: time.sleep(pause), N_PARTS)


def play(
    env: Any,
    seed: int | None = None,
    n_episodes: int | None = None,
    writer: "DatasetWriter | None" = None,
    wait: Callable[[float], object] = time.sleep,
) -> None:
    """Let a person act until the window is closed.

    Args:
        env: With the writer's recorder in it if there is a writer.
        seed: Of the first reset.
        n_episodes: Ends it, too.
        writer: Where the episodes are written.
        wait: What to do while no key is down, called with seconds.
    """
    from sb3_stereo.envs.bullet import pybullet
    from sb3_stereo.envs.keyboard import NEW_EPISODE, action_of, is_down

    n_joints = env.action_space.shape[0]
    _, info = env.reset(seed=seed)
    steps = n_done = 0
    print_line(state(steps, info, env.unwrapped.rho))
    while (keys := env.unwrapped.keyboard_events()) is not None and n_done != n_episodes:
        action, ended = action_of(keys, n_joints), is_down(keys, NEW_EPISODE)
        if action is None and not ended:
            wait(WAIT)
            continue
        if action is not None and not ended:
            try:
                _, _, terminated, truncated, info = env.step(action)
            except pybullet.error:
                if env.unwrapped.keyboard_events() is None:
                    break
                raise
            ended, steps = terminated or truncated, steps + 1
            print_line(state(steps, info, env.unwrapped.rho))
            n_done += ended
        if ended:
            if writer is not None:
                writer.write(*env.get_wrapper_attr("take")())
            _, info = env.reset()
            steps = 0
            print_line(state(steps, info, env.unwrapped.rho))


def state(steps: int, info: dict[str, Any], rho: float) -> str:
    """Say how far the arm is from the target, in the images and in space."""
    pixels = info["pixel_distances"].mean()
    seen = f"{pixels:.1f} px of {rho:g}" if pixels == pixels else "a marker is hidden"
    verdict = ", reached" if info["is_success"] else ""
    return f"step {steps}: {seen}, {100 * info['distance']:.1f} cm{verdict}" if steps else f"new episode: {seen}"


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and play.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(manual_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
