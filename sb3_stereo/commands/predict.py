"""Predict actions for ordinary images: `python -m sb3_stereo predict LEFT RIGHT --model RUN`."""

import argparse
import json
import sys
from collections.abc import Iterator
from itertools import islice
from typing import Any

from sb3_stereo import runtime
from sb3_stereo.commands.flags import (
    Parser,
    add_model_flags,
    add_process_flags,
    at_least,
    file,
    load_agent,
    path,
    run_command,
)
from sb3_stereo.config.schema import DEFAULT_ENV
from sb3_stereo.console import command_line
from sb3_stereo.errors import ConfigError
from sb3_stereo.real_images.player import Player, description, drawn, plain
from sb3_stereo.real_images.sources import image_sets, make_folder, write_image


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(
        prog=command_line("predict"),
        description="Detect the markers in images and print the agent's joint torques.",
    )
    parser.add_argument(
        "sources",
        metavar="LEFT RIGHT",
        nargs="+",
        help="for each view an image, a folder of images or a camera index",
    )
    parser.add_argument(
        "--model", type=path, metavar="RUN", help="run directory of the agent (default: the one that ships)"
    )
    add_model_flags(parser)
    parser.add_argument(
        "-n", type=at_least(1), metavar="N", help="stop after N pairs (default: all; cameras: until Ctrl-C)"
    )
    parser.add_argument("--draw", type=file, metavar="FOLDER", help="save an annotated image for each pair")
    parser.add_argument("--json", action="store_true", help="print one JSON object per pair")
    add_process_flags(parser)
    return parser


def load_player(args: argparse.Namespace) -> Player:
    """Load the run's agent and make its environment."""
    from sb3_stereo.building.factory import make_env
    from sb3_stereo.envs.pick import StereoPickEnv
    from sb3_stereo.runs.pretrained import pretrained_run

    config, _, model = load_agent(args, args.model or pretrained_run("ddpg", DEFAULT_ENV))
    env = make_env(config.env_id, config.env_kwargs, config.env_wrapper)()
    if not hasattr(env.unwrapped, "cameras"):
        raise ConfigError(f"{config.env_id} has no cameras; give a run of an environment of sb3_stereo")
    if isinstance(env.unwrapped, StereoPickEnv):
        way_out = f"play an agent of {config.env_id}, which looks for an object, with enjoy"
        raise ConfigError(f"predict finds a red and a blue marker in images; {way_out}")
    return Player(model, env)


def predict_command(args: argparse.Namespace) -> int:
    """Answer every set of images."""
    runtime.tune_allocator()
    images: Iterator[Any] = image_sets(args.sources)
    player = load_player(args)
    names = [camera.name for camera in player.cameras]
    if len(args.sources) != len(names):
        raise ConfigError(
            f"the agent sees {len(names)} views ({', '.join(names)}), got {len(args.sources)}; give one each"
        )
    if args.draw:
        make_folder(args.draw)
    for number, moment in enumerate(islice(images, args.n), 1):
        answer = player.answer(moment)
        print(json.dumps(plain(answer)) if args.json else description(answer, player.rho), flush=True)
        if args.draw:
            write_image(args.draw / f"{number:04}.png", drawn(answer, player.rho))
    return 0


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and answer.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(predict_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
