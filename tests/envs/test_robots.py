"""Your own arm and cameras: from maps and files, and what is said of a wrong one."""

import copy
import pickle
from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from small_arms import joint, link, robot

from sb3_stereo.commands.check import save_frame
from sb3_stereo.config.schema import load_config, parse_config
from sb3_stereo.envs.arm import Arm
from sb3_stereo.envs.cameras import STEREO_PAIR, CameraSpec, camera_specs, mirror_each_other
from sb3_stereo.envs.diagnosis import describe, diagnose
from sb3_stereo.envs.marker_specs import HOLLOW, MarkerSpec
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.robots import ARMS, WAM, ArmSpec, arm_spec
from sb3_stereo.envs.simulation import Client
from sb3_stereo.envs.specs import plain
from sb3_stereo.errors import ConfigError

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
MY_ARM, MY_CAMERAS = str(EXAMPLES / "my_arm.yml"), str(EXAMPLES / "my_cameras.yml")
MINIMAL = {"urdf": "wam.urdf", "joints": ["J1"], "end_effector_link": "palm", "effort_limits": [1], "damping": [1]}


@pytest.mark.parametrize("spec", ARMS.values(), ids=ARMS)
def test_an_arm_survives_yaml(spec: ArmSpec) -> None:
    assert arm_spec(yaml.safe_load(yaml.safe_dump(plain(spec)))) == spec


def test_pairs_may_be_a_map_and_numbers_texts() -> None:
    spec = arm_spec({**MINIMAL, "rest": {"J2": "1e-1"}, "link_colors": {"palm": [0, "5e-1", 1]}})
    assert spec.rest == (("J2", 0.1),)
    assert spec.link_colors == (("palm", (0.0, 0.5, 1.0)),)


SPECS = (WAM, ARMS["panda"], *STEREO_PAIR, HOLLOW)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda spec: pickle.loads(pickle.dumps(spec)), replace])
def test_a_specification_is_a_value(copied: Any) -> None:
    for spec in SPECS:
        assert copied(spec) == spec and hash(copied(spec)) == hash(spec)
    assert len({*SPECS, *map(copied, SPECS)}) == len(SPECS)
    with pytest.raises(FrozenInstanceError):
        WAM.urdf = "other.urdf"  # type: ignore[misc]


def test_numpys_numbers_and_arrays_are_numbers_and_lists() -> None:
    arrays = {"effort_limits": np.array([1]), "damping": [np.int64(1)], "base_position": np.zeros(3, np.float32)}
    spec = arm_spec({**MINIMAL, **arrays, "simple_shapes": np.True_, "joints": np.array(["J1"])})
    assert plain(spec) == plain(ArmSpec(**MINIMAL | {"simple_shapes": True}))
    assert yaml.safe_load(yaml.safe_dump(plain(spec))) == plain(spec)
    assert replace(STEREO_PAIR[0], width=np.int64(160), up=np.array([0, 0, 1])) == replace(STEREO_PAIR[0], width=160)
    with pytest.raises(ValueError) as error:
        replace(WAM, marker_radius=np.True_)
    assert str(error.value) == "arm: marker_radius is True; give a number"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: replace(WAM, colour="red"), "arm has no 'colour'; leave it out"),
        (lambda: ArmSpec("wam.urdf", ("J1",)), "arm lacks 'end_effector_link', 'effort_limits', 'damping'; add them"),
        (lambda: CameraSpec("top"), "camera 'top' lacks 'position'; add it"),
        (lambda: CameraSpec("top", (0, 0)), "camera 'top': position is (0, 0); give 3 numbers"),
        (lambda: MarkerSpec(standoff="far"), "markers: standoff is 'far'; give a number"),
    ],
)
def test_what_is_made_without_a_map_is_explained_as_well(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError) as error:
        make()
    assert str(error.value) == message


def test_cameras_survive_yaml() -> None:
    assert camera_specs(yaml.safe_load(yaml.safe_dump(plain(STEREO_PAIR)))) == STEREO_PAIR


def test_a_robot_file_may_lie_beside_its_yaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.urdf").write_text("<robot/>")
    (tmp_path / "arm.yml").write_text(yaml.safe_dump({**MINIMAL, "urdf": "mine.urdf"}))
    monkeypatch.chdir(tmp_path.parent)
    assert arm_spec(f"{tmp_path.name}/arm.yml").urdf == str(tmp_path / "mine.urdf")


def test_the_examples_make_an_environment() -> None:
    env = StereoReachEnv(arm=MY_ARM, cameras=MY_CAMERAS)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert env.arm.spec.joints == ("joint1", "joint2", "joint3", "joint5")
    assert [camera.spec.name for camera in env.cameras] == ["front", "side"]
    assert env.mirrored_joints is None
    env.close()


def test_a_record_holds_what_the_files_held(tmp_path: Path) -> None:
    config = load_config("ddpg", "WamStereoReach-v0", env_kwargs={"arm": MY_ARM, "cameras": MY_CAMERAS})
    assert config.env_kwargs["arm"]["joints"] == ["joint1", "joint2", "joint3", "joint5"]
    recorded = yaml.safe_load(yaml.safe_dump(config.plain()))
    assert parse_config("ddpg", "WamStereoReach-v0", recorded) == config


def test_what_stands_on_the_floor_does_not_collide_with_it() -> None:
    """The xArm's base is a link of its own on a frame called world."""
    env = StereoReachEnv(arm=MY_ARM)
    env.arm.rest_at([0, 0, 0, 0])
    assert not env.arm.contacts()
    touched = set()
    for pose in np.random.default_rng(0).uniform(*env.arm.limits.T, (50, 4)):
        env.arm.rest_at(pose)
        touched |= env.arm.contacts()
    assert "link5 and the floor" in touched and "link_base and the floor" not in touched
    env.close()


def test_mirrored_cameras_are_recognised() -> None:
    left, right = STEREO_PAIR
    middle = CameraSpec("middle", (3.0, 0.0, 1.0))
    assert mirror_each_other((left, right)) and mirror_each_other((left, middle, right))
    assert not mirror_each_other((left, middle)) and not mirror_each_other((left,))
    assert not mirror_each_other((left, replace(right, horizontal_fov=1.0)))


def test_a_diagnosis_measures_the_wam() -> None:
    env = StereoReachEnv()
    phases: dict[str, list[int]] = {}
    result = diagnose(
        env, n_poses=60, n_steps=30, progress=lambda phase, done, total: phases.setdefault(phase, [total]).append(done)
    )
    assert list(phases) == ["looking at poses", "moving joints", "random agent"]
    assert all(done == list(range(1, total + 1)) for total, *done in phases.values())
    assert result.joints == ("J1", "J2", "J3", "J4") and result.mirrored_joints == ("J1", "J3")
    assert result.mirror_error < 0.1 and result.misplaced == 0.0
    assert 0.7 < result.free < 1.0 and 0.8 < result.seen[0] <= result.seen[1]
    assert np.all((result.travel > 0.5) & (result.travel < 1.3))
    assert sum(share for _, share in result.collisions) >= 1 - result.free
    env.close()


def test_a_diagnosis_sees_a_shell_of_a_markers_colour() -> None:
    red = replace(WAM, link_colors=(("forearm", (1.0, 0.0, 0.0)),))
    env = StereoReachEnv(arm=red)
    assert diagnose(env, n_poses=20, n_steps=1).misplaced > 0.5
    env.close()


def test_a_diagnosis_of_an_arm_that_always_collides_names_the_links() -> None:
    env = StereoReachEnv(arm=replace(ARMS["panda"], collision_exempt=()))
    with pytest.raises(ValueError) as error:
        diagnose(env, n_poses=10)
    assert str(error.value) == (
        "no random pose is free of collisions: panda_hand and panda_link7 touch in 100%; "
        "add links to collision_exempt or change rest"
    )
    env.close()


ERRORS: list[tuple[Any, str]] = [
    ("kua", "unknown arm 'kua'; arms are wam, kuka, panda, or give a .yml file"),
    ("no.yml", "no arm file 'no.yml'; give the path of a YAML file"),
    (3, "arm is 3; give a map"),
    ({"urdf": "wam.urdf"}, "arm lacks 'joints', 'end_effector_link', 'effort_limits', 'damping'; add them"),
    (
        {**MINIMAL, "color": "red"},
        "unknown field of arm 'color'; fields are urdf, joints, end_effector_link, effort_limits, damping, "
        "end_effector_offset, rest, base_position, base_orientation, mirrored_joints, drive_inertia, collision_exempt, "
        "link_colors, simple_shapes, marker_radius, further_joints, suction_cup",
    ),
    ({**MINIMAL, "joints": "J1"}, "arm: joints is 'J1'; give a list of texts"),
    ({**MINIMAL, "damping": ["much"]}, "arm: damping[0] is 'much'; give a number"),
    ({**MINIMAL, "damping": [True]}, "arm: damping[0] is True; give a number"),
    ({**MINIMAL, "damping": [float("nan")]}, "arm: damping[0] is nan; give a finite number"),
    ({**MINIMAL, "base_position": [0, 1]}, "arm: base_position is [0, 1]; give 3 numbers"),
    (
        {**MINIMAL, "base_orientation": [0, 1]},
        "base_orientation is (0.0, 1.0); give roll, pitch and yaw, or a quaternion (x, y, z, w) that is not 0",
    ),
    (
        {**MINIMAL, "base_orientation": [0, 0, 0, 0]},
        "base_orientation is (0.0, 0.0, 0.0, 0.0); "
        "give roll, pitch and yaw, or a quaternion (x, y, z, w) that is not 0",
    ),
    ({**MINIMAL, "rest": 1}, "arm: rest is 1; give a map or a list of pairs"),
    ({**MINIMAL, "rest": [["J2"]]}, "arm: rest[0] is ['J2']; give a pair"),
    ({**MINIMAL, "link_colors": {"palm": [0, 1]}}, "arm: link_colors[0][1] is [0, 1]; give 3 numbers"),
    ({**MINIMAL, "base_position": [0, 0, -2e4]}, "arm: base_position[2] is -20000.0; give at least -10000"),
    ({**MINIMAL, "mirrored_joints": 1}, "arm: mirrored_joints is 1; give a list of texts"),
    ({**MINIMAL, "simple_shapes": 1}, "arm: simple_shapes is 1; give true or false"),
    ({**MINIMAL, "joints": ["J1", "J1"]}, "joints are ('J1', 'J1'); give at least one, each once"),
    ({**MINIMAL, "damping": [1, 2]}, "damping has 2 values for 1 joints; give one each"),
    ({**MINIMAL, "effort_limits": [0]}, "arm: effort_limits[0] is 0; give a positive number"),
    ({**MINIMAL, "damping": [-1]}, "arm: damping[0] is -1; give at least 0"),
    ({**MINIMAL, "marker_radius": 0}, "arm: marker_radius is 0; give a positive number"),
    ({**MINIMAL, "mirrored_joints": ["J2"]}, "unknown one of mirrored_joints 'J2'; the actuated joints are J1"),
    ({**MINIMAL, "rest": {"J1": 0}}, "rest has 'J1', which is actuated; leave it out of one of them"),
]


@pytest.mark.parametrize(("arm", "message"), ERRORS)
def test_a_wrong_arm_is_explained(arm: Any, message: str) -> None:
    with pytest.raises(ValueError) as error:
        arm_spec(arm)
    assert str(error.value) == message


CAMERA = {"name": "left", "position": [1, 1, 1]}


@pytest.mark.parametrize(
    ("cameras", "message"),
    [
        ([], "no cameras; give at least one CameraSpec, or map of one"),
        ("no.yml", "no camera file 'no.yml'; give the path of a YAML file"),
        ([CAMERA, {"name": "right"}], "camera 2 lacks 'position'; add it"),
        ([{**CAMERA, "width": 3.5}], "camera 1: width is 3.5; give an integer"),
        ([{**CAMERA, "near": -1}], "camera 'left': near -1.0, far 10.0; give 0 < near < far"),
        (
            [{**CAMERA, "fov": 1}],
            "unknown field of camera 1 'fov'; fields are name, position, target, up, horizontal_fov, width, height, "
            "near, far",
        ),
    ],
)
def test_a_wrong_camera_is_explained(cameras: Any, message: str) -> None:
    with pytest.raises(ValueError) as error:
        camera_specs(cameras)
    assert str(error.value) == message


def test_what_is_no_yaml_is_explained(tmp_path: Path) -> None:
    file = tmp_path / "arm.yml"
    file.write_text("urdf: [")
    with pytest.raises(ValueError, match=rf"^'{file}' is not plain YAML: "):
        arm_spec(str(file))


def test_a_wrong_arm_is_an_error_before_a_run_directory_is_made() -> None:
    with pytest.raises(ConfigError) as error:
        load_config("ddpg", "WamStereoReach-v0", env_kwargs={"arm": "kua"})
    assert str(error.value) == "unknown arm 'kua'; arms are wam, kuka, panda, or give a .yml file"


DESK = {"arm": str(EXAMPLES / "desk_arm.yml"), "cameras": str(EXAMPLES / "desk_cameras.yml")}


@pytest.mark.parametrize(
    ("orientation", "rotation"),
    [
        ((0.0, 0.0, np.pi / 2), [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        ((np.pi, 0.0, 0.0), [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
        ((np.pi / 2, 0.0, np.pi / 2), [[0, 0, 1], [1, 0, 0], [0, 1, 0]]),  # roll first, about fixed axes
        ((0.0, 0.0, 3.0, 3.0), [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),  # a quaternion of any length
    ],
)
def test_an_orientation_turns_the_whole_arm_about_its_base(
    client: Client, orientation: tuple[float, ...], rotation: Any
) -> None:
    place, pose = (0.1, -0.2, 0.3), [0.3, 0.5, -0.2, 1.0]
    upright, turned = Arm(WAM, client), Arm(replace(WAM, base_orientation=orientation, base_position=place), client)
    for arm in (upright, turned):
        arm.rest_at(pose)
    np.testing.assert_allclose(
        turned.end_effector_position, rotation @ upright.end_effector_position + place, atol=1e-6
    )
    np.testing.assert_allclose(
        turned.chain_positions, upright.chain_positions @ np.transpose(rotation) + place, atol=1e-6
    )


@pytest.mark.parametrize(
    ("orientation", "mirrored"),
    [
        ((0.0, 0.4, 0.0), (0, 2)),  # still in the plane y = 0
        ((0.0, 0.0, np.pi), (0, 2)),
        ((np.pi, 0.0, 0.0), (0, 2)),  # from the ceiling
        ((0.0, 0.0, 0.3), None),
        ((0.2, 0.0, 0.0), None),
        ((0.0, 0.0, np.pi / 2), None),
        ((0.2, 0.0, 0.0, 1.0), None),
    ],
)
def test_an_arm_out_of_the_mirror_plane_is_not_mirrored(
    orientation: tuple[float, ...], mirrored: tuple[int, ...] | None
) -> None:
    env = StereoReachEnv(arm=replace(WAM, base_orientation=orientation, base_position=(0.0, 0.0, 1.0)))
    assert env.mirrored_joints == mirrored
    env.close()


def test_an_arm_whose_file_looks_sideways_may_be_turned_into_the_mirror_plane(tmp_path: Path) -> None:
    """Its own plane is x = 0, as the SO-101's, and is y = 0 once it is mounted."""
    file = robot(
        tmp_path,
        *(link(f"l{k}") for k in range(3)),
        joint("j1", "l0", "l1", "0 0 1"),
        joint("j2", "l1", "l2", "1 0 0"),
        link("hand"),
        joint("h", "l2", "hand", kind="fixed"),
    )
    arm = ArmSpec(file, ("j1", "j2"), "hand", (8, 4), (8, 4), mirrored_joints=("j1",))
    for yaw, mirrored in ((np.pi / 2, (0,)), (0.0, (0,)), (0.7, None)):  # without a yaw the file is believed
        env = StereoReachEnv(arm=replace(arm, base_orientation=(0.0, 0.0, yaw)))
        assert env.mirrored_joints == mirrored
        env.close()


def test_a_desktop_arm_moves_a_radian_per_pulse_and_shows_its_markers() -> None:
    env = StereoReachEnv(**DESK, target_position=(0.22, 0.0, 0.25))
    result = diagnose(env, n_poses=30, n_steps=5)
    assert np.all((result.travel > 0.9) & (result.travel < 1.15))
    assert result.seen[0] > 0.9 and result.misplaced == 0.0 and result.solid and not result.without_shapes
    assert result.mirrored_joints == ("pan",) and result.mirror_error < 0.05 and env.mirrored_joints == (0,)
    env.close()


def sliding_arm(folder: Path, size: float) -> ArmSpec:
    slide = joint("slide", "l0", "l1", "1 0 0", limits=(-0.1, 0.3), kind="prismatic")
    file = robot(folder, link("l0"), *(link(f"l{k}", size=size) for k in (1, 2)), slide, joint("j1", "l1", "l2"))
    return ArmSpec(file, ("slide", "j1"), "l2", (1.0, 8.0), (20.0, 8.0))


def test_a_sliding_joint_is_told_in_millimetres(tmp_path: Path) -> None:
    env = StereoReachEnv(arm=sliding_arm(tmp_path, 0.02))
    lines = describe(diagnose(env, n_poses=20, n_steps=1)).splitlines()
    assert lines[1:3] == [
        "slide                       -100     300      25 mm",
        "j1                         -2.00    2.00    0.50 rad",
    ]
    assert lines[3].startswith("free of collisions: ") and lines[3].endswith("% of random poses")
    env.close()


def test_a_robot_that_nothing_can_touch_is_not_called_free(tmp_path: Path) -> None:
    env = StereoReachEnv(arm=sliding_arm(tmp_path, 0.0))
    result = diagnose(env, n_poses=20, n_steps=1)
    assert not result.solid
    assert describe(result).splitlines()[3] == (
        "free of collisions: not known, as no link that moves has a collision shape and nothing stops it; "
        "add <collision> to the links of the URDF"
    )
    env.close()


def test_a_link_that_is_drawn_and_cannot_be_touched_is_named(tmp_path: Path) -> None:
    arm = sliding_arm(tmp_path, 0.02)
    text = Path(arm.urdf).read_text().rpartition("<collision>")
    Path(arm.urdf).write_text(text[0] + text[2].partition("</collision>")[2])
    env = StereoReachEnv(arm=arm)
    assert "  without a collision shape: l2" in describe(diagnose(env, n_poses=20, n_steps=1)).splitlines()
    env.close()


def test_a_reset_that_finds_no_free_pose_names_what_touches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sb3_stereo.envs.starts.MAX_DRAWS", 20)
    for random_target in (False, True):
        env = StereoReachEnv(arm=replace(ARMS["panda"], collision_exempt=()), random_target=random_target)
        with pytest.raises(ValueError) as error:
            env.reset(seed=0)
        assert str(error.value) == (
            "no random pose is free of collisions: panda_hand and panda_link7 touch in 100%; "
            "add links to collision_exempt or change rest"
        )
        env.close()


def test_check_draws_an_arm_before_any_reset_and_where_it_collides(tmp_path: Path) -> None:
    import cv2

    env = StereoReachEnv(render_mode="rgb_array", arm=replace(ARMS["panda"], collision_exempt=()))
    save_frame(env, str(tmp_path / "arm.png"))
    picture = cv2.imread(str(tmp_path / "arm.png"))
    assert picture is not None and picture.shape[0] > 360 and picture.shape[1] > 2 * 480
    blue, green, red = picture[..., 0].astype(int), picture[..., 1].astype(int), picture[..., 2].astype(int)
    assert (red > green + 100).any() and (blue > green + 100).any()  # both markers
    env.close()
