"""The judge of grasps against closed forms: friction limits, pendulums, collisions; and its exact repeatability."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
from grasp_worlds import UPRIGHT, X, Y, Z, box, cylinder, grasp, pose
from scipy.spatial.transform import Rotation

from aerograsp_env.sim import grasp_scene
from aerograsp_env.sim.grasp_judge import GRAVITY, OUTCOMES, JudgeConfig, judge_grasp, record_grasp
from aerograsp_env.sim.gripper import GripperConfig

LIMIT = 2 * 0.7 * 25.0 / GRAVITY  # [kg] that two pads hold: 2 μ F = m g
SLOW = JudgeConfig(load_time=0.5, lift=0.1, lift_time=1.0, shake_acceleration=0.0, shake_time=0.0, hold_time=0.3)
STILL = JudgeConfig(lift=0.0, shake_acceleration=0.0, shake_time=1.0)


def same(first, second) -> bool:
    """Bit by bit; NaN equals NaN."""
    return all(
        np.asarray(a).tobytes() == np.asarray(b).tobytes() and np.shape(a) == np.shape(b)
        for a, b in zip(first, second, strict=True)
    )


# friction -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("share", "held"), [(0.8, True), (1.25, False)])
@pytest.mark.parametrize(("force", "friction"), [(25.0, 0.7), (15.0, 0.7), (25.0, 0.4)])
def test_two_pads_resist_a_weight_up_to_twice_friction_times_force(share, held, force, friction):
    gripper = GripperConfig(force=force, friction=friction)
    item = box(mass=share * 2 * friction * force / GRAVITY, friction=friction)
    judgement = judge_grasp(item, grasp(), UPRIGHT, gripper, SLOW)
    assert judgement.held is held
    assert judgement.outcome == ("held" if held else "dropped")
    if held:
        assert judgement.slip < 1e-3


def test_the_friction_of_a_contact_is_the_geometric_mean_of_both_surfaces():
    for own, other in ((0.35, 1.4), (1.4, 0.35)):
        gripper = GripperConfig(friction=other)
        assert judge_grasp(box(mass=0.8 * LIMIT, friction=own), grasp(), UPRIGHT, gripper, SLOW).held
        assert not judge_grasp(box(mass=1.25 * LIMIT, friction=own), grasp(), UPRIGHT, gripper, SLOW).held


def test_a_wall_under_the_object_needs_no_friction():
    """With the closing axis upright the lower finger carries the object: friction has nothing to do."""
    item = box(mass=1.5, friction=0.05)
    assert not judge_grasp(item, grasp(), UPRIGHT, config=SLOW).held
    held = judge_grasp(item, grasp(closing=Z, approach=X, width=0.09), pose(np.array([Z, Y, -X]).T), config=SLOW)
    assert held.held


@pytest.mark.parametrize("height", [0.0, 0.02])
def test_a_held_object_does_not_creep(height):
    judgement = judge_grasp(box(mass=0.9), grasp((0.0, 0.0, height)), UPRIGHT, config=STILL)
    assert judgement.strict
    assert judgement.slip < 1e-4 and judgement.turn < 1e-3  # in 1.3 s


def test_pads_neither_let_go_nor_snap_while_the_object_is_shaken():
    recording = record_grasp(box(), grasp(), UPRIGHT)
    shaken = recording.width[-550:]  # and then held still
    assert np.ptp(shaken) < 5e-5
    assert np.abs(np.diff(shaken)).max() < 5e-6


# turning about the closing axis ---------------------------------------------------------------------


def test_an_object_held_beside_its_centre_of_mass_hangs_down_like_a_pendulum():
    gripper = GripperConfig(friction=0.7)
    lying = pose(Rotation.from_euler("y", 90, degrees=True).as_matrix())  # its long axis along −x of the cloud
    at_center = judge_grasp(box(), grasp(closing=Y, width=0.08), lying, gripper)
    assert at_center.strict and at_center.turn < 0.01
    turns = []
    for offset in (0.03, 0.04, 0.05):
        judgement = judge_grasp(box(), grasp((offset, 0.0, 0.0), closing=Y), lying, gripper)
        assert judgement.held and not judgement.strict
        turns.append(judgement.turn)
        assert judgement.slip < 0.02  # it turns about the pads
    assert turns == sorted(turns) and turns[-1] == pytest.approx(0.5 * np.pi, abs=0.3)
    left = judge_grasp(box(), grasp((-0.05, 0.0, 0.0), closing=Y), lying, gripper)
    assert left.turn == pytest.approx(turns[-1], abs=0.1)


def test_an_object_hanging_below_the_grasp_does_not_turn():
    judgement = judge_grasp(box(), grasp((0.0, 0.0, 0.04)), UPRIGHT)
    assert judgement.strict and judgement.turn < 0.02


# outcomes -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("outcome", "changes"),
    [
        ("held", {}),
        ("collision", {"width": 0.047}),  # the pads begin within the box
        ("collision", {"center": (0.01, 0.0, 0.0), "width": 0.06}),  # one of them does
        ("collision", {"center": (0.0, 0.0, -0.02)}),  # the palm meets its top
        ("collision", {"closing": Z, "approach": X, "width": 0.1}),  # 0.12 m is wider than the gripper opens
        ("collision", {"approach": X, "closing": Z, "center": (0.0, 0.0, 0.05), "width": 0.06}),  # a finger in its way
        ("missed", {"center": (0.0, 0.0, 0.08)}),  # above it
        ("missed", {"center": (0.0, 0.05, 0.0)}),  # beside it
        ("too wide", {"width": 0.11}),
    ],
)
def test_each_case_gets_its_name(outcome, changes):
    judgement = judge_grasp(box(), grasp(**changes), UPRIGHT)
    assert judgement.outcome == outcome in OUTCOMES
    assert judgement.held is (outcome == "held")
    if not judgement.held:
        assert np.isnan([judgement.slip, judgement.turn]).all() and not judgement.strict and judgement.survived == 0.0


def test_no_grasp_is_degenerate():
    assert judge_grasp(box(), None, UPRIGHT).outcome == "degenerate"


def test_contact_within_a_millimetre_is_no_collision():
    assert judge_grasp(box(), grasp(width=0.0485), UPRIGHT).outcome == "held"  # 0.75 mm a side
    assert judge_grasp(box(), grasp(width=0.0470), UPRIGHT).outcome == "collision"  # 1.5 mm a side


def test_what_stands_in_the_way_only_of_the_approach_is_a_collision():
    """A rod longer than the fingers, taken at its middle: from the side they reach, along its axis they do not."""
    long = cylinder(0.03, 0.30)
    assert judge_grasp(long, grasp(closing=X, approach=Y), UPRIGHT).outcome == "held"
    assert judge_grasp(long, grasp(closing=X, approach=-Z), UPRIGHT).outcome == "collision"  # along its axis


def test_an_oblique_grasp_on_a_slippery_cylinder_slips_away():
    """The pads meet a cylinder's side far from where their line crosses the axis: it is squeezed out."""
    judgement = judge_grasp(cylinder(friction=0.1), grasp((0.0, -0.024, 0.0), approach=Y), UPRIGHT)
    assert judgement.outcome == "slipped away"


def test_contacts_are_where_the_fingers_close_and_point_inwards():
    turn = pose(Rotation.random(random_state=3).as_matrix(), (0.1, -0.05, 0.02))
    at = grasp(turn[:3, 3], closing=turn[:3, 0], approach=-turn[:3, 2])
    judgement = judge_grasp(box(), at, turn)
    local = (judgement.contact_points - turn[:3, 3]) @ turn[:3, :3]
    normals = judgement.contact_normals @ turn[:3, :3]
    assert len(local) == 8  # two pads of four corners
    np.testing.assert_allclose(np.abs(local[:, 0]), 0.025, atol=2e-4)
    np.testing.assert_allclose(np.abs(local[:, 1:]), 0.004, atol=1e-3)
    np.testing.assert_allclose(normals[:, 0], -np.sign(local[:, 0]), atol=1e-3)


@pytest.mark.parametrize(("angles", "least", "most"), [((0.0, 15.0), 0.98, 1.0), ((47.0, 75.0), 0.0, 0.25)])
def test_grasps_within_the_friction_cone_hold_and_those_far_outside_do_not(angles, least, most):
    """Lines across a cylinder beside its axis meet its side at asin(offset / radius) from the normal; the cone: 35°."""
    rng, item, held = np.random.default_rng(0), cylinder(), []
    for k in range(40):
        offset = 0.03 * np.sin(np.radians(rng.uniform(*angles)))
        turn = pose(Rotation.random(random_state=k).as_matrix())
        at = grasp(turn[:3, :3] @ [0.0, -offset, rng.uniform(-0.01, 0.01)], turn[:3, 0], turn[:3, 1])
        held.append(judge_grasp(item, at, turn).held)
    assert least <= np.mean(held) <= most


# invariance and repeatability -----------------------------------------------------------------------


def test_turning_everything_about_the_vertical_changes_nothing():
    spin = pose(Rotation.from_euler("z", 0.9).as_matrix(), (0.2, 0.1, -0.3))
    tilt = pose(Rotation.random(random_state=1).as_matrix())
    first = grasp(closing=tilt[:3, 0], approach=tilt[:3, 2])
    second = grasp(spin[:3, 3], closing=spin[:3, :3] @ first.closing_axis, approach=spin[:3, :3] @ first.approach_axis)
    one, two = judge_grasp(cylinder(), first, tilt), judge_grasp(cylinder(), second, spin @ tilt)
    assert (one.outcome, one.strict) == (two.outcome, two.strict)
    assert one.slip == pytest.approx(two.slip, abs=1e-5)


def test_equal_inputs_give_equal_bits_whatever_came_before():
    item, at = cylinder(), grasp((0.003, 0.0, 0.02), closing=X, approach=Y)
    first = judge_grasp(item, at, UPRIGHT)
    judge_grasp(item, grasp((0.0, -0.024, 0.0), approach=Y), UPRIGHT)
    judge_grasp(box(mass=5.0), grasp(), UPRIGHT)
    assert same(judge_grasp(item, at, UPRIGHT), first)
    grasp_scene._cache.clear()
    assert same(judge_grasp(dataclasses.replace(item), at, UPRIGHT), first)  # a model compiled anew
    assert same(record_grasp(item, at, UPRIGHT).judgement, first)


def test_compiled_models_are_kept_and_few():
    grasp_scene._cache.clear()
    gripper, items = GripperConfig(), [box() for _ in range(60)]
    first = grasp_scene.grasp_model(items[0], gripper)
    assert grasp_scene.grasp_model(items[0], GripperConfig()) is first
    for item in items:
        grasp_scene.grasp_model(item, gripper)
    assert len(grasp_scene._cache) < 60
    assert grasp_scene.grasp_model(items[0], gripper) is not first


# model --------------------------------------------------------------------------------------------


def test_the_model_has_the_objects_mass_and_no_constraint_holds_it():
    turn = Rotation.random(random_state=0).as_matrix()
    inertia = turn @ np.diag([1e-3, 2e-3, 2.5e-3]) @ turn.T
    item = dataclasses.replace(box(), inertia=inertia, center_of_mass=np.array([0.01, -0.02, 0.03]))
    model = grasp_scene.grasp_model(item, GripperConfig())
    body = model.body("object")
    assert (model.neq, body.mass[0]) == (0, item.mass)
    np.testing.assert_allclose(body.ipos, item.center_of_mass, atol=1e-12)
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, body.iquat)
    R = R.reshape(3, 3)
    np.testing.assert_allclose(R @ np.diag(body.inertia) @ R.T, inertia, rtol=1e-6, atol=1e-12)
    assert model.opt.gravity.tolist() == [0.0, 0.0, 0.0]
    fingers = (model.geom_contype == 1) & (model.geom_conaffinity == 0)
    assert fingers.sum() == len(GripperConfig().boxes(0.05))  # which therefore never meet each other


def test_a_recording_ends_with_the_object_lifted_and_begins_behind_it():
    recording = record_grasp(box(), grasp(), UPRIGHT)
    config = JudgeConfig()
    assert recording.judgement.held
    np.testing.assert_allclose(recording.T_gripper[0, :3, 3], config.approach_distance * Z, atol=1e-9)
    np.testing.assert_allclose(recording.T_gripper[-1, :3, 3], config.lift * Z, atol=2e-3)
    np.testing.assert_allclose(recording.T_object[-1, :3, 3], config.lift * Z, atol=3e-3)
    assert recording.width[0] == pytest.approx(0.08) and recording.width[-1] == pytest.approx(0.05, abs=1e-3)
    assert np.allclose(np.diff(recording.times), 0.002)
    with pytest.raises(ValueError, match="too wide"):
        record_grasp(box(), grasp(width=0.2), UPRIGHT)


def test_shaking_has_the_stated_acceleration():
    recording = record_grasp(box(), grasp(), UPRIGHT)
    config = JudgeConfig()
    start = len(recording.times) - round((config.shake_time + config.hold_time) / 0.002)
    path = recording.T_gripper[start : start + 500, :3, 3] - config.lift * Z
    acceleration = np.gradient(np.gradient(path, 0.002, axis=0), 0.002, axis=0)
    steady, whole = np.abs(acceleration[120:390]).max(axis=0), np.abs(acceleration).max()
    assert (steady > 0.9 * config.shake_acceleration).all() and (steady < 1.3 * config.shake_acceleration).all()
    assert whole < 1.6 * config.shake_acceleration  # running in and out


@pytest.mark.parametrize("changes", [{"lift": -1.0}, {"closing_time": np.nan}, {"shake_frequencies": (0.0, 1.0, 1.0)}])
def test_bad_settings_are_refused(changes):
    with pytest.raises(ValueError, match=next(iter(changes))):
        JudgeConfig(**changes)


def test_a_pose_that_is_not_rigid_is_refused():
    with pytest.raises(ValueError, match="T_cloud_object"):
        judge_grasp(box(), grasp(), 2.0 * np.eye(4))
