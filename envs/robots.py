"""What the task must know of a robot: `ArmSpec`, the arms that come with the package, and yours from a YAML file."""

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from sb3_stereo.envs.specs import quoted, read_yaml, require, require_known
from sb3_stereo.envs.validation import (
    STRICT,
    Flag,
    Numbers,
    Pairs,
    PositiveQuantity,
    Quantity,
    Text,
    Texts,
    Vector,
    explained,
    from_map,
    listed,
)

NotNegative = Annotated[Quantity, Field(ge=0)]
EffortAndDamping = Annotated[tuple[PositiveQuantity, NotNegative], listed("2 numbers", 2)]


@explained("arm")
@dataclass(frozen=True, config=STRICT)
class ArmSpec:
    """A robot. In YAML it is a map of these fields; pairs may be written as a map.

    Attributes:
        urdf: File in `envs/assets` or in `pybullet_data`, or a path; in a YAML file it may start at that file's folder.
        joints: The actuated joints' names, in the order of the action.
        end_effector_link: Link that carries the red marker.
        effort_limits: Effort of a full action per actuated joint, in [N m] (in [N] for a sliding joint).
        damping: Viscous damping per actuated joint, in [N m s/rad] (in [N s/m]).
        end_effector_offset: Middle of the marker in that link's frame, in [m].
        rest: Where the other moving joints are held, as (joint, position) in [rad] or [m]; 0 for those not named.
        base_position: Of the base link's frame, in [m], world.
        base_orientation: Of that frame: roll, pitch and yaw about the world's fixed axes, in [rad], as in a URDF's
            rpy; or a quaternion (x, y, z, w) of any length.
        mirrored_joints: Actuated joints that turn the other way in the mirror image of the mounted arm through the
            plane y = 0; None if the arm has none or does not look like it. `python -m sb3_stereo check` tells.
        drive_inertia: Rotor inertia seen at a joint, in [kg m^2], as (link, about its x, y and z axis).
        collision_exempt: Pairs of links that may overlap. A link and its parent always may.
        link_colors: Of links in place of the file's, as (link, (red, green, blue)), from 0 to 1. Pure red and pure
            blue are the markers'.
        simple_shapes: Draw the collision shapes in place of the visual ones: TinyRenderer's time is that of triangles.
        marker_radius: Of both markers, in [m].
        further_joints: Joints that the environment's `n_joints` can actuate besides, in this order, as (joint, (effort
            limit, damping)); until then they rest. They belong to no mirror image.
        suction_cup: Length of a suction cup that stands on `end_effector_offset`, along the z axis of that link, in
            [m]; None for none.

    Raises:
        ValueError: If a value makes no robot.
    """

    urdf: Text
    joints: Texts
    end_effector_link: Text
    effort_limits: Numbers[PositiveQuantity]
    damping: Numbers[NotNegative]
    end_effector_offset: Vector = (0.0, 0.0, 0.0)
    rest: Pairs[Quantity] = ()
    base_position: Vector = (0.0, 0.0, 0.0)
    base_orientation: Numbers[Quantity] = (0.0, 0.0, 0.0)
    mirrored_joints: Texts | None = None
    drive_inertia: Pairs[Vector] = ()
    collision_exempt: Pairs[Text] = ()
    link_colors: Pairs[Vector] = ()
    simple_shapes: Flag = False
    marker_radius: PositiveQuantity = 0.07
    further_joints: Pairs[EffortAndDamping] = ()
    suction_cup: PositiveQuantity | None = None

    def __post_init__(self) -> None:
        n_joints = len(self.joints)
        once = 0 < n_joints == len(set(self.joints))
        require(once, f"joints are {quoted(self.joints)}; give at least one, each once")
        for name, values in (("effort_limits", self.effort_limits), ("damping", self.damping)):
            require(len(values) == n_joints, f"{name} has {len(values)} values for {n_joints} joints; give one each")
        n_numbers, length = len(self.base_orientation), math.hypot(*self.base_orientation)
        oriented = n_numbers == 3 or (n_numbers == 4 and length > 0)
        way_out = "give roll, pitch and yaw, or a quaternion (x, y, z, w) that is not 0"
        require(oriented, f"base_orientation is {self.base_orientation}; {way_out}")
        for link, inertia in self.drive_inertia:
            useful = min(inertia) >= 0 and sum(inertia) > 0
            require(useful, f"drive_inertia of {quoted(link)} is {inertia}; give one axis a positive number, none less")
        for joint in self.mirrored_joints or ():
            require_known("one of mirrored_joints", joint, self.joints, "the actuated joints")
        for joint, _ in self.rest:
            held = joint not in self.joints
            require(held, f"rest has {quoted(joint)}, which is actuated; leave it out of one of them")
        for joint, _ in self.further_joints:
            new = joint not in self.joints
            require(new, f"further_joints has {quoted(joint)}, which is actuated; leave it out of one of them")

    def actuating(self, n_joints: int) -> "ArmSpec":
        """The arm with the first `n_joints` of its joints and further joints actuated.

        Raises:
            ValueError: If it has fewer, or more are actuated in any case.
        """
        few, many = len(self.joints), len(self.joints) + len(self.further_joints)
        wanted = str(few) if few == many else f"{few} to {many}"
        require(few <= n_joints <= many, f"n_joints is {n_joints}, and this arm's is {wanted}; give that")
        added = self.further_joints[: n_joints - few]
        names = tuple(joint for joint, _ in added)
        return replace(
            self,
            joints=self.joints + names,
            effort_limits=self.effort_limits + tuple(effort for _, (effort, _) in added),
            damping=self.damping + tuple(damping for _, (_, damping) in added),
            rest=tuple(pair for pair in self.rest if pair[0] not in names),
            mirrored_joints=None if added else self.mirrored_joints,
            further_joints=self.further_joints[n_joints - few :],
        )

    @property
    def base_quaternion(self) -> tuple[float, float, float, float]:
        """`base_orientation` as a quaternion (x, y, z, w) of length 1."""
        if len(self.base_orientation) == 4:
            x, y, z, w = np.array(self.base_orientation) / math.hypot(*self.base_orientation)
            return float(x), float(y), float(z), float(w)
        (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle / 2), math.cos(angle / 2)) for angle in self.base_orientation)
        return (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        )


WAM = ArmSpec(
    urdf="wam.urdf",
    joints=("J1", "J2", "J3", "J4"),
    end_effector_link="palm",
    end_effector_offset=(0.0, 0.0, 0.0609),  # d7, libbarrett
    # Chosen, not Barrett's: with this damping a full pulse of 0.5 s moves each joint by about a radian.
    effort_limits=(20.0, 30.0, 10.0, 5.0),
    damping=(8.0, 10.0, 4.0, 2.0),
    mirrored_joints=("J1", "J3"),
    # Rotor inertia times the squared gear ratio (AC-02, Barrett's motor page).
    drive_inertia=(
        ("shoulder_yaw", (0.0, 0.0, 0.2052)),
        ("shoulder_pitch_drive", (0.0, 0.1888, 0.0)),
        ("upper_arm", (0.0, 0.0, 0.0669)),
        ("forearm", (0.0, 0.0346, 0.0)),
        ("wrist_yaw", (0.0, 0.0, 0.00323)),
        ("wrist_pitch", (0.0, 0.00323, 0.0)),
        ("palm", (0.0, 0.0, 0.000317)),
    ),
    # The palm's and the wrist's shapes overlap their neighbours' by construction.
    collision_exempt=(("forearm", "wrist_pitch"), ("forearm", "wrist_yaw"), ("shoulder_yaw", "upper_arm")),
    # Chosen likewise. The stops of J5 are not the same on both sides, so a wrist has no mirror image.
    further_joints=(("J5", (0.5, 0.2)), ("J6", (0.5, 0.2)), ("J7", (0.25, 0.1))),
)

# Joints 1 and 3 of the next two would mirror their frames, but not their looks: the shells stick out to one side of the
# links, and a mirrored picture is no picture of theirs. So they have no mirror image.
KUKA = ArmSpec(
    urdf="kuka_iiwa/model.urdf",
    joints=("lbr_iiwa_joint_1", "lbr_iiwa_joint_2", "lbr_iiwa_joint_3", "lbr_iiwa_joint_4"),
    end_effector_link="lbr_iiwa_link_7",
    end_effector_offset=(0.0, 0.0, 0.07),  # in front of the flange
    # Chosen so that a full pulse moves each joint by about what it moves the WAM's, with the WAM's damping.
    effort_limits=(20.0, 32.0, 12.0, 7.0),
    damping=(8.0, 10.0, 4.0, 2.0),
)

PANDA = ArmSpec(
    urdf="franka_panda/panda.urdf",
    joints=("panda_joint1", "panda_joint2", "panda_joint3", "panda_joint4"),
    end_effector_link="panda_grasptarget",
    # Chosen likewise; the file's inertias, 0.1 kg m^2 for every link, ask for more than the links' masses would.
    effort_limits=(22.0, 32.0, 20.0, 14.0),
    damping=(8.0, 10.0, 4.0, 3.0),
    rest=(
        ("panda_joint6", 3.141593),  # the hand points along the forearm
        ("panda_joint7", 0.785398),  # and is parallel to the wrist
        ("panda_finger_joint1", 0.04),  # open, as closed fingers touch
        ("panda_finger_joint2", 0.04),
    ),
    simple_shapes=True,  # the visual ones have 100 000 triangles, which takes four times as long
    collision_exempt=(("panda_link7", "panda_hand"),),
    # The file's arm is white, as is what is behind it.
    link_colors=tuple(
        (f"panda_{link}", (tone, tone, tone))
        for link, tone in (
            ("link0", 0.6),
            ("link1", 0.3),
            ("link2", 0.75),
            ("link3", 0.3),
            ("link4", 0.75),
            ("link5", 0.4),
            ("link6", 0.75),
            ("link7", 0.3),
            ("hand", 0.6),
            ("leftfinger", 0.3),
            ("rightfinger", 0.3),
        )
    ),
)

ARMS = {"wam": WAM, "kuka": KUKA, "panda": PANDA}


def arm_spec(arm: ArmSpec | Mapping[str, Any] | str) -> ArmSpec:
    """Return the robot that is given as itself, as a map, by its name in `ARMS`, or by the path of a YAML file.

    Raises:
        ValueError: If there is none, or its fields are wrong.
    """
    if isinstance(arm, ArmSpec):
        return arm
    if not isinstance(arm, str):
        return from_map(ArmSpec, arm, "arm")
    if arm in ARMS:
        return ARMS[arm]
    is_file = arm.endswith((".yml", ".yaml"))
    require(is_file, f"unknown arm {quoted(arm)}; arms are {', '.join(ARMS)}, or give a .yml file")
    spec = from_map(ArmSpec, read_yaml(arm, "arm"), f"arm {quoted(arm)}")
    beside = Path(os.path.expanduser(arm)).resolve().parent / spec.urdf
    return replace(spec, urdf=str(beside)) if beside.is_file() else spec
