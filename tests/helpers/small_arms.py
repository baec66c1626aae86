"""URDFs of arms made for a test."""

from collections.abc import Sequence
from pathlib import Path

LIMITS = '<limit lower="{}" upper="{}" effort="1" velocity="9"/>'


def link(name: str, mass: float = 0.1, inertia: float = 1e-4, size: float = 0.02) -> str:
    """A link around a point 5 cm above its frame, with a small box unless `size` is 0."""
    shape = f'<origin xyz="0 0 0.05"/><geometry><box size="{size} {size} {size}"/></geometry>'
    shapes = f"<visual>{shape}</visual><collision>{shape}</collision>" if size else ""
    tensor = f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><origin xyz="0 0 0.05"/><mass value="{mass}"/>{tensor}</inertial>'
    return f'<link name="{name}">{inertial}{shapes}</link>'


def joint(
    name: str,
    parent: str,
    child: str,
    axis: str = "0 1 0",
    limits: Sequence[float] = (-2, 2),
    kind: str = "revolute",
    more: str = "",
) -> str:
    """A joint 10 cm above the parent's frame."""
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 0.1"/><axis xyz="{axis}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{LIMITS.format(*limits)}{more}</joint>'


def robot(folder: Path, *parts: str) -> str:
    """Write a URDF and return its path."""
    file = folder / "robot.urdf"
    file.write_text(f'<robot name="small">{"".join(parts)}</robot>')
    return str(file)


def two_links(folder: Path) -> str:
    """A yaw and a pitch that move 0.1 kg each, as on a desktop arm."""
    links = [link(f"l{k}") for k in range(3)]
    return robot(folder, *links, joint("j1", "l0", "l1", "0 0 1"), joint("j2", "l1", "l2"))
