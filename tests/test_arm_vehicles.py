"""The vehicles that carry the arms: what they weigh, what an arm does to them, and room for the arms to move."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from aerograsp_env.sim.airframe import BELEROFONTE, GRAVITY
from aerograsp_env.sim.arms.mjcf import Contact, arm_mjcf, inertial, shape_geom
from aerograsp_env.sim.arms.vehicles import (
    AQUILES,
    BELEROFONTE_ARMS,
    BELEROFONTE_TOOL,
    VEHICLES,
    ArmMount,
    VehicleConfig,
)
from aerograsp_env.spatial import inverse, so3_exp, transform

everyone = pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES)
ALL = Contact(1, 1)


def compile_vehicle(vehicle: VehicleConfig, margin: float = 0.0) -> mujoco.MjModel:
    """The vehicle alone in free space, everything colliding with everything that is nearer than `margin`."""
    more = f'margin="{0.5 * margin}"'  # a pair's is the sum
    arms = [arm_mjcf(m.arm, m.prefix, m.T_body_base, links=ALL, more=more) for m in vehicle.mounts]
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/>'
        f'<worldbody><body name="airframe"><freejoint/>{inertial(*vehicle.airframe.properties())}'
        f"{''.join(shape_geom(shape, '', ALL, more) for shape in vehicle.shapes)}"
        f"{''.join(arm.body for arm in arms)}</body></worldbody>"
        f"<contact>{''.join(arm.excludes for arm in arms)}</contact>"
        f"<actuator>{''.join(arm.actuators for arm in arms)}</actuator></mujoco>"
    )
    return model


def place(vehicle: VehicleConfig, model: mujoco.MjModel, data: mujoco.MjData, which: str) -> None:
    for mount in vehicle.mounts:
        for joint, angle in zip(mount.arm.joints, getattr(mount.arm, which), strict=True):
            name = mount.prefix + joint.name
            data.joint(name).qpos[0] = angle
            data.actuator(name).ctrl[0] = angle
    mujoco.mj_forward(model, data)


# room -------------------------------------------------------------------------------------------------------------


@everyone
@pytest.mark.parametrize("which", ["stowed", "home"])
def test_arms_are_clear_of_airframe_gear_and_each_other(vehicle, which):
    # Pairs of one arm may come nearer (its upper arm passes its base at 7 mm); nothing else within 4 cm.
    model = compile_vehicle(vehicle, margin=0.04)
    data = mujoco.MjData(model)
    place(vehicle, model, data, which)
    for i in range(data.ncon):
        names = [model.body(model.geom_bodyid[g]).name for g in data.contact[i].geom]
        sides = {name.partition("_")[0] for name in names}
        assert len(sides) == 1 and "airframe" not in sides, f"{names} at {data.contact[i].dist:.3f} m"
        assert data.contact[i].dist > 0.005


@everyone
def test_arms_pass_beneath_the_airframe_however_the_yaw_joint_turns(vehicle):
    model = compile_vehicle(vehicle)
    data = mujoco.MjData(model)
    for yaw in np.radians([-90, -45, 0, 45, 90]):
        place(vehicle, model, data, "home")
        for mount in vehicle.mounts:
            data.joint(f"{mount.prefix}joint0").qpos[0] = yaw
        mujoco.mj_forward(model, data)
        assert data.ncon == 0


@everyone
def test_home_puts_the_tools_below_and_in_front(vehicle):
    for mount in vehicle.mounts:
        tool = mount.T_body_base @ mount.arm.link_poses(mount.arm.home)[-1]
        np.testing.assert_allclose(tool[:3, 2], (0, 0, -1), atol=1e-12)
        assert tool[0, 3] > 0.10 and tool[2, 3] < -0.40
        assert tool[1, 3] == pytest.approx(mount.T_body_base[1, 3], abs=0.02)


@everyone
def test_camera_sees_the_tools_at_home(vehicle):
    for mount in vehicle.mounts:
        tool = mount.T_body_base @ mount.arm.link_poses(mount.arm.home)[-1]
        x, y, z, _ = inverse(vehicle.T_body_camera) @ tool[:, 3]
        assert z > 0.2 and max(abs(x), abs(y)) / z < np.tan(np.radians(40.0))


# masses -----------------------------------------------------------------------------------------------------------


@everyone
def test_mass_centre_and_inertia_are_those_of_the_compiled_vehicle(vehicle):
    model = compile_vehicle(vehicle)
    data = mujoco.MjData(model)
    for which in ("stowed", "home"):
        place(vehicle, model, data, which)
        angles = {mount.side: getattr(mount.arm, which) for mount in vehicle.mounts}
        mass, center, inertia = vehicle.mass_properties(angles)
        assert mass == pytest.approx(model.body_mass.sum(), abs=1e-9)
        np.testing.assert_allclose(center, data.subtree_com[0], atol=1e-12)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        shifted = mass * (center @ center * np.eye(3) - np.outer(center, center))
        np.testing.assert_allclose(full[3:6, 3:6], inertia + shifted, atol=1e-12)
    assert np.abs(vehicle.mass_properties()[1][:2]).max() < 0.01  # balanced, which saves the rotors' range


@everyone
def test_vehicle_hovers_on_half_its_thrust(vehicle):
    weight = GRAVITY * vehicle.mass_properties()[0]
    assert 0.35 < weight / (6 * vehicle.airframe.rotor.thrust_max) < 0.5


@pytest.mark.parametrize("active", ["right", "left"])
def test_stowed_arm_weighs_in_the_airframe_as_it_did_on_its_joints(active):
    one = BELEROFONTE_ARMS.with_active((active,))
    assert [mount.side for mount in one.mounts] == [active]
    angles = {active: one.mount(active).arm.home}
    got, expected = one.mass_properties(angles), BELEROFONTE_ARMS.mass_properties(angles)
    assert got[0] == pytest.approx(expected[0], abs=1e-12)
    np.testing.assert_allclose(got[1], expected[1], atol=1e-12)
    np.testing.assert_allclose(got[2], expected[2], atol=1e-12)


def test_stowed_arm_keeps_its_shapes():
    both, one = compile_vehicle(BELEROFONTE_ARMS), compile_vehicle(BELEROFONTE_ARMS.with_active(("right",)))
    assert both.ngeom == one.ngeom
    data, alone = mujoco.MjData(both), mujoco.MjData(one)
    place(BELEROFONTE_ARMS, both, data, "stowed")
    mujoco.mj_forward(one, alone)
    for i in range(both.ngeom):
        name = both.geom(i).name
        if not name.startswith("right_"):
            np.testing.assert_allclose(alone.geom(name).xpos, data.geom(name).xpos, atol=1e-12)
            np.testing.assert_allclose(np.abs(alone.geom(name).xmat), np.abs(data.geom(name).xmat), atol=1e-12)


def test_all_arms_active_or_none():
    assert BELEROFONTE_ARMS.with_active(("left", "right")) is BELEROFONTE_ARMS
    none = BELEROFONTE_ARMS.with_active(())
    assert none.mounts == () and none.airframe.properties()[0] == pytest.approx(BELEROFONTE_ARMS.mass_properties()[0])


def test_vehicle_with_the_tool_is_the_docking_airframe_with_a_true_right_arm():
    old, new = BELEROFONTE.components, BELEROFONTE_TOOL.airframe.components
    kept = {c.name: c for c in new}
    assert BELEROFONTE_TOOL.tool and BELEROFONTE_TOOL.airframe.tip_position == BELEROFONTE.tip_position
    assert all(kept[c.name] == c for c in old if c.name.startswith(("boom", "motor", "plates", "left arm")))
    difference = BELEROFONTE_TOOL.mass_properties()[0] - BELEROFONTE.properties()[0]
    assert difference == pytest.approx(BELEROFONTE_TOOL.mounts[0].arm.total_mass - 0.67)


# physics ----------------------------------------------------------------------------------------------------------


def unfold(vehicle: VehicleConfig, timestep: float) -> tuple[np.ndarray, np.ndarray]:
    """How far (3,) airframe and centre of mass move while the arms go from stowed to home in 0.4 s, adrift."""
    model = compile_vehicle(vehicle)
    model.opt.timestep = timestep
    data = mujoco.MjData(model)
    place(vehicle, model, data, "stowed")
    start, steps = data.subtree_com[0].copy(), round(0.4 / timestep)
    for k in range(steps + steps // 4):
        share = min(1.0, k / steps)
        for mount in vehicle.mounts:
            angles = mount.arm.stowed + share * (mount.arm.home - mount.arm.stowed)
            for joint, angle in zip(mount.arm.joints, angles, strict=True):
                data.actuator(mount.prefix + joint.name).ctrl[0] = angle
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    return data.qpos[:3].copy(), data.subtree_com[0] - start


@pytest.mark.parametrize("vehicle", [AQUILES, BELEROFONTE_ARMS], ids=["aquiles", "belerofonte"])
def test_moving_arms_push_the_vehicle_and_leave_the_centre_of_mass(vehicle):
    (moved, coarse), (_, fine) = unfold(vehicle, 0.002), unfold(vehicle, 0.001)
    assert np.linalg.norm(moved) > 0.01  # the airframe rises by what the arms go down
    assert np.abs(coarse).max() < 2e-4
    np.testing.assert_allclose(fine, 0.5 * coarse, atol=2e-6)  # what is left is the integrator's, of first order


# camera -----------------------------------------------------------------------------------------------------------


def test_camera_of_aquiles_stands_where_the_text_puts_it():
    T_camera_arm = inverse(AQUILES.T_body_camera) @ AQUILES.mounts[0].T_body_base
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    expected = [[1, 0, 0, 0.06], [0, c, -s, 0.10], [0, s, c, 0.0], [0, 0, 0, 1]]
    np.testing.assert_allclose(T_camera_arm, expected, atol=1e-15)


# bad input --------------------------------------------------------------------------------------------------------


def test_arms_that_are_not_there_are_refused():
    for call in (
        lambda: AQUILES.mount("left"),
        lambda: AQUILES.with_active(("left",)),
        lambda: AQUILES.mass_properties({"left": np.zeros(4)}),
        lambda: BELEROFONTE_ARMS.with_active(("middle",)),
    ):
        with pytest.raises(ValueError, match="arm, only"):
            call()
    with pytest.raises(ValueError, match="q: expected shape"):
        AQUILES.mass_properties({"right": np.zeros(6)})


def test_impossible_vehicles_are_refused():
    mount = BELEROFONTE_ARMS.mount("left")
    with pytest.raises(ValueError, match="one arm per side"):
        replace(BELEROFONTE_ARMS, mounts=(mount, mount))
    with pytest.raises(ValueError, match="left arm's place"):
        replace(BELEROFONTE_ARMS, tool=True)
    with pytest.raises(ValueError, match="T_body_camera"):
        replace(AQUILES, T_body_camera=np.zeros((4, 4)))
    with pytest.raises(ValueError, match="side"):
        ArmMount("top", mount.arm, np.eye(4))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="T_body_base"):
        ArmMount("left", mount.arm, transform(so3_exp([0, 0, 1]), (0, 0, 0)) * 2.0)
