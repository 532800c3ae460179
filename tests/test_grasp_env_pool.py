"""Which objects stand where in Grasp-v0, the geometry that decides it, and the tracker's model of them."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from aerograsp_env.envs.grasp_levels import DUAL_LEVELS, LEVELS, GraspLevel, grasp_level, slopes
from aerograsp_env.envs.grasp_pool import PLACEMENTS, CrawlerPool, GraspPool, make_support
from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.manipulation.config import ManipulationConfig
from aerograsp_env.sim.manipulation.jaw_room import WIDEST, can_be_taken, opposed_pairs
from aerograsp_env.sim.manipulation.scene import build_model
from aerograsp_env.sim.manipulation.standing import set_item, standing
from aerograsp_env.sim.manipulation.supports import Support, pipe_saddle, table
from aerograsp_env.sim.objects import GraspObject, build_object
from aerograsp_env.sim.objects import test_objects as named_objects
from aerograsp_env.sim.objects.shapes import box
from aerograsp_env.sim.objects.surface_points import surface_points
from aerograsp_env.sim.objects.variants import heavier

JAWS = GripperConfig()
TABLE = table()


def block(*size: float) -> GraspObject:
    return build_object("block", "block", [box(size)], mass=0.3)


def on(support: Support, height: float, x: float = 0.0) -> np.ndarray:
    """T_world_object of an upright object whose centre is `height` above the seat."""
    T = support.T_world_seat.copy()
    T[:3, 3] += height * T[:3, 2] + x * T[:3, 0]
    return T


# surface points -----------------------------------------------------------------------------------


def test_surface_points_lie_on_the_surface_with_its_normals():
    size = np.array([0.06, 0.10, 0.16])
    cloud = surface_points(block(*size), 256)
    assert cloud.shape == (256, 6)
    share = cloud[:, :3] / (0.5 * size)
    np.testing.assert_allclose(np.abs(share).max(axis=1), 1.0, atol=1e-9)
    face = np.abs(cloud[:, 3:]).argmax(axis=1)
    np.testing.assert_allclose(np.abs(cloud[np.arange(256), 3 + face]), 1.0)
    np.testing.assert_allclose(share[np.arange(256), face], cloud[np.arange(256), 3 + face], atol=1e-9)  # outwards


def test_surface_points_are_even_and_always_the_same():
    size = np.array([0.06, 0.10, 0.16])
    item = block(*size)
    cloud = surface_points(item, 256)
    areas = np.array([size[1] * size[2], size[0] * size[2], size[0] * size[1]])
    counts = np.bincount(np.abs(cloud[:, 3:]).argmax(axis=1), minlength=3)
    np.testing.assert_allclose(counts / 256, areas / areas.sum(), atol=0.06)
    gaps = np.linalg.norm(cloud[:, None, :3] - cloud[None, :, :3], axis=2)
    np.fill_diagonal(gaps, np.inf)
    mean_gap = math.sqrt(2.0 * areas.sum() / 256)
    assert gaps.min() > 0.4 * mean_gap  # random points come arbitrarily near
    np.testing.assert_array_equal(surface_points(block(*size), 256), cloud)
    with pytest.raises(ValueError, match="read-only"):
        cloud[0] = 0.0
    with pytest.raises(ValueError, match="count"):
        surface_points(item, 0)


# opposed pairs and room ---------------------------------------------------------------------------


def test_opposed_pairs_of_a_box_are_its_narrow_sides():
    pairs = opposed_pairs(block(0.03, 0.05, 0.20))
    straight = np.abs(pairs.closing).max(axis=1) > 1.0 - 1e-9
    widths = pairs.width[straight]
    axes = np.abs(pairs.closing[straight]).argmax(axis=1)
    assert set(axes.tolist()) == {0, 1}
    np.testing.assert_allclose(widths, np.where(axes == 0, 0.03, 0.05), atol=1e-9)
    np.testing.assert_allclose(pairs.center[straight, axes], 0.0, atol=1e-9)
    tilted = pairs.width[~straight]
    assert ((tilted > 0.03) & (tilted <= WIDEST)).all()


def test_a_ray_goes_on_through_pieces_that_touch_and_ends_at_a_gap():
    touching = build_object("two", "two", [box((0.02, 0.04, 0.06)), box((0.03, 0.04, 0.06), (0.025, 0.0, 0.0))])
    pairs = opposed_pairs(touching)
    along = (np.abs(pairs.closing[:, 0]) > 1.0 - 1e-9) & (np.abs(pairs.center[:, 1]) < 0.015)
    np.testing.assert_allclose(pairs.width[along], 0.05, atol=1e-6)
    legs = [box((0.02, 0.04, 0.10), (x, 0.0, 0.0)) for x in (-0.03, 0.03)]
    arch = build_object("arch", "arch", [*legs, box((0.08, 0.04, 0.02), (0.0, 0.0, 0.06))])
    pairs = opposed_pairs(arch)
    low = (np.abs(pairs.closing[:, 0]) > 1.0 - 1e-9) & (pairs.center[:, 2] < 0.04)
    np.testing.assert_allclose(pairs.width[low], 0.02, atol=1e-9)  # a leg, not both with the air between them


@pytest.mark.parametrize(
    ("size", "takes"),
    [
        ((0.06, 0.06, 0.10), True),
        ((0.088, 0.20, 0.10), True),
        ((0.092, 0.20, 0.095), False),  # wider than 9 cm on every side that the jaws can come to
        ((0.12, 0.12, 0.12), False),
        ((0.04, 0.20, 0.030), True),
        ((0.04, 0.20, 0.006), False),  # too low: the fingers' tips would touch the table
        ((0.15, 0.15, 0.05), False),  # its height is narrow enough, but the table is in the way
    ],
)
def test_boxes_on_a_table_can_be_taken_or_not(size, takes):
    item = block(*size)
    assert can_be_taken(item, on(TABLE, 0.5 * size[2]), TABLE, JAWS) is takes


def test_walls_around_it_leave_the_jaws_no_room():
    floor, post = box((0.18, 0.18, 0.02), (0.0, 0.0, -0.01)), box((0.085, 0.085, 0.06), (0.0, 0.0, 0.025))
    walls = [box((0.04, 0.18, 0.06), (x, 0.0, 0.025)) for x in (-0.07, 0.07)]
    walls += [box((0.18, 0.04, 0.06), (0.0, y, 0.025)) for y in (-0.07, 0.07)]
    free, walled = (build_object("post", "post", [floor, post, *more]) for more in ((), walls))
    assert can_be_taken(free, on(TABLE, 0.02), TABLE, JAWS)
    assert not can_be_taken(walled, on(TABLE, 0.02), TABLE, JAWS)  # gaps of 7 mm, fingers are 8 mm thick
    assert len(opposed_pairs(walled).width) > 0


def test_the_rim_keeps_the_jaws_away():
    saddle = pipe_saddle()
    bar = block(0.02, 0.20, 0.016)
    assert can_be_taken(bar, on(saddle, 0.008), saddle, JAWS)
    assert not can_be_taken(bar, on(saddle, 0.008, x=saddle.half_size[0] - 0.012), saddle, JAWS)


# the pool -----------------------------------------------------------------------------------------


def test_every_pose_of_the_pool_can_be_taken_and_every_test_object_is_in_it():
    for name in ("easy", "oblique"):
        pool = GraspPool("test", LEVELS[name], JAWS)
        rng = np.random.default_rng(0)
        drawn = [pool.draw(rng) for _ in range(20)]
        for item, support, T in {id(s.T_world_object): s[1:] for s in drawn}.values():
            assert can_be_taken(item, T, support, JAWS)
            assert support.contains(T[:3, :3] @ item.center_of_mass + T[:3, 3])
        for item in named_objects():
            assert pool.draw(rng, item.name).item is item


def test_draws_do_not_depend_on_what_was_drawn_before():
    first, second = (GraspPool(["mug", "capsule"], LEVELS["oblique"], JAWS) for _ in range(2))
    for seed in range(20):
        second.draw(np.random.default_rng(seed))
    for seed in range(10):
        a, b = first.draw(np.random.default_rng(seed)), second.draw(np.random.default_rng(seed))
        assert a.scene == b.scene
        np.testing.assert_array_equal(a.T_world_object, b.T_world_object)
        np.testing.assert_array_equal(a.item.vertices, b.item.vertices)
        scene = first.scene(a.scene)
        assert (scene.item, scene.support) == (a.item, a.support)


def test_families_have_members_that_stay_themselves():
    pool = GraspPool("capsule", LEVELS["easy"], JAWS)
    assert pool.item("capsule", 1) is pool.item("capsule", 1)
    assert not np.array_equal(pool.item("capsule", 1).vertices, pool.item("capsule", 2).vertices)


def test_the_crawler_stands_upright_at_multiples_of_sixty_degrees():
    pool = CrawlerPool(DUAL_LEVELS["oblique"])
    rng = np.random.default_rng(0)
    headings = set()
    for _ in range(30):
        setting = pool.draw(rng)
        T = np.linalg.inv(setting.support.T_world_seat) @ setting.T_world_object
        assert T[2, 2] > 1.0 - 1e-6
        heading = math.degrees(math.atan2(T[1, 0], T[0, 0]))
        assert abs(heading / 60.0 - round(heading / 60.0)) < 0.01
        headings.add(round(heading / 60.0) % 6)
    assert headings == set(range(6))
    assert PLACEMENTS >= 6


def test_levels_by_name_value_and_change():
    assert grasp_level("heavy") is LEVELS["heavy"]
    level = GraspLevel(mass=None)
    assert grasp_level(level) is level
    assert grasp_level({"mass": (0.3, 0.4)}, DUAL_LEVELS).spread == DUAL_LEVELS["easy"].spread
    np.testing.assert_allclose(np.degrees(slopes(LEVELS["oblique"])), [15.0, 20.0, 25.0, 30.0])
    assert slopes(LEVELS["easy"]) == [0.0]
    np.testing.assert_allclose(np.degrees(slopes(GraspLevel(slope=(math.radians(11), math.radians(13))))), [12.0])


# the scene ----------------------------------------------------------------------------------------


def test_a_scene_is_laid_out_alike_for_every_object_and_support():
    config = ManipulationConfig(hold=False)
    supports = make_support("table", 0.0), make_support("saddle", math.radians(20.0))
    models = [build_model(config, [standing(item, s)]) for item, s in zip(named_objects()[:2], supports, strict=True)]
    for count in ("nq", "nv", "nu", "nbody", "nmocap", "nsensordata"):
        assert getattr(models[0], count) == getattr(models[1], count)
    for name in ("airframe", "right_joint0", "object"):
        assert models[0].joint(name).qposadr == models[1].joint(name).qposadr


def test_another_mass_and_surface_are_the_items():
    config, item, support = ManipulationConfig(), named_objects()[1], make_support("table", 0.0)
    model = build_model(config, [standing(item, support)])
    other = heavier(item, 0.2, 0.3)
    set_item(model, other, support, ["right_left_pad"], 0.7)
    fresh = build_model(config, [standing(other, support)])
    body = model.body("object").id
    for name in ("body_mass", "body_inertia", "body_ipos", "body_subtreemass"):
        np.testing.assert_allclose(getattr(model, name)[body], getattr(fresh, name)[body], rtol=1e-9)
    assert model.geom_friction[model.geom("right_left_pad").id, 0] == pytest.approx(math.sqrt(0.3 * 0.7))
    for name in ("support0", "support1"):
        expected = fresh.geom_friction[fresh.geom(name).id]
        np.testing.assert_allclose(model.geom_friction[model.geom(name).id], expected)
    np.testing.assert_allclose(model.dof_invweight0[-6:], fresh.dof_invweight0[-6:], rtol=1e-6)


def test_the_support_body_moves_all_of_the_support():
    config, item, support = ManipulationConfig(), named_objects()[0], make_support("saddle", math.radians(15.0))
    model = build_model(config, [standing(item, support)])
    data = mujoco.MjData(model)
    data.mocap_pos[0] = (1.0, 2.0, 3.0)
    mujoco.mj_kinematics(model, data)
    for i, solid in enumerate(support.solids):
        geom = data.geom(f"support{i}")
        np.testing.assert_allclose(geom.xpos, solid.T_world_solid[:3, 3] + (1.0, 2.0, 3.0), atol=1e-9)
        np.testing.assert_allclose(geom.xmat.reshape(3, 3), solid.T_world_solid[:3, :3], atol=1e-9)
