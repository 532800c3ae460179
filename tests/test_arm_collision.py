"""Collisions of arms: known distances, symmetry, agreement with MuJoCo's own geometry, and bad input."""

import mujoco
import numpy as np
import pytest

from aerograsp_env.sim.arms.description import Shape
from aerograsp_env.sim.arms.vehicles import AQUILES, BELEROFONTE_ARMS, BELEROFONTE_TOOL
from aerograsp_env.spatial import so3_exp, transform
from baselines.kinematics.collision import CollisionModel, convex_hull

HOME = {m.side: m.arm.home for m in BELEROFONTE_ARMS.mounts}
CUBE = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.05, 0.05)])


def _random_angles(rng: np.random.Generator) -> dict[str, np.ndarray]:
    limits = BELEROFONTE_ARMS.mounts[0].arm.limits
    return {side: rng.uniform(limits[:, 0], limits[:, 1]) for side in ("right", "left")}


@pytest.mark.parametrize("vehicle", [AQUILES, BELEROFONTE_ARMS, BELEROFONTE_TOOL], ids=lambda v: v.name)
def test_stowed_and_home_are_clear(vehicle):
    model = CollisionModel(vehicle)
    for angles in ({}, {m.side: m.arm.home for m in vehicle.mounts}):
        assert model.clearance(angles).nearest.distance > 0.004
        assert model.collides(angles) is None


def test_distance_to_a_ball_shaped_obstacle_is_the_closed_form():
    # a hull far below: the nearest part of the stretched arm is its hand, whose jaws end 4 mm beyond the tool frame
    model = CollisionModel(BELEROFONTE_ARMS.with_active(["right"]), {"cube": [CUBE]})
    straight = {"right": np.zeros(6)}
    tool = model.arms["right"].forward(np.zeros(6))
    jaws = BELEROFONTE_ARMS.mount("right").arm.gripper.jaws
    gap = 0.08
    below = tool[:3, 3] - [0.0, 0.0, 0.5 * jaws.pad_height + 0.05 + gap]
    # beside the opening, under one finger: its foot is a face, parallel to the cube's
    below = below + tool[:3, 0] * 0.5 * jaws.max_width
    found = model.clearance(straight, poses={"cube": transform(np.eye(3), below)})
    assert found.arm_obstacle.distance == pytest.approx(gap, abs=1e-6)
    assert found.arm_obstacle.first.startswith("right/")
    above = below + [0.0, 0.0, gap + 0.01]
    hit = model.clearance(straight, poses={"cube": transform(np.eye(3), above)}).arm_obstacle
    assert hit.distance < 0.0
    assert model.collides(straight, poses={"cube": transform(np.eye(3), above)}) is not None
    ignored = model.clearance(straight, poses={"cube": transform(np.eye(3), above)}, ignore=[("right", "cube")])
    assert ignored.arm_obstacle.distance == np.inf


def test_arms_commanded_into_each_other_are_found_from_both_sides():
    model = CollisionModel(BELEROFONTE_ARMS)
    inwards = np.radians([90.0, -80.0, 30.0, 0.0, 0.0, 0.0])
    found = []
    for sign in (1.0, -1.0):
        angles = {"right": inwards * [sign, 1, 1, 1, 1, 1], "left": inwards * [-sign, 1, 1, 1, 1, 1]}
        found.append(model.clearance(angles).arm_arm.distance)
    assert min(found) < 0.0 < max(found)


def test_distances_are_symmetric_between_mirrored_arms():
    model = CollisionModel(BELEROFONTE_ARMS)
    rng = np.random.default_rng(0)
    for _ in range(20):
        angles = _random_angles(rng)
        a = model.clearance(angles, within=2.0).arm_arm
        b = model.clearance(dict(reversed(angles.items())), within=2.0).arm_arm
        assert a == b


def test_pieces_that_touch_are_those_of_mujoco():
    """Every pair's sign agrees with MuJoCo's own distance, for arm against arm."""
    rng = np.random.default_rng(1)
    model = CollisionModel(BELEROFONTE_ARMS)
    spec = mujoco.MjSpec()
    kinds = {"capsule": mujoco.mjtGeom.mjGEOM_CAPSULE, "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
             "box": mujoco.mjtGeom.mjGEOM_BOX}  # fmt: skip
    parts = [(m.side, i, shape) for m in BELEROFONTE_ARMS.mounts for i, link in enumerate(m.arm.links)
             for shape in link.shapes]  # fmt: skip
    for side, i, shape in parts:
        body = spec.worldbody.add_body(name=f"{side}{i}{shape.name}", mocap=True)
        size = [*shape.size, 0.0][:3]
        body.add_geom(name=f"{side}{i}{shape.name}", type=kinds[shape.kind], size=size)
    compiled = spec.compile()
    data = mujoco.MjData(compiled)
    nearer = 0
    for _ in range(40):
        angles = _random_angles(rng)
        for side, i, shape in parts:
            T = model.arms[side].link_poses(angles[side])[i] @ shape.T_link_shape
            body = compiled.body(f"{side}{i}{shape.name}")
            data.mocap_pos[body.mocapid[0]] = T[:3, 3]
            mujoco.mju_mat2Quat(data.mocap_quat[body.mocapid[0]], T[:3, :3].ravel())
        mujoco.mj_forward(compiled, data)
        names = {side: [f"{side}{i}{s.name}" for o, i, s in parts if o == side] for side in ("right", "left")}
        expected = min(
            mujoco.mj_geomDistance(compiled, data, compiled.geom(a).id, compiled.geom(b).id, 3.0, None)
            for a in names["right"] for b in names["left"]
        )  # fmt: skip
        found = model.clearance(angles, within=3.0).arm_arm.distance
        # the model also has the gripper's boxes: it can only be nearer
        assert found <= expected + 1e-4
        nearer += abs(found - expected) < 1e-4
    assert nearer > 0


def test_collides_is_the_sign_of_the_clearance():
    model = CollisionModel(BELEROFONTE_ARMS)
    rng = np.random.default_rng(2)
    seen = set()
    for _ in range(40):
        angles = _random_angles(rng)
        hit = model.collides(angles, margin=0.01) is not None
        assert hit == (model.clearance(angles).nearest.distance < 0.01)
        seen.add(hit)
    assert seen == {True, False}


def test_closing_jaws_come_nearer_to_what_is_between_them():
    model = CollisionModel(
        BELEROFONTE_ARMS.with_active(["right"]), {"rod": [Shape.capsule("rod", (0, 0, -0.004), (0, 0, 0.004), 0.01)]}
    )
    T = model.arms["right"].forward(HOME["right"])
    jaws = BELEROFONTE_ARMS.mount("right").arm.gripper.jaws
    for width in (0.03, 0.06, jaws.max_width):
        found = model.clearance({"right": HOME["right"]}, {"right": width}, {"rod": T}).arm_obstacle
        assert found.distance == pytest.approx(0.5 * width - 0.01, abs=1e-6)


def test_bad_input_is_refused():
    model = CollisionModel(BELEROFONTE_ARMS, {"cube": [CUBE]})
    for arguments, word in (
        (({"middle": np.zeros(6)},), "middle"),
        (({"right": np.zeros(5)},), "q"),
        (({"right": np.full(6, np.nan)},), "q"),
        (({}, {"right": 0.2}), "widths"),
        (({}, {}, {"ball": np.eye(4)}), "ball"),
        (({}, {}, {"cube": np.diag([1.0, 1.0, -1.0, 1.0])}), "cube"),
    ):
        with pytest.raises(ValueError, match=word):
            model.clearance(*arguments)
    with pytest.raises(ValueError, match="volume"):
        convex_hull(CUBE[:, :2] @ np.eye(2, 3))
    with pytest.raises(ValueError, match="obstacles"):
        CollisionModel(BELEROFONTE_ARMS, {"right": [CUBE]})
    with pytest.raises(ValueError, match="obstacles"):
        CollisionModel(BELEROFONTE_ARMS, {"nothing": []})


def test_a_turned_vehicle_frame_changes_nothing():
    """Distances depend on relative poses alone: an obstacle turned with the arm's base keeps its distance."""
    model = CollisionModel(AQUILES, {"cube": [CUBE]})
    q = np.radians([0.0, -60.0, 60.0, 0.0])
    T = model.arms["right"].forward(q) @ transform(so3_exp([0.3, 0.2, 0.1]), (0.0, 0.0, 0.2))
    base = model.clearance({"right": q}, poses={"cube": T}).arm_obstacle.distance
    turn = np.radians(40.0)
    pivot = np.asarray(AQUILES.mounts[0].T_body_base)
    spin = pivot @ transform(so3_exp([0.0, 0.0, -turn]), np.zeros(3)) @ np.linalg.inv(pivot)
    turned = model.clearance({"right": q + [turn, 0, 0, 0]}, poses={"cube": spin @ T}).arm_obstacle.distance
    assert turned == pytest.approx(base, abs=1e-6)
