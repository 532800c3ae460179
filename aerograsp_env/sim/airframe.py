"""Hexarotor airframes: mass and inertia from their components, rotors, and the mixer.

Two airframes are described. `BELEROFONTE` is the medium hexarotor of the thesis (section 5.3). Its text gives no
masses, so they are derived here from a component table (typical parts of that class: 6S battery, mini computer, 15-inch
rotors, two printed arms) by the parallel-axis theorem. `FIREFLY` carries the published figures of the AscTec Firefly
(RotorS, Furrer et al. 2016), whose rotor constants are identified ones.

Body frame: x forward, y left, z up; origin at the centre of the rotor hubs' ring, in the plane of the booms.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

GRAVITY = 9.81  # [m/s²]
AIR_DENSITY = 1.204  # [kg/m³] at 20 °C, sea level


@dataclass(frozen=True)
class Component:
    """A part as a solid box: mass [kg], centre [m] and full extents [m] in the body frame."""

    name: str
    mass: float
    position: tuple[float, float, float]
    extents: tuple[float, float, float]

    def inertia(self) -> NDArray[np.float64]:
        """(3, 3) inertia of the solid box about its own centre [kg m²]."""
        a, b, c = self.extents
        return self.mass / 12.0 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])


def mass_properties(components: tuple[Component, ...]) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Total mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m²], by the parallel-axis theorem."""
    mass = sum(c.mass for c in components)
    com = sum((c.mass * np.asarray(c.position) for c in components), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for c in components:
        r = np.asarray(c.position) - com
        inertia += c.inertia() + c.mass * (r @ r * np.eye(3) - np.outer(r, r))
    return mass, com, inertia


@dataclass(frozen=True)
class Rotor:
    """What the six rotors share.

    thrust = thrust_constant · ω² [N], drag torque = drag_ratio · thrust [N m], ω follows its command with a first-order
    lag.
    """

    thrust_constant: float  # [N s²/rad²]
    drag_ratio: float  # [m]
    speed_max: float  # [rad/s]
    time_constant_up: float  # [s]
    time_constant_down: float  # [s]
    drag: float  # in-plane force per rotor = −drag · ω · v⊥ [N s²/(rad m)]
    radius: float  # [m]

    @property
    def thrust_max(self) -> float:
        """[N] at full speed."""
        return self.thrust_constant * self.speed_max**2


@dataclass(frozen=True)
class AirframeConfig:
    """One hexarotor. `components` or (`mass`, `com`, `inertia`) say what it weighs."""

    name: str
    rotor: Rotor
    arm_length: float  # hub distance from the centre [m]
    rotor_height: float  # rotor plane above the body origin [m]
    drag_area: float  # C_d A of the body [m²], same along every axis
    tip_position: tuple[float, float, float]  # where the docking tool's tip is mounted, body frame [m]
    components: tuple[Component, ...] = ()
    mass: float = 0.0
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inertia: tuple[float, float, float] = (0.0, 0.0, 0.0)
    angles: tuple[float, ...] = field(default=tuple(np.radians([30.0, 90.0, 150.0, -150.0, -90.0, -30.0]).tolist()))
    directions: tuple[int, ...] = (1, -1, 1, -1, 1, -1)  # +1 turns counter-clockwise seen from above

    def properties(self) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """Mass [kg], centre of mass (3,) [m], inertia about it (3, 3) [kg m²], body frame."""
        if self.components:
            return mass_properties(self.components)
        return self.mass, np.array(self.com), np.diag(self.inertia)

    def rotor_positions(self) -> NDArray[np.float64]:
        """(6, 3) hubs in the body frame [m]."""
        a = np.asarray(self.angles)
        x, y = self.arm_length * np.cos(a), self.arm_length * np.sin(a)
        return np.stack([x, y, np.full(6, self.rotor_height)], axis=1)

    def allocation(self, com: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """(4, 6) matrix from rotor thrusts [N] to (collective thrust [N], torque about `com` [N m])."""
        r = self.rotor_positions() - (self.properties()[1] if com is None else com)
        yaw = -self.rotor.drag_ratio * np.asarray(self.directions, dtype=float)  # reaction opposes the rotor's turning
        return np.stack([np.ones(6), r[:, 1], -r[:, 0], yaw])

    def torque_scale(self) -> NDArray[np.float64]:
        """(3,) torque [N m] that PX4's mixer gives a full roll, pitch or yaw command.

        PX4 normalises each axis' column of the mixer to a largest entry of one and each motor's output to its thrust
        range, which is how one set of default gains serves airframes of any size.
        """
        columns = self.allocation(np.zeros(3))[1:]
        weights = columns / np.abs(columns).max(axis=1, keepdims=True)
        return self.rotor.thrust_max * np.sum(columns * weights, axis=1)

    def with_payload(self, mass: float, position: tuple[float, float, float] = (0.0, 0.0, -0.2)) -> AirframeConfig:
        """The same airframe with `mass` [kg] more under it; the autopilot is not told."""
        if not 0.0 <= mass <= 5.0:
            raise ValueError(f"payload must be in [0, 5] kg, got {mass}")
        if mass == 0.0:
            return self
        own, com, inertia = self.properties()
        base = self.components or (Component("airframe", own, tuple(com.tolist()), _box_of(own, inertia)),)
        return replace(self, components=base + (Component("payload", mass, position, (0.1, 0.1, 0.1)),))


def _box_of(mass: float, inertia: NDArray[np.float64]) -> tuple[float, float, float]:
    """Extents of the solid box that has this diagonal inertia."""
    i = np.diag(inertia)
    e = np.sqrt(np.maximum(6.0 / mass * (i.sum() - 2.0 * i), 0.0))
    return float(e[0]), float(e[1]), float(e[2])


def _booms(radius: float, boom_mass: float, motor_mass: float, height: float) -> tuple[Component, ...]:
    parts = []
    for i, angle in enumerate(np.radians([30.0, 90.0, 150.0, -150.0, -90.0, -30.0])):
        c, s = float(np.cos(angle)), float(np.sin(angle))
        middle = 0.5 * radius * c, 0.5 * radius * s, 0.0
        parts.append(Component(f"boom {i}", boom_mass, middle, (0.025, 0.025, 0.025)))
        parts.append(Component(f"motor {i}", motor_mass, (radius * c, radius * s, height), (0.05, 0.05, 0.05)))
    return tuple(parts)


BELEROFONTE = AirframeConfig(
    name="belerofonte",
    rotor=Rotor(3.6e-5, 0.018, 850.0, 0.04, 0.06, 7.3e-5, 0.19),
    arm_length=0.42,
    rotor_height=0.05,
    drag_area=0.10,
    tip_position=(0.35, 0.20, -0.10),
    components=(
        Component("plates, wiring and power board", 0.90, (0.0, 0.0, 0.0), (0.25, 0.25, 0.06)),
        Component("battery, 6S 12 Ah", 1.50, (-0.07, 0.0, -0.06), (0.18, 0.09, 0.06)),
        Component("onboard computer", 0.50, (0.0, 0.0, -0.12), (0.11, 0.11, 0.04)),
        Component("autopilot and GPS", 0.15, (0.0, 0.0, 0.05), (0.08, 0.08, 0.03)),
        *_booms(0.42, 0.12, 0.22, 0.03),
        Component("landing gear", 0.40, (0.0, 0.0, -0.15), (0.30, 0.30, 0.20)),
        Component("right arm, stowed", 0.67, (0.0, -0.20, -0.15), (0.10, 0.10, 0.25)),
        Component("left arm, holding the tool", 0.67, (0.15, 0.20, -0.10), (0.30, 0.06, 0.06)),
        Component("camera", 0.10, (0.12, 0.0, -0.10), (0.02, 0.09, 0.03)),
    ),
)

FIREFLY = AirframeConfig(
    name="firefly",
    rotor=Rotor(8.54858e-6, 0.016, 838.0, 0.0125, 0.025, 8.06428e-5, 0.10),
    arm_length=0.215,
    rotor_height=0.037,
    drag_area=0.03,
    tip_position=(0.22, 0.0, -0.08),
    mass=1.56779,
    # published izz 0.0977 exceeds ixx + iyy, which no body's can: held at that limit
    inertia=(0.0347563, 0.0458929, 0.0806),
)

AIRFRAMES = {a.name: a for a in (BELEROFONTE, FIREFLY)}
