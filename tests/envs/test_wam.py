"""The WAM model against Barrett's published numbers and the laws of mechanics."""

import xml.etree.ElementTree as ET
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from sb3_stereo.envs.arm import Arm
from sb3_stereo.envs.robots import WAM
from sb3_stereo.envs.simulation import Client

ALL_JOINTS = replace(WAM.actuating(7), effort_limits=(1.0,) * 7, damping=(0.0,) * 7)
# Bullet's inverse dynamics refuses tensors that no mass distribution has, as drives make them.
WITHOUT_DRIVES = replace(ALL_JOINTS, drive_inertia=())
LIGHT_IN_SHADE = 0.75  # the cameras' ambient share


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
