"""Light joints move as their damping says, at any time step."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_arms import joint, link, robot, two_links

from sb3_stereo.envs.arm import Arm
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.robots import ARMS, ArmSpec
from sb3_stereo.envs.simulation import Client

GRAVITY = (0.0, 0.0, -9.81)


def spec(urdf: str, n_joints: int = 2) -> ArmSpec:
    joints = tuple(f"j{k}" for k in range(1, n_joints + 1))
    return ArmSpec(urdf, joints, f"l{n_joints}", (8.0, 4.0, 4.0)[:n_joints], (8.0, 4.0, 4.0)[:n_joints])


def travel(
    arm_spec: ArmSpec, rate: int, start: Sequence[float], efforts: Sequence[float], gravity: Sequence[float] = (0, 0, 0)
) -> np.ndarray:
    """How far a push of half a second moves the joints."""
    client = Client()
    client.setTimeStep(1 / rate)
    client.setGravity(*gravity)
    arm = Arm(arm_spec, client)
    arm.rest_at(start)
    arm.push(list(efforts), rate // 2)
    moved = arm.actuated_positions - start
    client.close()
    return moved


@pytest.mark.parametrize("inertia", [1e-6, 1e-4, 0.015, 0.05, 2.0])
@pytest.mark.parametrize("gravity", [(0, 0, 0), GRAVITY])
def test_a_damped_joint_turns_as_calculus_says(tmp_path: Path, inertia: float, gravity: Sequence[float]) -> None:
    """About an upright axis through its centre of mass: q(t) = (effort / damping) * (t - T * (1 - exp(-t / T)))."""
    turn = joint("j1", "l0", "l1", "0 0 1", limits=(-9, 9))
    urdf = robot(tmp_path, link("l0"), link("l1", inertia=inertia), turn)
    lag = inertia / 8.0
    expected = 1.0 * (0.5 - lag * (1 - np.exp(-0.5 / lag)))
    assert travel(spec(urdf, 1), 240, [0.0], [8.0], gravity)[0] == pytest.approx(expected, rel=0.02)


def test_a_full_pulse_of_two_light_links_moves_one_joint_by_effort_over_damping(tmp_path: Path) -> None:
    env = StereoReachEnv(arm=spec(two_links(tmp_path)))
    start = env.reset(options={"joint_positions": [0.0, 0.1]})[1]["joint_positions"]
    moved = env.step([0.0, 1.0])[4]["joint_positions"] - start
    np.testing.assert_allclose(moved, [0.0, 0.5], atol=0.005)
    env.close()


def test_a_finer_time_step_changes_little(tmp_path: Path) -> None:
    arm = spec(two_links(tmp_path))
    moved = [travel(arm, rate, [0.3, -0.7], [8.0, 4.0]) for rate in (240, 480, 24_000)]
    np.testing.assert_allclose(moved[0], moved[1], rtol=0.01)
    np.testing.assert_allclose(moved[0], moved[2], rtol=0.02)  # Bullet's own damping, stable at this rate


def test_a_joint_at_its_stop_does_not_hold_up_the_others(tmp_path: Path) -> None:
    arm = spec(two_links(tmp_path))
    moved = [travel(arm, rate, [0.3, 1.9], [8.0, 4.0]) for rate in (240, 24_000)]
    np.testing.assert_allclose(moved[0], moved[1], atol=0.005)
    assert moved[0][1] == pytest.approx(0.1, abs=0.002)


@pytest.mark.parametrize("orientation", [(0.0, 0.0, 0.0), (0.9, -0.4, 0.3)])
def test_a_light_arm_sinks_under_its_weight_as_with_fine_steps(tmp_path: Path, orientation: tuple[float, ...]) -> None:
    weak = replace(spec(two_links(tmp_path)), damping=(0.4, 0.2), base_orientation=orientation)
    moved = [travel(weak, rate, [0.3, 0.7], [0.1, 0.05], GRAVITY) for rate in (240, 24_000)]
    assert np.abs(moved[0]).max() > 0.1
    np.testing.assert_allclose(moved[0], moved[1], rtol=0.02, atol=0.002)


@pytest.mark.parametrize("orientation", [(0.0, 0.0, 0.0), (0.9, -0.4, 0.3)])
def test_drives_slow_a_light_arm_as_with_fine_steps(tmp_path: Path, orientation: tuple[float, ...]) -> None:
    drives = (("l1", (0.0, 0.3, 0.4)), ("l2", (0.0, 0.002, 0.001)))
    driven = replace(spec(two_links(tmp_path)), drive_inertia=drives, base_orientation=orientation)
    client = Client()
    client.setTimeStep(1 / 240)
    assert Arm(driven, client)._damping is not None  # the drive of l2 is too light for 240 Hz
    moved = [travel(driven, rate, [0.3, 0.7], [8.0, 4.0]) for rate in (240, 24_000)]
    assert moved[1][0] < 0.47  # slower than without drives
    np.testing.assert_allclose(moved[0], moved[1], rtol=0.02)
    client.close()


@pytest.mark.parametrize("name", ARMS)
def test_the_arms_that_come_with_it_are_damped_by_bullet(name: str, client: Client) -> None:
    """Their recorded results rest on it."""
    assert Arm(ARMS[name], client)._damping is None


def test_more_damping_than_bullet_can_take_is_still_damping() -> None:
    env = StereoReachEnv(damping=[800.0, 1000.0, 400.0, 200.0])
    start = env.reset(options={"joint_positions": [0.1, 0.5, 0.2, 0.9]})[1]["joint_positions"]
    moved = env.step([1.0, 1.0, 1.0, 1.0])[4]["joint_positions"] - start
    np.testing.assert_allclose(moved[:4], 0.5 * np.array([20, 30, 10, 5]) / [800, 1000, 400, 200], rtol=0.05)
    env.close()
