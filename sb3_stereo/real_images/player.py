"""An agent's actions on ordinary images."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sb3_stereo.errors import one_line
from sb3_stereo.real_images.detection import detect, observe, white_balanced
from sb3_stereo.real_images.sources import Image, fit
from sb3_stereo.viz.drawing import Caption, Effort, View, scene

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

MARKERS = ("end effector", "target")


class Answer(NamedTuple):
    """What was found in one set of images, and what the agent would do: nothing where a marker is undecided."""

    names: tuple[str, ...]
    views: list[View]
    observation: Any
    efforts: list[Effort]
    distance: float  # of the markers, mean over the views, [px] of the task's success frame; nan unless all are found
    undecided: dict[tuple[str, str], list[NDArray[np.float64]]]  # (view, marker) -> where it may be, one place or two


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
        self._locate = task.locate_markers
        self.cameras = [camera.spec for camera in task.cameras]

    def answer(self, images: Sequence[tuple[str, Image]]) -> Answer:
        """Look at one image per camera, of any size."""
        views: list[View] = []
        undecided: dict[tuple[str, str], list[NDArray[np.float64]]] = {}
        frames = [
            fit(image, camera.width, camera.height) for camera, (_, image) in zip(self.cameras, images, strict=True)
        ]
        for number, (camera, frame) in enumerate(zip(self.cameras, frames, strict=True)):
            found = detect(frame)
            views.append(View(camera.name, white_balanced(frame), self._locate(number, *found.masks)))
            undecided.update({(camera.name, marker): at for marker, at in zip(MARKERS, found.undecided) if at})
        observation = observe(frames, self.composite)
        efforts = [] if undecided else self._answer(observation)
        distance = float(self._success_distances(np.array([view.blobs.offset for view in views])).mean())
        return Answer(tuple(name for name, _ in images), views, observation, efforts, distance, undecided)

    def _answer(self, observation: Any) -> list[Effort]:
        action, _ = self.model.predict(observation, deterministic=True)
        return [Effort(*known) for known in zip(self.joints, *self.efforts(action), strict=True)]

    def efforts(self, action: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The efforts [N m] of an action and their shares of the limits, (n_joints,) each."""
        env: Any = self.env
        while env is not env.unwrapped:
            action = env.action(action) if isinstance(env, gym.ActionWrapper) else action
            env = env.env
        shares = np.clip(np.asarray(action, np.float64), -1.0, 1.0)
        return shares * self.limits, shares


def description(answer: Answer, rho: float) -> str:
    """Describe an answer in words."""
    lines = [one_line(" | ".join(answer.names))]
    for view in answer.views:
        red, blue = (_place(answer, view.name, *known) for known in zip(MARKERS, view.blobs, strict=True))
        apart = "" if np.isnan(view.blobs.offset).any() else f", {np.hypot(*view.blobs.offset):.1f} px apart"
        lines.append(f"  {view.name:<8}end effector {red}, target {blue}{apart}")
    lines.append(f"  {_reached(answer, rho)}")
    if answer.undecided:
        return "\n".join([*lines, f"  {_doubts(answer)}"])
    efforts = (f"{joint} {torque:+.1f} N m ({100 * share:+.0f} %)" for joint, torque, share in answer.efforts)
    return "\n".join([*lines, f"  efforts: {', '.join(efforts)}"])


def _doubts(answer: Answer) -> str:
    """Say why there is no answer: every marker that is undecided, and where it may be."""
    doubts = (
        f"the {marker} in {view} may be at {' or at '.join(map(_point, places))}"
        for (view, marker), places in answer.undecided.items()
    )
    return f"no efforts: {'; '.join(doubts)}; take away or cover what is not the marker, or give more light"


def _place(answer: Answer, view: str, marker: str, centroid: NDArray[np.float64]) -> str:
    if (view, marker) in answer.undecided:
        return "undecided"
    return "hidden" if np.isnan(centroid).any() else _point(centroid)


def _point(centroid: NDArray[np.float64]) -> str:
    return f"({centroid[0]:.1f}, {centroid[1]:.1f})"


def _reached(answer: Answer, rho: float) -> str:
    if answer.undecided:
        return "mean distance unknown: a marker is undecided"
    if np.isnan(answer.distance):
        return "mean distance unknown: a marker is hidden"
    verdict = "reached" if answer.distance <= rho else "not reached"
    return f"mean distance {answer.distance:.1f} px: {verdict} (at most {rho:g} px)"


def plain(answer: Answer) -> dict[str, Any]:
    """Return an answer as JSON writes it: pixels of the frames, [N m], null where a marker is hidden or undecided."""

    def numbers(values: Any) -> list[float] | None:
        return None if np.isnan(values).any() else [round(float(value), 3) for value in values]

    found = {
        view.name: {"end_effector": numbers(view.blobs.end_effector), "target": numbers(view.blobs.target)}
        for view in answer.views
    }
    efforts = {joint: {"torque": round(float(t), 3), "share": round(float(s), 4)} for joint, t, s in answer.efforts}
    undecided: dict[str, Any] = {}
    for (view, marker), places in answer.undecided.items():
        undecided.setdefault(view, {})[marker.replace(" ", "_")] = [numbers(place) for place in places]
    return {"images": answer.names, "views": found, "efforts": efforts or None, "undecided": undecided}


def drawn(answer: Answer, rho: float) -> Image:
    """Draw an answer."""
    return scene(answer.views, answer.observation, Caption(_reached(answer, rho).split(": "), answer.efforts))
