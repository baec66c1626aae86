"""Marker detection and policy success on disturbed images.

    python -m benchmarks.analysis.detection [--model RUN]

renders the 100 test poses, disturbs the frames and prints a Markdown table: how many pixels the centroids of
`sb3_stereo.real_images.detection` move from the exact ones. With a model, also its success when it only sees
such images. A second table counts detections among the people of `benchmarks.analysis.people`.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from benchmarks.analysis.people import BACKGROUNDS, COMPANY, Scene, draw_scene
from sb3_stereo.building.factory import make_env
from sb3_stereo.envs.markers import find_blobs
from sb3_stereo.evaluation.protocol import eval_initial_states, eval_poses, evaluate
from sb3_stereo.real_images.detection import Detection, detect, observe
from sb3_stereo.real_images.sources import fit
from sb3_stereo.runs.directory import load_record, model_path
from sb3_stereo.runs.models import load_model

ENV_ID = "WamStereoReach-v0"

Image = NDArray[np.uint8]
Disturbance = Callable[[Image, np.random.Generator], Image]


def _clipped(image: Any) -> Image:
    return np.asarray(np.clip(np.rint(image), 0, 255), np.uint8)


def noise(image: Image, rng: np.random.Generator, sigma: float) -> Image:
    """Independent Gaussian noise per pixel and channel, `sigma` of 255."""
    return _clipped(image + rng.normal(0, sigma, image.shape))


def light(image: Image, rng: np.random.Generator, gains: Sequence[float]) -> Image:
    """Light of another colour and strength: factors for red, green and blue."""
    return _clipped(image * np.array(gains))


def shade(image: Image, rng: np.random.Generator, darkest: float) -> Image:
    """Light that falls off from left to right, down to a factor of `darkest`."""
    return _clipped(image * np.linspace(1, darkest, image.shape[1])[:, None])


def jpeg(image: Image, rng: np.random.Generator, quality: int) -> Image:
    """What a JPEG of this quality leaves; its colours have half the resolution."""
    _, data = cv2.imencode(".jpg", image[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR_RGB), np.uint8)


def blur(image: Image, rng: np.random.Generator, sigma: float) -> Image:
    """A lens out of focus: a Gaussian blur of `sigma` [px]."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.uint8)


def clutter(image: Image, rng: np.random.Generator) -> Image:
    """Patches of muted colours in place of the white background, with a little white among them."""
    patches = rng.integers(90, 190, (12, 16, 3)).astype(np.uint8)
    patches[rng.random((12, 16)) < 0.05] = 255
    background = cv2.resize(patches, image.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    return np.where((image == 255).all(axis=2, keepdims=True), background, image)


def webcam(image: Image, rng: np.random.Generator) -> Image:
    """Warm and dim light from one side, then noise, then JPEG."""
    return jpeg(noise(shade(light(image, rng, (0.8, 0.68, 0.5)), rng, 0.7), rng, 8), rng, 60)


DISTURBANCES: Mapping[str, Disturbance] = {
    "none": lambda image, rng: image,
    "noise, σ 10": partial(noise, sigma=10),
    "noise, σ 25": partial(noise, sigma=25),
    "warm light (1, 0.85, 0.6)": partial(light, gains=(1, 0.85, 0.6)),
    "cold light (0.65, 0.85, 1)": partial(light, gains=(0.65, 0.85, 1)),
    "greenish light (0.8, 1, 0.8)": partial(light, gains=(0.8, 1, 0.8)),
    "a third of the light": partial(light, gains=(0.33, 0.33, 0.33)),
    "overexposed by half": partial(light, gains=(1.5, 1.5, 1.5)),
    "shade, down to 0.4": partial(shade, darkest=0.4),
    "JPEG, quality 90": partial(jpeg, quality=90),
    "JPEG, quality 50": partial(jpeg, quality=50),
    "JPEG, quality 20": partial(jpeg, quality=20),
    "cluttered background": clutter,
    "webcam: warm, dim, shade, noise 8, JPEG 60": webcam,
}

TOLERANCE = 2.0  # [px] of a frame: a centroid further off than this is wrong
PHOTOGRAPHS: Mapping[str, Disturbance] = {
    "none": DISTURBANCES["none"],
    "underexposed": partial(light, gains=(0.4, 0.4, 0.4)),
    "overexposed": partial(light, gains=(1.4, 1.4, 1.4)),
    "warm": partial(light, gains=(1, 0.85, 0.65)),
    "cold": partial(light, gains=(0.75, 0.88, 1)),
    "blur": partial(blur, sigma=2),
    "JPEG": partial(jpeg, quality=30),
    "noise": partial(noise, sigma=10),
    "webcam": lambda image, rng: webcam(blur(image, rng, 1.5), rng),
}


class DisturbedViews(gym.ObservationWrapper[Any, Any, Any]):
    """What `predict` would show a policy in place of the environment's own composite."""

    def __init__(self, env: gym.Env[Any, Any], disturb: Disturbance) -> None:
        super().__init__(env)
        self.disturb, self.rng = disturb, np.random.default_rng(0)

    def observation(self, observation: Any) -> Any:
        """What the policy sees of the disturbed frames."""
        unwrapped: Any = self.unwrapped
        return observe([self.disturb(frame, self.rng) for frame in rendered(self)], unwrapped.composite)


def rendered(env: gym.Env[Any, Any]) -> list[Image]:
    """What the cameras see, RGB."""
    unwrapped: Any = env.unwrapped
    return [np.ascontiguousarray(frame[:, :, :3]) for frame in unwrapped.draw()]


def pose_frames(n_poses: int = 100) -> list[Image]:
    """Both views of test poses, with targets all over the workspace."""
    env, rng, frames = gym.make(ENV_ID), np.random.default_rng(0), []
    for pose in eval_poses(ENV_ID)[:n_poses]:
        target = rng.uniform((0.2, -0.5, 0.2), (0.7, 0.5, 1.0))
        env.reset(options={"joint_positions": pose, "target_position": target})
        frames += rendered(env)
    env.close()
    return frames


def found(frames: Sequence[Image], disturb: Disturbance) -> list[str]:
    """Cells of the table: how far the centroids move, and how many are missed or imagined."""
    rng = np.random.default_rng(0)
    exact = np.array([find_blobs(frame) for frame in frames])  # (n_frames, 2 markers, 2)
    detections = [detect(disturb(frame, rng)) for frame in frames]
    seen = np.array([detection.markers for detection in detections])
    undecided = np.array([[bool(places) for places in detection.undecided] for detection in detections])
    moved = np.linalg.norm(seen - exact, axis=2)
    moved = moved[np.isfinite(moved)]
    hidden, unseen = np.isnan(exact[:, :, 0]), np.isnan(seen[:, :, 0])
    cells = [f"{np.median(moved):.2f}", f"{np.percentile(moved, 95):.2f}", f"{moved.max():.2f}"]
    return [
        *cells,
        f"{np.sum(unseen & ~undecided & ~hidden)} of {np.sum(~hidden)}",
        f"{np.sum(undecided)}",
        f"{np.sum(~unseen & hidden)} of {np.sum(hidden)}",
    ]


def photographs(
    company: str, n_scenes: int, visible: tuple[bool, bool] = (True, True)
) -> Iterator[tuple[Image, Scene]]:
    """Scenes with and without a bar in front of the markers on every background, each disturbed in every way."""
    for background, covered, number in product(BACKGROUNDS, (0.0, 0.4), range(n_scenes)):
        rng = np.random.default_rng([*company.encode(), BACKGROUNDS.index(background), round(10 * covered), number])
        scene = draw_scene(company, background, rng, covered, visible)
        for disturb in PHOTOGRAPHS.values():
            yield fit(disturb(scene.image, rng), 320, 240), scene


def verdicts(found: Detection, scene: Scene) -> list[str]:
    """For both markers "right", "wrong", "undecided" or "missed"; a hidden marker that is not found is right."""
    words = []
    for seen, places, exact in zip(found.markers, found.undecided, scene.markers, strict=True):
        if places:
            words.append("undecided")
        elif np.isnan(seen).any():
            words.append("right" if np.isnan(exact).any() else "missed")
        else:
            words.append("right" if np.linalg.norm(seen - exact) <= TOLERANCE else "wrong")
    return words


def among_people(company: str, n_scenes: int, find: Callable[[Image], Detection] = detect) -> list[str]:
    """Cells of the second table: what becomes of visible markers, then of hidden ones."""
    cells = []
    for visible in ((True, True), (False, False)):
        seen = Counter(
            word for image, scene in photographs(company, n_scenes, visible) for word in verdicts(find(image), scene)
        )
        words = ("right", "undecided", "missed", "wrong") if visible[0] else ("right", "undecided", "wrong")
        cells += [str(seen[word]) for word in words]
    return cells


def reached(run: str, disturb: Disturbance, n_poses: int) -> list[str]:
    """Cells of the table: how a run's best model does where it sees disturbed images only."""
    config, _ = load_record(run)
    model = load_model(config, model_path(run, config.env_id, best=True), "cpu")
    make = make_env(config.env_id, config.env_kwargs, config.env_wrapper)
    score = evaluate(model, lambda: DisturbedViews(make(), disturb), eval_initial_states(config.env_id)[:n_poses])
    return [f"{100 * score.success_rate:.0f}", f"{score.mean_steps_capped:.1f}"]


def main(argv: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.analysis.detection", description="Markers in disturbed images."
    )
    parser.add_argument("--model", metavar="RUN", help="also play this run's best model")
    parser.add_argument("--poses", type=int, default=100, help="test poses that it starts from (default: 100)")
    parser.add_argument("--scenes", type=int, default=4, help="drawn per row and background (default: 4)")
    args = parser.parse_args(argv)
    frames = pose_frames()
    head = ["disturbance", "moved, median px", "95 %", "most", "missed", "undecided", "imagined"]
    head += ["reached, %", "episode length, failures as 30"] if args.model else []
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for name, disturb in DISTURBANCES.items():
        cells = found(frames, disturb) + (reached(args.model, disturb, args.poses) if args.model else [])
        print(f"| {' | '.join([name, *cells])} |", flush=True)
    head = ["in view", "right", "undecided", "missed", "wrong", "not there: right", "undecided", "wrong"]
    print(f"\n| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for company in COMPANY:
        print(f"| {' | '.join([company, *among_people(company, args.scenes)])} |", flush=True)


if __name__ == "__main__":
    main()
