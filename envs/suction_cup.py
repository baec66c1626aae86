"""A suction cup on any arm: one link more in its URDF, fixed to the end effector."""

import os
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sb3_stereo.envs.robots import ArmSpec
from sb3_stereo.envs.specs import require
from sb3_stereo.envs.urdf import mesh_file

CUP_LINK, CUP_JOINT = "sb3_stereo_suction_cup", "sb3_stereo_suction_cup_mount"
CUP_RADIUS = 0.02  # [m]
CUP_MASS = 0.02  # [kg]
TUBE_GREY = "0.3 0.3 0.3 1"


@contextmanager
def with_suction_cup(spec: ArmSpec, path: str, robot: ET.Element) -> Iterator[str]:
    """The path of the arm's file, or while this lasts of one with the cup in it.

    Args:
        spec: The arm.
        path: Of its file.
        robot: What the file holds.
    """
    if spec.suction_cup is None:
        yield path
        return
    names = {part.get("name") for part in robot}
    require(not names & {CUP_LINK, CUP_JOINT}, f"the arm has a {CUP_LINK} already; leave suction_cup out")
    with tempfile.TemporaryDirectory() as folder:
        extended = ET.fromstring(ET.tostring(robot))
        for mesh in extended.iterfind("link//geometry/mesh"):  # Bullet looks for them from the file's folder
            found = mesh_file(mesh.get("filename", ""), path)
            assert found is not None  # `read_urdf` has checked them
            mesh.set("filename", os.path.relpath(found, folder))
        extended.extend(_cup(spec.end_effector_link, spec.end_effector_offset, spec.suction_cup))
        ET.indent(extended)  # Bullet cuts a line after some 8000 characters
        file = Path(folder) / Path(path).name
        file.write_bytes(ET.tostring(extended))
        yield str(file)


def _cup(link: str, offset: tuple[float, ...], length: float) -> ET.Element:
    """The link and the joint of a cup whose frame is in the middle of its lip, z outwards."""
    x, y, z = offset
    middle = f'<origin xyz="0 0 {-length / 2}"/>'
    shape = f'{middle}<geometry><cylinder radius="{CUP_RADIUS}" length="{length}"/></geometry>'
    across, along = CUP_MASS * (3 * CUP_RADIUS**2 + length**2) / 12, CUP_MASS * CUP_RADIUS**2 / 2
    inertia = f'<inertia ixx="{across}" iyy="{across}" izz="{along}" ixy="0" ixz="0" iyz="0"/>'
    return ET.fromstring(
        f'<parts><link name="{CUP_LINK}">'
        f'<inertial>{middle}<mass value="{CUP_MASS}"/>{inertia}</inertial>'
        f'<visual>{shape}<material name="{CUP_LINK}"><color rgba="{TUBE_GREY}"/></material></visual>'
        f"<collision>{shape}</collision></link>"
        f'<joint name="{CUP_JOINT}" type="fixed"><parent link="{link}"/><child link="{CUP_LINK}"/>'
        f'<origin xyz="{x} {y} {z + length}"/></joint></parts>'
    )
