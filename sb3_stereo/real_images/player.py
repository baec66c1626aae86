"""What an agent would do on ordinary images."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sb3_stereo.real_images.detection import find_markers, observe, white_balanced
from sb3_stereo.real_images.sources import Image, fit
from sb3_stereo.viz.drawing import Effort, Story, View, scene

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
