"""Airframe, rotors and air against closed forms."""

from __future__ import annotations

import itertools
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from dock_worlds import AT_NOMINAL, FREE, make, world

from aerograsp_env.sim.airframe import (
    AIR_DENSITY,
    AIRFRAMES,
    BELEROFONTE,
    FIREFLY,
    GRAVITY,
    AirframeConfig,
    mass_properties,
)
from aerograsp_env.sim.config import DockConfig
from aerograsp_env.sim.docking_tool import DockingToolConfig
from aerograsp_env.sim.kernel_control import ground_effect, mix, rotors
from aerograsp_env.sim.scene import TIMESTEP

WEIGHTLESS_TOOL = DockingToolConfig(link_masses=(1e-6,) * 6)


def without_drag(airframe: AirframeConfig) -> AirframeConfig:
    return replace(airframe, drag_area=0.0, rotor=replace(airframe.rotor, drag=0.0))


def fly_unpowered(
    config: DockConfig, seconds: float, wind=(0.0, 0.0, 0.0), gravity: bool = True, velocity=(0.0, 0.0, 0.0)
):
    """(model, data) after `seconds` with the rotors off in a steady wind; nothing but air and gravity acts."""
    model, data, p, s = world(config)
    if not gravity:
        model.opt.gravity[:] = 0.0
    data.qpos[:3], data.qvel[:3], s.wind[:] = (0.0, 0.0, 500.0), velocity, wind
    for _ in range(round(seconds / TIMESTEP)):
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
        force = data.xfrc_applied[p.airframe_body]
        rotors(p, s, rotation.reshape(3, 3), data.qpos, data.qvel, np.zeros(6), data.ctrl, force)
        mujoco.mj_step(model, data)
    return model, data


# mass properties ----------------------------------------------------------------------------------


def test_mass_properties_equal_those_of_point_masses():
    # Eight equal points at ± extent / (2 √3) have exactly a solid box's mass, centre and second moments.
    masses, points = [], []
    for c in BELEROFONTE.components:
        for corner in itertools.product((-1.0, 1.0), repeat=3):
            masses.append(c.mass / 8)
            points.append(np.array(c.position) + np.array(corner) * np.array(c.extents) / (2 * np.sqrt(3)))
    m, x = np.array(masses), np.array(points)
    centre = m @ x / m.sum()
    second = np.einsum("n,ni,nj->ij", m, x - centre, x - centre)
    mass, com, inertia = BELEROFONTE.properties()
    assert mass == pytest.approx(m.sum(), rel=1e-12)
    np.testing.assert_allclose(com, centre, atol=1e-12)
    np.testing.assert_allclose(inertia, np.trace(second) * np.eye(3) - second, atol=1e-12)


def test_mass_properties_equal_mujocos_own():
    geoms = "".join(
        f'<geom type="box" pos="{c.position[0]} {c.position[1]} {c.position[2]}" mass="{c.mass}" '
        f'size="{c.extents[0] / 2} {c.extents[1] / 2} {c.extents[2] / 2}"/>'
        for c in BELEROFONTE.components
    )
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody><body><freejoint/>{geoms}</body></worldbody></mujoco>")
    mass, com, inertia = BELEROFONTE.properties()
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[1])
    axes = rotation.reshape(3, 3)
    assert mass == pytest.approx(model.body_mass[1], rel=1e-9)
    np.testing.assert_allclose(com, model.body_ipos[1], atol=1e-9)
    np.testing.assert_allclose(inertia, axes @ np.diag(model.body_inertia[1]) @ axes.T, atol=1e-9)


@pytest.mark.parametrize("airframe", AIRFRAMES.values(), ids=AIRFRAMES)
def test_the_scene_weighs_what_the_airframe_and_the_tool_say(airframe):
    model, *_ = world(DockConfig(airframe=airframe))
    mass, com, inertia = airframe.properties()
    body = model.body("airframe")
    assert body.mass[0] == pytest.approx(mass, rel=1e-8)
    np.testing.assert_allclose(body.ipos, com, atol=1e-8)
    assert np.sort(body.inertia) == pytest.approx(np.linalg.eigvalsh(inertia), rel=1e-7)
    assert body.subtreemass[0] - mass == pytest.approx(0.150, abs=1e-6)  # Table 5.1: the tool weighs 150 g


def test_a_payload_adds_its_mass_where_it_hangs_and_the_autopilot_is_not_told():
    mass, com, inertia = BELEROFONTE.properties()
    loaded, loaded_com, loaded_inertia = BELEROFONTE.with_payload(1.0, (0.0, 0.0, -0.2)).properties()
    assert loaded == pytest.approx(mass + 1.0)
    np.testing.assert_allclose(loaded * loaded_com, mass * com + [0.0, 0.0, -0.2], atol=1e-12)
    assert (np.linalg.eigvalsh(loaded_inertia - inertia) > -1e-12).all()
    # an airframe given by its figures keeps them under a payload of (almost) nothing
    light = FIREFLY.with_payload(1e-9)
    for before, after in zip(FIREFLY.properties(), light.properties(), strict=True):
        np.testing.assert_allclose(after, before, atol=1e-8)
    assert BELEROFONTE.with_payload(0.0) is BELEROFONTE
    _, _, p, _ = world(DockConfig(payload=1.0))
    assert p.believed_mass == pytest.approx(mass + 0.150)
    with pytest.raises(ValueError, match="payload must be in"):
        BELEROFONTE.with_payload(-0.1)


def test_mass_properties_of_one_box_are_its_own():
    mass, com, inertia = mass_properties(BELEROFONTE.components[:1])
    part = BELEROFONTE.components[0]
    assert mass == part.mass
    np.testing.assert_allclose(com, part.position)
    np.testing.assert_allclose(inertia, part.inertia())


# mixer --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("airframe", AIRFRAMES.values(), ids=AIRFRAMES)
def test_allocation_is_what_mujocos_rotors_do(airframe):
    model, data, *_ = world(DockConfig(airframe=airframe))
    data.qpos[3:7] = (1.0, 0.0, 0.0, 0.0)
    for k in range(6):
        data.ctrl[:] = 0.0
        data.ctrl[k] = 2.0
        mujoco.mj_forward(model, data)
        thrust, *torque = (
            2.0 * airframe.allocation(np.zeros(3))[:, k]
        )  # a free joint's torque is about the body's origin
        np.testing.assert_allclose(data.qfrc_actuator[:6], [0.0, 0.0, thrust, *torque], atol=1e-8)


@pytest.mark.parametrize("airframe", AIRFRAMES.values(), ids=AIRFRAMES)
def test_mixer_is_an_exact_right_inverse(airframe):
    allocation = airframe.allocation()
    np.testing.assert_allclose(allocation @ np.linalg.pinv(allocation), np.eye(4), atol=1e-12)
    _, _, p, _ = world(DockConfig(airframe=airframe))
    np.testing.assert_allclose(allocation @ p.mixer, np.eye(4), atol=1e-12)


def test_mix_gives_the_wrench_where_thrusts_suffice_and_the_torque_where_shifting_does():
    _, _, p, _ = world()
    allocation, rng, thrusts = BELEROFONTE.allocation(), np.random.default_rng(0), np.zeros(6)
    kinds = set()
    for _ in range(2000):
        wrench = rng.uniform([0.0, -15.0, -15.0, -2.0], [1.2 * 6 * p.thrust_max, 15.0, 15.0, 2.0])
        wanted = p.mixer @ wrench
        mix(p, wrench, thrusts)
        assert (thrusts >= 0.0).all() and (thrusts <= p.thrust_max).all()
        if wanted.min() >= 0.0 and wanted.max() <= p.thrust_max:
            kinds.add("exact")
            np.testing.assert_allclose(allocation @ thrusts, wrench, atol=1e-9)
        elif (
            np.ptp(wanted) <= p.thrust_max
        ):  # the collective gives way, torques do not (allocation about the com: exact)
            kinds.add("shifted")
            centred = BELEROFONTE.allocation(np.array([0.0, 0.0, BELEROFONTE.properties()[1][2]]))
            np.testing.assert_allclose((centred @ (thrusts - wanted))[1:], 0.0, atol=1e-9)
        else:
            kinds.add("clipped")
    assert kinds == {"exact", "shifted", "clipped"}


@pytest.mark.parametrize("airframe", AIRFRAMES.values(), ids=AIRFRAMES)
def test_full_normalised_torque_is_that_of_px4s_mixer(airframe):
    # A full roll command moves each motor by its entry of the roll column, normalised to a largest entry of one.
    columns = airframe.allocation(np.zeros(3))[1:]
    for axis in range(3):
        motors = columns[axis] / np.abs(columns[axis]).max() * airframe.rotor.thrust_max
        assert airframe.torque_scale()[axis] == pytest.approx(columns[axis] @ motors)


# rotors and air -----------------------------------------------------------------------------------


def spin(p, s, thrusts, ticks: int, height: float = 1e3) -> list[float]:
    ctrl, wrench, speeds = np.zeros(6), np.zeros(6), []
    for _ in range(ticks):
        rotors(p, s, np.eye(3), np.array([0.0, 0.0, height]), np.zeros(3), np.full(6, thrusts), ctrl, wrench)
        speeds.append(float(s.rotor_speed[0]))
    return speeds


def test_rotor_lag_is_first_order():
    _, _, p, s = world()
    rotor = BELEROFONTE.rotor
    t = TIMESTEP * np.arange(1, 101)
    target = 600.0
    up = spin(p, s, rotor.thrust_constant * target**2, 100)
    np.testing.assert_allclose(up, target * (1.0 - np.exp(-t / rotor.time_constant_up)), rtol=1e-12)
    down = spin(p, s, 0.0, 100)
    np.testing.assert_allclose(down, up[-1] * np.exp(-t / rotor.time_constant_down), rtol=1e-12)
    assert max(spin(p, s, 1e3, 2000)) <= rotor.speed_max * (1 + 1e-12)  # no command turns a rotor faster than it can


def cheeseman_bennett(height: float, radius: float) -> float:
    """Thrust in over out of ground effect (Cheeseman & Bennett 1955), a rotor at `height` [m]."""
    return 1.0 / (1.0 - radius**2 / (16.0 * height**2))


def test_ground_effect_gain():
    for height in (0.1, 0.2, 0.5, 3.0):
        assert ground_effect(height, 0.19) == pytest.approx(cheeseman_bennett(height, 0.19), rel=1e-12)
    assert ground_effect(0.0, 0.19) == pytest.approx(cheeseman_bennett(0.095, 0.19))  # bounded on the floor
    _, _, p, s = world()
    s.rotor_speed[:] = 500.0
    ctrl = np.zeros(6)
    thrusts = np.full(6, p.believed_thrust_constant * 500.0**2)
    rotors(p, s, np.eye(3), np.array([0.0, 0.0, 0.4]), np.zeros(3), thrusts, ctrl, np.zeros(6))
    expected = (
        p.thrust_constant * 500.0**2 * cheeseman_bennett(0.4 + BELEROFONTE.rotor_height, BELEROFONTE.rotor.radius)
    )
    np.testing.assert_allclose(ctrl, expected, rtol=1e-12)


def test_hovering_near_the_floor_takes_less_rotor_speed_by_cheeseman_and_bennett():
    speeds, height = {}, 0.40
    env = make(**FREE, config=DockConfig(bound=50.0))
    for name, z in (("near", height), ("far", 30.0)):
        env.reset(seed=0, options=AT_NOMINAL)
        env.data.qpos[2] = z
        for _ in range(300):
            env.step(np.zeros(3, np.float32))
        speeds[name] = env.state["rotor_speed"].copy(), float(env.data.qpos[2]) + BELEROFONTE.rotor_height
    ratio = speeds["near"][0] / speeds["far"][0]
    radius = BELEROFONTE.rotor.radius
    expected = np.sqrt(cheeseman_bennett(speeds["far"][1], radius) / cheeseman_bennett(speeds["near"][1], radius))
    assert expected < 0.996  # enough to be seen
    np.testing.assert_allclose(ratio, expected, rtol=1e-4)


def test_rotor_drag_and_body_drag_closed_forms():
    _, _, p, s = world()
    s.rotor_speed[:] = 500.0
    s.wind[:] = (1.0, -2.0, 0.5)
    velocity, wrench = np.array([3.0, 1.0, -1.0]), np.zeros(6)
    thrusts = np.full(6, p.believed_thrust_constant * 500.0**2)
    angle = 0.7
    rotation = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    rotors(p, s, rotation, np.array([0.0, 0.0, 100.0]), velocity, thrusts, np.zeros(6), wrench)
    air = velocity - s.wind
    body = -0.5 * AIR_DENSITY * BELEROFONTE.drag_area * np.linalg.norm(air) * air
    axis = rotation[:, 2]
    in_plane = air - (air @ axis) * axis
    each = -BELEROFONTE.rotor.drag * 500.0 * in_plane
    np.testing.assert_allclose(wrench[:3], body + 6 * each, rtol=1e-12)
    arms = (BELEROFONTE.rotor_positions() - BELEROFONTE.properties()[1]) @ rotation.T
    np.testing.assert_allclose(wrench[3:], np.cross(arms, each).sum(axis=0), atol=1e-12)


# flight with the rotors off -----------------------------------------------------------------------


@pytest.mark.parametrize("airframe", AIRFRAMES.values(), ids=AIRFRAMES)
def test_free_fall(airframe):
    seconds = 2.0
    _, data = fly_unpowered(DockConfig(airframe=without_drag(airframe)), seconds)
    assert data.qvel[2] == pytest.approx(-GRAVITY * seconds, rel=1e-9)
    # semi-implicit steps add g t dt / 2 to ½ g t²: known, and removed here
    fallen = 500.0 - data.qpos[2] - 0.5 * GRAVITY * seconds * TIMESTEP
    assert fallen == pytest.approx(0.5 * GRAVITY * seconds**2, rel=1e-9)
    np.testing.assert_allclose(data.qpos[:2], 0.0, atol=1e-9)


def test_falling_through_air_nears_terminal_velocity_as_tanh():
    config = DockConfig(tool=WEIGHTLESS_TOOL)
    mass = BELEROFONTE.properties()[0]
    terminal = np.sqrt(2 * mass * GRAVITY / (AIR_DENSITY * BELEROFONTE.drag_area))
    for seconds in (1.0, 3.0, 6.0):
        _, data = fly_unpowered(config, seconds)
        assert -data.qvel[2] == pytest.approx(terminal * np.tanh(GRAVITY * seconds / terminal), rel=1e-3)


def test_a_steady_wind_carries_an_unpowered_body_along():
    config = DockConfig(tool=WEIGHTLESS_TOOL)
    mass = BELEROFONTE.properties()[0]
    wind = np.array([4.0, -3.0, 0.0])
    _, data = fly_unpowered(config, 5.0, wind, gravity=False)
    k = 0.5 * AIR_DENSITY * BELEROFONTE.drag_area / mass
    relative = 5.0 / (1.0 + 5.0 * k * 5.0)  # du/dt = −k u², u(0) = 5 m/s
    np.testing.assert_allclose(data.qvel[:3], wind * (1.0 - relative / 5.0), rtol=1e-3, atol=1e-6)


def test_momentum_and_energy_are_conserved_with_rotors_and_damping_off():
    tool = DockingToolConfig(joint_damping=0.0, joint_armature=0.0, flex_damping=0.0)
    model, data, *_ = world(DockConfig(airframe=without_drag(BELEROFONTE), tool=tool))
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 5e-4
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    rng = np.random.default_rng(1)
    data.qpos[2] = 100.0
    data.qpos[7:] = rng.uniform(-0.5, 0.5, 6)
    data.qvel[:] = rng.uniform(-1.0, 1.0, 12)
    body = model.body("airframe").id
    mass = model.body_subtreemass[body]

    def invariants():
        mujoco.mj_forward(model, data)
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        momentum = mass * data.subtree_linvel[body]
        return momentum.copy(), data.subtree_angmom[body].copy(), data.energy.sum(), data.energy[1]

    linear, angular, energy, kinetic = invariants()
    seconds = 1.0
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    linear_after, angular_after, energy_after, _ = invariants()
    np.testing.assert_allclose(linear_after - linear, [0.0, 0.0, -mass * GRAVITY * seconds], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(angular_after, angular, rtol=1e-6, atol=1e-7)
    assert abs(energy_after - energy) < 1e-6 * kinetic
