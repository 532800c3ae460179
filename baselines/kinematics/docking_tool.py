"""Kinematics of the passive five-joint docking tool (thesis section 5.4.1, Table 5.1, figure 5.15).

The chain, from the clamped base to the tip that holds the vehicle, is T_base_tip = T0 T1 T2 T3 T4 with
T0 = Rz(θ0) Trans(0, 0, l0), Ti = Rx(θi) Trans(0, 0, li) for i = 1…3, T4 = Ry(θ4) Trans(0, l4, 0). The thesis prints
every translation along its rotation axis and θ1 in T4; links 1–3 could not move the tip then, so the links are taken
across.

Joints 1–3 turn about parallel axes: with y' = Rz(θ0) y and φ = θ1 + θ2 + θ3 the tip lies in the plane (y', z), and its
rotation is Rz(θ0) Rx(φ) Ry(θ4). Everything below is written in that plane. A vehicle hangs level at φ = ± 90°.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.spatial import as_array, check_transform
from baselines.kinematics import docking_workspace
from baselines.kinematics.docking_workspace import SetPoint, Workspace

Array = NDArray[np.float64]

HALF_RANGE = np.deg2rad(75.0)  # half of the 150° over which a potentiometer's signal does not saturate [rad]

_LIMIT_SLACK = 1e-9  # rounding of an inverse at a limit [rad]
_CHUNK = 20_000  # poses solved at once: ten branches each, so memory stays below 100 MB


class Unreachable(ValueError):
    """No joint angles meet the pose within tolerance and limits; the attributes hold the best branch's evidence."""

    def __init__(self, message: str, position_error: float, orientation_error: float, limit_excess: float) -> None:
        super().__init__(message)
        self.position_error = position_error  # of the closest pose the joints can make [m]
        self.orientation_error = orientation_error  # [rad]
        self.limit_excess = limit_excess  # how far its worst joint lies beyond its limit, 0 inside [rad]


class ToolSolution(NamedTuple):
    """What `DockingTool.solve` found for each pose; where `reachable` is False the rest is about the closest branch."""

    q: Array  # (..., 5) [rad], NaN where not reachable
    reachable: NDArray[np.bool_]  # (...)
    quality: Array  # (...) in [0, 1], 0 where not reachable
    position_error: Array  # (...) [m]
    orientation_error: Array  # (...) [rad]
    limit_excess: Array  # (...) [rad], how far the worst joint lies beyond its limit


@dataclass(frozen=True)
class DockingTool:
    """The docking tool's kinematics.

    Args:
        joint_centers: the angle at the middle of each potentiometer's signal range [rad]; how the tool was mounted.
        lengths: l0 … l4 [m]; Table 5.1's by default.

    Raises:
        ValueError: not five finite numbers each, or a length that is not positive.
    """

    joint_centers: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    lengths: tuple[float, ...] = (0.071, 0.105, 0.155, 0.07, 0.075)

    def __post_init__(self) -> None:
        for name in ("joint_centers", "lengths"):
            values = as_array(getattr(self, name), (5,), name)
            if values.shape != (5,):
                raise ValueError(f"{name}: expected shape (5,), got {values.shape}")
            object.__setattr__(self, name, tuple(values.tolist()))
        if min(self.lengths) <= 0.0:
            raise ValueError(f"lengths: expected positive lengths, got {self.lengths}")

    @property
    def limits(self) -> Array:
        """(5, 2) [rad]: the joint centres ± 75°, outside which the readings saturate."""
        return np.asarray(self.joint_centers)[:, None] + HALF_RANGE * np.array([-1.0, 1.0])

    def forward(self, q: ArrayLike) -> Array:
        """T_base_tip (..., 4, 4) at joint angles q (..., 5) [rad]; limits are not enforced.

        Raises:
            ValueError: q has another shape or is not finite.
        """
        return self._forward(as_array(q, (5,), "q"))

    def jacobian(self, q: ArrayLike) -> Array:
        """d(tip velocity; tip angular velocity) / d(joint rates), (..., 6, 5): linear first, axes of the base.

        Raises:
            ValueError: q has another shape or is not finite.
        """
        q = as_array(q, (5,), "q")
        T = self._forward(q)
        c0, s0, zero, one = np.cos(q[..., 0]), np.sin(q[..., 0]), np.zeros(q.shape[:-1]), np.ones(q.shape[:-1])
        up = np.stack([zero, zero, one], axis=-1)
        sideways = np.stack([c0, s0, zero], axis=-1)  # the axis of joints 1–3
        inward = np.stack([-s0, c0, zero], axis=-1)  # y'
        tip = T[..., :3, 3]
        origin = self.lengths[0] * up
        columns = [(np.cross(up, tip), up)]
        for length, angle in zip(self.lengths[1:4], np.moveaxis(np.cumsum(q[..., 1:4], axis=-1), -1, 0), strict=True):
            columns.append((np.cross(sideways, tip - origin), sideways))
            origin = origin + length * (np.cos(angle)[..., None] * up - np.sin(angle)[..., None] * inward)
        columns.append((np.zeros_like(tip), T[..., :3, 1]))  # the last link lies along its own axis
        return np.stack([np.concatenate(pair, axis=-1) for pair in columns], axis=-1)

    def quality(self, q: ArrayLike) -> Array:
        """Product over the joints of 1 − |q − centre| / 75°, (...): 1 at the centres, 0 at and beyond any limit.

        Thesis section 5.4.1, figure 5.15. q is (..., 5) [rad].

        Raises:
            ValueError: q has another shape or is not finite.
        """
        return self._quality(as_array(q, (5,), "q"))

    def inverse(self, T: ArrayLike, tolerance: float = 1e-6) -> Array:
        """Joint angles (..., 5) [rad] within the limits at which the tip's pose is T, in closed form.

        Where several branches fit, the one of highest quality; at the singularity (level, with the tip over the base,
        only θ0 ± θ4 matters) the split of highest quality.

        Args:
            T: T_base_tip, (..., 4, 4).
            tolerance: on position [m] and on orientation [rad]: five joints meet a five-dimensional set of poses only.

        Raises:
            Unreachable: some pose cannot be met within tolerance and limits; its attributes say by how much.
            ValueError: T is not a rigid transform, or the tolerance not a positive number.
        """
        solution = self.solve(T, tolerance)
        if solution.reachable.all():
            return solution.q
        first = tuple(int(i) for i in np.argwhere(~solution.reachable)[0])
        position, orientation, excess = (
            float(evidence[first])
            for evidence in (solution.position_error, solution.orientation_error, solution.limit_excess)
        )
        where = f" at index {first} (first of {np.sum(~solution.reachable)} unreachable)" if first else ""
        if max(position, orientation) > tolerance:
            reason = f"the closest pose is off by {position:.3g} m and {orientation:.3g} rad, tolerance {tolerance:g}"
        else:
            reason = f"its best branch has a joint {np.rad2deg(excess):.3g}° beyond its limit"
        raise Unreachable(f"T: unreachable pose{where}: {reason}", position, orientation, excess)

    def solve(self, T: ArrayLike, tolerance: float = 1e-6) -> ToolSolution:
        """As `inverse`, but an unreachable pose is marked in the result instead of raised.

        Raises:
            ValueError: T is not a rigid transform, or the tolerance not a positive number.
        """
        T = check_transform(T, "T")
        if not 0.0 < tolerance < np.inf:
            raise ValueError(f"tolerance: expected a positive number, got {tolerance}")
        flat = T.reshape(-1, 4, 4)
        chunks = [self._solve(flat[i : i + _CHUNK], tolerance) for i in range(0, max(len(flat), 1), _CHUNK)]
        shape = T.shape[:-2]
        return ToolSolution(*(np.concatenate(x).reshape(shape + x[0].shape[1:]) for x in zip(*chunks, strict=True)))

    def workspace(
        self,
        resolution: float = 0.02,
        heading: float | None = None,
        up: bool = True,
        bounds: ArrayLike | None = None,
    ) -> Workspace:
        """The quality over a grid of tip positions with the vehicle level: `docking_workspace.workspace`."""
        return docking_workspace.workspace(self, resolution, heading, up, bounds)

    def best_set_point(
        self,
        center: ArrayLike | None = None,
        radius: ArrayLike = 0.05,
        search: ArrayLike | None = None,
        heading: float | None = None,
        up: bool = True,
        resolution: float = 0.01,
    ) -> SetPoint:
        """The tip position whose worst quality over the expected motion is best: `docking_workspace.best_set_point`."""
        return docking_workspace.best_set_point(self, center, radius, search, heading, up, resolution)

    def _forward(self, q: Array) -> Array:
        l0, l1, l2, l3, l4 = self.lengths
        first = q[..., 1]
        second = first + q[..., 2]
        phi = second + q[..., 3]
        c0, s0, c4, s4 = np.cos(q[..., 0]), np.sin(q[..., 0]), np.cos(q[..., 4]), np.sin(q[..., 4])
        c, s = np.cos(phi), np.sin(phi)
        radial = -l1 * np.sin(first) - l2 * np.sin(second) - l3 * s + l4 * c  # along y'
        height = l0 + l1 * np.cos(first) + l2 * np.cos(second) + l3 * c + l4 * s
        zero, one = np.zeros_like(c0), np.ones_like(c0)
        rows = [
            [c0 * c4 - s0 * s * s4, -s0 * c, c0 * s4 + s0 * s * c4, -s0 * radial],
            [s0 * c4 + c0 * s * s4, c0 * c, s0 * s4 - c0 * s * c4, c0 * radial],
            [-c * s4, s, c * c4, height],
            [zero, zero, zero, one],
        ]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    def _quality(self, q: Array) -> Array:
        return np.prod(np.clip(1.0 - np.abs(q - self.joint_centers) / HALF_RANGE, 0.0, 1.0), axis=-1)

    def _branches(self, T: Array) -> Array:
        """Every candidate of the closed form, (N, 10, 5), each joint within half a turn of its centre.

        Five candidates for θ0, two elbows each. θ0 follows from the plane that holds the tip, unless the tip is over
        the base; or from the direction of the tip's y axis, unless that is vertical, as it is in a level vehicle;
        where both fail θ0 is free, and half way between the centres is best. Which of them hold, `forward` tells.
        """
        _, l1, l2, l3, l4 = self.lengths
        R, p = T[:, None, :3, :3], T[:, None, :3, 3]
        middle_0, middle_4 = self.joint_centers[0], self.joint_centers[4]
        sense = np.where(R[..., 2, 1] < 0.0, -1.0, 1.0)  # φ = ± 90° leaves θ0 ± θ4, seen in the tip's x axis
        free = _wrap(np.arctan2(R[..., 1, 0], R[..., 0, 0]) - middle_0 - sense * middle_4) / 2.0 + middle_0
        by_position = np.arctan2(-p[..., 0], p[..., 1])
        by_rotation = np.arctan2(-R[..., 0, 1], R[..., 1, 1])
        theta0 = np.concatenate([by_position, by_position + np.pi, by_rotation, by_rotation + np.pi, free], axis=1)

        c, s = np.cos(theta0), np.sin(theta0)
        phi = np.arctan2(R[..., 2, 1], c * R[..., 1, 1] - s * R[..., 0, 1])
        theta4 = np.arctan2(c * R[..., 0, 2] + s * R[..., 1, 2], c * R[..., 0, 0] + s * R[..., 1, 0])
        # The end of link 2 in the plane, seen from joint 1; then the two-link arm's law of cosines.
        y = c * p[..., 1] - s * p[..., 0] + l3 * np.sin(phi) - l4 * np.cos(phi)
        z = p[..., 2] - self.lengths[0] - l3 * np.cos(phi) - l4 * np.sin(phi)
        elbow = np.arccos(np.clip((y**2 + z**2 - l1**2 - l2**2) / (2.0 * l1 * l2), -1.0, 1.0))
        candidates = []
        for theta2 in (elbow, -elbow):
            theta1 = np.arctan2(-y, z) - np.arctan2(l2 * np.sin(theta2), l1 + l2 * np.cos(theta2))
            candidates.append(np.stack([theta0, theta1, theta2, phi - theta1 - theta2, theta4], axis=-1))
        q = np.concatenate(candidates, axis=1)
        return self.joint_centers + _wrap(q - self.joint_centers)

    def _solve(self, T: Array, tolerance: float) -> ToolSolution:
        q = self._branches(T)
        reached = self._forward(q)
        position = np.linalg.norm(reached[..., :3, 3] - T[:, None, :3, 3], axis=-1)
        # ‖R₁ − R₂‖ = 2√2 sin(angle / 2): exact at small angles, where the arc cosine of the trace is not.
        chord = np.linalg.norm(reached[..., :3, :3] - T[:, None, :3, :3], axis=(-2, -1))
        orientation = 2.0 * np.arcsin(np.minimum(chord / np.sqrt(8.0), 1.0))
        excess = np.max(np.abs(q - self.joint_centers), axis=-1) - HALF_RANGE
        excess = np.where(excess <= _LIMIT_SLACK, 0.0, excess)
        error = np.maximum(position, orientation)
        quality = self._quality(q)
        # First what meets the pose within limits, by quality; then what meets it beyond them; then what comes closest.
        score = np.where(error > tolerance, -100.0 - error, np.where(excess > 0.0, -excess, quality))
        best = np.argmax(score, axis=1)
        pick = (np.arange(len(T)), best)
        reachable = score[pick] >= 0.0
        q_best = np.clip(q[pick], *self.limits.T)  # takes the slack back
        return ToolSolution(
            np.where(reachable[:, None], q_best, np.nan),
            reachable,
            np.where(reachable, quality[pick], 0.0),
            position[pick],
            orientation[pick],
            excess[pick],
        )


def _wrap(angle: Array) -> Array:
    """The same angle in [−π, π)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
