"""The pipe-inspection crawler: a big object with handles, which two arms take together.

After the mock-up of the AEROARMS project that the thesis models, detects and grasps (sections 2.4, 3.3 and 3.6.3): a
three-lobed shell with a hole in its middle, a drive unit under each lobe and a tubular handle along each of the three
sides. Three vertical planes of symmetry make twists of 60° look nearly alike, as the thesis says of its pose estimates.

Our choices: a third larger than the mock-up, so that two arms whose bases are 0.4 m apart fit around it; no antennas;
handles level with the top of the shell and so long that opposite points of two of them lie on one line with the centre
of mass: held there, the crawler hangs level.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.sim.objects import shapes
from aerograsp_env.sim.objects.build import build_object
from aerograsp_env.sim.objects.grasp_object import GraspObject
from aerograsp_env.sim.objects.shapes import Pieces, moved

Array = NDArray[np.float64]

TURN = 2.0 * np.pi / 3.0
MASS = 1.2  # [kg]
LOBE_DISTANCE, LOBE_RADIUS = 0.125, 0.050  # [m] of a lobe's middle from the axis, and its own radius
HOLE_RADIUS = 0.030  # [m]
FLOOR, BELT, TOP = 0.035, 0.075, 0.115  # [m] heights above the ground: of the belly, the widest part and the top
INSET = 0.020  # [m] by which belly and top are narrower than the widest part
DRIVE_RADIUS, DRIVE_HEIGHT = 0.034, 0.050  # [m]
HANDLE_RADIUS = 0.011  # [m] of the tube
HANDLE_DISTANCE, HANDLE_LENGTH, HANDLE_HEIGHT = 0.160, 0.200, 0.113  # [m] of the straight bar
# [m] the tube from within the shell to its bar: outwards, and along the bar
HANDLE_BEND = ((0.080, 0.095), (0.140, 0.125))
DRIVE_DENSITY, BELLY_DENSITY, SHELL_DENSITY, HANDLE_DENSITY = 3.0, 1.5, 0.6, 0.6  # relative


class Handle(NamedTuple):
    """The straight bar of a handle, in the crawler's frame."""

    start: Array  # (3,) [m]
    end: Array  # (3,) [m]
    radius: float  # [m] of the tube


@functools.cache
def pipe_crawler(mass: float = MASS, friction: float = 0.7) -> GraspObject:
    """The crawler. Frame: on the ground below its middle, z up, x through one of the lobes.

    Raises:
        ValueError: a mass or friction that is not positive.
    """
    drive = moved(
        shapes.frustum(0.9 * DRIVE_RADIUS, DRIVE_RADIUS, DRIVE_HEIGHT, 12), (LOBE_DISTANCE, 0.0, 0.5 * DRIVE_HEIGHT)
    )
    parts = (
        (_three(drive), DRIVE_DENSITY),
        (_layer((FLOOR, INSET), (BELT, 0.0)), BELLY_DENSITY),
        (_layer((BELT, 0.0), (TOP, INSET)), SHELL_DENSITY),
        (_three(shapes.sweep(_handle_path(), shapes.circle(HANDLE_RADIUS, 8))), HANDLE_DENSITY),
    )
    pieces = [piece for group, _ in parts for piece in group]
    densities = [density for group, density in parts for _ in group]
    return build_object("pipe_crawler", "pipe_crawler", pieces, mass=mass, densities=densities, friction=friction)


def crawler_handles() -> tuple[Handle, Handle, Handle]:
    """The bars of the three handles, at 60°, 180° and 300° about z; each runs counter-clockwise."""
    bars = []
    for angle in np.pi / 3.0 + TURN * np.arange(3):
        out, along = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([-np.sin(angle), np.cos(angle), 0.0])
        middle = HANDLE_DISTANCE * out + (0.0, 0.0, HANDLE_HEIGHT)
        bars.append(Handle(middle - 0.5 * HANDLE_LENGTH * along, middle + 0.5 * HANDLE_LENGTH * along, HANDLE_RADIUS))
    return bars[0], bars[1], bars[2]


def _three(pieces: Pieces) -> Pieces:
    """The pieces and their copies turned by 120° and 240° about z."""
    return tuple(piece for k in range(3) for piece in moved(pieces, turn=(0.0, 0.0, k * TURN)))


def _layer(bottom: tuple[float, float], top: tuple[float, float]) -> Pieces:
    """Six wedges around the hole, between two (height, inset) [m]."""
    wedges = []
    for side in (1.0, -1.0):
        rims = [np.insert(_wedge(inset) * (1.0, side), 2, height, axis=1) for height, inset in (bottom, top)]
        wedges.append(shapes.hull(np.concatenate(rims)))
    return _three(tuple(wedges))


def _wedge(inset: float) -> Array:
    """(K, 2) outline of the body between 0° (a lobe's tip) and 60° (the middle of a side), without the hole."""
    radius = LOBE_RADIUS - inset
    angles = np.linspace(0.0, np.pi / 3.0, 4)
    side = np.array([np.cos(np.pi / 3.0), np.sin(np.pi / 3.0)])
    lobe = (LOBE_DISTANCE, 0.0) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ends = [(0.5 * LOBE_DISTANCE + radius) * side, HOLE_RADIUS * side, (HOLE_RADIUS, 0.0)]
    return np.concatenate([lobe, ends])


def _handle_path() -> Array:
    """(6, 3) the tube's middle line of the handle at 60°."""
    half = [*HANDLE_BEND, (HANDLE_DISTANCE, 0.5 * HANDLE_LENGTH)]
    flat = np.array([(out, -along) for out, along in half] + [(out, along) for out, along in reversed(half)])
    cos, sin = np.cos(np.pi / 3.0), np.sin(np.pi / 3.0)
    turned = flat @ np.array([[cos, sin], [-sin, cos]])
    return np.insert(turned, 2, HANDLE_HEIGHT, axis=1)
