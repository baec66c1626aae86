"""What v1 measures is straight: distance in the images against the projected one, success against that in space."""

import csv
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from benchmarks import RESULTS
from benchmarks.analysis.yardstick import look_at, measure
from sb3_stereo.envs import ENV_IDS
from sb3_stereo.envs.cameras import CLOSE_PAIR, camera_specs, plain_cameras
from sb3_stereo.envs.marker_specs import HOLLOW, SOLID, MarkerSpec, marker_spec
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.real_images.detection import detect

V1_IDS = [env_id for env_id in ENV_IDS if env_id.endswith("-v1")]
RECORDED = ("WamStereoReach-v1",)
DISTANCES = (0.0, 0.01, 0.02, 0.03, 0.05, 0.075, 0.1, 0.2, 0.3)  # [m]


@pytest.fixture(scope="module")
def v1() -> Iterator[Any]:
    env = gym.make("WamStereoReach-v1", render_mode="rgb_array").unwrapped
    yield env
    env.close()


@pytest.mark.parametrize("distance", DISTANCES)
def test_the_measured_distance_is_the_projected_one_and_success_that_in_space(v1: Any, distance: float) -> None:
    """The full measurement, with 500 poses for each distance, is `benchmarks.analysis.yardstick`."""
    looks = look_at(v1, distance, n_poses=25, seed=100)
    assert looks.errors.mean() < 1.0 and np.quantile(looks.errors, 0.95) < 2.0
    reached = looks.success[~looks.arm_hides]
    if distance < 0.035:
        assert reached.all()
    if distance > 0.07:
        assert not looks.success.any()
    if distance <= 0.1:
        assert looks.undefined.sum() <= looks.arm_hides.sum() + 1


@pytest.mark.slow
@pytest.mark.parametrize("env_id", V1_IDS)
def test_the_yardstick_is_straight_at_every_distance_for_every_arm(env_id: str) -> None:
    distances = (0.0, 0.01, 0.02, 0.035, 0.05, 0.07, 0.1, 0.14, 0.2, 0.3)
    check_laws(dict(zip(distances, (looks.row() for looks in measure(env_id, distances, n_poses=150)), strict=True)))


@pytest.mark.parametrize("env_id", RECORDED)
def test_the_committed_record_keeps_the_laws(env_id: str) -> None:
    with (RESULTS / f"yardstick_{env_id}.csv").open(encoding="utf-8") as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    check_laws({row.pop("distance_m"): row for row in rows})


def check_laws(rows: dict[float, dict[str, float]]) -> None:
    """Rows of the yardstick by distance in [m]."""
    for distance, row in rows.items():
        assert row["mean_error_px"] < 1.0 and row["p95_error_px"] < 2.0, distance
        if distance <= 0.1:
            assert row["undefined"] <= row["arm_hides"] + 0.02, distance
        if distance < 0.035:
            assert row["success_unless_arm_hides"] >= 0.99, distance
        if distance > 0.07:
            assert row["success"] <= 0.01, distance
    success = [rows[distance]["success_unless_arm_hides"] for distance in sorted(rows)]
    assert all(after <= before + 0.01 for before, after in pairwise(success))


def test_a_success_is_a_distance_in_space_of_at_most_7_5_cm(v1: Any) -> None:
    """rho times 7.5 mm per pixel is 3.75 cm, and the mean of two views at a right angle sees half of it or more."""
    rng = np.random.default_rng(0)
    hands = np.array([v1.reset(seed=seed)[1]["end_effector_position"] for seed in range(100)])
    directions = rng.normal(size=(100, 100, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)

    def reached(distance: float) -> float:
        targets = hands[:, None] + distance * directions
        offsets = [c.spec.project(hands)[:, None] - c.spec.project(targets) for c in v1.cameras]
        return float(np.mean(np.linalg.norm(offsets, axis=-1).mean(axis=0) <= v1.rho))

    assert reached(0.035) > 0.99 and reached(0.07) < 0.01
    assert 0.3 < reached(0.05) < 0.5


def test_every_marker_is_in_view_wherever_the_arm_can_be() -> None:
    for env_id in V1_IDS:
        env: Any = gym.make(env_id).unwrapped
        low, high = env.arm.limits.T
        hands = []
        for pose in np.random.default_rng(0).uniform(low, high, (400, 4)):
            if env._world.place_arm(pose):
                hands.append(env.arm.end_effector_position)
        for camera in env.cameras:
            pixels = camera.spec.project(np.array(hands))
            assert ((pixels > 0) & (pixels < (319, 239))).all(axis=1).mean() > 0.995
        env.close()


def test_the_distance_in_space_is_told(v1: Any) -> None:
    _, info = v1.reset(seed=0)
    assert info["distance"] == pytest.approx(np.linalg.norm(info["end_effector_position"] - info["target_position"]))


def test_what_is_within_a_hollow_target_is_seen_and_what_is_behind_it_is_not(v1: Any) -> None:
    _, info = v1.reset(seed=0)
    pose, hand = v1.arm.actuated_positions, info["end_effector_position"]

    def red_pixels(target: np.ndarray) -> int:
        v1.reset(options={"joint_positions": pose, "target_position": target})
        frame = v1.render()[:, :320].astype(int)
        return int(((frame[..., 0] > 128) & (frame[..., 2] < 70) & (frame[..., 1] < 70)).sum())

    towards_camera = np.subtract(v1.cameras[0].spec.position, hand)
    towards_camera /= np.linalg.norm(towards_camera)
    alone = red_pixels(hand + np.array([0, 0, 0.5]))
    assert alone > 50
    assert red_pixels(hand) == alone
    assert red_pixels(hand - 0.2 * towards_camera) == alone
    assert red_pixels(hand + 0.2 * towards_camera) == 0


def test_markers_and_cameras_by_name_by_map_and_as_themselves() -> None:
    assert marker_spec("solid") is SOLID and marker_spec("hollow") is HOLLOW and marker_spec(HOLLOW) is HOLLOW
    assert marker_spec({"measure": "circle", "target_radius": 0.05}) == MarkerSpec("circle", target_radius=0.05)
    assert camera_specs(["right"], "close") == CLOSE_PAIR[1:]
    resolved = StereoReachEnv.plain_kwargs({"markers": HOLLOW, "cameras": ["left", CLOSE_PAIR[1]]})
    assert marker_spec(resolved["markers"]) == HOLLOW
    assert resolved["cameras"][0] == "left" and camera_specs(resolved["cameras"], "close") == CLOSE_PAIR
    assert plain_cameras(["left"]) == ["left"]


def test_another_camera_of_a_pair_is_that_of_the_framing() -> None:
    env: Any = gym.make("WamStereoReach-v1", cameras=["left"]).unwrapped
    assert [camera.spec for camera in env.cameras] == [CLOSE_PAIR[0]]
    env.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"markers": "hollo"}, "unknown markers 'hollo'; markers are solid, hollow"),
        ({"markers": {"size": 1}}, "unknown field of markers 'size'; fields are measure, end_effector_radius, "
         "target_radius, standoff, hollow_target"),
        ({"markers": {"measure": "area"}}, "unknown measure of markers 'area'; measures are centroid, circle"),
        ({"markers": {"target_radius": 0}}, "markers: target_radius is 0; give a positive number"),
        ({"markers": 3}, "markers is 3; give a map"),
        ({"framing": "near"}, "unknown framing 'near'; framings are wide, close"),
    ],
)  # fmt: skip
def test_wrong_markers_and_framings_are_explained(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as error:
        StereoReachEnv(**arguments)
    assert str(error.value) == message


def test_ordinary_images_are_measured_as_rendered_frames_are(v1: Any) -> None:
    """Noise, JPEG and warm light, and one marker in front of the other: the circle stays, the centroid does not."""
    rng, errors = np.random.default_rng(0), []
    for seed in range(12):
        hand = v1.reset(seed=seed)[1]["end_effector_position"]
        pose, away = v1.arm.actuated_positions, rng.normal(size=3)
        target = hand + 0.03 * away / np.linalg.norm(away)
        _, info = v1.reset(options={"joint_positions": pose, "target_position": target})
        for view, frame in enumerate(np.hsplit(v1.render(), 2)):
            noisy = frame * (1, 0.85, 0.6) + rng.normal(0, 10, frame.shape)
            image = np.clip(noisy, 0, 255).astype(np.uint8)
            found = v1.locate_markers(view, *detect(image).masks)
            errors.append(np.hypot(*found.offset) - info["pixel_distances"][view])
    known = np.abs(np.array(errors)[np.isfinite(errors)])
    assert len(known) > 16 and known.mean() < 0.6 and np.quantile(known, 0.9) < 1.5
