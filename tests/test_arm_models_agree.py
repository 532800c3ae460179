"""One description, three models: what MuJoCo and pin make of an arm agrees; servos and fingers do as described."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from aerograsp_env.sim.arms.description import ArmConfig
from aerograsp_env.sim.arms.hecatonquiros import ARMS, HECATONQUIROS_6DOF
from aerograsp_env.sim.arms.mjcf import ArmXml, Contact, arm_mjcf
from aerograsp_env.sim.arms.urdf import urdf
from aerograsp_env.spatial import so3_exp, transform

GRAVITY = np.array([1.0, -2.0, -9.0])  # so that no torque vanishes by symmetry
MOUNT = transform(so3_exp([0.3, -2.0, 0.5]), (0.1, -0.2, 0.3))
TOLERANCE = 1e-9
everyone = pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)


@dataclass
class World:
    """An arm bolted to MuJoCo's world at MOUNT."""

    xml: ArmXml
    model: mujoco.MjModel
    data: mujoco.MjData

    def settle(self, seconds: float) -> None:
        for _ in range(round(seconds / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)


def world(arm: ArmConfig, gravity=GRAVITY, **options) -> World:
    xml = arm_mjcf(arm, "right_", MOUNT, **options)
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody>{xml.body}'
        f"</worldbody><contact>{xml.excludes}</contact><actuator>{xml.actuators}</actuator></mujoco>"
    )
    model.opt.gravity[:] = gravity
    return World(xml, model, mujoco.MjData(model))


def pin_model(arm: ArmConfig, fingers: bool):
    """The URDF's model, gravity as in the world and turned into the base's frame, and MuJoCo's order of its joints."""
    model = pin.buildModelFromXML(urdf(arm, fingers=fingers))
    model.gravity.linear[:] = MOUNT[:3, :3].T @ GRAVITY
    names = [joint.name for joint in arm.joints] + fingers * ["left_finger_joint", "right_finger_joint"]
    assert all(model.existJointName(name) for name in names)
    assert model.nv == len(names)
    return model, model.createData(), [model.joints[model.getJointId(name)].idx_v for name in names]


def tool_pose(data: mujoco.MjData) -> np.ndarray:
    site = data.site("right_tool")
    return transform(site.xmat.reshape(3, 3), site.xpos)


def mass_matrix(w: World) -> np.ndarray:
    """Without the motors' own inertia, which rigid-body models do not have."""
    full = np.zeros((w.model.nv, w.model.nv))
    mujoco.mj_fullM(w.model, w.data, full)
    return full - np.diag(w.model.dof_armature)


# kinematics and dynamics ------------------------------------------------------------------------------------------


@everyone
def test_mujoco_and_pin_agree(arm):
    w = world(arm)
    model, data, order = pin_model(arm, fingers=True)
    rng = np.random.default_rng(1)
    low, high = w.model.jnt_range.T
    frame = model.getFrameId("tool")
    for _ in range(100):
        q, v = rng.uniform(low, high), rng.normal(size=low.size)
        w.data.qpos[:], w.data.qvel[:] = q, v
        mujoco.mj_forward(w.model, w.data)
        q_pin, v_pin = np.zeros(model.nq), np.zeros(model.nv)
        q_pin[order], v_pin[order] = q, v
        pin.framesForwardKinematics(model, data, q_pin)
        tool = data.oMf[frame].homogeneous
        np.testing.assert_allclose(tool_pose(w.data), MOUNT @ tool, atol=TOLERANCE)
        np.testing.assert_allclose(arm.link_poses(q[: arm.n])[-1], tool, atol=TOLERANCE)

        expected = pin.crba(model, data, q_pin)
        expected = np.triu(expected) + np.triu(expected, 1).T
        np.testing.assert_allclose(mass_matrix(w), expected[np.ix_(order, order)], atol=TOLERANCE)
        bias = pin.nonLinearEffects(model, data, q_pin, v_pin)
        np.testing.assert_allclose(w.data.qfrc_bias, bias[order], atol=TOLERANCE)
        w.data.qvel[:] = 0.0
        mujoco.mj_forward(w.model, w.data)
        weight = pin.computeGeneralizedGravity(model, data, q_pin)
        np.testing.assert_allclose(w.data.qfrc_bias, weight[order], atol=TOLERANCE)


@everyone
def test_plain_chain_is_the_arm_with_its_fingers_open(arm):
    w = world(arm)
    model, data, order = pin_model(arm, fingers=False)
    assert order == list(range(arm.n))
    for q in np.random.default_rng(2).uniform(arm.limits[:, 0], arm.limits[:, 1], size=(20, arm.n)):
        w.data.qpos[: arm.n] = q
        mujoco.mj_forward(w.model, w.data)
        expected = pin.crba(model, data, q)
        expected = np.triu(expected) + np.triu(expected, 1).T
        np.testing.assert_allclose(mass_matrix(w)[: arm.n, : arm.n], expected, atol=TOLERANCE)
        mass, center, inertia = arm.mass_properties(q)
        assert mass == pytest.approx(w.model.body_mass.sum(), abs=TOLERANCE)
        R = MOUNT[:3, :3]
        np.testing.assert_allclose(w.data.subtree_com[0], R @ center + MOUNT[:3, 3], atol=TOLERANCE)
        # Half the rotational energy of the whole, frozen, about its centre: from MuJoCo's bodies, one by one.
        about = np.zeros((3, 3))
        for i in range(1, w.model.nbody):
            axes = w.data.ximat[i].reshape(3, 3)
            r = w.data.xipos[i] - w.data.subtree_com[0]
            about += axes @ np.diag(w.model.body_inertia[i]) @ axes.T
            about += w.model.body_mass[i] * (r @ r * np.eye(3) - np.outer(r, r))
        np.testing.assert_allclose(about, R @ inertia @ R.T, atol=TOLERANCE)


@everyone
def test_limits_and_ratings_reach_both_models(arm):
    w = world(arm)
    model, _, _ = pin_model(arm, fingers=False)
    np.testing.assert_array_equal(w.model.jnt_range[: arm.n], arm.limits)
    np.testing.assert_allclose(np.stack([model.lowerPositionLimit, model.upperPositionLimit], axis=1), arm.limits)
    torques = np.array([joint.torque_limit for joint in arm.joints])
    np.testing.assert_array_equal(w.model.actuator_forcerange[: arm.n, 1], torques)
    np.testing.assert_allclose(model.upperEffortLimit, torques)
    assert not w.model.actuator_forcelimited[arm.n :].any()  # the worm holds whatever pulls
    np.testing.assert_array_equal(w.model.dof_armature[: arm.n], [joint.armature for joint in arm.joints])


def test_names_are_those_that_are_promised():
    arm = HECATONQUIROS_6DOF
    w = world(arm)
    assert w.xml.joints == (*(f"right_joint{i}" for i in range(6)), "right_left_finger", "right_right_finger")
    for i, name in enumerate(w.xml.joints):
        assert w.model.joint(name).id == i and w.model.actuator(name).id == i
    for name in (*w.xml.links, *w.xml.fingers):
        w.model.body(name)
    assert w.xml.tool == "right_tool" and w.model.site("right_tool").id == 0
    names = [w.model.geom(i).name for i in range(w.model.ngeom)]
    names += [w.model.body(i).name for i in range(1, w.model.nbody)]
    assert all(name.startswith("right_") for name in names)


def test_gripper_of_the_scene_is_the_one_that_grasps_are_planned_for():
    arm = HECATONQUIROS_6DOF
    w = world(arm)
    jaws = arm.gripper.jaws
    w.data.qpos[: arm.n] = arm.home
    for travel in (0.0, 0.02):
        w.data.qpos[arm.n :] = travel
        mujoco.mj_forward(w.model, w.data)
        T = tool_pose(w.data)
        palm = {box.name: box for box in jaws.boxes(jaws.max_width)}["palm"]
        for box in (*jaws.boxes(jaws.max_width - 2 * travel)[:4], palm):
            geom = w.data.geom(f"right_{box.name}")
            np.testing.assert_allclose(geom.xpos, T[:3, :3] @ box.center + T[:3, 3], atol=1e-12)
            np.testing.assert_allclose(geom.xmat.reshape(3, 3), T[:3, :3], atol=1e-12)
            np.testing.assert_allclose(w.model.geom(f"right_{box.name}").size, box.half_size)


def test_contact_bits_and_friction_are_the_callers():
    w = world(HECATONQUIROS_6DOF, links=Contact(4, 8, 3), fingers=Contact(16, 32, 5), friction=0.4)
    for i in range(w.model.ngeom):
        geom = w.model.geom(i)
        finger = geom.name.endswith(("pad", "left_finger", "right_finger"))
        bits = (geom.contype[0], geom.conaffinity[0], geom.group[0])
        assert bits == ((16, 32, 5) if finger else (4, 8, 3))
        if finger:
            assert geom.friction[0] == 0.4 and geom.priority[0] == 1 and geom.condim[0] == 4


@everyone
def test_parts_of_an_arm_do_not_collide_where_they_join(arm):
    w = world(arm, links=Contact(1, 1))
    for q in (arm.home, arm.stowed):
        for travel in (0.0, arm.gripper.travel):
            w.data.qpos[:] = (*q, travel, travel)
            mujoco.mj_forward(w.model, w.data)
            assert w.data.ncon == 0


# servos and fingers -----------------------------------------------------------------------------------------------


@everyone
def test_servos_hold_a_pose_and_sag_as_springs_do(arm):
    w = world(arm, gravity=(0.0, 0.0, -9.81))
    w.data.qpos[: arm.n] = w.data.ctrl[: arm.n] = arm.home
    w.settle(1.5)
    stiffness = np.array([joint.stiffness for joint in arm.joints])
    sag = w.data.qpos[: arm.n] - arm.home
    np.testing.assert_allclose(-stiffness * sag, w.data.qfrc_bias[: arm.n], atol=1e-6)
    assert np.abs(sag).max() < np.radians(1.0)
    assert np.abs(w.data.qvel).max() < 1e-8


@everyone
def test_servos_settle_within_half_a_second_and_push_no_harder_than_they_can(arm):
    w = world(arm, gravity=(0.0, 0.0, 0.0))
    w.data.qpos[: arm.n] = arm.home
    w.data.ctrl[: arm.n] = arm.home + 0.3
    torques = np.array([joint.torque_limit for joint in arm.joints])
    most = np.zeros(arm.n)
    for _ in range(250):
        mujoco.mj_step(w.model, w.data)
        most = np.maximum(most, np.abs(w.data.actuator_force[: arm.n]))
    assert (most <= torques).all() and (most == torques).any()
    np.testing.assert_allclose(w.data.qpos[: arm.n], arm.home + 0.3, atol=2e-3)


def test_worm_holds_its_fingers_against_any_pull():
    arm = HECATONQUIROS_6DOF
    w = world(arm, gravity=(0.0, 0.0, 0.0))
    w.data.qpos[:] = w.data.ctrl[:] = (*arm.home, 0.02, 0.02)
    pull = 10.0 * arm.gripper.stall_force
    w.data.qfrc_applied[arm.n :] = -pull
    w.settle(0.5)
    given = 0.02 - w.data.qpos[arm.n :]
    np.testing.assert_allclose(given, pull / arm.gripper.stiffness, atol=1e-6)
    w.data.qfrc_applied[:] = 0.0
    w.settle(0.5)
    np.testing.assert_allclose(w.data.qpos[arm.n :], 0.02, atol=1e-6)


# bad input --------------------------------------------------------------------------------------------------------


def test_mounts_that_are_not_rigid_are_refused():
    with pytest.raises(ValueError, match="T_body_base"):
        arm_mjcf(HECATONQUIROS_6DOF, "right_", 1.1 * np.eye(4))
    for friction in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="friction"):
            arm_mjcf(HECATONQUIROS_6DOF, "right_", MOUNT, friction=friction)


def test_another_mass_is_seen_by_both_models():
    # Guards against models that agree because they read nothing of the description.
    last = HECATONQUIROS_6DOF.links[-1]
    arm = replace(HECATONQUIROS_6DOF, links=(*HECATONQUIROS_6DOF.links[:-1], replace(last, mass=last.mass + 0.5)))
    assert world(arm).model.body_mass.sum() == pytest.approx(HECATONQUIROS_6DOF.total_mass + 0.5)
    assert sum(i.mass for i in pin_model(arm, fingers=True)[0].inertias) == pytest.approx(arm.total_mass)
