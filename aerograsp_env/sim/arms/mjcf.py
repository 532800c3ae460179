"""An arm as MJCF text, to stand inside the airframe's body of a MuJoCo scene.

Every name carries the prefix (`right_`): bodies `base`, the links' names, `left_finger`, `right_finger`; joints and
actuators `joint0` …, `left_finger`, `right_finger`; site `tool` at the tool frame; geoms named like the shapes, and
`palm`, `left_pad`, `left_finger`, … of the gripper.

Servos and fingers are MuJoCo's position actuators, force = kp (ctrl − q) − kv q̇ within ± the torque limit, whose
damping the integrators `implicit` and `implicitfast` treat implicitly. The fingers' have no force limit: the screw they
hang on cannot be driven back, whatever pulls at them; what limits the grip is the motor, which stops turning the screw
(`WormGripper`). Inertias are given, so geoms weigh nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.sim.arms.description import ArmConfig, Link, Shape
from aerograsp_env.sim.gripper import Box
from aerograsp_env.spatial import check_transform, quat_wxyz_from_matrix

Array = NDArray[np.float64]

# Pads as in `aerograsp_env.sim.grasp_scene`, which judges grasps: as soft as rubber, friction much harder (impratio).
PAD_SOLREF = (0.01, 1.0)
PAD_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)
TORSION, ROLLING = 0.002, 1e-4  # [m]


class Contact(NamedTuple):
    """What collides with what: MuJoCo's bits, and a geom group to draw or cast rays by."""

    contype: int
    conaffinity: int
    group: int = 1


ARM_CONTACT = Contact(1, 2)
"""Collides with the docking scene's geoms (2, 1), not with the airframe's (1, 2)."""


class ArmXml(NamedTuple):
    """MJCF of one arm, and the names in it, all with the prefix."""

    body: str  # one <body>, to stand in the airframe's body
    actuators: str  # <general> elements: the joints', then the fingers'
    excludes: str  # <exclude> elements: parts of the arm that overlap by design
    joints: tuple[str, ...]  # n hinges, then the left and the right finger's slides
    links: tuple[str, ...]  # bodies: base and n links
    fingers: tuple[str, str]  # bodies
    tool: str  # site


def numbers(*values: float) -> str:
    """An MJCF attribute's value, exact."""
    return " ".join(f"{v:.17g}" for v in values)


def placement(T: Array) -> str:
    """`pos` and `quat` of a (4, 4) transform."""
    return f'pos="{numbers(*T[:3, 3])}" quat="{numbers(*quat_wxyz_from_matrix(T[:3, :3]))}"'


def inertial(mass: float, center: Array, inertia: Array) -> str:
    """The <inertial> element."""
    full = (inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2])
    return f'<inertial pos="{numbers(*center)}" mass="{numbers(mass)}" fullinertia="{numbers(*full)}"/>'


def shape_geom(shape: Shape, prefix: str, contact: Contact, more: str = "") -> str:
    """A massless <geom> of a shape, with further attributes `more`."""
    return (
        f'<geom name="{prefix}{shape.name}" type="{shape.kind}" {placement(shape.T_link_shape)} '
        f'size="{numbers(*shape.size)}" mass="0" contype="{contact.contype}" conaffinity="{contact.conaffinity}" '
        f'group="{contact.group}" {more}/>'
    )


def _box(box: Box) -> Shape:
    return Shape.box(box.name, box.center, box.half_size)


def _fingers(arm: ArmConfig, prefix: str, contact: Contact, friction: float) -> str:
    gripper = arm.gripper
    boxes = {box.name: _box(box) for box in gripper.jaws.boxes(gripper.jaws.max_width)}
    pad = (
        f'condim="4" priority="1" friction="{numbers(friction, TORSION, ROLLING)}" solref="{numbers(*PAD_SOLREF)}" '
        f'solimp="{numbers(*PAD_SOLIMP)}"'
    )
    text = ""
    for finger in gripper.fingers():
        geoms = shape_geom(boxes[finger.name.replace("finger", "pad")], prefix, contact, pad)
        geoms += shape_geom(boxes[finger.name], prefix, contact, pad)
        text += (
            f'<body name="{prefix}{finger.name}" {placement(arm.T_last_tool)}>'
            f'<joint name="{prefix}{finger.name}" type="slide" axis="{numbers(finger.closing, 0, 0)}" limited="true" '
            f'range="{numbers(0.0, gripper.travel)}" armature="{numbers(gripper.finger_armature)}"/>'
            f"{inertial(gripper.finger_mass, finger.center, gripper.finger_inertia())}{geoms}</body>\n"
        )
    return text


def arm_mjcf(
    arm: ArmConfig,
    prefix: str,
    T_body_base: ArrayLike,
    links: Contact = ARM_CONTACT,
    fingers: Contact | None = None,
    friction: float | None = None,
    more: str = "",
) -> ArmXml:
    """MJCF of `arm`, mounted at T_body_base (4, 4).

    Args:
        prefix: of every name, such as "right_".
        links: what the links and the palm collide with.
        fingers: the same for fingers and pads; as the links if None.
        friction: Coulomb coefficient of pads and fingers with whatever they touch (their priority is 1); the jaws' own
            if None. `grasp_scene.contact_friction` gives that of an object.
        more: further attributes of the links' geoms, such as a material of the scene.

    Raises:
        ValueError: a T_body_base that is not rigid, or a friction that is not positive.
    """
    T_body_base = check_transform(T_body_base, "T_body_base")
    friction = arm.gripper.jaws.friction if friction is None else friction
    if not 0.0 < friction < np.inf:
        raise ValueError(f"friction: expected a positive value, got {friction}")
    jaws = arm.gripper.jaws
    palm = _box(next(box for box in jaws.boxes(jaws.max_width) if box.name == "palm")).moved(arm.T_last_tool)

    def content(link: Link) -> str:
        geoms = "".join(shape_geom(shape, prefix, links, more) for shape in link.shapes)
        return inertial(link.mass, link.center_of_mass, link.inertia) + geoms

    inner = (
        shape_geom(palm, prefix, links, more)
        + f'<site name="{prefix}tool" {placement(arm.T_last_tool)} size="0.004" group="4"/>\n'
        + _fingers(arm, prefix, fingers or links, friction)
    )
    for joint, link in zip(reversed(arm.joints), reversed(arm.links), strict=True):
        inner = (
            f'<body name="{prefix}{link.name}" {placement(joint.T_parent_joint)}>'
            f'<joint name="{prefix}{joint.name}" type="hinge" axis="{numbers(*joint.axis)}" limited="true" '
            f'range="{numbers(*joint.limits)}" armature="{numbers(joint.armature)}"/>'
            f"{content(link)}\n{inner}</body>\n"
        )
    body = f'<body name="{prefix}base" {placement(T_body_base)}>{content(arm.base)}\n{inner}</body>\n'

    actuators = []
    for joint in arm.joints:
        limit = joint.torque_limit
        actuators.append(_position(prefix + joint.name, joint.stiffness, joint.damping, joint.limits, limit))
    gripper = arm.gripper
    for finger in gripper.fingers():
        actuators.append(_position(prefix + finger.name, gripper.stiffness, gripper.damping, (0.0, gripper.travel)))
    moved = [prefix + finger.name for finger in gripper.fingers()]
    return ArmXml(
        body=body,
        actuators="\n".join(actuators),
        excludes=f'<exclude body1="{moved[0]}" body2="{moved[1]}"/>'
        f'<exclude body1="{prefix}{arm.base.name}" body2="{prefix}{arm.links[0].name}"/>',
        joints=(*(prefix + joint.name for joint in arm.joints), *moved),
        links=tuple(prefix + link.name for link in (arm.base, *arm.links)),
        fingers=(moved[0], moved[1]),
        tool=f"{prefix}tool",
    )


def _position(
    name: str, stiffness: float, damping: float, limits: tuple[float, float], force: float | None = None
) -> str:
    limited = "" if force is None else f' forcelimited="true" forcerange="{numbers(-force, force)}"'
    return (
        f'<general name="{name}" joint="{name}" gaintype="fixed" biastype="affine" gainprm="{numbers(stiffness)}" '
        f'biasprm="{numbers(0.0, -stiffness, -damping)}" ctrllimited="true" ctrlrange="{numbers(*limits)}"{limited}/>'
    )
