"""An arm as URDF text, so that rigid-body libraries (pin, roboticstoolbox, …) read the same description."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.arms.description import ArmConfig, Link, Shape
from aerograsp_env.spatial import rpy_from_matrix

Array = NDArray[np.float64]


def _numbers(*values: float) -> str:
    return " ".join(f"{v:.17g}" for v in values)


def _origin(T: Array) -> str:
    return f'<origin xyz="{_numbers(*T[:3, 3])}" rpy="{_numbers(*rpy_from_matrix(T[:3, :3]))}"/>'


def _inertial(mass: float, center: Array, inertia: Array) -> str:
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    moments = " ".join(f'{name}="{_numbers(inertia[at])}"' for name, at in entries.items())
    return (
        f'<inertial><origin xyz="{_numbers(*center)}" rpy="0 0 0"/><mass value="{_numbers(mass)}"/>'
        f"<inertia {moments}/></inertial>"
    )


def _collisions(shape: Shape) -> str:
    """URDF knows no capsules: a cylinder and a sphere at either end."""

    def element(T: Array, geometry: str) -> str:
        return f"<collision>{_origin(T)}<geometry>{geometry}</geometry></collision>"

    if shape.kind == "box":
        return element(shape.T_link_shape, f'<box size="{_numbers(*(2.0 * s for s in shape.size))}"/>')
    radius, half = shape.size
    text = element(shape.T_link_shape, f'<cylinder radius="{_numbers(radius)}" length="{_numbers(2.0 * half)}"/>')
    if shape.kind == "capsule":
        for sign in (-1.0, 1.0):
            end = shape.T_link_shape.copy()
            end[:3, 3] += sign * half * end[:3, 2]
            text += element(end, f'<sphere radius="{_numbers(radius)}"/>')
    return text


def _link(link: Link) -> str:
    shapes = "".join(_collisions(shape) for shape in link.shapes)
    return f'<link name="{link.name}">{_inertial(link.mass, link.center_of_mass, link.inertia)}{shapes}</link>'


def urdf(arm: ArmConfig, fingers: bool = False) -> str:
    """URDF text of `arm`, its base fixed; the last link, `tool`, is the tool frame and weighs nothing.

    With `fingers` they are two prismatic joints `left_finger_joint` and `right_finger_joint`, 0 when open and
    positive when closing, and the chain branches. Without, they belong to the last link, fully open: a plain chain.
    """
    links = arm.links if fingers else arm.with_fingers()
    lines = [f'<robot name="{arm.name}">', _link(arm.base)]
    parent = arm.base.name
    for joint, link in zip(arm.joints, links, strict=True):
        lines.append(_link(link))
        lines.append(
            f'<joint name="{joint.name}" type="revolute"><parent link="{parent}"/><child link="{link.name}"/>'
            f'{_origin(joint.T_parent_joint)}<axis xyz="{_numbers(*joint.axis)}"/>'
            f'<limit lower="{_numbers(joint.limits[0])}" upper="{_numbers(joint.limits[1])}" '
            f'effort="{_numbers(joint.torque_limit)}" velocity="{_numbers(joint.rate_limit)}"/></joint>'
        )
        parent = link.name
    lines.append(
        f'<link name="tool"/><joint name="tool_joint" type="fixed"><parent link="{parent}"/><child link="tool"/>'
        f"{_origin(arm.T_last_tool)}</joint>"
    )
    if fingers:
        gripper = arm.gripper
        for finger in gripper.fingers():
            lines.append(
                f'<link name="{finger.name}">{_inertial(gripper.finger_mass, finger.center, gripper.finger_inertia())}'
                f'</link><joint name="{finger.name}_joint" type="prismatic"><parent link="{parent}"/>'
                f'<child link="{finger.name}"/>{_origin(arm.T_last_tool)}<axis xyz="{_numbers(finger.closing, 0, 0)}"/>'
                f'<limit lower="0" upper="{_numbers(gripper.travel)}" effort="{_numbers(gripper.stall_force)}" '
                f'velocity="{_numbers(gripper.jaw_speed)}"/></joint>'
            )
    return "\n".join([*lines, "</robot>"]) + "\n"
