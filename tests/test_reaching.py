"""Grasps that flying arms can do: pairs in closed form, reach, collisions, the base's place, two arms, re-ranking."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from aerograsp_env.sim.arms.vehicles import AQUILES, BELEROFONTE_ARMS
from aerograsp_env.sim.gripper import GripperConfig
from aerograsp_env.sim.objects.crawler import crawler_handles, pipe_crawler
from aerograsp_env.sim.objects.surface_points import surface_points
from aerograsp_env.spatial import inverse, so3_exp, transform, transform_points
from baselines.grasping.clearance import point_distances, swept_boxes
from baselines.grasping.dual import DualPlanner, PairSettings
from baselines.grasping.on_bars import grasps_on_bars
from baselines.grasping.on_model import grasps_on_model, volume_center
from baselines.grasping.reaching import GraspPlanner, Reached, ReachSettings
from baselines.grasping.reranking import rerank
from baselines.grasping.scenes import Scene, frame_clear, frame_points, moved_scene, surroundings
from baselines.kinematics.arm import Arm
from baselines.kinematics.ik import solve_ik
from baselines.kinematics.manipulability import manipulability
from baselines.kinematics.regions import posture, region
from baselines.policies.grasp_dual import crawler_surface

JAWS = GripperConfig()
VEHICLE = BELEROFONTE_ARMS.with_active(["right"])
MOUNT = VEHICLE.mount("right")
ARM = Arm.from_config(MOUNT.arm, MOUNT.T_body_base)
UP = np.array([0.0, 0.0, 1.0])


class Solid(NamedTuple):
    points: NDArray[np.float64]
    normals: NDArray[np.float64]


def box(size: tuple[float, float, float], count: int = 400) -> Solid:
    """Evenly sampled, centred at the origin."""
    rng = np.random.default_rng(0)
    half = 0.5 * np.asarray(size)
    areas = np.array([size[1] * size[2], size[0] * size[2], size[0] * size[1]]).repeat(2)
    face = rng.choice(6, size=count, p=areas / areas.sum())
    points = rng.uniform(-1.0, 1.0, (count, 3)) * half
    sign = np.where(face % 2 == 0, 1.0, -1.0)
    points[np.arange(count), face // 2] = sign * half[face // 2]
    normals = np.zeros((count, 3))
    normals[np.arange(count), face // 2] = sign
    return Solid(points, normals)


def ball(radius: float, count: int = 400) -> Solid:
    z = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    angle = np.pi * (1.0 + math.sqrt(5.0)) * np.arange(count)
    normals = np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], axis=1)
    return Solid(radius * normals, normals)


BOX = box((0.05, 0.04, 0.12))


def scene(solid: Solid = BOX, place=(0.26, -0.20, -0.57), height: float = 0.06, turn: float = 0.3) -> Scene:
    """The solid stands on a level plane, its origin `height` above it."""
    T = transform(so3_exp([0.0, 0.0, turn]), place)
    return Scene(T, solid.points, solid.normals, T[:3, 3] - (0.0, 0.0, height), UP)


PLANNER = GraspPlanner(VEHICLE)
PLAN = PLANNER.plan(scene())


# --- grasps of a model ------------------------------------------------------------------------------------------------


def test_a_boxs_grasps_are_across_its_faces():
    grasps = grasps_on_model(*BOX)
    closing = np.abs(grasps.T[:, :3, 0])
    assert len(grasps) > 50
    np.testing.assert_allclose(closing.max(axis=1), 1.0, atol=1e-12)  # exactly along an axis of the box
    size = np.array([0.05, 0.04, 0.12])[closing.argmax(axis=1)]
    np.testing.assert_allclose(grasps.widths, size, atol=1e-12)
    assert grasps.widths.max() < JAWS.max_width - 0.012  # never along the long side
    np.testing.assert_allclose(np.linalg.det(grasps.T[:, :3, :3]), 1.0, atol=1e-12)
    assert (np.diff(grasps.score) <= 0.0).all()


def test_a_balls_closing_lines_pass_near_its_middle():
    grasps = grasps_on_model(*ball(0.03))
    np.testing.assert_allclose(grasps.widths, 0.06, atol=3e-3)
    assert grasps.lever.max() < 0.010
    np.testing.assert_allclose(grasps.lever, _line_distance(grasps.T, grasps.center), atol=1e-12)


def _line_distance(T, center):
    arm = center - T[:, :3, 3]
    return np.linalg.norm(np.cross(arm, T[:, :3, 0]), axis=1)


def test_the_jaws_have_room_on_the_way():
    grasps = grasps_on_model(*BOX, room=0.004)
    boxes = swept_boxes(JAWS, grasps.openings, grasps.widths, tolerance=0.0)[:, :5]
    apart = point_distances(BOX.points, grasps.T[:, :3, :3], grasps.T[:, :3, 3], boxes, 0.02)
    assert apart.min() >= 0.004 - 1e-9
    assert (grasps.openings > grasps.widths).all() and grasps.openings.max() <= JAWS.max_width


def test_nothing_of_the_gripper_comes_near_the_support():
    point, normal = np.array([0.0, 0.0, -0.06]), UP
    free, standing = grasps_on_model(*BOX), grasps_on_model(*BOX, support=(point, normal))
    assert len(standing) < len(free) and standing.reasons["support"] > 0
    corners = np.stack(np.meshgrid(*[(0, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + np.arange(3)
    boxes = swept_boxes(JAWS, standing.openings, standing.widths, tolerance=0.0)
    for T, parts in zip(standing.T, boxes, strict=True):
        assert transform_points(T, parts[:, corners].reshape(-1, 3))[:, 2].min() > -0.06 + 0.003 - 1e-9
    assert (standing.T[:, 2, 2] < -0.99).any()  # straight down is among them


def test_centre_of_mass_by_the_divergence_theorem():
    shift = np.array([0.3, -0.2, 0.1])
    np.testing.assert_allclose(volume_center(ball(0.04).points + shift, ball(0.04).normals), shift, atol=2e-4)
    big, small = box((0.10, 0.10, 0.10), 3000), box((0.02, 0.02, 0.10), 600)  # densities alike: 3000 : 660
    points = np.concatenate([big.points, small.points + (0.0, 0.0, 0.4)])
    normals = np.concatenate([big.normals, small.normals])
    share = 0.02 * 0.02 / (0.10 * 0.10 + 0.02 * 0.02)
    np.testing.assert_allclose(volume_center(points, normals), [0.0, 0.0, 0.4 * share], atol=6e-3)


def test_points_without_a_volume_have_their_mean():
    flat = box((0.1, 0.1, 1e-9))
    np.testing.assert_allclose(volume_center(flat.points, flat.normals), flat.points.mean(axis=0))


def test_what_is_too_wide_is_turned_down_and_said():
    grasps = grasps_on_model(*box((0.12, 0.13, 0.14)))
    assert len(grasps) == 0 and grasps.reasons["too wide"] > 0


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"friction": 0.0}, "friction"),
        ({"margin": 0.2}, "margin"),
        ({"approaches": 0}, "approaches"),
        ({"support": (np.zeros(3), np.array([0.0, 0.0, 2.0]))}, "support"),
        ({"points": np.full((20, 3), np.nan)}, "points"),
        ({"normals": 2.0 * BOX.normals}, "normals"),
    ],
)
def test_bad_models_are_refused_by_name(change, name):
    with pytest.raises(ValueError, match=name):
        grasps_on_model(**({"points": BOX.points, "normals": BOX.normals} | change))


# --- bars -------------------------------------------------------------------------------------------------------------


def test_bars_are_grasped_across():
    surface = crawler_surface()
    grasps = grasps_on_bars(crawler_handles(), surface[:, :3], surface[:, 3:])
    along = np.array([bar.end - bar.start for bar in crawler_handles()])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    assert len(grasps) > 100
    assert np.abs(np.einsum("gi,bi->gb", grasps.T[:, :3, 0], along)).min(axis=1).max() < 1e-9
    np.testing.assert_allclose(grasps.widths, 0.022)
    np.testing.assert_allclose(grasps.center, pipe_crawler().center_of_mass, atol=0.03)
    with pytest.raises(ValueError, match="bars"):
        grasps_on_bars([(np.zeros(3), np.zeros(3), 0.01)], surface[:, :3], surface[:, 3:])
    with pytest.raises(ValueError, match="bars"):
        grasps_on_bars([(np.zeros(3), UP, 0.06)], surface[:, :3], surface[:, 3:])


# --- where an arm does an orientation well ----------------------------------------------------------------------------


def test_region_agrees_with_the_inverse_kinematics():
    rng = np.random.default_rng(1)
    R = so3_exp([0.0, 0.3, 0.0]) @ np.diag([1.0, -1.0, -1.0])
    positions = rng.uniform([-0.2, -0.5, -0.7], [0.5, 0.1, -0.2], (40, 3))
    at = region(ARM, R, positions, 0.05)
    reached = 0
    for p, score, q, before in zip(positions, *at, strict=True):
        if score > 0.0:
            reached += 1
            np.testing.assert_allclose(ARM.forward(q), transform(R, p), atol=1e-6)
            np.testing.assert_allclose(ARM.forward(before), transform(R, p - 0.05 * R[:, 2]), atol=1e-6)
            assert score == pytest.approx(min(posture(ARM, q), posture(ARM, before)))
            assert ARM.within_limits(q) and ARM.within_limits(before)
        else:
            assert np.isnan(q).all()
    plain = region(ARM, R, positions)
    for p, score in zip(positions, plain.score, strict=True):
        assert (score > 0.0) == solve_ik(ARM, transform(R, p), method="global").converged
    assert 0 < reached < len(positions)


def test_posture_falls_to_zero_at_singularities_and_limits():
    q = np.asarray(MOUNT.arm.home)
    assert 0.5 < posture(ARM, q) <= 1.0
    straight = q.copy()
    straight[4] = 0.0  # the wrist's outer axes are one line
    assert posture(ARM, straight) == pytest.approx(0.0, abs=1e-9)
    assert manipulability(ARM, straight) == pytest.approx(0.0, abs=1e-9)
    limit = q.copy()
    limit[0] = ARM.limits[0, 1]
    assert posture(ARM, limit) == 0.0


def test_region_refuses_what_it_cannot_use():
    with pytest.raises(ValueError, match="rotation"):
        region(ARM, np.diag([1.0, 1.0, -1.0]), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="back"):
        region(ARM, np.eye(3), np.zeros((1, 3)), -0.1)
    with pytest.raises(ValueError, match="joints"):
        region(Arm.hecatonquiros_4dof(), np.eye(3), np.zeros((1, 3)))


# --- planning with one arm --------------------------------------------------------------------------------------------


def test_planned_grasps_are_reached_where_the_base_puts_the_object():
    settings = PLANNER.settings
    assert len(PLAN.grasps) == settings.kept
    for grasp in PLAN.grasps:
        T = grasp.T_level_object @ grasp.T_object_grasp
        before = T.copy()
        before[:3, 3] -= settings.back * T[:3, 2]
        np.testing.assert_allclose(ARM.forward(grasp.q), T, atol=1e-6)
        np.testing.assert_allclose(ARM.forward(grasp.q_before), before, atol=1e-6)
        np.testing.assert_allclose(grasp.T_level_object[:3, :3], scene().T_level_object[:3, :3])  # heading is kept
    scores = [grasp.score for grasp in PLAN.grasps]
    assert scores == sorted(scores, reverse=True)


def test_planned_grasps_are_clear_of_frame_support_and_object():
    model = surroundings(VEHICLE, scene())
    for grasp in PLAN.grasps:
        poses = moved_scene(scene(), grasp.T_level_object)
        before = model.clearance({"right": grasp.q_before}, {"right": grasp.opening}, poses)
        assert before.nearest.distance >= PLANNER.settings.arm_room
        at = model.clearance({"right": grasp.q}, {"right": grasp.opening}, poses, ignore=[("right", "object")])
        assert at.nearest.distance >= PLANNER.settings.grasp_room


def test_the_base_moves_when_the_arm_alone_cannot_reach():
    far = PLANNER.plan(scene(place=(1.2, 0.7, -0.9)))
    assert far.grasps
    moved = far.grasps[0].T_level_object[:3, 3] - (1.2, 0.7, -0.9)
    assert np.linalg.norm(moved) > 0.8
    near = PLAN.grasps[0].T_level_object[:3, 3] - scene().T_level_object[:3, 3]
    assert np.linalg.norm(near) < 0.3


def test_the_airframe_keeps_its_height_over_the_support():
    frame = frame_points(VEHICLE)
    lowest = frame[:, 2].min()
    level = scene()
    objects = np.array([[0.3, 0.0, lowest - 0.5], [0.3, 0.0, lowest - 0.05], [0.3, 0.0, lowest + 0.05]])
    np.testing.assert_array_equal(frame_clear(frame, level, objects, 0.12, 0.9), [True, False, False])
    np.testing.assert_array_equal(
        frame_clear(frame, level, np.array([[5.0, 0.0, 0.1]]), 0.12, 0.9), [True]
    )  # far beside it the plane does not count


def test_moved_scene_keeps_the_support_under_the_object():
    slope = scene()._replace(up=so3_exp([0.0, 0.4, 0.0]) @ UP)
    T = slope.T_level_object.copy()
    T[:3, 3] += (0.1, -0.2, 0.05)
    poses = moved_scene(slope, T)
    np.testing.assert_allclose(poses["support"][:3, 2], slope.up)
    np.testing.assert_allclose(
        poses["support"][:3, 3] - T[:3, 3], slope.support - slope.T_level_object[:3, 3], atol=1e-12
    )


def test_nothing_to_do_is_said_with_the_reasons():
    plan = PLANNER.plan(scene(box((0.2, 0.2, 0.2)), height=0.1))
    assert plan.grasps == () and plan.reasons["too wide"] > 0


def test_planning_refuses_bad_input():
    mirrored = scene()._replace(T_level_object=np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(ValueError, match="T_level_object"):
        PLANNER.plan(mirrored)
    with pytest.raises(ValueError, match="T_level_object"):
        PLANNER.plan(scene()._replace(T_level_object=np.full((4, 4), np.nan)))
    with pytest.raises(ValueError, match="joints"):
        GraspPlanner(AQUILES).plan(scene())
    with pytest.raises(ValueError, match="left"):
        GraspPlanner(VEHICLE, "left")
    with pytest.raises(ValueError, match="back"):
        ReachSettings(back=0.0)


# --- two arms ---------------------------------------------------------------------------------------------------------


def crawler_scene() -> Scene:
    T = transform(so3_exp([0.0, 0.0, 0.0]), (0.26, 0.0, -0.65))
    surface = surface_points(pipe_crawler(), 256)
    return Scene(T, surface[:, :3], surface[:, 3:], T[:3, 3].copy(), UP)


def test_pairs_are_apart_balanced_and_reached_together():
    planner, around = DualPlanner(BELEROFONTE_ARMS), crawler_scene()
    surface = crawler_surface()
    T = inverse(around.T_level_object)
    support = transform_points(T, around.support), T[:3, :3] @ UP
    handles = grasps_on_bars(crawler_handles(), surface[:, :3], surface[:, 3:], JAWS, support)
    plan = planner.plan(around, shortlist=handles)
    assert plan.grasps
    model = surroundings(BELEROFONTE_ARMS, around)
    center = transform_points(plan.grasps[0].T_level_object, pipe_crawler().center_of_mass)
    for both in plan.grasps:
        tools = []
        for arm, hand in zip(planner.arms, (both.right, both.left), strict=True):
            tool = both.T_level_object @ hand.T_object_grasp
            np.testing.assert_allclose(arm.forward(hand.q), tool, atol=1e-6)
            tools.append(tool[:3, 3])
        line = tools[1] - tools[0]
        assert np.linalg.norm(line) > planner.pairs.apart and line[1] > planner.pairs.sides
        poses = moved_scene(around, both.T_level_object)
        clear = model.clearance({"right": both.right.q_before, "left": both.left.q_before}, {}, poses)
        assert min(clear.arm_arm.distance, clear.arm_frame.distance) >= planner.settings.arm_room - 0.03
        widths = {"right": both.right.opening, "left": both.left.opening}
        before = {"right": both.right.q_before, "left": both.left.q_before}
        assert model.collides(before, widths, poses, margin=planner.settings.arm_room) is None
    best = plan.grasps[0]
    right, left = (transform_points(best.T_level_object, h.T_object_grasp[:3, 3]) for h in (best.right, best.left))
    share = (center - right) @ (left - right) / np.sum((left - right) ** 2)
    assert abs(share - 0.5) < 0.1  # each arm carries about half
    aside = center - right - share * (left - right)
    assert np.linalg.norm(aside[:2]) < 0.03


def test_two_arms_take_a_long_box_without_a_shortlist():
    beam = box((0.04, 0.5, 0.05), 256)
    plan = DualPlanner(BELEROFONTE_ARMS).plan(scene(beam, place=(0.26, 0.0, -0.6), height=0.025, turn=0.0))
    assert plan.grasps
    centers = [hand.T_object_grasp[1, 3] for hand in (plan.grasps[0].right, plan.grasps[0].left)]
    assert centers[0] < -0.05 and centers[1] > 0.05 and abs(sum(centers)) < 0.1


def test_a_single_arm_vehicle_has_no_pairs():
    with pytest.raises(ValueError, match="left"):
        DualPlanner(VEHICLE)
    with pytest.raises(ValueError, match="apart"):
        PairSettings(apart=-1.0)


# --- re-ranking -------------------------------------------------------------------------------------------------------


def turned_away(grasp: Reached) -> np.ndarray:
    """The object so far that its grasps are out of reach."""
    T = grasp.T_level_object.copy()
    T[0, 3] += 2.0
    return T


def test_the_current_grasp_is_kept_until_it_is_out_of_reach():
    first, second = PLAN.grasps[0], PLAN.grasps[1]
    back = PLANNER.settings.back
    at = rerank(ARM, PLAN.grasps, first.T_level_object, 0, back)
    assert at.chosen == 0 and at.scores[0] > 0.0
    better = rerank(ARM, PLAN.grasps, second.T_level_object, 1, back)
    assert better.chosen == 1
    gone = rerank(ARM, PLAN.grasps, turned_away(first), 0, back)
    assert gone.chosen == -1 and not gone.scores.any()
    assert rerank(ARM, (), first.T_level_object, -1, back).chosen == -1


def test_hysteresis_decides_between_grasps_that_are_nearly_alike():
    back, T = PLANNER.settings.back, PLAN.grasps[0].T_level_object
    scores = rerank(ARM, PLAN.grasps, T, -1, back).scores
    best, other = np.argsort(-scores)[:2]
    assert scores[other] > 0.0
    gap = float(scores[best] - scores[other])
    assert rerank(ARM, PLAN.grasps, T, int(other), back, hysteresis=gap + 0.01).chosen == other
    assert rerank(ARM, PLAN.grasps, T, int(other), back, hysteresis=max(gap - 0.01, 0.0)).chosen == best


def test_what_collides_is_passed_over():
    back, T = PLANNER.settings.back, PLAN.grasps[0].T_level_object
    scores = rerank(ARM, PLAN.grasps, T, 0, back).scores
    asked = []

    def collides(g: int, q: np.ndarray) -> bool:
        np.testing.assert_allclose(ARM.forward(q), T @ PLAN.grasps[g].T_object_grasp, atol=1e-6)
        asked.append(g)
        return g == 0

    choice = rerank(ARM, PLAN.grasps, T, 0, back, collides=collides)
    assert choice.chosen != 0 and (choice.chosen == -1 or scores[choice.chosen] > 0.0)
    assert asked[0] == 0
