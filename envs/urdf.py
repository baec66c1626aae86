"""A robot's URDF: found, read, and rejected where Bullet would silently load something else."""

import os
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from xml.parsers import expat

from sb3_stereo.envs.specs import as_number, quoted, require, require_known, require_readable

MESHES = (".obj", ".stl", ".dae")  # that Bullet reads
MAX_DEPTH = 100  # of tags in tags; Bullet's parser calls itself for each
SCHEMES = ("package://", "model://", "file://")


@dataclass(frozen=True)
class Mimic:
    """A joint's position: multiplier * the leader's + offset."""

    leader: str
    multiplier: float
    offset: float


@contextmanager
def urdf_path(path: str) -> Iterator[str]:
    """The full path of a robot's file in `envs/assets` or `pybullet_data`, or of one anywhere.

    Raises:
        ValueError: If there is none, or it is empty or huge.
    """
    with as_file(files("sb3_stereo.envs") / "assets") as assets:
        places = assets, *_pybullet_data(), Path()
        paths = [str(place / os.path.expanduser(path)) for place in places]  # a full path stays itself
        found = next(filter(os.path.isfile, paths), path)
        package = "packages of ROS are not searched, so " if path.startswith("package://") else ""
        require_readable(found, "robot", f"{package}give a path, or a URDF of envs/assets or of pybullet_data")
        yield os.path.abspath(found)  # Bullet looks for meshes in the folders that it names


def _pybullet_data() -> list[Path]:
    """The folder of robots that comes with PyBullet, if that is installed."""
    try:
        import pybullet_data
    except ImportError:
        return []
    return [Path(pybullet_data.getDataPath())]


def read_urdf(path: str) -> ET.Element:
    """Return the <robot> of a file.

    Raises:
        ValueError: If it is no XML, no URDF, still xacro, or names a mesh that Bullet cannot read.
    """
    robot = _parse(path)
    file = quoted(path)
    for tag in robot.iter():
        texts = (tag.tag if tag.tag.startswith("xacro:") else "", *tag.attrib.values())
        macro = next((text for text in texts if text.startswith("xacro:") or "${" in text or "$(" in text), None)
        way_out = "expand it with `xacro FILE > robot.urdf` and give robot.urdf"
        require(macro is None, f"{file} has {quoted(macro)}: it is xacro, not yet URDF; {way_out}")
    is_urdf = robot.tag == "robot" and robot.find("link") is not None
    require(is_urdf, f"{file} is no URDF, as it has no <robot> with a <link>; give a URDF")
    _check_tree(robot, file)
    _check_meshes(robot, path)
    return robot


def _parse(path: str) -> ET.Element:
    """Parse without namespaces, which Bullet does not know, so prefixes need not be declared."""
    builder, depth = ET.TreeBuilder(), 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        require(depth <= MAX_DEPTH, f"{quoted(path)} has tags in tags, more than {MAX_DEPTH} deep; give a URDF")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(Path(path).read_bytes(), True)
    except OSError as error:
        raise ValueError(f"cannot read {quoted(path)} ({error.strerror}); make it readable") from error
    except (expat.ExpatError, LookupError) as error:  # the latter of an unknown encoding
        raise ValueError(f"{quoted(path)} is not XML ({error}); give a URDF") from error
    return builder.close()


def _check_tree(robot: ET.Element, file: str) -> None:
    """Raise a ValueError unless the joints make one tree of the links: Bullet ends the process over some others."""
    links = _names(robot, "link", file)
    _names(robot, "joint", file)
    parents: dict[str, str] = {}
    for joint in robot.iterfind("joint"):
        parent, child = (getattr(joint.find(end), "attrib", {}).get("link") for end in ("parent", "child"))
        for link in (parent, child):
            require_known(f"link of joint {quoted(joint.get('name'))} of {file}:", link, links, "links")
        require("type" in joint.attrib, f"joint {quoted(joint.get('name'))} of {file} has no type; give it one")
        require(child not in parents, f"{file} has two joints that move link {quoted(child)}; leave one")
        parents[str(child)] = str(parent)
    roots = [link for link in links if link not in parents]
    names = ", ".join(map(quoted, roots))
    require(len(roots) < 2, f"{file} is in pieces, as no joint leads to any of the links {names}; join them")
    reached = set(roots)
    while grown := {link for link, parent in parents.items() if parent in reached} - reached:
        reached |= grown
    circle = [link for link in links if link not in reached]
    require(not circle, f"{file} has joints in a circle through {', '.join(map(quoted, circle))}; leave one out")


def _names(robot: ET.Element, tag: str, file: str) -> list[str]:
    names = [part.get("name", "") for part in robot.iterfind(tag)]
    require(all(names), f"{file} has a {tag} without a name; give it one")
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    require(twice is None, f"{file} has two {tag}s named {quoted(twice)}; rename one")
    return names


def _check_meshes(robot: ET.Element, path: str) -> None:
    """Raise a ValueError that names the first mesh that Bullet would not find or read."""
    names = [mesh.get("filename", "") for mesh in robot.iterfind("link//geometry/mesh")]
    missing = [name for name in names if mesh_file(name, path) is None]
    wrong = [name for name in names if name not in missing and not name.lower().endswith(MESHES)]
    kinds = ", ".join(MESHES)
    if wrong:
        raise ValueError(f"Bullet reads no mesh such as {quoted(wrong[0])} of {quoted(path)}; convert it to {kinds}")
    if missing:
        more = f" and {len(set(missing)) - 1} more" if len(set(missing)) > 1 else ""
        raise ValueError(f"{quoted(path)} needs the mesh {quoted(missing[0])}{more}, {_where(missing[0])}")


def mesh_file(mesh: str, path: str) -> str | None:
    """The file of a mesh of the URDF at `path`, found as Bullet finds it; None if there is none."""
    folders = [*map(str, Path(path).parents), ".", "..", "../.."]
    places = (os.path.join(folder, _bare(mesh)) for folder in folders)
    return next(filter(os.path.isfile, places), None)


def _bare(mesh: str) -> str:
    scheme = next(filter(mesh.startswith, SCHEMES), "")
    return mesh[len(scheme) :]


def _where(mesh: str) -> str:
    """Where a missing mesh was looked for, and what to do."""
    if mesh.startswith(("package://", "model://")):
        package = quoted(_bare(mesh).split("/")[0])
        return f"and no folder {package} beside or above it has that; put that package there, or write a path"
    home = "with the home folder spelled out " if mesh.startswith("~") else ""
    return f"which is not there; put it beside the file, or write its path {home}into the file"


def mimics(robot: ET.Element, path: str) -> dict[str, Mimic]:
    """Return what every mimic joint follows, Bullet ignoring that; never another mimic joint.

    Raises:
        ValueError: If a leader is unknown, a number is none, or joints follow each other in a circle.
    """
    found, joints = {}, {joint.get("name", ""): joint.find("mimic") for joint in robot.iterfind("joint")}
    for name, mimic in joints.items():
        if mimic is not None:
            require_known(f"joint that {quoted(name)} of {quoted(path)} mimics:", mimic.get("joint"), joints, "joints")
            numbers = [mimic.get("multiplier", "1"), mimic.get("offset", "0")]
            fitted = [as_number(number) for number in numbers]
            given = f"mimic joint {quoted(name)} of {quoted(path)} has multiplier and offset {', '.join(numbers)}"
            require(None not in fitted, f"{given}; give numbers")
            found[name] = Mimic(mimic.get("joint", ""), float(fitted[0] or 0.0), float(fitted[1] or 0.0))
    return {name: _resolved(name, found, path) for name in found}


def _resolved(name: str, found: dict[str, Mimic], path: str) -> Mimic:
    """Follow a mimic joint to the joint that moves by itself."""
    mimic, seen = found[name], {name}
    while mimic.leader in found:
        circle = f"mimic joints {', '.join(sorted(seen))} of {quoted(path)} follow each other in a circle"
        require(mimic.leader not in seen, f"{circle}; let one of them move by itself")
        seen.add(mimic.leader)
        next_ = found[mimic.leader]
        mimic = Mimic(next_.leader, mimic.multiplier * next_.multiplier, mimic.multiplier * next_.offset + mimic.offset)
    return mimic


def without_inertia(robot: ET.Element) -> list[str]:
    """Names of the links that the file gives no mass, such as frames at the tool."""
    return [link.get("name", "") for link in robot.iterfind("link") if link.find("inertial") is None]
