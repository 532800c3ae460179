"""The passive docking tool: five sensed joints between the airframe and a clamp on the pipe.

Geometry after the thesis, section 5.4.1 (equations 5.1–5.4, with the translations along the links) and Table 5.1:
T_base_tip = T0 T1 T2 T3 T4, with T0 = Rz(θ0) Trans(0, 0, l0), Ti = Rx(θi) Trans(0, 0, li) for i = 1…3 and
T4 = Ry(θ4) Trans(0, l4, 0).

Choices of ours, which the text leaves open:
- Joint zeros. The text gives a mechanical range of 170° and a signal range of 150° per joint, not where they lie.
  `centers` puts them where the usable room around the docked pose is largest (a ball of 10 cm within the signal range
  of every joint; with every range centred on the straight chain it is 1–2 cm).
- Mounting. The tip's y axis points up when the vehicle is level (θ1 + θ2 + θ3 = 90°) and the vehicle's forward axis
  points from the tip to the pipe: R_TIP_BODY.
- Flex. With a level vehicle θ0 and θ4 are both yaw, so five joints and rigid ends would lock the vehicle's lateral
  tilt. The thesis leaves a roll joint out because the printed parts give; that give is a soft hinge between tip and
  airframe.
- Heading spring. The axis of θ4 is vertical and the hanging chain's weight lies beside it: like a gate on a tilted post
  it would swing to a stop at any tilt, and no base could be brought into line with the pipe. Wiring and friction
  prevent that on the real tool; here a spring does, too soft to be felt in docked flight (0.01 N m at 6°).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Columns are the body's axes in the tip frame: forward = −z, left = −x, up = +y.
R_TIP_BODY: NDArray[np.float64] = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
# Columns are the base's axes in the world: the pipe runs along world y, the base's y axis points along world x.
R_WORLD_BASE: NDArray[np.float64] = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class DockingToolConfig:
    """Geometry, ranges and mechanics of the docking tool (thesis Table 5.1 and section 5.4.3 unless said)."""

    lengths: tuple[float, float, float, float, float] = (0.071, 0.105, 0.155, 0.07, 0.075)  # l0 … l4 [m]
    centers: tuple[float, float, float, float, float] = (
        0.0,
        -0.13962634015954636,  # −8°
        1.6755160819145563,  # 96°
        -0.4886921905584123,  # −28°
        0.0,
    )  # ours, see above [rad]
    nominal_tip: tuple[float, float, float] = (0.0, -0.22, 0.185)  # docked tip position in the base frame [m]
    mechanical_range: float = 2.9670597283903604  # 170° [rad]
    signal_range: float = 2.6179938779914944  # 150°: readings saturate here [rad]
    # base with clamp, lock servo and accelerometer; l0 … l4 links: 150 g in all, split by length and fittings (ours)
    link_masses: tuple[float, float, float, float, float, float] = (0.055, 0.015, 0.02, 0.025, 0.02, 0.015)  # [kg]
    joint_damping: float = 0.003  # bearings, wiring and potentiometers (ours) [N m s/rad]
    heading_stiffness: float = 0.1  # light spring that centres θ4, see above (ours) [N m/rad]
    joint_armature: float = 1e-5  # keeps the light chain well conditioned (ours) [kg m²]
    flex_stiffness: float = 10.0  # roll give of the printed parts (ours) [N m/rad]
    flex_damping: float = 0.1  # [N m s/rad]
    stop_stiffness: float = 20.0  # a joint past its mechanical range bends the printed stop (ours) [N m/rad] …
    stop_damping: float = 0.05  # [N m s/rad]
    stop_strength: float = 1.5  # … and breaks it above this [N m]: the episode's "joint_limit"
    overload_force: float = 60.0  # a clamp or a printed link gives way above this (ours) [N]
    lock_torque: float = 0.18  # stall torque of the SG90 servo that locks θ0 in flight [N m]
    lock_stiffness: float = 1.0  # [N m/rad]

    def __post_init__(self) -> None:
        for name, n in (("lengths", 5), ("centers", 5), ("nominal_tip", 3), ("link_masses", 6)):
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape != (n,) or not np.isfinite(value).all():
                raise ValueError(f"{name} must be {n} finite numbers, got {getattr(self, name)!r}")
        if min(self.lengths) <= 0 or min(self.link_masses) <= 0:
            raise ValueError("lengths and link_masses must be positive")
        if not 0 < self.signal_range <= self.mechanical_range:
            raise ValueError(f"signal_range must be in (0, mechanical_range], got {self.signal_range}")

    def mechanical_limits(self) -> NDArray[np.float64]:
        """(5, 2) [rad]."""
        c = np.asarray(self.centers)[:, None]
        return c + 0.5 * self.mechanical_range * np.array([[-1.0, 1.0]])

    def signal_limits(self) -> NDArray[np.float64]:
        """(5, 2) [rad]."""
        c = np.asarray(self.centers)[:, None]
        return c + 0.5 * self.signal_range * np.array([[-1.0, 1.0]])
