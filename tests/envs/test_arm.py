"""Any arm: poses, pulses, brakes, limits, and what is said of a wrong one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sb3_stereo.envs.arm import Arm
from sb3_stereo.envs.bullet import pybullet
from sb3_stereo.envs.robots import ARMS, WAM, ArmSpec
from sb3_stereo.envs.simulation import Client


@pytest.mark.parametrize(("name", "elbow"), [("wam", 0.8), ("kuka", 0.8), ("panda", -1.5)])
def test_a_full_pulse_moves_each_joint_by_about_a_radian(name: str, elbow: float, client: Client) -> None:
    spec = ARMS[name]
    arm = Arm(spec, client)
    for joint, limit in enumerate(spec.effort_limits):
        for sign in (1, -1):
            start = np.array([0.0, 0.3, 0.0, elbow])
            arm.rest_at(start)
            efforts = [0.0] * 4
            efforts[joint] = sign * limit
            arm.push(efforts, 120)
            assert 0.75 < sign * (arm.actuated_positions[joint] - start[joint]) < 1.35


@pytest.mark.parametrize("spec", ARMS.values(), ids=ARMS)
def test_the_other_joints_rest_where_they_are_told(spec: ArmSpec, client: Client) -> None:
    arm = Arm(spec, client)
    arm.rest_at(arm.limits.mean(axis=1))
    rest = dict(spec.rest)
    for _ in range(3):
        arm.push(list(spec.effort_limits), 120)
        arm.brake()
        for joint in range(client.getNumJoints(arm.body)):
            info = client.getJointInfo(arm.body, joint)
            if info[2] != pybullet.JOINT_FIXED and joint not in arm.actuated:
                assert client.getJointState(arm.body, joint)[0] == rest.get(info[1].decode(), 0.0)


def test_the_base_stands_where_it_is_told(client: Client) -> None:
    positions = []
    for place in ((0.0, 0.0, 0.0), (0.1, -0.2, 0.3)):
        arm = Arm(replace(WAM, base_position=place), client)
        arm.rest_at([0.3, 0.5, -0.2, 1.0])
        positions.append(arm.end_effector_position)
    np.testing.assert_allclose(positions[1] - positions[0], (0.1, -0.2, 0.3), atol=1e-6)


def test_colours_are_those_of_the_spec(client: Client) -> None:
    arm = Arm(replace(WAM, link_colors=(("base", (0.1, 0.2, 0.3)), ("palm", (0.4, 0.5, 0.6)))), client)
    shapes = client.getVisualShapeData(arm.body)
    for link, colour in ((-1, (0.1, 0.2, 0.3, 1.0)), (7, (0.4, 0.5, 0.6, 1.0))):
        for shape in shapes:
            if shape[1] == link:
                np.testing.assert_allclose(shape[7], colour, atol=1e-6)


def test_a_joint_without_limits_turns_once_around(client: Client, tmp_path: Path) -> None:
    inertia = '<mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    links = "".join(f'<link name="{name}"><inertial>{inertia}</inertial></link>' for name in ("base", "hand"))
    joint = '<joint name="turn" type="continuous"><parent link="base"/><child link="hand"/><axis xyz="0 0 1"/></joint>'
    (tmp_path / "wheel.urdf").write_text(f'<robot name="wheel">{links}{joint}</robot>')
    spec = ArmSpec(str(tmp_path / "wheel.urdf"), ("turn",), "hand", (1.0,), (1.0,))
    np.testing.assert_allclose(Arm(spec, client).limits, [[-np.pi, np.pi]])


def test_joint_limits_hold_under_full_effort(client: Client) -> None:
    arm = Arm(WAM, client)
    low, high = arm.limits.T
    for sign in (1, -1):
        arm.rest_at([0, 0, 0, 0.5])
        arm.push([sign * limit for limit in WAM.effort_limits], 2400)
        q = arm.joint_positions[:4]
        assert np.all(low - 0.01 <= q) and np.all(q <= high + 0.01)


def test_the_wrist_stays_at_zero(client: Client) -> None:
    arm = Arm(WAM, client)
    rng = np.random.default_rng(0)
    for _ in range(10):
        arm.push((rng.uniform(-1, 1, 4) * WAM.effort_limits).tolist(), 120)
        np.testing.assert_allclose(arm.joint_positions[4:], 0, atol=5e-3)
        arm.brake()
        np.testing.assert_array_equal(arm.joint_positions[4:], 0)


def test_braking_keeps_the_pose_and_stops_the_arm(client: Client) -> None:
    arm = Arm(WAM, client)
    arm.push(list(WAM.effort_limits), 60)
    moving = arm.joint_positions
    arm.brake()
    np.testing.assert_array_equal(arm.joint_positions[:4], moving[:4])
    assert not any(state[1] for state in client.getJointStates(arm.body, arm.actuated))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"urdf": "nothing.urdf"},
            "no robot file 'nothing.urdf'; give a path, or a URDF of envs/assets or of pybullet_data",
        ),
        (
            {"joints": ("J1", "J2", "J3", "elbow")},
            "unknown joint 'elbow'; the robot's moving ones are J1, J2, J3, J4, J5, J6, J7",
        ),
        (
            {"end_effector_link": "hand"},
            "unknown link 'hand'; the robot's moving ones are shoulder_yaw, shoulder_pitch, shoulder_pitch_drive, "
            "upper_arm, forearm, wrist_yaw, wrist_pitch, palm",
        ),
        (
            {"rest": (("J8", 0.0),)},
            "unknown joint 'J8'; the robot's moving ones are J1, J2, J3, J4, J5, J6, J7",
        ),
        (
            {"link_colors": (("hand", (0.5, 0.5, 0.5)),)},
            "unknown link 'hand'; the robot's are base, shoulder_yaw, shoulder_pitch, shoulder_pitch_drive, upper_arm, "
            "forearm, wrist_yaw, wrist_pitch, palm",
        ),
    ],
)
def test_a_wrong_spec_names_the_choices(client: Client, change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError) as error:
        Arm(replace(WAM, **change), client)  # type: ignore[arg-type]
    assert str(error.value) == message


WHEEL = """<robot name="wheel"><link name="stand"/>
<link name="hand"><inertial><mass value="{mass}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
</link><joint name="turn" type="{kind}"><parent link="stand"/><child link="hand"/><axis xyz="0 0 1"/>
<limit lower="{low}" upper="1" effort="1" velocity="1"/></joint></robot>"""


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": "nan"}, "{file} has a mass, an inertia, an origin or an axis of no robot; check them"),
        ({"mass": "-1"}, "{file} has a mass, an inertia, an origin or an axis of no robot; check them"),
        ({"low": "-1e300"}, "joint 'turn' of {file} has a limit of 1e+300; give at most 1000"),
        ({"kind": "spherical"}, "joint 'turn' of {file} neither turns nor slides; use revolute and prismatic joints"),
    ],
)
def test_a_file_of_no_robot_is_explained(client: Client, tmp_path: Path, change: dict[str, str], message: str) -> None:
    file = tmp_path / "wheel.urdf"
    file.write_text(WHEEL.format(**{"mass": "1", "low": "-1", "kind": "revolute"} | change))
    with pytest.raises(ValueError) as error:
        Arm(ArmSpec(str(file), ("turn",), "hand", (1.0,), (1.0,)), client)
    assert str(error.value) == message.format(file=repr(str(file)))


def test_pybullet_returns_arrays() -> None:
    assert pybullet.isNumpyEnabled(), "a PyBullet without NumPy draws ten times slower"
