"""Planning from one view: settings, what is estimated of an object, and what is proposed on it."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from grasp_worlds import box, cylinder
from scipy.spatial.transform import Rotation

from aerograsp_env.interfaces import UNIT_TOLERANCE
from aerograsp_env.sim.depth_view import DepthCameraConfig, partial_view
from aerograsp_env.sim.gripper import GripperConfig
from baselines.grasping.antipodal import closing_angles, line_distance
from baselines.grasping.clearance import swept_boxes
from baselines.grasping.planning import PlannerConfig, estimate_object, propose, usable
from baselines.grasping.ranking import CONTEXT, CROWDED, TERMS, WEIGHTS, ranking, terms

EYE = np.array([0.0, 0.0, 0.5])
GRIPPER = GripperConfig()


class View(NamedTuple):
    points: np.ndarray
    normals: np.ndarray
    noise: np.ndarray
    viewpoint: np.ndarray


def half_sphere(radius: float = 0.03, count: int = 400) -> View:
    """What is seen of a sphere about the origin from above, up to a grazing angle of 75°."""
    i = np.arange(count) + 0.5
    height = 1.0 - (1.0 - np.cos(np.radians(75.0))) * i / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * i
    across = np.sqrt(1.0 - height**2)
    normals = np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=1)
    return View(radius * normals, normals, np.full(count, 1e-3), EYE)


def seen(item, direction, seed: int = 0, rotation: np.ndarray | None = None) -> tuple[View, np.ndarray]:
    """A view as the environment gives it, unoccluded, and where the object's frame is in it (4, 4)."""
    camera = DepthCameraConfig(occluded_probability=0.0)
    direction = np.asarray(direction, dtype=float)
    rotation = np.eye(3) if rotation is None else rotation
    rng = np.random.default_rng(seed)
    view = partial_view(item, rotation, direction / np.linalg.norm(direction), 512, camera, rng)
    return View(view.points, view.normals, view.noise, view.viewpoint), view.T_cloud_object


def moved(view: View, rotation: np.ndarray, shift=(0.0, 0.0, 0.0)) -> View:
    points, eye = view.points @ rotation.T + shift, rotation @ view.viewpoint + shift
    return View(points, view.normals @ rotation.T, view.noise, eye)


# settings -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("prior", "sphere"),
        ("points", 3),
        ("points", 100.0),
        ("starts", 0),
        ("samples", True),
        ("length_scale", 0.0),
        ("bare_length_scale", -0.1),
        ("deviation", float("nan")),
        ("level", "0.3"),
        ("weights", {"luck": 1.0}),
        ("weights", {"pfc": float("nan")}),
        ("normal_noise", float("inf")),
        ("trust", 1.5),
        ("trust", -0.1),
        ("room", -1.0),
    ],
)
def test_settings_out_of_range_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        PlannerConfig(**{name: value})


def test_weights_may_be_zero():
    PlannerConfig(trust=0.0, clearance=0.0, room=0.0, weights={})


# clouds that say too little -------------------------------------------------------------------------


def degenerate() -> dict[str, np.ndarray]:
    t = np.linspace(-0.05, 0.05, 64)
    return {
        "equal": np.tile([0.01, 0.02, 0.03], (64, 1)),
        "collinear": t[:, None] * np.array([1.0, 2.0, -0.5]),
        "collinear in float32": (t[:, None] * np.array([1.0, 2.0, -0.5])).astype(np.float32).astype(float),
        "two places": np.repeat([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]], 32, axis=0),
        "three points": np.eye(3) * 0.02,
    }


@pytest.mark.parametrize("name", degenerate())
def test_degenerate_clouds_are_refused(name):
    points = degenerate()[name]
    normals, noise = np.tile([0.0, 0.0, 1.0], (len(points), 1)), np.full(len(points), 1e-3)
    assert not usable(points)
    with pytest.raises(ValueError, match="points: expected at least 4"):
        estimate_object(points, normals, noise, EYE, PlannerConfig())
    with pytest.raises(ValueError, match="points"):
        propose(points, normals, noise, EYE, np.random.default_rng(0))


def test_faulty_arrays_are_errors_and_not_merely_unusable():
    view = half_sphere()
    points = view.points.copy()
    points[7, 1] = np.nan
    for wrong in (points, view.points[:, :2].T[..., None]):
        with pytest.raises(ValueError, match="points"):
            usable(wrong)
    with pytest.raises(ValueError, match="normals"):
        estimate_object(view.points, 2.0 * view.normals, view.noise, EYE, PlannerConfig())
    with pytest.raises(ValueError, match="viewpoint"):
        estimate_object(view.points, view.normals, view.noise, np.full(3, np.nan), PlannerConfig())


@pytest.mark.parametrize("distinct", [4, 10, 60])
def test_points_seen_again_without_noise_are_no_trouble(distinct):
    view = half_sphere()
    rows = np.random.default_rng(1).integers(0, distinct, 512) * (400 // distinct)
    estimate = estimate_object(view.points[rows], view.normals[rows], np.zeros(512), EYE, PlannerConfig())
    assert np.isfinite(estimate.center).all() and np.linalg.norm(estimate.center) < 0.03


def test_a_flat_cloud_can_be_planned_on():
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.03, 0.03, (300, 2)), np.zeros(300)])
    assert usable(points)
    found = propose(points, np.tile([0.0, 0.0, 1.0], (300, 1)), np.full(300, 1e-3), EYE, rng)
    assert np.isfinite(found.score).all() and found.estimate.center[2] < 0.0  # behind what is seen


# the estimate ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("radius", [0.02, 0.04])
def test_the_centre_of_mass_of_a_sphere_seen_from_one_side(radius):
    view = half_sphere(radius)
    assert view.points[:, 2].mean() > 0.6 * radius  # no answer
    for config, error in (
        (PlannerConfig(trust=1.0), 0.1),  # a sphere's prior is right
        (PlannerConfig(), 0.3),
        (PlannerConfig(prior="constant"), 0.4),
    ):
        center = estimate_object(*view, config).center
        assert np.linalg.norm(center[:2]) < 0.05 * radius and abs(center[2]) < error * radius


def test_trust_weighs_both_estimates_of_the_centre():
    view = half_sphere()
    centers = [estimate_object(*view, PlannerConfig(trust=trust)).center for trust in (0.0, 0.3, 1.0)]
    np.testing.assert_allclose(centers[1], 0.7 * centers[0] + 0.3 * centers[2], atol=1e-12)
    np.testing.assert_allclose(centers[0], estimate_object(*view, PlannerConfig(prior="constant")).center, atol=1e-12)


@pytest.mark.parametrize("direction", [(1.0, 0.7, 0.4), (0.3, 1.0, 0.6), (-0.5, -0.8, 0.3)])
@pytest.mark.parametrize("item", [box(), cylinder()], ids=["box", "cylinder"])
def test_the_centre_of_mass_of_bodies_seen_from_one_side(item, direction):
    view, T = seen(item, direction)
    center = estimate_object(*view, PlannerConfig()).center
    assert np.linalg.norm(center - T[:3, 3]) < 0.010
    assert np.linalg.norm(T[:3, 3]) > 0.014  # the mean of the seen points is no answer


def test_axes_of_the_fitted_ellipsoid_are_those_of_the_sphere():
    estimate = estimate_object(*half_sphere(0.03), PlannerConfig())
    np.testing.assert_allclose(estimate.axes, 0.03, rtol=0.1)
    assert (np.diff(estimate.axes) >= 0.0).all() and len(estimate.points) == PlannerConfig().points


@pytest.mark.parametrize("prior", ["ellipsoid", "constant"])
def test_the_estimate_moves_with_the_view(prior):
    config, view = PlannerConfig(prior=prior), seen(box(), (1.0, 0.6, 0.4))[0]
    here = estimate_object(*view, config)
    shift = np.array([0.05, -0.1, 0.02])
    there = estimate_object(*moved(view, np.eye(3), shift), config)
    np.testing.assert_allclose(there.center, here.center + shift, atol=1e-6)
    np.testing.assert_allclose(there.axes, here.axes, atol=1e-6)
    cycle = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # maps the centroid's lattice onto itself
    turned = estimate_object(*moved(view, cycle), replace(config, trust=0.0))
    bare = estimate_object(*view, replace(config, trust=0.0))
    np.testing.assert_allclose(turned.center, cycle @ bare.center, atol=1e-6)
    for seed in range(3):
        R = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
        turned = estimate_object(*moved(view, R), config)
        np.testing.assert_allclose(turned.points, here.points @ R.T, atol=1e-12)
        # The ellipsoid looks along some directions across the line of sight, the centroid at nodes 1 cm apart.
        np.testing.assert_allclose(turned.center, R @ here.center, atol=5e-3)
        np.testing.assert_allclose(turned.axes, here.axes, rtol=0.1)


@pytest.mark.parametrize("prior", ["ellipsoid", "constant"])
def test_the_estimate_scales_with_the_view(prior):
    config, view = PlannerConfig(prior=prior), half_sphere(0.02)
    large = View(2.0 * view.points, view.normals, 2.0 * view.noise, 2.0 * view.viewpoint)
    one, two = estimate_object(*view, config), estimate_object(*large, config)
    np.testing.assert_allclose(two.center, 2.0 * one.center, atol=2e-4)
    np.testing.assert_allclose(two.axes, 2.0 * one.axes, rtol=1e-3)


# proposals ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def proposals():
    view, _ = seen(box(), (1.0, 0.6, 0.4))
    return view, propose(*view, np.random.default_rng(3))


def test_every_proposal_fits_the_gripper_and_they_are_sorted(proposals):
    _, found = proposals
    assert len(found) > 20 and found.context.shape == (len(found), len(CONTEXT))
    c = found.candidates
    for axes in (c.closing_axes, c.approach_axes):
        np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, atol=UNIT_TOLERANCE)
    assert np.abs(np.einsum("gi,gi->g", c.closing_axes, c.approach_axes)).max() < UNIT_TOLERANCE
    assert (c.widths <= GRIPPER.max_width).all() and (c.widths > c.contact_widths).all()
    assert (np.diff(found.score) <= 0.0).all()
    assert (found.pfc >= 0.0).all() and (found.pfc <= 1.0).all()
    np.testing.assert_allclose(c.centers, c.positions.mean(axis=1), atol=1e-12)
    friction = np.arctan(GRIPPER.friction)
    assert closing_angles(c.positions, c.normals).max() <= friction + 1e-9
    best = found.grasp(0)
    np.testing.assert_array_equal(best.center, c.centers[0])
    assert best.width == c.widths[0]


def test_the_context_says_what_its_names_say(proposals):
    view, found = proposals
    c, columns = found.candidates, dict(zip(CONTEXT, found.context.T, strict=True))
    center = found.estimate.center
    sight = (view.viewpoint - center) / np.linalg.norm(view.viewpoint - center)
    to_center = center - c.centers
    below = to_center - (to_center * c.closing_axes).sum(axis=1, keepdims=True) * c.closing_axes
    expected = {
        "pfc": found.pfc,
        "closing_angle": closing_angles(c.positions, c.normals),
        "line_distance": line_distance(c.positions, center),
        "centre_distance": np.linalg.norm(c.centers - center, axis=1),
        "width": c.contact_widths,
        "approach_to_view": c.approach_axes @ sight,
        "closing_to_view": np.abs(c.closing_axes @ sight),
        "approach_to_up": c.approach_axes[:, 2],
        "closing_to_up": np.abs(c.closing_axes[:, 2]),
        "room": c.widths - c.contact_widths,
        "above": -below[:, 2],
        "aside": np.hypot(*below[:, :2].T),
        "size": np.full(len(c), found.estimate.axes[1]),
        "slenderness": np.full(len(c), found.estimate.axes[2] / found.estimate.axes[0]),
    }
    for name, values in expected.items():
        np.testing.assert_allclose(columns[name], values, atol=1e-12, err_msg=name)
    assert (columns["deviation_first"] <= columns["deviation_second"]).all() and columns["deviation_first"].min() >= 0.0
    assert (columns["unseen_first"] <= columns["unseen_second"]).all()
    assert set(columns["tightness"]) <= {0.0, 1.0, 2.0}
    apart = np.linalg.norm(c.positions[:, :, None] - found.estimate.points, axis=3).min(axis=2)
    np.testing.assert_allclose(np.sort(apart, axis=1)[:, 0], columns["unseen_first"], atol=1e-12)
    assert np.isfinite(found.context).all()


def test_the_score_is_the_weighted_sum_of_what_is_known(proposals):
    view: View = proposals[0]
    found = proposals[1]
    columns = dict(zip(CONTEXT, found.context.T, strict=True))
    columns["pfc"] = np.log(np.maximum(columns["pfc"], 1e-3))
    for name in ("closing_to_view", "closing_to_up"):
        columns[f"{name}_squared"] = columns[name] ** 2
    columns["crowding"] = np.exp(-found.clearance / CROWDED)
    assert tuple(columns) == TERMS and set(WEIGHTS) <= set(TERMS)
    np.testing.assert_allclose(terms(found.context, found.clearance), np.stack(list(columns.values()), axis=1))
    expected = sum(weight * columns[name] for name, weight in WEIGHTS.items())
    np.testing.assert_allclose(found.score, expected, atol=1e-9)
    np.testing.assert_allclose(ranking(found.context, found.clearance), found.score, atol=1e-9)
    nearest = propose(*view, np.random.default_rng(3), PlannerConfig(weights={"line_distance": -1.0}))
    assert (np.diff(nearest.context[:, CONTEXT.index("line_distance")]) >= 0.0).all()
    np.testing.assert_array_equal(np.sort(nearest.pfc), np.sort(found.pfc))  # the same grasps in another order


def test_the_clearance_is_that_of_fingers_and_palm_from_the_seen_points_at_most(proposals):
    view, found = proposals
    c, far = found.candidates, 0.03
    assert (found.clearance >= 0.0).all() and (found.clearance <= far).all() and np.ptp(found.clearance) > 0.002
    boxes = swept_boxes(GRIPPER, c.widths, c.contact_widths)[:, [1, 3, 4]]
    rotations = np.stack([c.closing_axes, np.cross(c.approach_axes, c.closing_axes), c.approach_axes], axis=2)
    for g in range(0, len(c), 7):
        local = ((view.points - c.centers[g]) @ rotations[g])[:, None]
        apart = np.maximum(np.maximum(boxes[g, :, :3] - local, local - boxes[g, :, 3:]), 0.0)
        assert found.clearance[g] <= min(np.linalg.norm(apart, axis=2).min(), far) + 1e-9  # the surface may be nearer


def test_equal_seeds_propose_equal_grasps_and_other_seeds_others(proposals):
    view: View = proposals[0]
    found = proposals[1]
    again, other = (propose(*view, np.random.default_rng(seed)) for seed in (3, 4))
    for name in ("score", "pfc", "context", "clearance"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))
    np.testing.assert_array_equal(again.candidates.centers, found.candidates.centers)
    assert not np.array_equal(other.candidates.centers[:5], found.candidates.centers[:5])


def test_taking_some_keeps_their_rows_together(proposals):
    _, found = proposals
    rows = np.array([5, 2, 9])
    some = found.take(rows)
    assert len(some) == 3 and some.estimate is found.estimate
    np.testing.assert_array_equal(some.score, found.score[rows])
    np.testing.assert_array_equal(some.context, found.context[rows])
    np.testing.assert_array_equal(some.clearance, found.clearance[rows])
    np.testing.assert_array_equal(some.grasp(1).center, found.grasp(2).center)
    assert len(found.take(np.zeros(len(found), dtype=bool))) == 0


def test_what_is_too_large_for_the_gripper_gets_no_proposal():
    found = propose(*half_sphere(0.15), np.random.default_rng(0))
    assert len(found) == 0 and found.context.shape == (0, len(CONTEXT)) and found.candidates.reasons


def test_a_wider_gripper_and_more_friction_find_more():
    view, _ = seen(box((0.09, 0.11, 0.13)), (1.0, 0.6, 0.4))

    def count(gripper=None, friction=None):
        found = propose(*view, np.random.default_rng(0), gripper=gripper, friction=friction)
        return len(np.unique(found.candidates.positions.reshape(-1, 6), axis=0))

    assert count(GripperConfig(max_width=0.16)) > count()
    assert count(friction=50.0) >= count() >= count(friction=0.05)
