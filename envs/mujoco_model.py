"""A MuJoCo model of the world: an arm from its URDF, the floor, the markers, and things that belong to no task."""

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sb3_stereo.envs.clutter import AWAY, shape_of
from sb3_stereo.envs.joints import Joints, MovingJoint, make_joints
from sb3_stereo.envs.mujoco_binding import mujoco
from sb3_stereo.envs.robots import ArmSpec
from sb3_stereo.envs.scene import BLUE, FLOOR_HALF_EXTENTS, GREY, RED, sphere
from sb3_stereo.envs.specs import quoted, require, require_known
from sb3_stereo.envs.suction_cup import with_suction_cup
from sb3_stereo.envs.urdf import mesh_file, mimics, read_urdf, urdf_path, without_inertia

MESHES = (".obj", ".stl", ".msh")  # that MuJoCo reads
NOTHING_MUCH = 1e-9  # [kg] and [kg m^2], of a link without an inertia: MuJoCo moves nothing that weighs nothing
DRAWN, HIDDEN = 1, 3  # groups of shapes; MuJoCo draws 0 to 2
STIFF = (2.0, 1.0)  # of a constraint: time constant in time steps, the smallest that is stable, and damping ratio
RIGID = (0.99, 0.999, 0.001, 0.5, 2.0)  # of a joint that is held, or follows another: hardly any give
FLOOR, MARKERS, THING, OTHER_WORLD = ".floor", (".red", ".blue"), ".thing{}", ".world"  # names that no URDF has


class Around(NamedTuple):
    """What is around the arm."""

    radii: tuple[float, float]  # of the red and of the blue ball, in [m]
    hollow_target: bool
    n_things: int


@dataclass(frozen=True)
class Model:
    """A compiled model, and what is what in it.

    Attributes:
        compiled: MuJoCo's `MjModel`.
        joints: Numbered as MuJoCo does, which are the indices of their positions and speeds as well.
        links: The robot's links and the numbers of their bodies, the base first.
    """

    compiled: Any
    joints: Joints
    links: dict[str, int]


def build_model(arm: ArmSpec, around: Around, physics_rate: float) -> Model:
    """Compile the world, gravity left out.

    Args:
        arm: The robot, whose file is read.
        around: What else there is.
        physics_rate: Simulation steps per second, in [Hz].

    Raises:
        ValueError: If MuJoCo cannot load the file, or names in `arm` are not in it.
    """
    with urdf_path(arm.urdf) as path:
        robot = read_urdf(path)
        with with_suction_cup(arm, path, robot) as extended:
            robot = read_urdf(extended)
            following = mimics(robot, path)
            massless = without_inertia(robot)
            spec = _load(robot, extended)
    links = tuple(_link_of(body.name) for body in spec.bodies if body.name != "world")
    _check_names(arm, [joint.name for joint in spec.joints], links)
    _set_up_links(spec, arm, links, massless)
    _add_surroundings(spec, around)
    spec.option.timestep = 1.0 / physics_rate
    compiled = _compile(spec, arm)
    joints = make_joints(arm, _moving(compiled, arm), following)
    _couple_joints(spec, compiled, joints)
    compiled = _compile(spec, arm)
    _set_up_dynamics(compiled, arm)
    return Model(compiled, joints, {link: int(compiled.body(body_of(link)).id) for link in links})


def body_of(link: str) -> str:
    """The name of a link's body: MuJoCo has a world of its own."""
    return OTHER_WORLD if link == "world" else link


def _link_of(body: str) -> str:
    return "world" if body == OTHER_WORLD else body


def _load(robot: ET.Element, path: str) -> Any:
    """MuJoCo's specification of a URDF's <robot>. Visual shapes and fixed links are kept."""
    for joint in robot.iterfind("joint"):
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
    for link in robot.iterfind("link"):
        link.set("name", body_of(link.get("name", "")))
    for end in (*robot.iterfind("joint/parent"), *robot.iterfind("joint/child")):
        end.set("link", body_of(end.get("link", "")))
    meshes = _rename_meshes(robot, path)
    for extension in robot.findall("mujoco"):
        robot.remove(extension)
    options = {"discardvisual": "false", "fusestatic": "false", "strippath": "false"}
    options["balanceinertia"] = "true"  # some files have tensors that no mass distribution has; MuJoCo refuses those
    ET.SubElement(ET.SubElement(robot, "mujoco"), "compiler", options)
    try:
        return mujoco.MjSpec.from_string(ET.tostring(robot, encoding="unicode"), assets=meshes)
    except ValueError as error:
        raise ValueError(_refusal(path, error)) from error


def _refusal(path: str, error: Exception) -> str:
    return f"MuJoCo cannot load {quoted(path)} ({' '.join(str(error).split())}); check it and the meshes it names"


def _compile(spec: Any, arm: ArmSpec) -> Any:
    try:
        return spec.compile()
    except ValueError as error:
        raise ValueError(_refusal(arm.urdf, error)) from error


def _rename_meshes(robot: ET.Element, path: str) -> dict[str, bytes]:
    """Give every file and scale a name of its own: MuJoCo 3.3 takes a file's first scale for all of its uses but one.

    Returns:
        The files by their new names.
    """
    names: dict[tuple[str, str], str] = {}
    files: dict[str, bytes] = {}
    for mesh in robot.iterfind("link//geometry/mesh"):
        file, ending = mesh.get("filename", ""), os.path.splitext(mesh.get("filename", ""))[1].lower()
        way_out = f"convert it to {', '.join(MESHES)}"
        require(ending in MESHES, f"MuJoCo reads no mesh such as {quoted(file)} of {quoted(path)}; {way_out}")
        key = file, mesh.get("scale", "")
        if key not in names:
            names[key] = f"{len(names)}{ending}"
            found = mesh_file(file, path)
            assert found is not None  # `read_urdf` has seen to it
            files[names[key]] = Path(found).read_bytes()
        mesh.set("filename", names[key])
    return files


def _check_names(arm: ArmSpec, joints: Iterable[str], links: Iterable[str]) -> None:
    joints, links = list(joints), list(links)
    for joint in (*arm.joints, *dict(arm.rest)):
        require_known("joint", joint, joints, "the robot's moving ones")
    named = (arm.end_effector_link, *dict(arm.drive_inertia), *dict(arm.link_colors))
    for link in (*named, *(link for pair in arm.collision_exempt for link in pair)):
        require_known("link", link, links, "the robot's")


def _set_up_links(spec: Any, arm: ArmSpec, links: tuple[str, ...], massless: Iterable[str]) -> None:
    """Mount the base, say what is drawn and what may overlap, and take mass from what has none."""
    base = spec.body(body_of(links[0]))
    x, y, z, w = arm.base_quaternion
    base.pos, base.quat = arm.base_position, (w, x, y, z)
    colours = dict(arm.link_colors)
    for link in links:
        for geom in spec.body(body_of(link)).geoms:
            solid = bool(geom.contype)
            geom.group = DRAWN if solid == arm.simple_shapes else HIDDEN
            geom.rgba = (*colours[link], 1.0) if link in colours else geom.rgba
    for link in massless:
        body = spec.body(body_of(link))
        body.explicitinertial, body.mass, body.inertia = True, NOTHING_MUCH, [NOTHING_MUCH] * 3
    # A link and its parent may overlap. MuJoCo sees to it, but not where the parent does not move.
    parents = {(spec.body(body_of(link)).parent.name, body_of(link)) for link in links[1:]}
    exempt = {(body_of(one), body_of(other)) for one, other in arm.collision_exempt}
    for one, other in sorted(parents | exempt):
        spec.add_exclude(bodyname1=one, bodyname2=other)


def _add_surroundings(spec: Any, around: Around) -> None:
    world, geom = spec.worldbody, mujoco.mjtGeom
    place = (0.0, 0.0, -FLOOR_HALF_EXTENTS[2])
    world.add_geom(name=FLOOR, type=geom.mjGEOM_BOX, size=FLOOR_HALF_EXTENTS, pos=place, rgba=GREY, group=HIDDEN)
    looks = {"contype": 0, "conaffinity": 0, "group": DRAWN}
    shapes: list[dict[str, Any]] = [{"type": geom.mjGEOM_SPHERE, "size": (r, 0.0, 0.0)} for r in around.radii]
    if around.hollow_target:
        points, triangles = sphere()
        inward = triangles[:, ::-1]  # their fronts are inside, and MuJoCo draws nothing from behind
        spec.add_mesh(
            name=MARKERS[1],
            uservert=(around.radii[1] * points).ravel(),
            userface=inward.ravel().astype(np.int32),
            usernormal=(-points).ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        shapes[1] = {"type": geom.mjGEOM_MESH, "meshname": MARKERS[1]}
    for name, shape, colour in zip(MARKERS, shapes, (RED, BLUE), strict=True):
        world.add_body(name=name, mocap=True).add_geom(rgba=colour, **shape, **looks)
    kinds = {"box": geom.mjGEOM_BOX, "cylinder": geom.mjGEOM_CYLINDER, "sphere": geom.mjGEOM_SPHERE}
    for number in range(around.n_things):
        kind, across, height = shape_of(number)
        size = (across, height, 0.0) if kind == "cylinder" else (across, across, height)
        name = THING.format(number)
        world.add_body(name=name, mocap=True, pos=AWAY).add_geom(type=kinds[kind], size=size, **looks)
    # One light, of which the cameras tell the rest.
    world.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, castshadow=False)
    spec.visual.headlight.active = 0
    spec.visual.quality.offsamples = 0  # a pixel shows one body


def _moving(compiled: Any, arm: ArmSpec) -> dict[str, MovingJoint]:
    hinge, slide = (kind.value for kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE))
    found = {}
    for number in range(compiled.njnt):
        joint = compiled.joint(number)
        simple = joint.type[0] in (hinge, slide)
        refusal = f"joint '{joint.name}' of {quoted(arm.urdf)} neither turns nor slides"
        require(simple, f"{refusal}; use revolute and prismatic joints")
        low, high = joint.range.tolist()
        found[joint.name] = MovingJoint(number, low, high, bool(joint.type[0] == slide))
    return found


def _couple_joints(spec: Any, compiled: Any, joints: Joints) -> None:
    """Hold the joints that are not actuated, and let those that mimic another follow it."""
    time, ratio = STIFF
    common = {
        "type": mujoco.mjtEq.mjEQ_JOINT,
        "objtype": mujoco.mjtObj.mjOBJ_JOINT,
        "solref": [time * spec.option.timestep, ratio],
        "solimp": RIGID,
    }
    names = [compiled.joint(joint).name for joint in range(compiled.njnt)]
    for joint in joints.held:
        place = joints.offsets[joints.moving.index(joint)]
        spec.add_equality(name1=names[joint], **common).data[:2] = place, 0.0
    for joint, leader, mimic in joints.geared:
        pair = spec.add_equality(name1=names[joint], name2=names[leader], **common)
        pair.data[:2] = mimic.offset, mimic.multiplier  # of a polynomial


def _set_up_dynamics(compiled: Any, arm: ArmSpec) -> None:
    """Rigid stops and contacts, no damping or friction but what the arm sets, and the drives' inertia."""
    stiff = np.array(STIFF) * (compiled.opt.timestep, 1.0)
    compiled.jnt_solref[:] = compiled.geom_solref[:] = stiff
    compiled.dof_damping[:] = compiled.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    for link, inertia in arm.drive_inertia:
        body = link_number = compiled.body(body_of(link)).id
        while compiled.body_jntnum[body] == 0:
            body = compiled.body_parentid[body]
            require(body > 0, f"drive_inertia has {quoted(link)}, which does not move; name a link that does")
        axis = data.xaxis[compiled.body_jntadr[body]] @ data.xmat[link_number].reshape(3, 3)
        # MuJoCo's armature is a rotor's inertia as its joint feels it.
        compiled.dof_armature[compiled.body_jntadr[body]] += float(np.array(inertia) @ axis**2)
    mujoco.mj_setConst(compiled, data)
