"""The renderers against analytic geometry, each other, and MuJoCo's camera convention."""

import json
import os
import subprocess
import sys
from typing import Any

import mujoco
import numpy as np
import pytest

from aerograsp_env.sim.rendering import FreeCamera, make_renderer

W, H = 64, 48
FOVY = 50.0  # [deg]
SCENE = f"""
<mujoco>
  <asset>
    <texture name="checker" type="2d" builtin="checker" rgb1="1 1 1" rgb2="0 0 0" width="64" height="64"/>
    <material name="checker" texture="checker" texrepeat="1 1" texuniform="true"/>
    <material name="paint" rgba="0 0 1 1" specular="0"/>
  </asset>
  <worldbody>
    <light type="directional" dir="0 0 -1"/>
    <geom name="floor" type="plane" size="0 0 0.1" rgba="0.9 0.9 0.9 1"/>
    <geom name="ball" type="sphere" size="0.3" pos="0.5 0 0.8" rgba="0.9 0.1 0.1 1"/>
    <geom name="block" type="box" size="0.2 0.3 0.25" pos="-0.6 0 0.25" material="paint"/>
    <geom name="secret" type="sphere" size="0.2" pos="0 0 1.5" group="4" rgba="0 1 0 1"/>
    <body name="target" mocap="true" pos="0 0 -5"><geom name="ghost" type="sphere" size="0.2" rgba="0 1 0 1"/></body>
    <camera name="top" pos="0 0 3" xyaxes="1 0 0 0 1 0" fovy="{FOVY}"/>
    <camera name="side" pos="0.2 -3 1.1" xyaxes="0.9 0.3 0 -0.1 0.3 0.9" fovy="{FOVY}"/>
    <camera name="flat" pos="0 0 3" projection="orthographic" fovy="2"/>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def world():
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def pinhole(model, data, name):
    """Position, rotation and (H, W, 3) unnormalised directions with camera z = −1, written apart from the renderer."""
    camera = model.camera(name).id
    f = (H / 2) / np.tan(np.deg2rad(model.cam_fovy[camera]) / 2)
    rays = np.empty((H, W, 3))
    for row in range(H):
        for column in range(W):
            rays[row, column] = [(column + 0.5 - W / 2) / f, (H / 2 - row - 0.5) / f, -1.0]
    R = data.cam_xmat[camera].reshape(3, 3)
    return data.cam_xpos[camera], R, rays @ R.T


def analytic_depth(position, rays):
    """Nearest of floor z = 0, the ball and the block (slab method); inf where nothing is hit."""
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = np.where(rays[..., 2] < 0, -position[2] / rays[..., 2], np.inf)
        a, offset = (rays**2).sum(-1), position - [0.5, 0, 0.8]
        half_b = rays @ offset
        root = half_b**2 - a * (offset @ offset - 0.3**2)
        ball = np.where(root >= 0, (-half_b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
        low = (np.array([-0.8, -0.3, 0.0]) - position) / rays
        high = (np.array([-0.4, 0.3, 0.5]) - position) / rays
        enter, leave = np.minimum(low, high).max(-1), np.maximum(low, high).min(-1)
        block = np.where(enter <= leave, enter, np.inf)
    return floor, ball, block


@pytest.mark.parametrize("camera", ["top", "side"])
def test_depth_is_exact(world, camera):
    model, data = world
    position, _, rays = pinhole(model, data, camera)
    surfaces = np.stack(analytic_depth(position, rays))
    expected = surfaces.min(axis=0)
    depth = make_renderer(model, W, H).depth(data, camera)
    assert depth.shape == (H, W) and depth.dtype == np.float32
    assert {0, 1, 2} <= set(surfaces.argmin(axis=0)[np.isfinite(expected)])  # all three surfaces are in the picture
    np.testing.assert_allclose(depth, np.where(np.isfinite(expected), expected, 0.0), rtol=1e-6)


def test_a_miss_is_zero(world):
    model, data = world
    camera = FreeCamera(lookat=(0, 0, 10), distance=1.0, azimuth=0.0, elevation=1.0)
    assert (make_renderer(model, W, H).depth(data, camera) == 0).all()


def test_a_point_projects_to_its_pixel(world):
    """MuJoCo's camera: x right, y up, −z forward; image rows run down."""
    model, data = world
    model.geom_rgba[model.geom("ghost").id] = [0, 1, 0, 1]
    renderer = make_renderer(model, 256, 192)
    f = 96 / np.tan(np.deg2rad(FOVY) / 2)
    for point_c in ([-0.8, 0.5, -2.0], [0.7, 0.3, -1.8]):  # upper left, upper right
        R = data.cam_xmat[model.camera("side").id].reshape(3, 3)
        data.mocap_pos[0] = data.cam_xpos[model.camera("side").id] + R @ point_c
        model.geom_size[model.geom("ghost").id] = 0.05
        mujoco.mj_forward(model, data)
        image = renderer.render(data, "side").astype(int)
        rows, columns = np.nonzero(image[..., 1] > 1.5 * image[..., [0, 2]].max(axis=-1))
        expected = [128 + f * point_c[0] / -point_c[2], 96 - f * point_c[1] / -point_c[2]]
        np.testing.assert_allclose([columns.mean() + 0.5, rows.mean() + 0.5], expected, atol=0.7)


def test_free_camera_equals_a_fixed_one(world):
    """MuJoCo's free camera at azimuth 90° and elevation −90° has x right and y up, like the camera `top`."""
    model, data = world
    renderer = make_renderer(model, W, H)
    free = FreeCamera((0, 0, 0), 3.0, np.pi / 2, -np.pi / 2, np.deg2rad(FOVY))
    np.testing.assert_allclose(renderer.depth(data, free), renderer.depth(data, "top"), rtol=1e-6)
    camera_id = model.camera("top").id
    np.testing.assert_array_equal(renderer.render(data, camera_id), renderer.render(data, "top"))


def test_intrinsics_of_a_camera_with_a_sensor():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><worldbody>
          <geom type="sphere" size="0.02" pos="0.3 0.2 0"/>
          <camera name="c" pos="0 0 2" resolution="64 48" sensorsize="0.006 0.0045" focal="0.005 0.004"
                  principal="0.0005 0.0003"/>
        </worldbody></mujoco>""")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rows, columns = np.nonzero(make_renderer(model, 640, 480).depth(data, "c"))
    # MuJoCo's principal point moves the picture left and down for positive values (checked against its rasteriser).
    u = 320 - 0.0005 / 0.006 * 640 + 0.005 / 0.006 * 640 * 0.3 / 2
    v = 240 - 0.0003 / 0.0045 * 480 - 0.004 / 0.0045 * 480 * 0.2 / 2
    np.testing.assert_allclose([columns.mean() + 0.5, rows.mean() + 0.5], [u, v], atol=0.3)


def pixel_of(image, point):
    """The pixel of camera `top` (H, W at 3 m over the origin) that sees the world point on the optical ray."""
    f = (H / 2) / np.tan(np.deg2rad(FOVY) / 2)
    depth = 3.0 - point[2]
    return image[int(H / 2 - f * point[1] / depth), int(W / 2 + f * point[0] / depth)].astype(int)


def test_colors_come_from_geom_then_material_and_follow_changes(world):
    model, data = world
    renderer = make_renderer(model, W, H)
    image = renderer.render(data, "top")
    assert image.shape == (H, W, 3) and image.dtype == np.uint8
    red, blue = pixel_of(image, (0.55, 0.02, 1.1)), pixel_of(image, (-0.6, 0, 0.5))
    assert red[0] > 2 * red[1:].max()
    assert blue[2] > 2 * blue[:2].max()
    model.geom_rgba[model.geom("block").id] = [0, 1, 0, 1]  # the geom's own colour hides its material's
    green = pixel_of(renderer.render(data, "top"), (-0.6, 0, 0.5))
    assert green[1] > 2 * green[[0, 2]].max()
    model.geom_rgba[model.geom("block").id] = [0.5, 0.5, 0.5, 1]
    np.testing.assert_array_equal(renderer.render(data, "top"), image)


def test_mocap_moves_show(world):
    model, data = world
    renderer = make_renderer(model, W, H)
    before = renderer.depth(data, "top")[H // 2, W // 2]
    data.mocap_pos[0] = [0, 0, 1.0]
    mujoco.mj_forward(model, data)
    after = renderer.depth(data, "top")[H // 2, W // 2]
    assert before == pytest.approx(3.0, rel=1e-3)
    assert after == pytest.approx(1.8, rel=1e-3)


def test_groups(world):
    model, data = world
    center = (H // 2, W // 2)
    assert make_renderer(model, W, H).depth(data, "top")[center] == pytest.approx(3.0, rel=1e-3)
    assert make_renderer(model, W, H, groups=(0, 4)).depth(data, "top")[center] == pytest.approx(1.3, rel=1e-3)


def test_shadow_lies_where_geometry_says():
    """Sun along (1, 0, −1): a ball of radius r at height h darkens the floor around x = h, over ±r in y."""
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><worldbody>
          <light type="directional" dir="1 0 -1"/>
          <geom type="plane" size="0 0 1" rgba="1 1 1 1"/>
          <geom type="sphere" size="0.2" pos="0 0 1" rgba="1 1 1 1"/>
          <camera name="top" pos="0 0 4" fovy="60"/>
        </worldbody></mujoco>""")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = make_renderer(model, 200, 200)
    image, depth = renderer.render(data, "top").astype(float), renderer.depth(data, "top")
    f = 100 / np.tan(np.deg2rad(30))
    columns, rows = np.meshgrid(np.arange(200) + 0.5, np.arange(200) + 0.5)
    x, y = (columns - 100) / f * 4, (100 - rows) / f * 4
    floor = np.abs(depth - 4) < 1e-3
    shadow = ((x - 1) / np.sqrt(2)) ** 2 + y**2  # squared distance of the floor point's sun ray from the centre
    inside, outside = floor & (shadow < 0.19**2), floor & (shadow > 0.21**2) & (np.hypot(x, y) < 2)
    assert inside.sum() > 50
    assert image[inside].max() < 0.75 * image[outside].min()
    assert np.ptp(image[inside], axis=0).max() <= 2  # ambient light alone, all over


def test_translucent_geoms_let_the_background_through_and_stay_in_the_model(world):
    model, data = world
    renderer = make_renderer(model, W, H)
    data.mocap_pos[0] = [-0.6, 0.0, 1.2]
    mujoco.mj_forward(model, data)
    ghost = model.geom("ghost").id
    model.geom_rgba[ghost] = [0, 1, 0, 0.4]
    before = model.geom_rgba.copy(), model.geom_matid.copy()
    mixed = pixel_of(renderer.render(data, "top"), (-0.6, 0, 0.5))
    np.testing.assert_array_equal(model.geom_rgba, before[0])
    np.testing.assert_array_equal(model.geom_matid, before[1])
    assert mixed[1] > 60 and mixed[2] > 60  # the ghost's green and the block's blue
    model.geom_rgba[ghost, 3] = 0.0
    gone = renderer.render(data, "top")
    data.mocap_pos[0] = [0, 0, -5]
    mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(gone, renderer.render(data, "top"))


def test_checker_floor():
    """texrepeat 1 with texuniform is one period in 2 m, as MuJoCo draws it: unit squares that alternate."""
    model = mujoco.MjModel.from_xml_string(SCENE.replace('name="floor"', 'name="floor" material="checker"'))
    model.geom_rgba[model.geom("floor").id] = 0.5, 0.5, 0.5, 1  # the default: the material's colour
    model.geom_pos[1:4, 2] -= 50
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    image = make_renderer(model, W, H).render(data, "top")
    bright = np.array([[pixel_of(image, (x, y, 0)).mean() for x in (-0.6, 0.6)] for y in (-0.6, 0.6)])
    assert bright[0, 0] == pytest.approx(bright[1, 1], abs=1) and bright[0, 1] == pytest.approx(bright[1, 0], abs=1)
    assert abs(bright[0, 0] - bright[0, 1]) > 150
    # Far away the squares are smaller than a pixel and must blend to one grey, without moiré.
    high = FreeCamera((0, 0, 0), 1000.0, 0.0, -np.pi / 2, 0.5)
    assert np.ptp(make_renderer(model, W, H).render(data, high).astype(int), axis=(0, 1)).max() <= 2


def test_supersampling_smooths_edges_but_not_colors(world):
    model, data = world
    once = make_renderer(model, W, H).render(data, "top").astype(int)
    smooth = make_renderer(model, W, H, samples=3).render(data, "top").astype(int)
    assert abs(pixel_of(once, (-0.6, 0, 0.5)) - pixel_of(smooth, (-0.6, 0, 0.5))).max() <= 2
    assert len(np.unique(smooth.reshape(-1, 3), axis=0)) > 1.2 * len(np.unique(once.reshape(-1, 3), axis=0))
    large = make_renderer(model, 3 * W, 3 * H).depth(data, "top")
    assert make_renderer(model, W, H, samples=3).depth(data, "top")[5, 5] == pytest.approx(large[16, 16])


def test_errors(world):
    model, data = world
    renderer = make_renderer(model, W, H)
    with pytest.raises(ValueError, match=r"ray, gl .*did you mean 'ray'.*got 'rays'"):
        make_renderer(model, W, H, backend="rays")
    for bad in ({"width": 0}, {"height": 1.5}, {"samples": 0}, {"width": True}, {"groups": (0, 9)}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            make_renderer(model, **bad)
    with pytest.raises(ValueError, match=r"'tip'.*'top', 'side'"):
        renderer.render(data, "tip")
    with pytest.raises(ValueError, match=r"\[0, 3\).*got 7"):
        renderer.depth(data, 7)
    with pytest.raises(ValueError, match="FreeCamera"):
        renderer.depth(data, 1.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="orthographic"):
        renderer.depth(data, "flat")
    other = mujoco.MjModel.from_xml_string("<mujoco/>")
    with pytest.raises(ValueError, match="data must belong"):
        renderer.render(mujoco.MjData(other), "top")
    wrong: list[tuple[str, Any]] = [("elevation", -20.0), ("fovy", 45.0), ("azimuth", 135.0)]  # in degrees
    for name, value in [*wrong, ("fovy", np.nan), ("distance", 0.0), ("distance", np.inf), ("lookat", (0, np.nan, 0))]:
        with pytest.raises(ValueError, match=name):
            FreeCamera(**{name: value})
    renderer.close()
    renderer.close()
    with pytest.raises(RuntimeError, match="closed"):
        renderer.render(data, "top")


def run(program, gl):
    environment = {**os.environ, "MUJOCO_GL": gl}
    return subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=120)


def test_rays_never_import_opengl():
    program = f"""
import sys, mujoco
from aerograsp_env.sim.rendering import make_renderer
model = mujoco.MjModel.from_xml_string('''{SCENE}''')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer = make_renderer(model, 32, 24)
renderer.render(data, "top"), renderer.depth(data, "top")
assert not [name for name in sys.modules if name.split(".")[0] in ("OpenGL", "glfw")], sys.modules
"""
    done = run(program, "disable")
    assert done.returncode == 0, done.stderr


COMPARE = f"""
import json, mujoco, numpy as np
from aerograsp_env.sim.rendering import FreeCamera, make_renderer
model = mujoco.MjModel.from_xml_string('''{SCENE}'''.replace('name="floor"', 'name="floor" material="checker"'))
model.geom_rgba[0] = 0.5, 0.5, 0.5, 1
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
gl, ray = make_renderer(model, 160, 120, "gl"), make_renderer(model, 160, 120)
result = []
try:
    for camera in ("top", "side", FreeCamera((0, 0, 0.5), 2.0, 0.7, -0.6, 0.9)):
        depths = [renderer.depth(data, camera) for renderer in (gl, ray)]
        images = [renderer.render(data, camera).astype(float).reshape(-1, 3) for renderer in (gl, ray)]
        near = [depth.ravel() for depth in depths]
        both = (near[0] > 0) & (near[1] > 0) & (near[1] < 10)
        correlation = np.corrcoef(images[0][both].ravel(), images[1][both].ravel())[0, 1]
        result.append([float(np.median(np.abs(near[0] - near[1])[both])), float(both.mean()), float(correlation)])
    fovy = float(model.vis.global_.fovy)
    gl.close()
except RuntimeError as error:
    print(json.dumps({{"error": str(error)}}))
else:
    print(json.dumps({{"result": result, "fovy": fovy}}))
"""


def test_opengl_agrees_or_says_what_to_install():
    # Without libEGL MuJoCo cannot even be imported under MUJOCO_GL=egl; with no setting it always can.
    attempts = [run(COMPARE, gl) for gl in ("egl", "")]
    done = next((attempt for attempt in attempts if attempt.returncode == 0), attempts[-1])
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout.splitlines()[-1])
    if "error" in answer:
        assert_names_the_remedy(answer["error"])
        return
    assert answer["fovy"] == 45.0  # the free camera's own field of view leaves the model as it was
    for error, seen, correlation in answer["result"]:
        assert error <= 1e-3  # [m]
        assert seen > 0.5
        assert correlation > 0.9


def test_opengl_switched_off_says_what_to_install():
    done = run(COMPARE, "disable")
    assert done.returncode == 0, done.stderr
    error = json.loads(done.stdout.splitlines()[-1])["error"]
    assert "MUJOCO_GL='disable'" in error
    assert_names_the_remedy(error)


def assert_names_the_remedy(error):
    for part in ("libegl1", "MUJOCO_GL=egl", "libosmesa6", "backend='ray'"):
        assert part in error
