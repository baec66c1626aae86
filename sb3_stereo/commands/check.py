"""Check an environment before training: `python -m sb3_stereo check --env-kwargs arm:my_arm.yml`."""

import argparse
import sys
from typing import Any

from sb3_stereo.commands.flags import Parser, at_least, path, run_command
from sb3_stereo.config.schema import DEFAULT_ENV
from sb3_stereo.console import Bar, command_line
from sb3_stereo.errors import ConfigError, setting_up

LINE_INTERVAL = 5.0  # [s] between two lines where there is no terminal


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(
        prog=command_line("check"),
        description="Measure joint motion per action, collision-free and visible poses, and how rare success is.",
    )
    parser.add_argument("--env", default=DEFAULT_ENV, help=f"environment id (default: {DEFAULT_ENV})")
    parser.add_argument(
        "--env-kwargs", nargs="+", metavar="KEY:VALUE", help="arguments of the environment, e.g. arm:my_arm.yml"
    )
    parser.add_argument("--poses", type=at_least(1), default=500, metavar="N", help="random poses (default: 500)")
    parser.add_argument(
        "--steps", type=at_least(1), default=1000, metavar="N", help="steps of a random agent (default: 1000)"
    )
    parser.add_argument("--seed", type=at_least(0), default=0, metavar="S", help="random seed (default: 0)")
    parser.add_argument("-o", "--output", type=path, metavar="FILE", help="save the camera images, e.g. arm.png")
    return parser


def check_command(args: argparse.Namespace) -> int:
    """Make the environment, measure it and print what was measured."""
    import gymnasium as gym

    from sb3_stereo.config.schema import check_env_id, check_env_kwargs
    from sb3_stereo.config.values import parse_assignments
    from sb3_stereo.envs.diagnosis import describe, diagnose
    from sb3_stereo.envs.pick import StereoPickEnv
    from sb3_stereo.envs.reach import StereoReachEnv

    check_env_id(args.env)
    kwargs = check_env_kwargs(args.env, parse_assignments(args.env_kwargs))
    with setting_up(args.env):
        env = gym.make(args.env, render_mode="rgb_array", **kwargs).unwrapped
        if not isinstance(env, StereoReachEnv):
            raise ConfigError(f"{args.env} has no arm and cameras to measure; take {DEFAULT_ENV} and --env-kwargs")
        if isinstance(env, StereoPickEnv):
            way_out = "take WamStereoReach-v1 with the same arm and cameras"
            raise ConfigError(f"check measures reaching, and {args.env} is a task of picking; {way_out}")
        if args.output:  # first, as it helps to understand what the measurements refuse
            save_frame(env, args.output)
        phases = Phases()
        try:
            found = diagnose(env, args.poses, args.steps, args.seed, phases.update)
        finally:
            phases.close()
        print(describe(found))
    env.close()
    return 0


class Phases:
    """A bar for each phase, one after the other."""

    def __init__(self) -> None:
        self._bar: Bar | None = None

    def update(self, phase: str, done: int, total: int) -> None:
        """Show how far a phase is; the first call of a phase begins it."""
        if self._bar is None:
            self._bar = Bar(total, "step", interval=LINE_INTERVAL)
        self._bar.update(done, phase)
        if done == total:
            self.close()

    def close(self) -> None:
        """End the phase that is shown, if there is one."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None


def save_frame(env: Any, path: str) -> None:
    """Save what the cameras see of the arm in the middle of its joints' ranges, whether it is free there or not."""
    import cv2

    from sb3_stereo.viz.drawing import View, side_by_side, titled

    frames = env.draw_pose(env.arm.limits.mean(axis=1))
    views = [
        View(camera.spec.name, frame, env.find_markers(number, frame))
        for number, (camera, frame) in enumerate(zip(env.cameras, frames, strict=True))
    ]
    picture = titled(
        "every joint in the middle of its range; rings: the markers as they are measured", side_by_side(views)
    )
    try:
        saved = cv2.imwrite(path, picture[:, :, ::-1])  # OpenCV's order of colours
    except cv2.error:
        saved = False
    if not saved:
        raise ConfigError(f"cannot write the image '{path}'; give a file such as arm.png in a folder that exists")


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and measure.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(check_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
