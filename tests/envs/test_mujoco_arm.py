"""An arm in MuJoCo moves as it does in Bullet."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_arms import joint, link, robot, two_links

from sb3_stereo.envs.arm import Arm
from sb3_stereo.envs.robots import ARMS, WAM, ArmSpec
from sb3_stereo.envs.simulation import Client

mujoco = pytest.importorskip("mujoco")

from sb3_stereo.envs.mujoco_arm import MujocoArm  # noqa: E402
from sb3_stereo.envs.mujoco_model import Around, build_model  # noqa: E402

ALONE = Around(radii=(0.035, 0.045), hollow_target=True, n_things=0)
WITHOUT_DRIVES = replace(WAM, drive_inertia=())


def arm_of(spec: ArmSpec, gravity: float = 0.0) -> tuple[MujocoArm, Any, Any]:
    model = build_model(spec, ALONE, 240.0)
    model.compiled.opt.gravity[:] = (0.0, 0.0, -gravity)
    data = mujoco.MjData(model.compiled)
    return MujocoArm(spec, model, data), model.compiled, data


def bullet_pulse(client: Client, arm: Arm, pose: Any, efforts: Any) -> Any:
    arm.rest_at(pose)
    arm.push(list(efforts), 120)
    return arm.actuated_positions - pose


def mujoco_pulse(arm: MujocoArm, pose: Any, efforts: Any) -> Any:
    arm.rest_at(pose)
    arm.push(list(efforts), 120)
    return arm.actuated_positions - pose


def poses_of(arm: Any, n: int, seed: int = 0) -> Any:
    low, high = arm.limits.T
    return np.random.default_rng(seed).uniform(low, high, (n, len(low)))


@pytest.mark.parametrize("name", ARMS)
def test_all_links_are_where_bullet_has_them(client: Client, name: str) -> None:
    spec = replace(ARMS[name], base_position=(0.1, -0.2, 0.3), base_orientation=(0.1, -0.2, 0.5))
    bullet, (twin, _, _) = Arm(spec, client), arm_of(spec)
    np.testing.assert_allclose(twin.limits, bullet.limits, atol=1e-6)
    np.testing.assert_allclose(twin.base_to_world, bullet.base_to_world, atol=1e-6)
    for pose in poses_of(bullet, 20):
        bullet.rest_at(pose)
        twin.rest_at(pose)
        np.testing.assert_allclose(twin.joint_positions, bullet.joint_positions, atol=1e-6)
        np.testing.assert_allclose(twin.chain_positions, bullet.chain_positions, atol=1e-5)
        np.testing.assert_allclose(twin.end_effector_position, bullet.end_effector_position, atol=1e-5)


@pytest.mark.parametrize("name", ARMS)
def test_the_links_weigh_what_they_weigh_in_bullet(client: Client, name: str) -> None:
    """Mass matrices of all moving joints, without the drives' inertia: MuJoCo gives that to the joints alone."""
    spec = replace(ARMS[name], drive_inertia=())
    bullet, (twin, model, data) = Arm(spec, client), arm_of(spec)
    mass = np.zeros((model.nv, model.nv))
    for pose in poses_of(bullet, 10):
        bullet.rest_at(pose)
        twin.rest_at(pose)
        mujoco.mj_forward(model, data)
        for column, unit in zip(mass, np.eye(model.nv), strict=True):  # the matrix is symmetric
            mujoco.mj_mulM(model, data, column, unit)
        expected = np.array(client.calculateMassMatrix(bullet.body, bullet.joint_positions.tolist()))
        np.testing.assert_allclose(mass, expected, atol=2e-3 * np.abs(expected).max())


def test_a_drive_is_felt_by_its_joint_alone() -> None:
    (_, with_drives, _), (_, without, _) = arm_of(WAM), arm_of(WITHOUT_DRIVES)
    added = with_drives.dof_armature - without.dof_armature
    np.testing.assert_allclose(added, [0.2052, 0.1888, 0.0669, 0.0346, 0.00323, 0.00323, 0.000317], rtol=1e-9)


def test_a_pulse_moves_a_free_joint_as_far_as_in_bullet(client: Client) -> None:
    """Without drives, and away from stops, within 0.01 % of how far the pulse moves the arm."""
    bullet, (twin, _, _) = Arm(WITHOUT_DRIVES, client), arm_of(WITHOUT_DRIVES)
    for pose in poses_of(bullet, 20, seed=1) * 0.3:
        for joint_number in range(4):
            efforts = np.zeros(4)
            efforts[joint_number] = 0.5 * WAM.effort_limits[joint_number]
            moved, expected = mujoco_pulse(twin, pose, efforts), bullet_pulse(client, bullet, pose, efforts)
            np.testing.assert_allclose(moved, expected, atol=1e-4 * np.abs(expected).max())


def test_with_its_drives_a_pulse_moves_an_arm_nearly_as_far(client: Client) -> None:
    """Bullet adds their inertia to the links, where earlier joints feel it too: within 5 %."""
    bullet, (twin, _, _) = Arm(WAM, client), arm_of(WAM)
    for pose in poses_of(bullet, 20, seed=2) * 0.3:
        efforts = 0.3 * np.random.default_rng(3).uniform(-1, 1, 4) * WAM.effort_limits
        moved, expected = mujoco_pulse(twin, pose, efforts), bullet_pulse(client, bullet, pose, efforts)
        assert np.linalg.norm(moved - expected) < 0.05 * np.linalg.norm(expected)


def test_stops_hold() -> None:
    arm, _, _ = arm_of(WAM)
    for sign, stop in ((-1, 0), (1, 1)):
        arm.rest_at([0.0] * 4)
        for _ in range(10):
            arm.push([sign * effort for effort in WAM.effort_limits], 120)
        assert np.abs(arm.actuated_positions - arm.limits[:, stop]).max() < 0.02
        assert (sign * (arm.actuated_positions - arm.limits[:, stop]) < 0.005).all()


def test_joints_that_are_not_actuated_are_held() -> None:
    arm, _, _ = arm_of(replace(WAM, rest=(("J5", 0.5), ("J6", -0.4))))
    arm.rest_at((0.3, -0.5, 0.2, 1.0))
    np.testing.assert_allclose(arm.joint_positions[4:], (0.5, -0.4, 0.0), atol=1e-12)
    arm.push(WAM.effort_limits, 120)
    np.testing.assert_allclose(arm.joint_positions[4:], (0.5, -0.4, 0.0), atol=2e-3)


def test_a_mimic_joint_follows(tmp_path: Path) -> None:
    follower = joint("j2", "l1", "l2", more='<mimic joint="j1" multiplier="-0.5" offset="0.2"/>')
    urdf = robot(tmp_path, *(link(f"l{k}") for k in range(3)), joint("j1", "l0", "l1"), follower)
    spec = ArmSpec(urdf=urdf, joints=("j1",), end_effector_link="l2", effort_limits=(0.05,), damping=(0.05,))
    arm, _, _ = arm_of(spec)
    arm.rest_at((0.4,))
    np.testing.assert_allclose(arm.joint_positions, (0.4, 0.0), atol=1e-12)
    arm.push((0.05,), 120)
    assert arm.joint_positions[0] > 0.6
    np.testing.assert_allclose(arm.joint_positions[1], 0.2 - 0.5 * arm.joint_positions[0], atol=2e-3)


def test_a_light_arm_moves_as_far_as_in_bullet(client: Client, tmp_path: Path) -> None:
    """Where damping is far above what an explicit integration takes."""
    urdf = two_links(tmp_path)
    spec = ArmSpec(urdf=urdf, joints=("j1", "j2"), end_effector_link="l2", effort_limits=(1, 1), damping=(1.0, 1.0))
    moved = mujoco_pulse(arm_of(spec)[0], np.zeros(2), (1.0, -0.5))
    np.testing.assert_allclose(moved, bullet_pulse(client, Arm(spec, client), np.zeros(2), (1.0, -0.5)), atol=0.01)


def test_a_resting_weightless_arm_stays_and_a_heavy_one_falls() -> None:
    for gravity, falls in ((0.0, False), (9.81, True)):
        arm, _, _ = arm_of(WAM, gravity)
        assert (np.abs(mujoco_pulse(arm, np.array((0.0, 1.0, 0.0, 0.5)), [0.0] * 4)).max() > 0.1) == falls


def test_parts_of_a_pulse_are_the_pulse() -> None:
    arm, _, _ = arm_of(WAM)
    whole, parts = mujoco_pulse(arm, np.zeros(4), WAM.effort_limits), []
    arm.rest_at(np.zeros(4))
    arm.push(WAM.effort_limits, 120, lambda part: parts.append((part, arm.end_effector_position)), 7)
    np.testing.assert_array_equal(arm.actuated_positions, whole)
    assert [part for part, _ in parts] == [1, 2, 3, 4, 5, 6]
    assert all(np.linalg.norm(after - before) > 0 for (_, before), (_, after) in pairwise(parts))


@pytest.mark.parametrize("name", ARMS)
def test_what_touches_in_bullet_touches(client: Client, name: str) -> None:
    """But for grazing: both agree in 95 % of the poses."""
    bullet, (twin, _, _) = Arm(ARMS[name], client), arm_of(ARMS[name])
    collides = []
    for pose in poses_of(bullet, 100):
        bullet.rest_at(pose)
        twin.rest_at(pose)
        alone = {pair for pair in twin.contacts() if "the floor" not in pair}  # Bullet has none in this test
        collides.append((bullet.collides(), bool(alone)))
    assert np.mean([one == other for one, other in collides]) >= 0.95


def test_a_mesh_that_mujoco_does_not_read_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "shell.dae").write_text("")
    shell = '<link name="l0"><visual><geometry><mesh filename="shell.dae"/></geometry></visual></link>'
    urdf = robot(tmp_path, shell, link("l1"), joint("j1", "l0", "l1"))
    spec = ArmSpec(urdf=urdf, joints=("j1",), end_effector_link="l1", effort_limits=(1,), damping=(1,))
    with pytest.raises(ValueError) as error:
        arm_of(spec)
    expected = f"MuJoCo reads no mesh such as 'shell.dae' of '{urdf}'; convert it to .obj, .stl, .msh"
    assert str(error.value) == expected


def test_a_link_may_be_named_world(client: Client, tmp_path: Path) -> None:
    parts = link("world"), link("l1"), link("l2"), joint("j1", "world", "l1"), joint("j2", "l1", "l2", "1 0 0")
    spec = ArmSpec(
        urdf=robot(tmp_path, *parts),
        joints=("j1", "j2"),
        end_effector_link="l2",
        effort_limits=(1, 1),
        damping=(1, 1),
        base_position=(0.1, 0.2, 0.3),
        collision_exempt=(("world", "l2"),),
        link_colors=(("world", (0.2, 0.3, 0.4)),),
    )
    bullet, (twin, _, _) = Arm(spec, client), arm_of(spec)
    for arm in (bullet, twin):
        arm.rest_at((0.4, -0.3))
    np.testing.assert_allclose(twin.end_effector_position, bullet.end_effector_position, atol=1e-6)
