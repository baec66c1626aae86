"""What an agent would do on ordinary images: `python -m sb3_stereo.play_images LEFT RIGHT --model RUN`."""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sb3_stereo import runtime
from sb3_stereo.cli import Parser, add_model_flags, add_process_flags, check_device, command_line, run_command
from sb3_stereo.detection import find_markers, observe, white_balanced
from sb3_stereo.drawing import Effort, Story, View, scene
from sb3_stereo.errors import ConfigError
from sb3_stereo.images import Image, fit, image_sets

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm


class Answer(NamedTuple):
    """What was found in one set of images, and what the agent would do."""

    names: tuple[str, ...]
    views: list[View]
    observation: Any
    efforts: list[Effort]
    distance: float  # of the markers, mean over the views, in [px] of the task's success frame; nan if one is hidden


class Player:
    """An agent and the task that it was trained for, of which only efforts and cameras count here.

    Args:
        model: The agent.
        env: Its environment, with the wrappers.
    """

    def __init__(self, model: "BaseAlgorithm", env: gym.Env[Any, Any]) -> None:
        self.model, self.env = model, env
        task: Any = env.unwrapped
        self.rho, self.limits, self.joints = task.rho, task.effort_limits, task.arm.spec.joints
        self.composite, self._success_distances = task.composite, task.success_distances
        self.cameras = [camera.spec for camera in task.cameras]

    def answer(self, images: Sequence[tuple[str, Image]]) -> Answer:
        """Look at one image per camera, of any size."""
        views = []
        for camera, (_, image) in zip(self.cameras, images, strict=True):
            frame = white_balanced(fit(image, camera.width, camera.height))
            views.append(View(camera.name, frame, find_markers(frame)))
        observation = observe([view.frame for view in views], self.composite)
        action, _ = self.model.predict(observation, deterministic=True)
        efforts = [Effort(*known) for known in zip(self.joints, *self.efforts(action), strict=True)]
        distances = self._success_distances(np.array([view.blobs.offset for view in views]))
        return Answer(tuple(name for name, _ in images), views, observation, efforts, float(distances.mean()))

    def efforts(self, action: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The efforts [N m] of an action and their shares of the limits, (n_joints,) each."""
        env: Any = self.env
        while env is not env.unwrapped:
            action = env.action(action) if isinstance(env, gym.ActionWrapper) else action
            env = env.env
        shares = np.clip(np.asarray(action, np.float64), -1.0, 1.0)
        return shares * self.limits, shares


def told(answer: Answer, rho: float) -> str:
    """Write an answer for a person."""
    lines = [" | ".join(answer.names)]
    for view in answer.views:
        red, blue = (_place(centroid) for centroid in view.blobs)
        apart = f", {np.hypot(*view.blobs.offset):.1f} px apart" if "hidden" not in (red, blue) else ""
        lines.append(f"  {view.name:<8}end effector {red}, target {blue}{apart}")
    lines.append(f"  {_reached(answer, rho)}")
    efforts = (f"{joint} {torque:+.1f} N m ({100 * share:+.0f} %)" for joint, torque, share in answer.efforts)
    return "\n".join([*lines, f"  efforts: {', '.join(efforts)}"])


def _place(centroid: NDArray[np.float64]) -> str:
    return "hidden" if np.isnan(centroid).any() else f"({centroid[0]:.1f}, {centroid[1]:.1f})"


def _reached(answer: Answer, rho: float) -> str:
    if np.isnan(answer.distance):
        return "mean distance unknown: a marker is hidden"
    verdict = "reached" if answer.distance <= rho else "not reached"
    return f"mean distance {answer.distance:.1f} px: {verdict} (at most {rho:g} px)"


def plain(answer: Answer) -> dict[str, Any]:
    """Return an answer as JSON writes it: pixels of the frames, [N m], null where a marker is hidden."""

    def numbers(values: Any) -> list[float] | None:
        return None if np.isnan(values).any() else [round(float(value), 3) for value in values]

    found = {
        view.name: {"end_effector": numbers(view.blobs.end_effector), "target": numbers(view.blobs.target)}
        for view in answer.views
    }
    efforts = {joint: {"torque": round(float(t), 3), "share": round(float(s), 4)} for joint, t, s in answer.efforts}
    return {"images": answer.names, "views": found, "efforts": efforts}


def drawn(answer: Answer, rho: float) -> Image:
    """Draw an answer."""
    return scene(answer.views, answer.observation, Story(_reached(answer, rho).split(": "), answer.efforts))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(
        prog=command_line("play_images"), description="Find the markers in images and print the agent's efforts."
    )
    parser.add_argument(
        "sources", metavar="LEFT RIGHT", nargs="+", help="per view an image, a folder of images or a camera's index"
    )
    parser.add_argument("--model", required=True, metavar="RUN", help="run directory of the agent")
    add_model_flags(parser)
    parser.add_argument("-n", type=int, metavar="N", help="stop after N pairs (default: all; cameras: until Ctrl-C)")
    parser.add_argument("--draw", type=Path, metavar="FOLDER", help="write a picture of each answer")
    parser.add_argument("--json", action="store_true", help="print one JSON object per pair")
    add_process_flags(parser)
    return parser


def load_player(args: argparse.Namespace) -> Player:
    """Load the run's agent and make its environment."""
    from sb3_stereo.building import make_env
    from sb3_stereo.models import load_model
    from sb3_stereo.runs import import_packages, load_record, model_path

    import_packages(args.gym_packages)
    check_device(args.device)
    config, _ = load_record(args.model)
    path = model_path(args.model, config.env_id, args.load_best, args.load_checkpoint)
    runtime.set_threads(args.num_threads)
    env = make_env(config.env_id, config.env_kwargs, config.env_wrapper)()
    if not hasattr(env.unwrapped, "cameras"):
        raise ConfigError(f"{config.env_id} has no cameras; give a run of an environment of sb3_stereo")
    return Player(load_model(config, path, args.device, args.trust), env)


def play_images_command(args: argparse.Namespace) -> int:
    """Answer every set of images."""
    runtime.tune_allocator()
    if args.n is not None and args.n <= 0:
        raise ConfigError(f"-n must be positive, got {args.n}")
    images: Iterator[Any] = image_sets(args.sources)
    player = load_player(args)
    names = [camera.name for camera in player.cameras]
    if len(args.sources) != len(names):
        raise ConfigError(
            f"the agent sees {len(names)} views ({', '.join(names)}), got {len(args.sources)}; give one each"
        )
    if args.draw:
        args.draw.mkdir(parents=True, exist_ok=True)
    for number, moment in enumerate(islice(images, args.n), 1):
        answer = player.answer(moment)
        print(json.dumps(plain(answer)) if args.json else told(answer, player.rho), flush=True)
        if args.draw:
            cv2.imwrite(str(args.draw / f"{number:04}.png"), drawn(answer, player.rho)[:, :, ::-1])
    return 0


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and answer.

    Returns:
        The exit status: 0, 2 after wrong input, 130 after Ctrl-C.
    """
    return run_command(play_images_command, make_parser().parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
