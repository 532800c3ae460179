"""The two aerial manipulators of the thesis: an airframe, the arms under it, a camera, and what of it collides.

`AQUILES` (section 5.2) is a hexarotor of the DJI F550's class with one four-joint arm below its centre;
`BELEROFONTE_ARMS` (section 5.3) is the medium hexarotor with two six-joint arms, their bases 0.4 m apart as in the
project's `dual_arm_manipulator_6dof.env.xml`, and a camera between them. `BELEROFONTE_TOOL` carries the docking tool on
its left arm and keeps the right one (section 5.4, figure 5.10).

The text gives no masses and few places. Masses come from component tables, as in `aerograsp_env.sim.airframe`. Ours are
also the places of the arms' bases, the camera's tilt on Belerofonte, landing gear that folds up under the side booms so
that arms swing freely, and batteries that balance the arms. Belerofonte's airframe is the one that docks, less its arms
and with the gear folded.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from aerograsp_env.sim.airframe import BELEROFONTE, AirframeConfig, Component, Rotor
from aerograsp_env.sim.arms.description import ArmConfig, Shape, combined, read_only
from aerograsp_env.sim.arms.hecatonquiros import HECATONQUIROS_4DOF, HECATONQUIROS_6DOF
from aerograsp_env.spatial import Array, check_transform, inverse, so3_exp, transform, transform_points

Side = Literal["right", "left"]
SIDES: tuple[Side, ...] = ("right", "left")


@dataclass(frozen=True, eq=False)
class ArmMount:
    """An arm and where it is bolted to the airframe.

    Raises:
        ValueError: an unknown side, or a pose that is not rigid.
    """

    side: Side
    arm: ArmConfig
    T_body_base: Array  # (4, 4)

    def __post_init__(self) -> None:
        if self.side not in SIDES:
            raise ValueError(f"side must be one of {SIDES}, got {self.side!r}")
        object.__setattr__(self, "T_body_base", read_only(check_transform(self.T_body_base, "T_body_base")))

    @property
    def prefix(self) -> str:
        """Of the arm's names in a scene."""
        return f"{self.side}_"

    def mass_properties(self, q: ArrayLike) -> tuple[float, Array, Array]:
        """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m²] of the arm at q, body frame."""
        mass, center, inertia = self.arm.mass_properties(q)
        R = self.T_body_base[:3, :3]
        return mass, transform_points(self.T_body_base, center), R @ inertia @ R.T


@dataclass(frozen=True, eq=False)
class VehicleConfig:
    """An airframe and what it carries.

    Raises:
        ValueError: two arms on one side, a tool beside a left arm, or a camera pose that is not rigid.
    """

    name: str
    airframe: AirframeConfig  # without the arms of `mounts`
    mounts: tuple[ArmMount, ...]
    T_body_camera: Array  # (4, 4), OpenCV's camera frame
    shapes: tuple[Shape, ...]  # what of the airframe collides, body frame
    tool: bool = False  # carries the docking tool at airframe.tip_position

    def __post_init__(self) -> None:
        sides = [mount.side for mount in self.mounts]
        if len(set(sides)) != len(sides):
            raise ValueError(f"{self.name}: one arm per side, got {sides}")
        if self.tool and "left" in sides:
            raise ValueError(f"{self.name}: the docking tool takes the left arm's place")
        object.__setattr__(self, "T_body_camera", read_only(check_transform(self.T_body_camera, "T_body_camera")))

    def mount(self, side: str) -> ArmMount:
        """The arm on a side.

        Raises:
            ValueError: there is none.
        """
        for mount in self.mounts:
            if mount.side == side:
                return mount
        raise ValueError(f"{self.name} has no {side!r} arm, only {[mount.side for mount in self.mounts]}")

    def mass_properties(self, angles: Mapping[str, ArrayLike] | None = None) -> tuple[float, Array, Array]:
        """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m²] with its arms, without a tool.

        `angles` maps a side to the arm's q (n,); an arm that is not in it is stowed.
        """
        angles = angles or {}
        for side in angles:
            self.mount(side)
        arms = [mount.mass_properties(angles.get(mount.side, mount.arm.stowed)) for mount in self.mounts]
        return combined([self.airframe.properties(), *arms])

    def with_active(self, sides: Collection[str]) -> VehicleConfig:
        """The same vehicle with joints on these sides only; the other arms are stowed and belong to the airframe.

        Mass, centre of mass, inertia and shapes stay those of the vehicle with all of its arms stowed.

        Raises:
            ValueError: a side without an arm.
        """
        active = {self.mount(side).side for side in sides}
        if len(active) == len(self.mounts):
            return self
        components, shapes = self.airframe.components, self.shapes
        for mount in self.mounts:
            if mount.side not in active:
                components += _points(f"{mount.side} arm, stowed", *mount.mass_properties(mount.arm.stowed))
                shapes += tuple(shape.moved(mount.T_body_base, mount.prefix + shape.name) for shape in _stowed(mount))
        return replace(
            self,
            airframe=replace(self.airframe, components=components),
            mounts=tuple(mount for mount in self.mounts if mount.side in active),
            shapes=shapes,
        )


def _points(name: str, mass: float, center: Array, inertia: Array) -> tuple[Component, ...]:
    """Six point masses that weigh and turn as the body does: pairs on its principal axes.

    A body's second moments are S = ½ tr(I) 1 − I; a pair of masses m/6 at ± d gives (m/3) d² along its axis.
    """
    moments, axes = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    distances = np.sqrt(3.0 * np.maximum(moments, 0.0) / mass)
    parts: list[Component] = []
    for i, distance in enumerate(distances):
        for sign in (-1.0, 1.0):
            x, y, z = (center + sign * distance * axes[:, i]).tolist()
            parts.append(Component(f"{name} {len(parts)}", mass / 6.0, (x, y, z), (0.0, 0.0, 0.0)))
    return tuple(parts)


def _stowed(mount: ArmMount) -> tuple[Shape, ...]:
    """The shapes of a stowed arm, its gripper open, in its base frame."""
    arm = mount.arm
    poses = arm.link_poses(arm.stowed)
    jaws = arm.gripper.jaws
    boxes = [Shape.box(box.name, box.center, box.half_size) for box in jaws.boxes(jaws.max_width)]
    parts = [(T, shape) for T, link in zip(poses[:-1], arm.links, strict=True) for shape in link.shapes]
    return (*arm.base.shapes, *(shape.moved(T) for T, shape in parts), *(box.moved(poses[-1]) for box in boxes))


# --- airframes --------------------------------------------------------------------------------------------------------


def _rotor_shapes(airframe: AirframeConfig) -> tuple[Shape, ...]:
    half = np.array([0.0, 0.0, 0.004])
    return tuple(
        Shape.cylinder(f"rotor{i}", p - half, p + half, airframe.rotor.radius)
        for i, p in enumerate(airframe.rotor_positions())
    )


def _gear_shapes(reach: float, height: float) -> tuple[Shape, ...]:
    """Landing gear folded up under the side booms."""
    return tuple(
        Shape.capsule(f"{side}_gear", (0.0, sign * 0.08, height), (0.0, sign * reach, height), 0.012)
        for side, sign in (("left", 1.0), ("right", -1.0))
    )


def _camera_shape(T_body_camera: Array) -> Shape:
    return Shape("camera", "box", T_body_camera @ transform(np.eye(3), (0.0, 0.0, -0.015)), (0.045, 0.015, 0.015))


def _camera_component(T_body_camera: Array) -> Component:
    x, y, z = T_body_camera[:3, 3].tolist()
    return Component("camera", 0.10, (x, y, z), (0.03, 0.09, 0.03))


def _below(x: float, y: float, z: float) -> Array:
    """An arm's base with its z axis down and its x axis forward."""
    return transform(np.diag([1.0, -1.0, -1.0]), (x, y, z))


def _aquiles() -> VehicleConfig:
    T_body_base = _below(0.0, 0.0, -0.09)
    # Section 5.2: from the arm's frame to the camera's, a turn of 30° about x and t = (0.06, 0.10, 0) m. With the arm's
    # base pointing down, the camera stands to its left and looks down and inwards.
    T_camera_base = transform(so3_exp([math.radians(30.0), 0.0, 0.0]), (0.06, 0.10, 0.0))
    T_body_camera = T_body_base @ inverse(T_camera_base)
    reach = 0.275  # hub to centre: 550 mm from motor to motor
    booms = []
    for i, angle in enumerate(np.radians([30.0, 90.0, 150.0, -150.0, -90.0, -30.0])):
        x, y = reach * math.cos(angle), reach * math.sin(angle)
        booms.append(Component(f"boom {i}", 0.055, (0.5 * x, 0.5 * y, 0.0), (0.02, 0.02, 0.02)))
        booms.append(Component(f"motor, controller and rotor {i}", 0.105, (x, y, 0.02), (0.04, 0.04, 0.04)))
    airframe = AirframeConfig(
        name="aquiles",
        # 10-inch rotors with a thrust coefficient of 0.10 at up to 10 000 rev/min: 14 N each
        rotor=Rotor(1.3e-5, 0.016, 1040.0, 0.03, 0.05, 3.0e-5, 0.127),
        arm_length=reach,
        rotor_height=0.04,
        drag_area=0.05,
        tip_position=(0.20, 0.0, -0.08),
        components=(
            Component("plates, wiring and power board", 0.40, (0.0, 0.0, 0.0), (0.20, 0.20, 0.04)),
            Component("battery, 4S 8 Ah", 0.75, (-0.06, 0.0, -0.045), (0.15, 0.05, 0.04)),
            Component("onboard computer", 0.40, (0.0, 0.0, 0.055), (0.115, 0.111, 0.035)),
            Component("autopilot and GPS", 0.10, (0.0, 0.0, 0.09), (0.08, 0.05, 0.02)),
            *booms,
            Component("landing gear, folded", 0.12, (0.0, 0.0, -0.03), (0.02, 0.50, 0.02)),
            _camera_component(T_body_camera),
        ),
    )
    shapes = (
        Shape.cylinder("hub", (0.0, 0.0, -0.025), (0.0, 0.0, 0.08), 0.09),
        Shape.box("battery", (-0.06, 0.0, -0.045), (0.075, 0.025, 0.02)),
        *_gear_shapes(0.26, -0.03),
        _camera_shape(T_body_camera),
        *_rotor_shapes(airframe),
    )
    mounts = (ArmMount("right", HECATONQUIROS_4DOF, T_body_base),)
    return VehicleConfig("aquiles", airframe, mounts, T_body_camera, shapes)


def _belerofonte(tool: bool) -> VehicleConfig:
    forward, down = math.cos(math.radians(60.0)), math.sin(math.radians(60.0))
    axes = np.array([[0.0, -down, forward], [-1.0, 0.0, 0.0], [0.0, -forward, -down]])  # right, down, ahead
    T_body_camera = transform(axes, (0.12, 0.0, -0.10))
    gone = {"right arm, stowed", "landing gear", "battery, 6S 12 Ah", "camera"}
    if not tool:
        gone.add("left arm, holding the tool")
    name = "belerofonte-tool" if tool else "belerofonte-arms"
    battery = (-0.13, 0.0, -0.06)
    airframe = replace(
        BELEROFONTE,
        name=name,
        components=(
            *(c for c in BELEROFONTE.components if c.name not in gone),
            Component("battery, 6S 12 Ah", 1.50, battery, (0.18, 0.09, 0.06)),
            Component("landing gear, folded", 0.40, (0.0, 0.0, -0.03), (0.03, 0.76, 0.03)),
            _camera_component(T_body_camera),
        ),
    )
    shapes: tuple[Shape, ...] = (
        Shape.cylinder("hub", (0.0, 0.0, -0.04), (0.0, 0.0, 0.06), 0.126),
        Shape.box("computer", (0.0, 0.0, -0.09), (0.055, 0.055, 0.05)),
        Shape.box("battery", battery, (0.09, 0.045, 0.03)),
        *_gear_shapes(0.38, -0.03),
        _camera_shape(T_body_camera),
        *_rotor_shapes(airframe),
    )
    mounts = [ArmMount("right", HECATONQUIROS_6DOF, _below(0.10, -0.20, -0.08))]
    if tool:
        x, y, z = airframe.tip_position
        shapes += (Shape.capsule("holder", (0.0, y, z), (x, y, z), 0.018),)
    else:
        mounts.append(ArmMount("left", HECATONQUIROS_6DOF, _below(0.10, 0.20, -0.08)))
    return VehicleConfig(name, airframe, tuple(mounts), T_body_camera, shapes, tool)


AQUILES = _aquiles()
BELEROFONTE_ARMS = _belerofonte(tool=False)
BELEROFONTE_TOOL = _belerofonte(tool=True)
VEHICLES = {v.name: v for v in (AQUILES, BELEROFONTE_ARMS, BELEROFONTE_TOOL)}
