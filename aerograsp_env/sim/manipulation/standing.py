"""An object and its support as a piece of a scene; the support on a mocap body, so that a model serves every place."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import mujoco
import numpy as np

from aerograsp_env.sim.manipulation.scene import ENVIRONMENT, OBJECT, Piece
from aerograsp_env.sim.manipulation.supports import ROLLING, TORSION, Support
from aerograsp_env.sim.objects import GraspObject
from aerograsp_env.sim.scene import quaternion

SUPPORT_BODY = "support"
_COLOUR = (0.86, 0.36, 0.20, 1.0)
_KINDS = {"box": mujoco.mjtGeom.mjGEOM_BOX, "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER}


@functools.lru_cache(maxsize=256)
def standing(item: GraspObject, support: Support) -> Piece:
    """The piece that adds both to a scene; always the same one for the same two.

    The body `SUPPORT_BODY` has the support's solids as they stand in their own world: its pose takes that world's
    origin elsewhere. The body and free joint `object` carry the item.
    """

    def add(spec: mujoco.MjSpec) -> None:
        _add_support(spec, support, item)
        _add_object(spec, item)

    return add


def _add_support(spec: mujoco.MjSpec, support: Support, item: GraspObject) -> None:
    body = spec.worldbody.add_body(name=SUPPORT_BODY, mocap=True)
    for i, solid in enumerate(support.solids):
        body.add_geom(
            name=f"support{i}", type=_KINDS[solid.kind], size=[*solid.size, 0.0][:3], pos=solid.T_world_solid[:3, 3],
            quat=quaternion(solid.T_world_solid[:3, :3]), rgba=[float(v) for v in solid.rgba.split()],
            contype=ENVIRONMENT.contype, conaffinity=ENVIRONMENT.conaffinity, group=ENVIRONMENT.group, condim=4,
            priority=1, friction=[support.contact_friction(item), TORSION, ROLLING],
        )  # fmt: skip


def _add_object(spec: mujoco.MjSpec, item: GraspObject) -> None:
    inertia = np.asarray(item.inertia, dtype=np.float64)
    body = spec.worldbody.add_body(name="object", mass=item.mass, ipos=item.center_of_mass, explicitinertial=True)
    body.fullinertia = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    body.add_freejoint(name="object")
    for i, piece in enumerate(item.pieces):
        spec.add_mesh(
            name=f"object{i}",
            uservert=np.asarray(piece.vertices, dtype=np.float64).ravel(),
            userface=np.asarray(piece.faces, dtype=np.int32).ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
        )
        body.add_geom(
            name=f"object{i}", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"object{i}", mass=0.0, rgba=_COLOUR,
            contype=OBJECT.contype, conaffinity=OBJECT.conaffinity, group=OBJECT.group, condim=4,
        )  # fmt: skip


def set_item(
    model: mujoco.MjModel, item: GraspObject, support: Support, pads: Sequence[str], pad_friction: float
) -> None:
    """Give the object of a compiled scene another mass and surface, in place: those of `item`, of the same shape.

    Args:
        pads: names of the gripper's geoms that touch it.
        pad_friction: Coulomb coefficient of their own surface; a contact's is the geometric mean of the two.
    """
    body = model.body("object").id
    model.body_inertia[body] *= item.mass / model.body_mass[body]
    model.body_mass[body] = item.mass
    for name in pads:
        model.geom_friction[model.geom(name).id, 0] = math.sqrt(item.friction * pad_friction)
    for i in range(len(support.solids)):
        model.geom_friction[model.geom(f"support{i}").id, 0] = support.contact_friction(item)
    mujoco.mj_setConst(model, mujoco.MjData(model))
