"""The printed arms of the Hecatonquiros project (thesis section 5.2, appendix A.3): four, five and six joints.

Offsets, axes and limits are those of the project's OpenRAVE files `arm_4dof.kinbody.xml`,
`arm_gripper_5dof.kinbody.xml` and `arm_gripper_6dof.kinbody.xml`; successive `<rotationaxis>` multiply from the left,
and the base is the body `arm_0_attachment`. At zero every arm is stretched along the base's z axis, and the tool frame
is parallel to the frame of joint 3. A negative angle of joint 1 leans the arm to the base's +x, a positive angle of
joint 2 bends it back.

The three grippers (section 5.3) add 0, 1 and 2 wrist axes between the forearm's roll (joint 3) and the jaws. The
four-joint arm's tool lies where `gripper_serial_strong_0dof.kinbody.xml` puts it, 0.235 m from joint 3 on its axis. The
files give no closing axis: the pads of `gripper_2dof.kinbody.xml` lie along x of the last joint, which at zero is
parallel to the axes of joints 1, 2 and 4; the other two are given the same.

Choices of ours, which text and files leave open:
- Masses. The text says that the four-joint arm weighs 0.72 kg with servos, wiring and electronics, and no file has a
  mass. The table below spreads them over parts of typical weight (servos of 60 g and 55 g, printed ABS), each a solid
  box; so the five-joint arm comes to 0.665 kg and the six-joint arm to 0.72 kg: lighter servos, brackets and gripper
  make up for the axes they have more.
- Servos. The four-joint arm has analog servos of 25 kg·cm (2.45 N m) in its joints, as the text says. The others have
  serial servos of 30 kg·cm (2.94 N m, 45 rev/min, 12-bit encoder, typical of those that 150 $ an arm can buy), two of
  them side by side at the shoulder. Gains are those of stiff position servos, not identified.
- Configurations. `home` points the tool along the base's z axis, 30° and more from every limit of the longer arms and
  where their Jacobians are far from singular; `stowed` folds the arm below its base.
- Collision shapes: capsules round the printed parts, a cylinder for the base, the boxes of the gripper.
"""

from __future__ import annotations

import numpy as np

from aerograsp_env.sim.airframe import Component, mass_properties
from aerograsp_env.sim.arms.description import ArmConfig, Joint, Link, Shape, WormGripper
from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.spatial import Array, transform

KGF_CM = 9.80665e-2  # [N m]
PWM_TORQUE, SERIAL_TORQUE = 25.0 * KGF_CM, 30.0 * KGF_CM
PWM_RATE, SERIAL_RATE = 5.0, 4.7  # without load [rad/s]
SERVO_SIZE = (0.045, 0.025, 0.035)  # [m] of either
_STIFFNESS = (60.0, 80.0, 60.0, 30.0, 20.0, 15.0)  # [N m/rad]
_DAMPING_TIME = 0.04  # damping / stiffness [s]
_ARMATURE = 0.01  # 8e-8 kg m² of a coreless motor behind gears of 1 : 345 [kg m²]

_X, _Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
_TURN = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # by 90° about y
# z 180° · y −90° · x −90°: the upper arm's x along the base's z, its hinge along the base's −y
_SHOULDER = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_WRIST_5 = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])  # x 180° · y 90°

Part = tuple[str, float, tuple[float, float, float], tuple[float, float, float]]  # name, [kg], centre, extents [m]


def _link(name: str, parts: tuple[Part, ...], *shapes: Shape) -> Link:
    mass, center, inertia = mass_properties(tuple(Component(*part) for part in parts))
    return Link(name, mass, center, inertia, shapes)


def _joints(
    placements: tuple[Array, ...],
    signs: tuple[float, ...],
    limits: tuple[tuple[float, float], ...],
    torques: tuple[float, ...],
    rate: float,
) -> tuple[Joint, ...]:
    return tuple(
        Joint(
            name=f"joint{i}",
            T_parent_joint=T,
            axis=np.array([0.0, 0.0, signs[i]]),
            limits=(float(np.radians(limits[i][0])), float(np.radians(limits[i][1]))),
            rate_limit=rate,
            torque_limit=torques[i],
            stiffness=_STIFFNESS[i],
            damping=_DAMPING_TIME * _STIFFNESS[i],
            armature=_ARMATURE,
        )
        for i, T in enumerate(placements)
    )


def _at(R: Array, x: float, y: float, z: float) -> Array:
    return transform(R, (x, y, z))


# base → yaw → shoulder → elbow → forearm roll, the same in all three
_PLACEMENTS = (
    _at(np.eye(3), 0.0, 0.0, 0.02 + 0.03),
    _at(_SHOULDER, 0.0, 0.0, 0.03),
    _at(np.eye(3), 0.148, 0.0, 0.0),
    _at(_TURN, 0.06, 0.0, 0.0),
)
_UPPER = Shape.capsule("upper_arm", (0.0, 0.0, 0.0), (0.148, 0.0, 0.0), 0.022)
_FOREARM = Shape.capsule("forearm", (0.0, 0.0, 0.0), (0.06, 0.0, 0.0), 0.020)
_HOUSING = Shape.cylinder("housing", (0.0, 0.0, 0.0), (0.0, 0.0, 0.045), 0.030)
_BRACKET = Shape.capsule("bracket", (0.0, 0.0, 0.005), (0.0, 0.0, 0.03), 0.024)
_JAWS = GripperConfig()  # the jaws for which grasps are planned and judged


def _four() -> ArmConfig:
    servo = SERVO_SIZE
    tool = 0.235
    links = (
        _link("yaw", (
            ("bracket", 0.040, (0.0, 0.0, 0.012), (0.05, 0.05, 0.03)),
            ("servo 1", 0.060, (0.0, 0.0, 0.03), servo),
        ), _BRACKET),
        _link("upper_arm", (
            ("beam", 0.050, (0.074, 0.0, 0.0), (0.148, 0.035, 0.030)),
            ("servo 2", 0.060, (0.140, 0.0, 0.0), servo),
            ("wiring", 0.010, (0.074, 0.0, 0.0), (0.148, 0.005, 0.005)),
        ), _UPPER),
        _link("forearm", (
            ("bracket", 0.030, (0.03, 0.0, 0.0), (0.06, 0.035, 0.035)),
            ("servo 3", 0.060, (0.035, 0.0, 0.0), servo),
        ), _FOREARM),
        _link("hand", (
            ("connector", 0.025, (0.0, 0.0, 0.01), (0.04, 0.04, 0.02)),
            ("gripper's frame", 0.055, (0.0, 0.0, 0.08), (0.05, 0.04, 0.12)),
            ("gripper's servo", 0.055, (0.0, 0.0, 0.09), (0.025, 0.035, 0.045)),
            ("worm and nut", 0.025, (0.0, 0.0, 0.14), (0.02, 0.02, 0.03)),
            ("jaw guide", 0.030, (0.0, 0.0, tool - 0.075), (0.122, 0.04, 0.03)),
        ), Shape.capsule("hand", (0.0, 0.0, 0.035), (0.0, 0.0, 0.135), 0.024)),
    )  # fmt: skip
    base = _link("base", (
        ("housing", 0.070, (0.0, 0.0, 0.022), (0.07, 0.07, 0.045)),
        ("servo 0", 0.060, (0.0, 0.0, 0.02), (0.045, 0.025, 0.035)),
        ("servo board", 0.045, (-0.04, 0.0, 0.005), (0.07, 0.055, 0.01)),
    ), _HOUSING)  # fmt: skip
    return ArmConfig(
        name="hecatonquiros-4dof",
        base=base,
        joints=_joints(
            _PLACEMENTS, (-1.0, 1.0, 1.0, -1.0), ((-90, 90), (-100, 30), (-15, 150), (-110, 110)),
            (PWM_TORQUE,) * 4, PWM_RATE,
        ),
        links=links,
        T_last_tool=_at(np.eye(3), 0.0, 0.0, tool),
        gripper=WormGripper(_JAWS, finger_mass=0.0225),
        stowed=np.radians([0.0, -100.0, 140.0, 0.0]),
        home=np.radians([0.0, -60.0, 60.0, 0.0]),
    )  # fmt: skip


def _serial_base() -> Link:
    return _link("base", (
        ("housing", 0.050, (0.0, 0.0, 0.022), (0.07, 0.07, 0.045)),
        ("servo 0", 0.055, (0.0, 0.0, 0.02), SERVO_SIZE),
        ("bus adapter", 0.010, (-0.03, 0.0, 0.005), (0.04, 0.03, 0.01)),
    ), _HOUSING)  # fmt: skip


def _serial_links() -> tuple[Link, Link, Link]:
    return (
        _link("yaw", (
            ("bracket", 0.040, (0.0, 0.0, 0.012), (0.05, 0.06, 0.03)),
            ("servo 1, left", 0.055, (0.0, 0.015, 0.03), SERVO_SIZE),
            ("servo 1, right", 0.055, (0.0, -0.015, 0.03), SERVO_SIZE),
        ), _BRACKET),
        _link("upper_arm", (
            ("beam", 0.040, (0.074, 0.0, 0.0), (0.148, 0.035, 0.030)),
            ("servo 2", 0.055, (0.140, 0.0, 0.0), SERVO_SIZE),
            ("wiring", 0.005, (0.074, 0.0, 0.0), (0.148, 0.005, 0.005)),
        ), _UPPER),
        _link("forearm", (
            ("bracket", 0.020, (0.03, 0.0, 0.0), (0.06, 0.035, 0.035)),
            ("servo 3", 0.055, (0.035, 0.0, 0.0), SERVO_SIZE),
        ), _FOREARM),
    )  # fmt: skip


_SERIAL_TORQUES = (SERIAL_TORQUE, 2.0 * SERIAL_TORQUE) + 4 * (SERIAL_TORQUE,)
_UPRIGHT_SERVO = (0.025, 0.035, 0.045)


def _five() -> ArmConfig:
    links = (
        *_serial_links(),
        _link("wrist_roll", (
            ("connector", 0.020, (0.0, 0.0, 0.005), (0.04, 0.04, 0.02)),
            ("tube", 0.025, (0.0, 0.0, 0.055), (0.04, 0.035, 0.09)),
            ("servo 4", 0.055, (0.0, 0.0, 0.105), _UPRIGHT_SERVO),
        ), Shape.capsule("wrist_roll", (0.0, 0.0, 0.035), (0.0, 0.0, 0.110), 0.020)),
        _link("hand", (
            ("gripper's frame", 0.030, (0.025, 0.0, 0.0), (0.05, 0.035, 0.04)),
            ("gripper's servo", 0.030, (0.045, 0.0, 0.0), (0.03, 0.030, 0.02)),
            ("jaw guide", 0.025, (0.065, 0.0, 0.0), (0.03, 0.04, 0.122)),
        ), Shape.capsule("hand", (0.015, 0.0, 0.0), (0.045, 0.0, 0.0), 0.018)),
    )  # fmt: skip
    return ArmConfig(
        name="hecatonquiros-5dof",
        base=_serial_base(),
        joints=_joints(
            (*_PLACEMENTS, _at(_WRIST_5, 0.0, 0.0, 0.124)), (-1.0, 1.0, 1.0, 1.0, 1.0), ((-110, 110),) * 5,
            _SERIAL_TORQUES[:5], SERIAL_RATE,
        ),
        links=links,
        T_last_tool=_at(_WRIST_5, 0.14, 0.0, 0.0),  # x along the wrist's hinge, z along the hand
        gripper=WormGripper(_JAWS),
        stowed=np.radians([0.0, -100.0, 100.0, 0.0, -100.0]),
        home=np.radians([0.0, 10.0, -80.0, 0.0, -70.0]),
    )  # fmt: skip


def _six() -> ArmConfig:
    links = (
        *_serial_links(),
        _link("wrist_roll", (
            ("connector", 0.020, (0.0, 0.0, 0.005), (0.04, 0.04, 0.02)),
            ("tube", 0.025, (0.0, 0.0, 0.050), (0.04, 0.035, 0.08)),
            ("servo 4", 0.055, (0.0, 0.0, 0.095), _UPRIGHT_SERVO),
        ), Shape.capsule("wrist_roll", (0.0, 0.0, 0.035), (0.0, 0.0, 0.100), 0.020)),
        _link("wrist_pitch", (
            ("bracket", 0.010, (0.015, 0.0, 0.0), (0.04, 0.035, 0.035)),
            ("servo 5", 0.055, (0.020, 0.0, 0.0), SERVO_SIZE),
        ), Shape.capsule("wrist_pitch", (0.0, 0.0, 0.0), (0.03, 0.0, 0.0), 0.020)),
        _link("hand", (
            ("gripper's frame", 0.020, (-0.010, 0.0, 0.015), (0.04, 0.035, 0.03)),
            ("gripper's servo", 0.030, (-0.015, 0.0, 0.025), (0.03, 0.030, 0.02)),
            ("jaw guide", 0.025, (-0.015, 0.0, 0.045), (0.122, 0.04, 0.03)),
        ), Shape.capsule("hand", (-0.008, 0.0, 0.012), (-0.015, 0.0, 0.030), 0.018)),
    )  # fmt: skip
    return ArmConfig(
        name="hecatonquiros-6dof",
        base=_serial_base(),
        joints=_joints(
            (*_PLACEMENTS, _at(_TURN.T, 0.0, 0.0, 0.115), _at(_TURN, 0.04, 0.0, 0.0)),
            (-1.0, 1.0, 1.0, 1.0, 1.0, 1.0), ((-110, 110),) * 6, _SERIAL_TORQUES, SERIAL_RATE,
        ),
        links=links,
        T_last_tool=_at(np.eye(3), -0.015, 0.0, 0.12),
        gripper=WormGripper(_JAWS),
        stowed=np.radians([0.0, -100.0, 100.0, 0.0, 100.0, 0.0]),
        home=np.radians([0.0, 10.0, -80.0, 0.0, 70.0, 0.0]),
    )  # fmt: skip


HECATONQUIROS_4DOF = _four()
HECATONQUIROS_5DOF = _five()
HECATONQUIROS_6DOF = _six()
ARMS = {arm.name: arm for arm in (HECATONQUIROS_4DOF, HECATONQUIROS_5DOF, HECATONQUIROS_6DOF)}
