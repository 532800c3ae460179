"""The MuJoCo model in which a grasp is judged: one object, and the parallel-jaw gripper that takes it.

The model's world is the gripper's frame (`aerograsp_env.sim.gripper`) as it stands at the grasp, so that one model
serves every grasp of an object: the object's free joint places it, and gravity comes as a force on it. The gripper
hangs on three slides driven by servos, so that contacts see the velocity of its pads; its fingers close with a constant
force.
"""

from __future__ import annotations

import threading
from collections import OrderedDict

import mujoco
import numpy as np

from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.objects import GraspObject

TIMESTEP = 0.002  # [s]
OBJECT_GROUP, GRIPPER_GROUP = 1, 2  # geom groups
BASE_MASS = 2.0  # [kg]
BASE_FREQUENCY = 20.0  # [Hz] of the critically damped servo of each slide
FINGER_MASS = 0.05  # [kg]
FINGER_ARMATURE = 0.30  # [kg] the drive's inertia, seen at the finger
CLOSING_SPEED = 0.20  # [m/s] at which the drive's friction balances the closing force
COUPLING = 2.0e4  # [N/m] stiffness of the drive that moves both fingers alike

# Pads as soft as rubber (0.2 mm under the closing force) and friction much harder than they are. Stiffer pads lose
# their contact for single steps while they are shaken, and snap back; with softer friction a held object creeps.
_SOLREF = (0.01, 1.0)
_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)
_IMPRATIO = 100.0
_TORSION = 0.002  # [m] torsional friction of one contact point, as a lever of its normal force
_ROLLING = 1e-4  # [m]; unused with four-dimensional contacts

_CACHE_SIZE = 48
_cache: OrderedDict[tuple[GraspObject, GripperConfig], mujoco.MjModel] = OrderedDict()
_lock = threading.Lock()


def contact_friction(item: GraspObject, gripper: GripperConfig) -> float:
    """Coulomb coefficient between the object and the gripper: the geometric mean of the two surfaces' own."""
    return float(np.sqrt(item.friction * gripper.friction))


def grasp_model(item: GraspObject, gripper: GripperConfig) -> mujoco.MjModel:
    """The compiled model of an object and a gripper; the last few are kept. It must not be changed.

    Joints: slides `x`, `y`, `z` of the base, `left` and `right` of the fingers (0 at the largest opening, positive
    when closing), and the object's free joint. Controls: the base's position (3) [m] and the fingers' forces (2) [N].
    """
    key = (item, gripper)
    with _lock:
        if key in _cache:
            _cache.move_to_end(key)
            return _cache[key]
    model = _compile(item, gripper)
    with _lock:
        _cache[key] = model
        while len(_cache) > _CACHE_SIZE:
            _cache.popitem(last=False)
    return model


def _compile(item: GraspObject, gripper: GripperConfig) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.modelname = "grasp"
    option = spec.option
    option.timestep = TIMESTEP
    option.gravity = (0.0, 0.0, 0.0)
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = _IMPRATIO
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.memory = 1 << 21
    _add_gripper(spec, gripper, contact_friction(item, gripper))
    _add_object(spec, item)
    for finger in ("left", "right"):
        spec.add_sensor(
            name=f"{finger}_touch",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            objname=finger,
            reftype=mujoco.mjtObj.mjOBJ_BODY,
            refname="object",
            intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1],
        )
    return spec.compile()


def _add_gripper(spec: mujoco.MjSpec, gripper: GripperConfig, friction: float) -> None:
    base = spec.worldbody.add_body(name="palm", mass=BASE_MASS, inertia=[0.01] * 3, explicitinertial=True)
    for name, axis in zip("xyz", np.eye(3), strict=True):
        base.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    closing, rate = 0.5 * gripper.max_width, 2.0 * np.pi * BASE_FREQUENCY
    bodies = {"palm": base}
    for name, sign in (("left", 1.0), ("right", -1.0)):
        body = base.add_body(name=name, mass=FINGER_MASS, inertia=[1e-4] * 3, explicitinertial=True)
        body.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[sign, 0.0, 0.0],
            limited=True,
            range=[0.0, closing],
            armature=FINGER_ARMATURE,
            damping=gripper.force / CLOSING_SPEED,
        )
        bodies[name] = body
    for box in gripper.boxes(gripper.max_width):
        bodies[box.name.partition("_")[0]].add_geom(
            name=box.name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=box.center,
            size=box.half_size,
            group=GRIPPER_GROUP,
            contype=1,  # meets the object only
            conaffinity=0,
            condim=4,
            priority=1,  # so that these settings hold for the contact
            friction=[friction, _TORSION, _ROLLING],
            solref=_SOLREF,
            solimp=_SOLIMP,
        )
    # A screw or a linkage moves both fingers alike: a spring between them, stiff and passive.
    tendon = spec.add_tendon(name="coupling", stiffness=COUPLING, damping=100.0, springlength=[0.0, 0.0])
    tendon.wrap_joint("left", 1.0)
    tendon.wrap_joint("right", -1.0)
    mass = BASE_MASS + 2.0 * FINGER_MASS
    for name in "xyz":
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=mass * rate**2, kv=2.0 * mass * rate)
    for name in ("left", "right"):
        spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT).set_to_motor()


def _add_object(spec: mujoco.MjSpec, item: GraspObject) -> None:
    body = spec.worldbody.add_body(name="object", mass=item.mass, ipos=item.center_of_mass, explicitinertial=True)
    inertia = np.asarray(item.inertia, dtype=np.float64)
    body.fullinertia = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    body.add_freejoint(name="object")
    for i, piece in enumerate(item.pieces):
        spec.add_mesh(
            name=f"piece_{i}",
            uservert=np.asarray(piece.vertices, dtype=np.float64).ravel(),
            userface=np.asarray(piece.faces, dtype=np.int32).ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
        )
        body.add_geom(
            name=f"piece_{i}",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"piece_{i}",
            group=OBJECT_GROUP,
            contype=0,
            conaffinity=1,
            condim=4,
        )
