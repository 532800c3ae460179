"""Supports, and objects at rest on them: geometry, bad input, and that MuJoCo leaves the objects where they are."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.manipulation.placing import PlacementError, place, possible_poses, settle
from aerograsp_env.sim.manipulation.supports import Support, inclined_table, pipe_saddle, table
from aerograsp_env.sim.objects import TRAIN_FAMILIES, VALIDATION_FAMILIES, build_object, shapes
from aerograsp_env.sim.objects import test_objects as fixed_objects
from aerograsp_env.sim.objects.crawler import pipe_crawler
from aerograsp_env.sim.objects.mjcf import object_mjcf
from aerograsp_env.sim.objects.resting import resting_poses
from aerograsp_env.sim.objects.variants import heavier

SUPPORTS = (
    table(center=(0.3, -0.2), heading=0.7),
    inclined_table(math.radians(15.0), heading=-1.0),
    inclined_table(math.radians(25.0), center=(1.0, 0.0), heading=2.0),
    pipe_saddle(heading=0.4),
    pipe_saddle(math.radians(20.0), 1.5, center=(0.0, 0.5), heading=2.5),
)
DRAWN = [family(np.random.default_rng(3)) for family in (*TRAIN_FAMILIES.values(), *VALIDATION_FAMILIES.values())]
OBJECTS = (*fixed_objects(), *DRAWN)
CASES = [(item, SUPPORTS[i % len(SUPPORTS)]) for i, item in enumerate(OBJECTS)]
BOX = build_object("box", "box", [shapes.box((0.05, 0.08, 0.16))])


def scene(item, support: Support) -> mujoco.MjModel:
    text = object_mjcf(item)
    return mujoco.MjModel.from_xml_string(f"""
<mujoco><option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="100"/>
  <default><geom solref="0.01 1" solimp="0.9 0.95 0.001"/><default class="object"/><default class="fixed"/></default>
  <asset>{text.assets}</asset>
  <worldbody><geom name="floor" type="plane" size="0 0 0.1"/>{support.geoms("fixed", item)}{text.body}</worldbody>
</mujoco>""")


def released(item, support: Support, T, seconds: float = 1.0):
    """Depth of the deepest contact at once, and how far the item moves and turns in the whole scene [m, m, rad]."""
    model = scene(item, support)
    data = mujoco.MjData(model)
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    data.qpos[:] = (*T[:3, 3], w, x, y, z)
    mujoco.mj_forward(model, data)
    depth = -min([contact.dist for contact in data.contact], default=0.0)
    start = data.xipos[1].copy()
    before = data.xmat[1].reshape(3, 3).copy()
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))
    turned = Rotation.from_matrix(before.T @ data.xmat[1].reshape(3, 3)).magnitude()
    return depth, float(np.linalg.norm(data.xipos[1] - start)), float(turned)


def check_rests(item, support: Support, T) -> None:
    depth, moved, turned = released(item, support, T)
    assert depth < 1e-3
    assert moved < 2e-3
    assert turned < math.radians(2.0)
    assert support.contains(T[:3, :3] @ item.center_of_mass + T[:3, 3])


@pytest.mark.parametrize(("item", "support"), CASES, ids=lambda value: value.name)
def test_objects_of_all_families_stay_where_they_are_placed(item, support):
    rng = np.random.default_rng(5)
    for _ in range(2):
        check_rests(item, support, place(item, support, rng))


@pytest.mark.parametrize(
    "support",
    [
        table(),
        inclined_table(math.radians(20.0)),
        pipe_saddle(seat=(0.36, 0.36)),
        pipe_saddle(math.radians(25.0), 1.5, seat=(0.36, 0.36)),
    ],
    ids=["table", "slope", "pipe", "oblique pipe"],
)
def test_the_crawler_stands_on_every_support(support):
    item = pipe_crawler()
    upright = resting_poses(item)[0]
    T = place(item, support, np.random.default_rng(0), pose=upright)
    check_rests(item, support, T)
    assert T[:3, 2] @ support.T_world_seat[:3, 2] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("item", [fixed_objects()[2], fixed_objects()[13], BOX], ids=lambda item: item.name)
def test_what_slips_or_rolls_down_a_slope_ends_at_its_lower_rim(item):
    support = inclined_table(math.radians(30.0))
    slippery = heavier(item, 0.4, 0.15)
    T = place(slippery, support, np.random.default_rng(1))
    check_rests(slippery, support, T)
    low = (item.vertices @ T[:3, :3].T + T[:3, 3] - support.T_world_seat[:3, 3]) @ support.T_world_seat[:3, :3]
    assert low[:, 0].max() > support.half_size[0] - 3e-3


def test_a_given_pose_and_heading_are_kept():
    support = table(heading=0.3)
    for pose in resting_poses(BOX):
        T = place(BOX, support, np.random.default_rng(0), pose=pose, heading=0.5, spread=0.0)
        local = np.linalg.inv(support.T_world_seat) @ T
        turn = Rotation.from_euler("z", 0.5).as_matrix()
        assert local[:3, :3] == pytest.approx(turn @ pose.T_support_object[:3, :3], abs=1e-12)
        assert local[:3, 3] == pytest.approx(turn @ pose.T_support_object[:3, 3], abs=1e-12)


def test_places_are_reproducible_and_spread_over_a_square():
    support = table()
    one, same = (place(BOX, support, np.random.default_rng(2)) for _ in range(2))
    assert np.array_equal(one, same)
    rng = np.random.default_rng(0)
    centers = np.array([place(BOX, support, rng, spread=0.1)[:2, 3] for _ in range(200)])
    assert np.abs(centers).max() <= 0.1
    assert np.abs(centers).max() > 0.09
    assert np.abs(centers.mean(axis=0)).max() < 0.02


def test_poses_that_tip_on_a_slope_are_not_possible_there():
    tall = build_object("tall", "tall", [shapes.box((0.03, 0.03, 0.16))])  # stands up to atan(3/16) = 10.6°
    low = (math.radians(8.0), math.radians(14.0))
    counts = [sum(pose.height > 0.1 for pose in possible_poses(tall, inclined_table(angle))) for angle in low]
    assert counts == [2, 0]
    assert len(possible_poses(tall, table())) == 6


def test_settling_measures_a_slide_and_a_rest():
    support = inclined_table(math.radians(25.0), size=(1.0, 0.4))
    pose = resting_poses(BOX)[0]
    T = place(BOX, support, np.random.default_rng(0), pose=pose, heading=0.0, spread=0.0)
    rest = settle(BOX, support, T)
    assert rest.still
    assert rest.moved < 1e-3
    slide = settle(heavier(BOX, friction=0.05), support, T, longest=0.3)
    friction = support.contact_friction(heavier(BOX, friction=0.05))
    fall = 0.5 * 9.80665 * (math.sin(support.slope) - friction * math.cos(support.slope)) * slide.duration**2
    assert not slide.still
    assert slide.moved == pytest.approx(fall, rel=0.05)


def test_seats_lie_where_they_are_told():
    assert table(0.8, center=(1.0, 2.0)).T_world_seat[:3, 3] == pytest.approx((1.0, 2.0, 0.8))
    for support in (inclined_table(0.3, heading=0.5), pipe_saddle(0.3, 1.5, heading=0.5)):
        assert support.slope == pytest.approx(0.3)
        down = support.T_world_seat[:3, 0]
        assert down[2] == pytest.approx(-math.sin(0.3))
        assert math.atan2(down[1], down[0]) == pytest.approx(0.5)
        assert support.T_world_seat[:3, 1] == pytest.approx((-math.sin(0.5), math.cos(0.5), 0.0))


@pytest.mark.parametrize("support", SUPPORTS, ids=lambda support: support.name)
def test_contains_is_the_room_over_the_seat(support):
    def world(x, y, z):
        return support.T_world_seat[:3, :3] @ (x, y, z) + support.T_world_seat[:3, 3]

    x, y = support.half_size
    assert support.contains([world(0.0, 0.0, 0.1), world(0.99 * x, -0.99 * y, 0.0)]).tolist() == [True, True]
    outside = [world(1.01 * x, 0.0, 0.1), world(0.0, 1.01 * y, 0.1), world(0.0, 0.0, -0.02), world(0.0, 0.0, 0.7)]
    assert not support.contains(outside).any()


@pytest.mark.parametrize("support", SUPPORTS, ids=lambda support: support.name)
def test_geoms_stand_on_the_floor_and_carry_the_seat(support):
    model = scene(BOX, support)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, i) for i in range(model.ngeom)]
    assert {f"support{i}" for i in range(len(support.solids))} < set(names)
    heights = []
    for i, name in enumerate(names):
        if name.startswith("support"):
            size = model.geom_size[i]
            half = size if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_BOX else np.array([size[0], size[0], size[1]])
            heights.append(data.geom_xpos[i, 2] - np.abs(data.geom_xmat[i].reshape(3, 3)[2]) @ half)
    assert min(heights) == pytest.approx(0.0, abs=1e-6)
    down, group = -support.T_world_seat[:3, 2], np.zeros(1, np.int32)
    start = support.T_world_seat[:3, 3] - 0.3 * down
    assert mujoco.mj_ray(model, data, start, down, None, 1, 1, group) == pytest.approx(0.3, abs=1e-7)


def test_friction_between_two_surfaces_is_their_geometric_mean():
    support = table(friction=0.4)
    item = heavier(BOX, friction=0.9)
    assert support.contact_friction(item) == pytest.approx(0.6)
    model = scene(item, support)
    data = mujoco.MjData(model)
    data.qpos[2] = 0.75 + 0.0799
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    assert data.contact[0].friction[0] == pytest.approx(0.6)
    assert data.contact[0].dim == 4
    assert "friction" not in support.geoms("fixed")


def test_the_object_in_a_scene_has_the_objects_mass_properties():
    for item in (fixed_objects()[9], pipe_crawler()):
        model = scene(item, table())
        assert model.body_mass[1] == pytest.approx(item.mass)
        assert model.body_ipos[1] == pytest.approx(item.center_of_mass, abs=1e-9)
        axes = Rotation.from_quat(model.body_iquat[1][[1, 2, 3, 0]]).as_matrix()
        assert axes @ np.diag(model.body_inertia[1]) @ axes.T == pytest.approx(item.inertia, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: table(0.0), "height"),
        (lambda: table(math.nan), "center|height"),
        (lambda: table(size=(0.0, 1.0)), "size"),
        (lambda: table(friction=0.0), "friction"),
        (lambda: inclined_table(1.2), "angle"),
        (lambda: inclined_table(-0.1), "angle"),
        (lambda: inclined_table(0.5, 0.05), "height"),
        (lambda: inclined_table(rim=-0.01), "rim"),
        (lambda: pipe_saddle(0.5, 0.3), "height"),
        (lambda: pipe_saddle(radius=0.0), "radius"),
        (lambda: pipe_saddle(length=0.1), "length"),
    ],
)
def test_bad_supports_are_refused(make, word):
    with pytest.raises(ValueError, match=word):
        make()


def test_what_does_not_fit_is_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(PlacementError, match="does not fit"):
        place(pipe_crawler(), pipe_saddle(seat=(0.10, 0.10)), rng)
    assert possible_poses(pipe_crawler(), pipe_saddle(seat=(0.10, 0.10))) == ()
    with pytest.raises(ValueError, match="spread"):
        place(BOX, table(), rng, spread=-1.0)
    with pytest.raises(ValueError, match="heading"):
        place(BOX, table(), rng, heading=math.inf)
