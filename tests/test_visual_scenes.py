"""Scenes: things rest on what is there, pictures agree with the truth that is told of them."""

from __future__ import annotations

import itertools
from dataclasses import replace

import igl
import mujoco
import numpy as np
import pytest

from aerograsp_env.sim.rgbd_camera import Capture, RGBDCameraConfig, SimulatedCamera
from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.sim.visual.looks import Look
from aerograsp_env.sim.visual.objects import nominal_object, random_object
from aerograsp_env.sim.visual.placing import Placed, footprint, lined_up, on_pipe, overlap, scatter
from aerograsp_env.sim.visual.scene_mjcf import SceneModel
from aerograsp_env.sim.visual.scenes import Ground, Light, Scene, SceneConfig, make_scene
from aerograsp_env.sim.visual.truths import truths
from aerograsp_env.sim.visual.viewpoints import draw_viewpoint, look_at
from aerograsp_env.spatial import transform

CAMERA = RGBDCameraConfig.ideal(160, 120)


def scene_of(*placed: Placed, distractors: tuple[Placed, ...] = ()) -> Scene:
    """On a grey plane under a high sun."""
    ground = Ground("plane", (0.0, 0.0, 1.0), np.eye(4), Look((0.5, 0.5, 0.5)))
    sun = Light("directional", np.zeros(3), np.array([0.2, 0.1, -0.95]), np.full(3, 0.6))
    return Scene(placed, distractors, (ground,), (sun,), np.full(3, 0.3), 0.5, 0.0, 0.3, SceneConfig())


def at(label: str, x: float = 0.0, y: float = 0.0, lift: float = 0.0) -> Placed:
    item = nominal_object(label)
    return Placed(item, transform(np.eye(3), np.array([x, y, lift - item.vertices[:, 2].min()])))


def shoot(scene: Scene, T: np.ndarray) -> tuple[Capture, SceneModel]:
    scene_model = scene.model()
    return SimulatedCamera(scene_model.model, CAMERA).capture(scene_model.data, T), scene_model


@pytest.fixture(scope="module")
def random_shots() -> list[tuple[Capture, SceneModel]]:
    shots = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        config = SceneConfig(("easy", "cluttered")[seed % 2], style=("aerial", "studio")[seed // 3])
        scene = make_scene(config, rng)
        shots.append(shoot(scene, draw_viewpoint(scene, rng).T_world_camera))
    return shots


def test_the_same_generator_makes_the_same_scene() -> None:
    one, same = (make_scene(SceneConfig("cluttered"), np.random.default_rng(4)) for _ in range(2))
    assert [p.object.label for p in one.objects] == [p.object.label for p in same.objects]
    for a, b in zip(one.objects + one.distractors, same.objects + same.distractors, strict=True):
        assert np.array_equal(a.T_world_object, b.T_world_object)
        assert np.array_equal(a.object.vertices, b.object.vertices)
    a, b = one.model().model, same.model().model
    assert np.array_equal(a.tex_data, b.tex_data)
    assert np.array_equal(a.mat_rgba, b.mat_rgba)


def test_easy_things_rest_apart_on_the_support() -> None:
    config = SceneConfig("easy", tuple(name for name in CLASSES if name != "crawler"))
    for seed in range(6):
        scene = make_scene(config, np.random.default_rng(seed))
        lows = [placed.points[:, 2].min() for placed in scene.objects]
        assert np.allclose(lows, scene.support_height, atol=1e-9)
        outlines = [footprint(placed) for placed in scene.objects]
        for k, one in enumerate(outlines):
            assert all(overlap(one, other) == 0.0 for other in outlines[:k])


def test_stacked_things_do_not_sink_into_the_support() -> None:
    rng = np.random.default_rng(0)
    items = [random_object("wrench", rng) for _ in range(6)]
    placed = scatter(items, rng, (0.05, 0.05), 0.4, stack=1.0)
    lows = np.array([p.points[:, 2].min() for p in placed])
    assert len(placed) >= 3
    assert lows.min() == pytest.approx(0.4)
    assert (lows > 0.4 - 1e-9).all()
    assert (lows > 0.401).any()


def test_lined_up_tools_lie_side_by_side() -> None:
    rng = np.random.default_rng(3)
    placed = lined_up([random_object("pliers", rng) for _ in range(5)], rng)
    spans = sorted((p.points[:, 0].min(), p.points[:, 0].max()) for p in placed)
    assert all(after[0] > before[1] for before, after in itertools.pairwise(spans))
    assert spans[0][0] + spans[-1][1] == pytest.approx(0.0, abs=0.05)


def test_the_crawler_touches_the_pipe_and_does_not_enter_it() -> None:
    rng = np.random.default_rng(1)
    for radius in (0.15, 0.3):
        placed = on_pipe(nominal_object("crawler"), rng, radius, 0.1, 0.5)
        clear = np.hypot(placed.points[:, 0], placed.points[:, 2] - 0.5) - radius
        assert clear[np.abs(placed.points[:, 0]) < radius].min() == pytest.approx(0.0, abs=1e-3)
        assert (clear > -1e-9).all()


def test_overlap_of_known_squares() -> None:
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32) * np.float32(0.1)
    assert overlap(square, square + np.float32(0.05)) == pytest.approx(0.0025, rel=1e-4)
    assert overlap(square, square + np.float32(0.2)) == 0.0


def test_every_geom_has_its_owner(random_shots) -> None:
    for _, scene_model in random_shots:
        scene, model = scene_model.scene, scene_model.model
        counts = np.bincount(scene_model.geom_object[scene_model.geom_object >= 0], minlength=len(scene.objects))
        assert counts.tolist() == [len(placed.object.parts) for placed in scene.objects]
        assert scene_model.geom_ground.sum() == len(scene.grounds)
        for geom in np.flatnonzero(scene_model.geom_object >= 0):
            placed = scene.objects[scene_model.geom_object[geom]]
            assert np.allclose(model.body_pos[model.geom_bodyid[geom]], placed.T_world_object[:3, 3])


def test_boxes_are_those_of_rays_cast_one_by_one(random_shots) -> None:
    checked = 0
    for capture, scene_model in random_shots[::2]:
        intrinsics, T = capture.frame.intrinsics, capture.frame.T_world_camera
        geom = np.zeros(1, np.int32)
        mask = np.full((intrinsics.height, intrinsics.width), -1)
        for row in range(intrinsics.height):
            for column in range(intrinsics.width):
                ray = np.array([(column - intrinsics.cx) / intrinsics.fx, (row - intrinsics.cy) / intrinsics.fy, 1.0])
                arguments = (scene_model.model, scene_model.data, T[:3, 3], T[:3, :3] @ ray, None, 1, -1, geom, None)
                if mujoco.mj_ray(*arguments) >= 0.0:
                    mask[row, column] = scene_model.geom_object[geom[0]]
        for truth in truths(capture, scene_model):
            rows, columns = np.nonzero(mask == truth.index)
            expected = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
            assert np.abs(truth.box - expected).max() <= 1.0  # a ray on an edge may fall to either side
            checked += 1
    assert checked > 3


def test_depth_lies_on_the_objects_at_their_true_poses(random_shots) -> None:
    checked = 0
    for capture, scene_model in random_shots:
        intrinsics = capture.frame.intrinsics
        owner = np.append(scene_model.geom_object, -1)[capture.segmentation]
        for truth in truths(capture, scene_model):
            rows, columns = np.nonzero(owner == truth.index)
            z = capture.clean_depth[rows, columns].astype(np.float64)
            x, y = (columns - intrinsics.cx) / intrinsics.fx, (rows - intrinsics.cy) / intrinsics.fy
            points = np.stack([x * z, y * z, z], axis=1)
            T = truth.T_c_object
            local = (points - T[:3, 3]) @ T[:3, :3]
            item = scene_model.scene.objects[truth.index].object
            assert truth.label == item.label
            squared, *_ = igl.point_mesh_squared_distance(local, item.vertices, item.faces.astype(np.int64))
            assert np.sqrt(squared.max()) < 1e-4
            checked += len(points)
    assert checked > 1000


def test_visibility_of_what_is_whole_half_hidden_and_cut_off() -> None:
    above = look_at(np.array([0.0, 0.0, 0.8]), np.zeros(3))
    capture, scene_model = shoot(scene_of(at("box"), at("hammer", 0.05, 0.18)), above)
    assert [truth.visibility for truth in truths(capture, scene_model)] == pytest.approx([1.0, 1.0], abs=0.03)

    item = nominal_object("box")
    cover = Placed(item, transform(np.eye(3), np.array([0.5 * item.extent[0], 0.0, 0.1])))  # over its right half
    capture, scene_model = shoot(scene_of(at("box"), distractors=(cover,)), above)
    (truth,) = truths(capture, scene_model)
    assert 0.4 < truth.visibility < 0.56
    assert not truth.difficult

    reach = 0.8 * CAMERA.height / CAMERA.width * np.tan(0.5 * CAMERA.fovy) * (CAMERA.width / CAMERA.height) ** 2
    capture, scene_model = shoot(scene_of(at("box", x=float(reach))), above)  # its middle on the picture's edge
    (truth,) = truths(capture, scene_model)
    assert truth.box[2] == CAMERA.width
    assert truth.visibility == pytest.approx(0.5, abs=0.12)

    capture, scene_model = shoot(scene_of(at("box", x=3.0)), above)
    assert truths(capture, scene_model) == []


def test_small_things_are_difficult() -> None:
    far = look_at(np.array([0.0, 0.0, 4.0]), np.zeros(3))
    capture, scene_model = shoot(scene_of(at("fruit")), far)
    (truth,) = truths(capture, scene_model)
    assert truth.difficult
    assert truth.visibility > 0.8


def test_dark_scenes_are_darker() -> None:
    def brightness(level: str) -> float:
        values = []
        for seed in range(4):
            rng = np.random.default_rng(seed)
            scene = make_scene(SceneConfig(level, ("box", "can"), (2, 2)), rng)
            T = look_at(np.array([0.0, -0.8, scene.support_height + 0.8]), scene.center)
            values.append(shoot(scene, T)[0].frame.rgb.mean())
        return float(np.mean(values))

    assert brightness("dark") < 0.5 * brightness("easy")


def test_relighting_changes_the_light_alone() -> None:
    rng = np.random.default_rng(0)
    scene = make_scene(SceneConfig(), rng)
    T = draw_viewpoint(scene, rng).T_world_camera
    scene_model = scene.model()
    camera = SimulatedCamera(scene_model.model, CAMERA)
    before = camera.capture(scene_model.data, T)
    other = scene_model.relight(scene.relit(rng))
    after = camera.capture(other.data, T)
    assert np.array_equal(before.segmentation, after.segmentation)
    assert np.array_equal(before.clean_depth, after.clean_depth)
    assert not np.array_equal(before.frame.rgb, after.frame.rgb)


def test_without_randomization_shapes_looks_and_light_are_fixed() -> None:
    scenes = [make_scene(SceneConfig(randomize=False), np.random.default_rng(seed)) for seed in range(3)]
    for scene in scenes:
        assert all(placed.object is nominal_object(placed.object.label) for placed in scene.objects)
        assert len(scene.lights) == 1
        assert not scene.distractors
    assert len({ground.look for scene in scenes for ground in scene.grounds if ground.shape != "cylinder"}) == 1
    assert np.array_equal(scenes[0].lights[0].color, scenes[1].lights[0].color)


def test_the_maker_makes_the_objects() -> None:
    asked = []

    def maker(label: str, rng: np.random.Generator):
        asked.append(label)
        return nominal_object(label)

    scene = make_scene(SceneConfig(labels=("can",), objects=(2, 2)), np.random.default_rng(0), maker)
    assert asked == ["can", "can"]
    assert all(placed.object is nominal_object("can") for placed in scene.objects)


def test_viewpoints_are_above_the_support_and_near() -> None:
    for style in ("aerial", "studio"):
        rng = np.random.default_rng(7)
        scene = make_scene(SceneConfig(style=style), rng)
        for _ in range(20):
            viewpoint = draw_viewpoint(scene, rng)
            position = viewpoint.T_world_camera[:3, 3]
            assert position[2] > scene.support_height
            assert np.linalg.norm(position - scene.center) < 3.5
            assert np.radians(29.0) < viewpoint.fovy < np.radians(76.0)
    T = look_at(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.5, 0.2]))
    assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3))
    target = T[:3, :3].T @ (np.array([0.0, 0.5, 0.2]) - T[:3, 3])
    assert np.allclose(target[:2], 0.0)
    assert target[2] > 0.0
    assert T[2, 1] < 0.0  # the picture's down points down


def test_pipes_are_not_in_the_way_of_the_camera() -> None:
    rng = np.random.default_rng(2)
    scenes = [make_scene(SceneConfig(labels=("crawler", "box")), rng) for _ in range(12)]
    piped = [scene for scene in scenes if any(ground.shape == "cylinder" for ground in scene.grounds)]
    assert len(piped) > 3
    for scene in piped:
        pipe = next(ground for ground in scene.grounds if ground.shape == "cylinder")
        for _ in range(10):
            eye = draw_viewpoint(scene, rng).T_world_camera[:3, 3]
            assert np.linalg.norm((eye - pipe.T_world_ground[:3, 3])[[0, 2]]) > pipe.size[0]


def test_an_empty_scene_can_be_drawn() -> None:
    scene = make_scene(SceneConfig(objects=(0, 0), distractors=(0, 0)), np.random.default_rng(0))
    capture, scene_model = shoot(scene, look_at(np.array([0.0, -1.0, 1.5]), scene.center))
    assert truths(capture, scene_model) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"level": "hard"}, "level: expected one of easy"),
        ({"style": "top"}, "style: expected one of aerial"),
        ({"labels": ("drill",)}, "labels: expected some of"),
        ({"labels": ()}, "labels: expected some of"),
        ({"objects": (5, 2)}, "objects: expected 0 ≤ from ≤ to"),
        ({"distractors": (-1, 2)}, "distractors: expected 0 ≤ from ≤ to"),
    ],
)
def test_bad_configurations(change: dict, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        SceneConfig(**change)


def test_a_capture_must_know_its_camera() -> None:
    capture, scene_model = shoot(scene_of(at("can")), look_at(np.array([0.0, 0.0, 0.8]), np.zeros(3)))
    with pytest.raises(ValueError, match="T_world_camera"):
        truths(capture._replace(frame=replace(capture.frame, T_world_camera=None)), scene_model)
