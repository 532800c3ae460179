"""How the vehicle of Detect-v0 moves while it looks: hovering, passing by, or circling, all in wind."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aerograsp_env.sim.flight import Path, Reference
from aerograsp_env.spatial import Array, inverse, matrix_from_rpy, so3_exp, transform

MOTIONS = ("any", "hover", "pass", "orbit")
DISTANCE = (0.9, 1.5)  # of the camera from what it looks at, when an episode begins [m]
TILT = (0.6, 1.2)  # of the camera below the body's x axis, a gimbal's setting for the episode [rad]
AIM = 0.08  # half-width of the square that the camera is aimed at, about the target [m]
PASS_SPEED = (0.10, 0.30)  # sideways [m/s]
ORBIT_RATE = (0.10, 0.30)  # about the target [rad/s]
RAMP = 0.5  # from rest to full speed [s]
CAMERA_PLACE = (0.12, 0.0, -0.10)  # on the airframe, body frame [m]


class Start(NamedTuple):
    """An episode's view and motion as drawn."""

    motion: str  # "hover", "pass" or "orbit"
    tilt: float  # [rad]
    T_world_start: Array  # (4, 4) the level frame in which the vehicle begins, in the scene's world
    path: Path


def camera_mount(tilt: float) -> Array:
    """T_body_camera (4, 4) of the camera, its axis `tilt` [rad] below the body's x axis."""
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # looking along x, upright
    return transform(so3_exp([0.0, tilt, 0.0]) @ level, CAMERA_PLACE)


def draw_start(motion: str, target: Array, duration: float, rng: np.random.Generator) -> Start:
    """A view of a `target` (3,) [m, world] from a drawn side and height, and a motion that keeps it in view.

    A pass is centred on the view of the target: it begins half of its way (over `duration` [s]) to one side.
    """
    kind = MOTIONS[int(rng.integers(1, len(MOTIONS)))]
    distance, tilt, heading = rng.uniform(*DISTANCE), rng.uniform(*TILT), rng.uniform(-np.pi, np.pi)
    aim, side = rng.uniform(-AIM, AIM, 2), rng.choice([-1.0, 1.0])
    speed, rate = rng.uniform(*PASS_SPEED), rng.uniform(*ORBIT_RATE)
    kind = kind if motion == "any" else motion
    R = matrix_from_rpy([0.0, 0.0, heading])
    mount = camera_mount(tilt)
    aimed_at = np.asarray(target, dtype=float) + [*aim, 0.0]
    camera = aimed_at - distance * R @ mount[:3, 2]
    T_world_start = transform(R, camera - R @ mount[:3, 3])
    if kind == "pass":
        T_world_start[:3, 3] -= R @ [0.0, 0.5 * side * speed * (duration - RAMP), 0.0]
        return Start(kind, tilt, T_world_start, _line(np.array([0.0, side * speed, 0.0])))
    if kind == "orbit":
        return Start(
            kind, tilt, T_world_start, _circle((inverse(T_world_start)[:3] @ [*aimed_at, 1.0])[:2], side * rate)
        )
    return Start(kind, tilt, T_world_start, _line(np.zeros(3)))


def _ramp(time: float) -> tuple[float, float]:
    """Seconds at full speed that the way so far is worth, and the speed as a share of full speed."""
    share = min(time / RAMP, 1.0)
    return (0.5 * time * share if time < RAMP else time - 0.5 * RAMP), share


def _line(velocity: Array) -> Path:
    def path(time: float) -> Reference:
        way, share = _ramp(time)
        return Reference(way * velocity, share * velocity, 0.0)

    return path


def _circle(center: Array, rate: float) -> Path:
    """About `center` (2,), offset from the start [m], always facing it."""
    start = np.append(-center, 0.0)

    def path(time: float) -> Reference:
        way, share = _ramp(time)
        arm = so3_exp([0.0, 0.0, rate * way]) @ start
        velocity = share * rate * np.array([-arm[1], arm[0], 0.0])
        return Reference(arm - start, velocity, share * rate)

    return path
