"""The WAM model against Barrett's published numbers and the laws of mechanics."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pybullet
import pytest

from sb3_stereo.envs.arm import Arm
from sb3_stereo.envs.robots import ARMS, WAM, ArmSpec
from sb3_stereo.envs.simulation import Client

ALL_JOINTS = replace(
    WAM, joints=("J1", "J2", "J3", "J4", "J5", "J6", "J7"), effort_limits=(1.0,) * 7, damping=(0.0,) * 7
)
# Bullet's inverse dynamics refuses tensors that no mass distribution has, as drives make them.
WITHOUT_DRIVES = replace(ALL_JOINTS, drive_inertia=())
LIGHT_IN_SHADE = 0.75  # the cameras' ambient share


@pytest.fixture
def client() -> Iterator[Client]:
    client = Client()
    client.setTimeStep(1 / 240)
    yield client
    client.close()


@pytest.mark.parametrize(
    ("q", "tool"),
    [
        ((0, 0, 0, 0, 0, 0, 0), (0, 0, 1.2569)),
        ((0, 1.0, 0, 1.5, 0, 0, 0), (0.739163, 0, 0.343099)),
        ((0, np.pi / 2, 0, 0, 0, 0, 0), (0.9109, 0, 0.346)),
        ((0, 0, 0, np.pi / 2, 0, 0, 0), (0.4059, 0, 0.941)),
        ((0.5, 0.8, -0.6, 1.2, 0.4, -0.7, 0.9), (0.736231, 0.169963, 0.675073)),
    ],
)
def test_forward_kinematics_is_barretts(client: Client, q: tuple[float, ...], tool: tuple[float, ...]) -> None:
    arm = Arm(ALL_JOINTS, client)
    arm.rest_at(q)
    np.testing.assert_allclose(arm.end_effector_position, tool, atol=1e-6)


def dh(q: np.ndarray) -> np.ndarray:
    """Tool position by Barrett's DH table, in [m] from the base's bottom: an independent closed form."""
    transform = np.eye(4)
    transform[2, 3] = 0.346
    half = np.pi / 2
    table = [(0, -half, 0), (0, half, 0), (0.045, -half, 0.55), (-0.045, half, 0), (0, -half, 0.3), (0, half, 0)]
    for theta, (a, alpha, d) in zip(q, [*table, (0, 0, 0.0609)], strict=True):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        transform = transform @ np.array(
            [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    return transform[:3, 3]


def test_forward_kinematics_is_the_dh_table_everywhere(client: Client) -> None:
    arm = Arm(ALL_JOINTS, client)
    low, high = arm.limits.T
    for q in np.random.default_rng(0).uniform(low, high, (200, 7)):
        arm.rest_at(q)
        np.testing.assert_allclose(arm.end_effector_position, dh(q), atol=1e-6)


def test_joint_limits_are_barretts(client: Client) -> None:
    expected = [(-2.6, 2.6), (-2.0, 2.0), (-2.8, 2.8), (-0.9, 3.1), (-4.76, 1.24), (-1.6, 1.6), (-3.0, 3.0)]
    np.testing.assert_allclose(Arm(ALL_JOINTS, client).limits, expected)


def test_gravity_torques_of_the_horizontal_arm_are_the_published_ones(client: Client) -> None:
    client.setGravity(0, 0, -9.81)
    arm = Arm(WITHOUT_DRIVES, client)
    torques = client.calculateInverseDynamics(arm.body, [0, np.pi / 2, 0, 0, 0, 0, 0], [0] * 7, [0] * 7)
    assert abs(torques[1]) == pytest.approx(27.94, rel=1e-3)
    assert abs(torques[3]) == pytest.approx(0.51524 * 9.81, rel=1e-3)  # AC-02's static moment about the elbow


def urdf_inertias() -> dict[str, np.ndarray]:
    root = ET.fromstring((files("sb3_stereo.envs") / "assets" / "wam.urdf").read_text())
    tensors = {}
    for link in root.iter("link"):
        i = {key: float(value) for key, value in link.find("inertial/inertia").attrib.items()}  # type: ignore[union-attr]
        rows = [[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]], [i["ixz"], i["iyz"], i["izz"]]]
        tensors[link.attrib["name"]] = np.array(rows)
    return tensors


def test_every_inertia_is_positive_definite_and_physical() -> None:
    tensors = urdf_inertias()
    assert not tensors.pop("shoulder_pitch_drive").any()  # a frame for the drive, without mass
    for name, tensor in tensors.items():
        small, middle, large = np.linalg.eigvalsh(tensor)
        assert small > 0, name
        assert large <= small + middle, name  # no mass distribution has another tensor


def mass_matrix(arm: Arm, client: Client, q: list[float]) -> np.ndarray:
    """What the simulation has: the inverse of the accelerations that unit efforts give, shape (7, 7)."""
    client.setTimeStep(1e-6)
    accelerations = []
    for effort in np.eye(7):
        arm.rest_at(q)
        arm.push(effort.tolist(), 1)
        accelerations.append([state[1] / 1e-6 for state in client.getJointStates(arm.body, arm.actuated)])
    return np.linalg.inv(accelerations)


def test_simulated_mass_matrix_is_that_of_the_published_inertias() -> None:
    client = Client()
    arm = Arm(WITHOUT_DRIVES, client)
    q = [0.0, 0.3, 0.2, 0.8, 0.1, 0.4, 0.0]
    np.testing.assert_allclose(mass_matrix(arm, client, q), client.calculateMassMatrix(arm.body, q), atol=1e-4)
    client.close()


def test_drive_inertia_is_added_about_each_joints_axis() -> None:
    matrices = []
    for spec in (ALL_JOINTS, WITHOUT_DRIVES):
        client = Client()
        # Pitched by a right angle, J1's axis is none of the links' that turn about their length.
        matrices.append(mass_matrix(Arm(spec, client), client, [0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0]))
        client.close()
    gain = np.diag(matrices[0] - matrices[1])
    own = np.array([0.2052, 0.1888, 0.0669, 0.0346, 0.00323, 0.00323, 0.000317])
    # A drive turns with its link, so the joints before it feel it too: J2 the drives of J4 and J6 here.
    carried = np.array([0.0, 0.0346 + 0.00323, 0.00323 + 0.000317, 0.00323, 0.000317, 0.0, 0.0])
    np.testing.assert_allclose(gain, own + carried, atol=0.006)


def test_energy_is_kept_without_damping_and_efforts(client: Client) -> None:
    client.setGravity(0, 0, 0)
    client.setTimeStep(1e-4)
    arm = Arm(WITHOUT_DRIVES, client)
    q = [0.1, 0.4, -0.3, 0.9, 0.2, 0.3, -0.2]
    speeds = [0.3, -0.2, 0.3, 0.4, 0.1, -0.3, 0.2]
    for joint, (position, speed) in enumerate(zip(q, speeds, strict=True)):
        client.resetJointState(arm.body, arm.actuated[joint], position, speed)

    def energy() -> float:
        states = client.getJointStates(arm.body, arm.actuated)
        velocity = np.array([state[1] for state in states])
        mass = np.array(client.calculateMassMatrix(arm.body, [state[0] for state in states]))
        return float(velocity @ mass @ velocity / 2)

    before = energy()
    arm.push([0.0] * 7, 2000)
    assert energy() == pytest.approx(before, rel=2e-3)


def test_free_motion_is_ideal_gravity_compensation() -> None:
    """Cancelling the weight at every instant is the motion without gravity, as the environment simulates it."""

    def final_pose(rate: int, gravity: float) -> np.ndarray:
        client = Client()
        client.setTimeStep(1 / rate)
        client.setGravity(0, 0, gravity)
        arm = Arm(WITHOUT_DRIVES, client)
        arm.set_damping([8, 10, 4, 2, 1, 1, 1])
        arm.rest_at([0.2, 0.5, -0.4, 1.0, 0, 0, 0])
        for _ in range(rate // 2):
            weight = client.calculateInverseDynamics(arm.body, arm.joint_positions.tolist(), [0.0] * 7, [0.0] * 7)
            arm.push([w + e for w, e in zip(weight, [10, -10, 5, 3, 0, 0, 0], strict=True)], 1)
        pose = arm.joint_positions
        client.close()
        return pose

    np.testing.assert_allclose(final_pose(2000, -9.81), final_pose(2000, 0.0), atol=2e-3)


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


def test_folding_through_itself_collides_and_standing_up_does_not(client: Client) -> None:
    arm = Arm(WAM, client)
    arm.rest_at([0, 0, 0, 0])
    assert not arm.collides()
    arm.rest_at([-1.36, -1.98, -2.62, 3.06])  # the wrist inside the base
    assert arm.collides()


def test_shells_and_markers_keep_apart_in_luminance() -> None:
    root = ET.fromstring((files("sb3_stereo.envs") / "assets" / "wam.urdf").read_text())
    tones = [float(colour.attrib["rgba"].split()[0]) for colour in root.iter("color")]
    assert len(tones) == 3
    red, blue = 0.299, 0.114
    for tone in tones:
        assert tone * LIGHT_IN_SHADE > red + 0.01 > blue + 0.01  # the darkest lit shell is lighter than the red


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
