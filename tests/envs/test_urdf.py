"""What is said of a file that is no robot, and what its mimic joints do."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_arms import joint, link, robot

from sb3_stereo.envs.arm import Arm
from sb3_stereo.envs.reach import StereoReachEnv
from sb3_stereo.envs.robots import ArmSpec, arm_spec
from sb3_stereo.envs.simulation import Client

LINKS = "".join(link(f"l{k}") for k in range(3))
JOINTS = joint("j1", "l0", "l1") + joint("j2", "l1", "l2")
COLLISION = '<collision><geometry><mesh filename="b.stl"/></geometry></collision>'
XACRO = "it is xacro, not yet URDF; expand it with `xacro FILE > robot.urdf` and give robot.urdf"


def mesh(name: str, kind: str = "collision") -> str:
    return LINKS.replace("</link>", f'<{kind}><geometry><mesh filename="{name}"/></geometry></{kind}></link>', 1)


def spec(urdf: str, **fields: Any) -> ArmSpec:
    return ArmSpec(
        urdf, **{"joints": ("j1",), "end_effector_link": "l2", "effort_limits": (8,), "damping": (8,)} | fields
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "{file} has 0 bytes; give a file of 1 to 16777216"),
        ("\x7fELF\x00\x01", "{file} is not XML (not well-formed (invalid token): line 1, column 0); give a URDF"),
        ("<robot><link>", "{file} is not XML (no element found: line 1, column 13); give a URDF"),
        (
            '<?xml version="1.0" encoding="klingon"?><a/>',
            "{file} is not XML (unknown encoding: klingon); give a URDF",
        ),
        ("<sdf><link/></sdf>", "{file} is no URDF, as it has no <robot> with a <link>; give a URDF"),
        ("<robot/>", "{file} is no URDF, as it has no <robot> with a <link>; give a URDF"),
        ("<a>" * 200, "{file} has tags in tags, more than 100 deep; give a URDF"),
        (f'<robot><xacro:include filename="a"/>{LINKS}</robot>', "{file} has 'xacro:include': " + XACRO),
        (
            f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="arm"/>{LINKS}</robot>',
            "{file} has 'xacro:macro': " + XACRO,
        ),
        (f'<robot name="${{name}}">{LINKS}</robot>', "{file} has '${{name}}': " + XACRO),
        (f"<robot>{LINKS}{joint('j1', 'l0', 'l1', axis='$(arg axis)')}</robot>", "{file} has '$(arg axis)': " + XACRO),
        (
            f"<robot>{mesh('package://small_description/meshes/l0.stl')}{JOINTS}</robot>",
            "{file} needs the mesh 'package://small_description/meshes/l0.stl', and no folder 'small_description' "
            "beside or above it has that; put that package there, or write a path",
        ),
        (
            f"<robot>{mesh('a.stl', 'visual').replace('</link>', COLLISION + '</link>', 1)}{JOINTS}</robot>",
            "{file} needs the mesh 'a.stl' and 1 more, which is not there; put it beside the file, or write its path "
            "into the file",
        ),
        (
            f"<robot>{mesh('~/l0.stl')}{JOINTS}</robot>",
            "{file} needs the mesh '~/l0.stl', which is not there; put it beside the file, or write its path with the "
            "home folder spelled out into the file",
        ),
        (
            f"<robot>{mesh('robot.urdf')}{JOINTS}</robot>",
            "Bullet reads no mesh such as 'robot.urdf' of {file}; convert it to .obj, .stl, .dae",
        ),
        (
            f"<robot>{LINKS}</robot>",
            "{file} is in pieces, as no joint leads to any of the links 'l0', 'l1', 'l2'; join them",
        ),
        (f"<robot>{LINKS}{JOINTS}{link('l2')}</robot>", "{file} has two links named 'l2'; rename one"),
        (f"<robot>{LINKS}{JOINTS}{JOINTS}</robot>", "{file} has two joints named 'j1'; rename one"),
        (
            f"<robot>{LINKS}{JOINTS}</robot>".replace(' type="revolute"', "", 1),
            "joint 'j1' of {file} has no type; give it one",
        ),
        (f"<robot>{LINKS}{JOINTS}<joint/></robot>", "{file} has a joint without a name; give it one"),
        (
            f"<robot>{LINKS}{JOINTS}{joint('j3', 'l0', 'l2')}</robot>",
            "{file} has two joints that move link 'l2'; leave one",
        ),
        (
            f"<robot>{LINKS}{JOINTS}{link('l3')}{joint('j3', 'l3', 'l3')}</robot>",
            "{file} has joints in a circle through 'l3'; leave one out",
        ),
        (
            f"<robot>{LINKS}{joint('j1', 'l0', 'hand')}</robot>",
            "unknown link of joint 'j1' of {file}: 'hand'; links are l0, l1, l2",
        ),
        (
            f"<robot>{LINKS}{JOINTS}</robot>",
            "Bullet cannot load {file} (Expected a name for robot); check it and the meshes it names",
        ),
    ],
)
def test_a_file_of_no_robot_is_one_sentence(
    client: Client, tmp_path: Path, text: str, message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "robot.urdf"
    file.write_text(text, encoding="latin-1")
    with pytest.raises(ValueError) as error:
        Arm(spec(str(file)), client)
    assert str(error.value) == message.format(file=repr(str(file)))
    assert capfd.readouterr().out == ""


def test_a_damaged_mesh_is_one_sentence(client: Client, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "l0.stl").write_text("solid nothing")
    file = robot(tmp_path, mesh("l0.stl"), JOINTS)
    with pytest.raises(ValueError) as error:
        Arm(spec(file), client)
    assert str(error.value).startswith("Bullet finds no shape in the mesh '")
    assert str(error.value).endswith(f"l0.stl' of {file!r}; check it")
    assert capfd.readouterr().out == ""


def test_meshes_of_a_package_beside_or_above_the_file_are_found(client: Client, tmp_path: Path) -> None:
    folder = tmp_path / "small_description"
    (folder / "urdf").mkdir(parents=True)
    (folder / "l0.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n")
    for name in ("package://small_description/l0.obj", "../l0.obj", str(folder / "l0.obj")):
        Arm(spec(robot(folder / "urdf", mesh(name), JOINTS)), client)


def test_a_home_folder_may_be_a_tilde(client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    robot(tmp_path, LINKS, JOINTS)
    (tmp_path / "arm.yml").write_text(
        "{urdf: robot.urdf, joints: [j1], end_effector_link: l2, effort_limits: [8], damping: [8]}"
    )
    assert arm_spec("~/arm.yml").urdf == str(tmp_path / "robot.urdf")
    Arm(spec("~/robot.urdf"), client)


def test_what_bullet_says_of_a_file_is_one_warning_and_not_printed(
    client: Client, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = robot(tmp_path, link("l0"), link("l1").replace('ixx="0.0001"', 'ixx="1"'), link("l2"), JOINTS)
    with pytest.warns(UserWarning) as said:
        Arm(spec(file), client)
    told = f"Bullet says of {file!r}: Bad inertia tensor properties, setting inertia to zero for link: l1"
    assert [str(warning.message) for warning in said] == [told]
    assert capfd.readouterr().out == ""


def test_a_frame_without_inertia_weighs_nothing(tmp_path: Path) -> None:
    moved = []
    for tool in ("", '<link name="tool"/>' + joint("t", "l2", "tool", kind="fixed")):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            env = StereoReachEnv(arm=spec(robot(tmp_path, LINKS, JOINTS, tool), damping=(0.01,), effort_limits=(0.01,)))
        env.reset(options={"joint_positions": [0.2]})
        moved.append(env.step([1.0])[4]["joint_positions"])
        env.close()
    assert moved[0][0] > 0.3
    np.testing.assert_allclose(*moved, atol=1e-6)


def test_a_joint_that_moves_nothing_is_explained(client: Client, tmp_path: Path) -> None:
    file = robot(tmp_path, LINKS, JOINTS, '<link name="l3"/>', joint("j3", "l2", "l3"))
    with pytest.raises(ValueError) as error:
        Arm(spec(file), client)
    wrong = "has a mass (no <inertial>: l3), an inertia, an origin or an axis of no robot; check them"
    assert str(error.value) == f"{file!r} {wrong}"


# ------------------------------------------------------------------------------------------------ held joints
def test_a_zero_action_moves_nothing(tmp_path: Path) -> None:
    file = robot(
        tmp_path,
        LINKS,
        link("l3"),
        link("l4"),
        joint("j1", "l0", "l1"),
        joint("j2", "l1", "l2", limits=(0.52, 5.76)),
        joint("j3", "l1", "l3", limits=(0.0, 0.05), kind="prismatic", more='<mimic joint="j2" multiplier="0.01"/>'),
        joint("j4", "l1", "l4", "1 0 0", limits=(-3, 3), more='<mimic joint="j1" multiplier="-0.5" offset="0.3"/>'),
    )
    env = StereoReachEnv(arm=spec(file, rest=(("j2", 0.52),)))
    before = env.reset(seed=0)[1]["joint_positions"]
    np.testing.assert_allclose(env.step([0.0])[4]["joint_positions"], before, atol=1e-9)
    env.close()


@pytest.mark.parametrize(
    ("limits", "rest", "said"),
    [
        (
            (0.52, 5.76),
            (),
            "held at 0, as rest does not name it, outside its limits [0.52, 5.76]; give rest: {j2: 0.52}",
        ),
        ((-1.0, 1.24), (("j2", 10.0),), "held at 10, outside its limits [-1, 1.24]; give rest: {j2: 1.24}"),
        ((0.5, 0.5), (), "held at 0, as rest does not name it, outside its limits [0.5, 0.5]; give rest: {j2: 0.5}"),
    ],
)
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_held_joint_outside_its_limits_is_refused(
    client: Client, tmp_path: Path, limits: tuple[float, float], rest: Any, said: str, kind: str
) -> None:
    file = robot(tmp_path, LINKS, joint("j1", "l0", "l1"), joint("j2", "l1", "l2", limits=limits, kind=kind))
    with pytest.raises(ValueError) as error:
        Arm(spec(file, rest=rest), client)
    assert str(error.value) == f"joint 'j2' is {said}"


# ------------------------------------------------------------------------------------------------ mimic joints
def led(leader: str, multiplier: object = -0.5, offset: object = 0.3) -> str:
    return f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/>'


@pytest.mark.parametrize("brake", [True, False])
@pytest.mark.parametrize("damping", [8.0, 0.05])
def test_mimic_joints_follow_through_resets_and_pulses(tmp_path: Path, brake: bool, damping: float) -> None:
    file = robot(
        tmp_path,
        LINKS,
        link("l3"),
        joint("j1", "l0", "l1"),
        joint("j2", "l1", "l2", limits=(-3, 3), more=led("j1")),
        joint("j3", "l2", "l3", kind="prismatic", more=led("j2", 0.1, 0)),
    )
    env = StereoReachEnv(arm=spec(file, effort_limits=(damping,), damping=(damping,)), brake=brake)
    start = env.reset(options={"joint_positions": [0.2]})[1]["joint_positions"]
    np.testing.assert_allclose(start, [0.2, 0.2, 0.02], atol=1e-12)
    for _ in range(3):
        moved = env.step([1.0])[4]["joint_positions"]
        np.testing.assert_allclose(moved[1:], [0.3 - 0.5 * moved[0], 0.03 - 0.05 * moved[0]], atol=1e-3)
    assert moved[0] == pytest.approx(1.7 if damping == 8.0 else 1.5, rel=0.1)
    env.close()


def test_mimic_joints_of_a_held_one_are_held_with_it(client: Client, tmp_path: Path) -> None:
    file = robot(tmp_path, LINKS, link("l3"), JOINTS, joint("j3", "l2", "l3", more=led("j2")))
    arm = Arm(spec(file, rest=(("j2", 0.4),)), client)
    arm.rest_at([0.1])
    np.testing.assert_allclose(arm.joint_positions, [0.1, 0.4, 0.1])
    arm.push([8.0], 120)
    np.testing.assert_allclose(arm.joint_positions[1:], [0.4, 0.1], atol=2e-3)


def test_a_joint_keeps_what_mimics_it_inside_its_limits(client: Client, tmp_path: Path) -> None:
    file = robot(
        tmp_path, LINKS, joint("j1", "l0", "l1"), joint("j2", "l1", "l2", limits=(0, 0.5), more=led("j1", -0.5, 0.3))
    )
    arm = Arm(spec(file), client)
    np.testing.assert_allclose(arm.limits, [[-0.4, 0.6]])
    arm.push([8.0], 480)
    assert arm.actuated_positions[0] == pytest.approx(0.6, abs=0.01)


@pytest.mark.parametrize(
    ("mimics", "fields", "message"),
    [
        (
            ("", led("j1")),
            {"joints": ("j2",)},
            "joint 'j2' of {file} mimics another, so nothing else moves it; put 'j1' in its place",
        ),
        (
            ("", led("j1")),
            {"rest": (("j2", 0.2),)},
            "rest has 'j2', which mimics 'j1'; leave it out, as it follows by itself",
        ),
        (("", led("j9")), {}, "unknown joint that 'j2' of {file} mimics: 'j9'; joints are j1, j2"),
        (("", led("j1", "twice")), {}, "mimic joint 'j2' of {file} has multiplier and offset twice, 0.3; give numbers"),
        (
            (led("j2"), led("j1")),
            {},
            "mimic joints j1, j2 of {file} follow each other in a circle; let one of them move by itself",
        ),
        (
            ("", led("j1", 1, 9)),
            {},
            "joint 'j1' has no position in its limits that puts 'j2', which mimics it, into its own; check both",
        ),
    ],
)
def test_wrong_mimic_joints_are_explained(
    client: Client, tmp_path: Path, mimics: tuple[str, str], fields: dict[str, Any], message: str
) -> None:
    first, second = mimics
    file = robot(tmp_path, LINKS, joint("j1", "l0", "l1", more=first), joint("j2", "l1", "l2", more=second))
    with pytest.raises(ValueError) as error:
        Arm(spec(file, **fields), client)
    assert str(error.value) == message.format(file=repr(file))


def test_a_copied_world_keeps_its_gears(tmp_path: Path) -> None:
    import copy

    file = robot(tmp_path, LINKS, joint("j1", "l0", "l1"), joint("j2", "l1", "l2", more=led("j1")))
    env = StereoReachEnv(arm=spec(file), brake=False)
    env.reset(seed=0)
    env.step([0.5])
    twin = copy.deepcopy(env)
    for action in ([1.0], [-0.3]):
        one, other = env.step(action), twin.step(action)
        np.testing.assert_array_equal(one[4]["joint_positions"], other[4]["joint_positions"])
    env.close()
    twin.close()


def test_held_values_that_agree_with_a_mimic_joint_may_be_named(client: Client, tmp_path: Path) -> None:
    file = robot(tmp_path, LINKS, link("l3"), JOINTS, joint("j3", "l2", "l3", more=led("j2")))
    held = spec(file, rest=(("j2", 0.4), ("j3", 0.1)))
    Arm(held, client)
    with pytest.raises(ValueError) as error:
        Arm(replace(held, rest=(("j2", 0.4), ("j3", 0.2))), client)
    assert str(error.value) == "rest has 'j3' at 0.2, which mimics 'j2' and so is at 0.1; leave it out"
