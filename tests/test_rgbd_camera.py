"""The simulated RGB-D camera: its geometry is MuJoCo's, and its faults follow their laws."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.sim.cameras import camera_view, pose_view, view_pose
from aerograsp_env.sim.depth_noise import DepthNoiseConfig, noisy_depth
from aerograsp_env.sim.image_noise import ImageNoiseConfig, motion_blur, noisy_image
from aerograsp_env.sim.rgbd_camera import RGBDCameraConfig, SimulatedCamera, stereo_pair
from aerograsp_env.sim.shading import LINEAR_OF_BYTE
from aerograsp_env.spatial import CAMERA_FROM_MUJOCO, inverse, transform, transform_points

W, H, FOVY = 64, 48, 0.9
SCENE = f"""
<mujoco>
  <worldbody>
    <light type="directional" dir="-.4 .5 -.8"/>
    <geom name="floor" type="plane" size="0 0 1" rgba=".8 .8 .8 1"/>
    <geom name="ball" type="sphere" size=".2" pos=".1 .2 .4" rgba=".9 .1 .1 1"/>
    <geom name="block" type="box" size=".2 .3 .25" pos="-.5 0 .25" euler="10 20 30" rgba=".1 .2 .9 1"/>
    <site name="s0" pos=".1 .2 .3"/><site name="s1" pos="-.2 .4 .1"/><site name="s2" pos=".4 -.3 .6"/>
    <camera name="c" pos=".3 -2 1.2" xyaxes="1 .1 .05 -.1 .5 .9" fovy="{np.rad2deg(FOVY)}" resolution="{W} {H}"/>
  </worldbody>
  <sensor>{"".join(f'<camprojection site="s{i}" camera="c"/>' for i in range(3))}</sensor>
</mujoco>
"""


@pytest.fixture(scope="module")
def world():
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def pose_of_camera(data) -> np.ndarray:
    return transform(data.cam_xmat[0].reshape(3, 3), data.cam_xpos[0]) @ CAMERA_FROM_MUJOCO


def random_pose(rng: np.random.Generator) -> np.ndarray:
    """Somewhere around the scene, rolled, looking towards its middle."""
    position = rng.normal(size=3)
    position = 2.0 * position / np.linalg.norm(position)
    position[2] = abs(position[2]) + 0.3
    z = -position / np.linalg.norm(position)
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    return transform(np.column_stack([x, np.cross(z, x), z]), position)


# --- D, T and K -------------------------------------------------------------------------------------------------------


def test_a_point_projects_where_mujocos_sensor_says(world):
    """MuJoCo counts pixels from the image's corner, these intrinsics from the first pixel's centre: half a pixel."""
    _, data = world
    K = RGBDCameraConfig(W, H, FOVY).intrinsics.matrix
    for i in range(3):
        x, y, z = K @ transform_points(inverse(pose_of_camera(data)), data.site_xpos[i])
        expected = data.sensordata[2 * i : 2 * i + 2]
        np.testing.assert_allclose([x / z + 0.5, y / z + 0.5], expected, atol=1e-6 * W)


@pytest.mark.parametrize("seed", range(4))
def test_depth_along_each_pixels_ray_is_mujocos(world, seed):
    model, data = world
    rng = np.random.default_rng(seed)
    camera, T = SimulatedCamera(model, RGBDCameraConfig.ideal(W, H, FOVY)), random_pose(rng)
    seen = camera.capture(data, T)
    geom = np.empty(1, np.int32)
    for u, v in zip(rng.integers(0, W, 60), rng.integers(0, H, 60), strict=True):
        ray = T[:3, :3] @ np.linalg.solve(camera.intrinsics.matrix, [u, v, 1.0])  # of length 1 along the optical axis
        depth = mujoco.mj_ray(model, data, T[:3, 3], ray, None, True, -1, geom)
        assert seen.segmentation[v, u] == geom[0]
        assert seen.clean_depth[v, u] == pytest.approx(max(depth, 0.0), rel=1e-6)


def test_a_pose_taken_from_a_camera_of_the_model_gives_its_picture(world):
    model, data = world
    T, view = pose_of_camera(data), camera_view(model, data, "c", W, H)
    np.testing.assert_allclose(view_pose(view), T, atol=1e-12)
    other = pose_view(T, RGBDCameraConfig(W, H, FOVY).intrinsics)
    for a, b in zip(view, other, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)
    ideal = SimulatedCamera(model, RGBDCameraConfig.ideal(W, H, FOVY)).capture(data, T, stamp=3.5)
    np.testing.assert_allclose(ideal.frame.T_world_camera, T)
    assert ideal.frame.stamp == 3.5 and ideal.backend == "ray"
    np.testing.assert_array_equal(ideal.frame.depth, ideal.clean_depth)


def test_stereo_disparity_is_focal_length_times_baseline_over_depth(world):
    model, data = world
    config = RGBDCameraConfig.ideal(320, 240)
    camera, baseline = SimulatedCamera(model, config), 0.1
    T = transform(Rotation.from_euler("x", np.pi).as_matrix(), [0.1, 0.2, 1.5])  # straight down, onto the ball
    left, right = stereo_pair(camera, data, T, baseline)

    def middle(rgb) -> float:
        red = (rgb[..., 0] > 2.0 * rgb[..., 1]) & (rgb[..., 0] > 60)
        return float(np.nonzero(red)[1].mean())

    depth = float(left.depth[120, 160])
    expected = config.intrinsics.fx * baseline / (1.5 - 0.4)  # of the ball's outline: between its top and its equator
    assert depth == pytest.approx(0.9, abs=1e-3)
    assert middle(left.rgb) - middle(right) == pytest.approx(expected, rel=0.04)


# --- the sensor's faults ----------------------------------------------------------------------------------------------

K = Intrinsics(200, 150, 180.0, 180.0, 99.5, 74.5)


def wall(z: float) -> np.ndarray:
    return np.full((150, 200), z, np.float32)


@pytest.mark.parametrize("z", [0.5, 1.0, 2.0, 4.0])
def test_depths_sigma_is_quadratic(z):
    config = DepthNoiseConfig(quantum=0.0, lost=0.0)
    seen = noisy_depth(wall(z), K, config, np.random.default_rng(0))
    assert seen.dtype == np.float32
    inside = seen[:, :150]  # right of it, the second eye sees nothing of the wall at 0.5 m
    inside = inside[inside > 0]
    assert inside.mean() == pytest.approx(z, rel=2e-3)
    assert inside.std() == pytest.approx(1.425e-3 * z**2, rel=0.05)


@pytest.mark.parametrize("z", [0.7, 1.9, 3.1])
def test_depth_comes_in_steps_of_disparity(z):
    seen = noisy_depth(wall(z), K, DepthNoiseConfig(), np.random.default_rng(0))
    inverse_depth = np.unique(1.0 / seen[seen > 0].astype(float))
    steps = inverse_depth / 2.85e-3
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-3)
    assert np.diff(np.unique(np.rint(steps))).min() == 1.0  # neighbouring steps: 2.85 mm · z² apart
    assert len(steps) >= 3


def test_no_faults_leave_depth_as_it_is():
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 5.0, (150, 200)).astype(np.float32)
    depth[::7] = 0.0
    np.testing.assert_allclose(noisy_depth(depth, K, DepthNoiseConfig.none(), rng), depth, rtol=1e-6)


@pytest.mark.parametrize(("baseline", "side"), [(0.075, "left"), (-0.075, "right")])
def test_the_second_eyes_shadow_is_as_wide_as_the_disparities_differ(baseline, side):
    """A near strip at z₁ before a wall at z₂ hides f b (1/z₁ − 1/z₂) pixels of it, on the side away from the eye."""
    depth = wall(2.0)
    depth[:, 80:120] = 0.8
    config = DepthNoiseConfig(0.0, 0.0, 0.0, baseline, 1.5, np.pi, 0.0)
    seen = noisy_depth(depth, K, config, np.random.default_rng(0))
    lost = np.flatnonzero(seen[75] == 0.0)
    width = 180.0 * 0.075 * (1 / 0.8 - 1 / 2.0)
    assert abs(len(lost) - width) <= 1.0
    assert (lost < 80).all() if side == "left" else (lost >= 120).all()


def test_slanted_surfaces_get_lost_from_the_start_to_the_limit_of_grazing():
    """A floor seen from 1 m above: the angle to its normal has the tangent of distance over height."""
    rows = np.arange(150)
    down = (rows - 20.0) / K.fy
    depth = np.where(down > 0, 1.0 / np.maximum(down, 1e-6), 0.0)[:, None].repeat(200, 1).astype(np.float32)
    depth[depth > 50] = 0.0
    tilted = K._replace(cy=20.0)
    config = DepthNoiseConfig(0.0, 0.0, 0.0, 0.0, np.radians(60), np.radians(80), 0.0)
    seen = noisy_depth(depth, tilted, config, np.random.default_rng(0)) > 0
    column = 99
    angle = np.array([np.arctan(np.hypot(depth[v, column], 0.0)) if depth[v, column] else np.nan for v in rows])
    share = seen[:, 60:140].mean(axis=1)
    for v in rows[30:140]:
        expected = np.clip((np.radians(80) - angle[v]) / np.radians(20), 0.0, 1.0)
        assert share[v] == pytest.approx(expected, abs=0.2)


def test_edges_flicker_between_the_two_surfaces():
    depth = wall(1.0)
    depth[:, 100:] = 2.0
    config = DepthNoiseConfig(0.0, 0.0, 0.5, 0.0, 1.5, np.pi, 0.0)
    seen = noisy_depth(depth, K, config, np.random.default_rng(0))
    assert set(np.unique(seen)) == {np.float32(1.0), np.float32(2.0)}
    wrong = (seen != depth).mean(axis=0)
    assert 0.05 < wrong[99] < 0.4 and 0.05 < wrong[100] < 0.4  # P(N(0, ½) > ½) is 0.16
    assert wrong[:96].max() == 0.0 == wrong[104:].max()


def test_shot_noise_is_the_square_root_of_what_was_counted():
    config = ImageNoiseConfig(0.0, 0.0, (1.0, 1.0), 0.0, 0.0, full_well=2000.0, read_noise=0.0)
    for value in (60, 120, 200):
        image = np.full((150, 200, 3), value, np.uint8)
        light = LINEAR_OF_BYTE[noisy_image(image, config, np.random.default_rng(0))]
        mean = LINEAR_OF_BYTE[value]
        assert light.mean() == pytest.approx(mean, rel=0.01)
        assert light.std() == pytest.approx(np.sqrt(mean / 2000.0), rel=0.05)


def test_the_gain_brightens_dark_pictures_and_their_noise():
    config = ImageNoiseConfig(exposure_sigma=0.0, white_balance_sigma=0.0)
    dark = np.full((150, 200, 3), 50, np.uint8)
    light = LINEAR_OF_BYTE[noisy_image(dark, config, np.random.default_rng(0))]
    assert light.mean() == pytest.approx(config.target, rel=0.03)
    gain = config.target / LINEAR_OF_BYTE[50]
    variance = LINEAR_OF_BYTE[50] / 6000.0 + (8.0 / 6000.0) ** 2
    assert light.std() == pytest.approx(gain * np.sqrt(variance), rel=0.05)
    black = noisy_image(np.zeros((150, 200, 3), np.uint8), config, np.random.default_rng(0))
    assert black.mean() < 40  # the gain ends


def test_no_faults_leave_the_picture_as_it_is():
    image = np.random.default_rng(1).integers(0, 256, (150, 200, 3), dtype=np.uint8)
    seen = noisy_image(image, ImageNoiseConfig.none(), np.random.default_rng(0))
    assert np.abs(seen.astype(int) - image).max() <= 1
    np.testing.assert_array_equal(motion_blur(image, wall(1.0), K, np.zeros(6), 0.1), image)


@pytest.mark.parametrize(
    ("twist", "axis", "length"),
    [((0.5, 0, 0, 0, 0, 0), 1, 180 * 0.5 * 0.04), ((0, 0.5, 0, 0, 0, 0), 0, 180 * 0.5 * 0.04),
     ((0, 0, 0, 0, 0.8, 0), 1, 180 * 0.8 * 0.04), ((0, 0, 0, 0.8, 0, 0), 0, 180 * 0.8 * 0.04)],
)  # fmt: skip
def test_a_point_blurs_to_a_line_of_the_length_that_it_moves(twist, axis, length):
    """At the middle of the picture, 1 m away: f v t pixels sideways, f ω t when turning."""
    image = np.zeros((150, 200, 3), np.uint8)
    image[74:76, 99:101] = 255
    seen = LINEAR_OF_BYTE[motion_blur(image, wall(1.0), K, twist, 0.04)][..., 0]
    assert seen.sum() == pytest.approx(4.0, rel=0.05)  # light is kept
    profile = seen.sum(axis=1 - axis)
    lit = np.flatnonzero(profile > 0.05 * profile.max())
    assert lit[-1] - lit[0] + 1 == pytest.approx(length + 2, abs=1.5)
    assert len(np.flatnonzero(seen.sum(axis=axis) > 1e-3)) == 2


def test_what_is_near_blurs_more_than_what_is_far_and_turning_blurs_alike():
    depth = wall(1.0)
    depth[:, :100] = 4.0
    stripes = np.zeros((150, 200, 3), np.uint8)
    stripes[:, ::8] = 255

    def contrast(image, columns) -> float:
        return float(LINEAR_OF_BYTE[image[75, columns, 0]].std())

    far, near = slice(30, 78), slice(120, 168)
    moved = motion_blur(stripes, depth, K, (0.6, 0, 0, 0, 0, 0), 0.04)
    assert contrast(moved, far) > 1.5 * contrast(moved, near)
    turned = motion_blur(stripes, depth, K, (0, 0, 0, 0, 0.3, 0), 0.04)
    assert contrast(turned, far) == pytest.approx(contrast(turned, near), rel=0.25)


def test_captures_repeat_with_their_seed_and_keep_to_the_range(world):
    model, data = world
    camera, T = SimulatedCamera(model, RGBDCameraConfig(W, H, min_depth=1.5, max_depth=2.5)), pose_of_camera(data)
    twist = (0.3, 0.1, 0, 0, 0.5, 0.2)
    a, b, c = (camera.capture(data, T, np.random.default_rng(s), twist_c=twist).frame for s in (1, 1, 2))
    np.testing.assert_array_equal(a.rgb, b.rgb)
    np.testing.assert_array_equal(a.depth, b.depth)
    assert (a.rgb != c.rgb).any() and (a.depth != c.depth).any()
    quiet = camera.capture(data, T)
    assert (quiet.clean_depth < 1.5).any() and (quiet.clean_depth > 2.5).any()
    for depth in (a.depth, quiet.frame.depth):
        assert ((depth == 0) | ((depth >= 1.5) & (depth <= 2.5))).all()
    seen = (quiet.frame.depth > 0) & (a.depth > 0)
    assert np.median(np.abs(a.depth - quiet.clean_depth)[seen]) < 0.01
    camera.close()
    with pytest.raises(RuntimeError, match="closed"):
        camera.capture(data, T)


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: RGBDCameraConfig(fovy=50.0), "fovy"),
        (lambda: RGBDCameraConfig(width=0), "width"),
        (lambda: RGBDCameraConfig(backend="rays"), "backend.*did you mean 'ray'"),
        (lambda: RGBDCameraConfig(min_depth=3.0, max_depth=2.0), "min_depth"),
        (lambda: DepthNoiseConfig(sigma=1.5), "sigma"),
        (lambda: DepthNoiseConfig(grazing_start=70.0), "grazing_start"),
        (lambda: ImageNoiseConfig(gain_range=(2.0, 1.0)), "gain_range"),
        (lambda: ImageNoiseConfig(full_well=0.0), "full_well"),
        (lambda: ImageNoiseConfig(exposure_time=float("nan")), "exposure_time"),
        (lambda: noisy_depth(wall(1.0)[:10], K, DepthNoiseConfig(), np.random.default_rng(0)), "depth"),
        (lambda: motion_blur(np.zeros((150, 200, 3), np.uint8), wall(1.0), K, (1, 2, 3), 0.1), "twist_c"),
        (lambda: motion_blur(np.zeros((150, 200), np.uint8), wall(1.0), K, np.zeros(6), 0.1), "rgb, depth"),
        (lambda: motion_blur(np.zeros((150, 200, 3), np.uint8), wall(1.0), K, np.zeros(6), -1.0), "exposure_time"),
        (lambda: pose_view(np.diag([1.0, 1.0, -1.0, 1.0]), K), "T_world_camera"),
        (lambda: pose_view(np.eye(3), K), "T_world_camera"),
        (lambda: pose_view(np.eye(4)[None], K), "T_world_camera"),
        (lambda: pose_view(np.eye(4), K._replace(distortion=[0.1, 0, 0, 0])), "distortion"),
    ],
)
def test_bad_input_is_named(make, name):
    with pytest.raises(ValueError, match=name):
        make()


def test_captures_refuse_what_is_not_rigid_or_of_another_model(world):
    model, data = world
    camera = SimulatedCamera(model, RGBDCameraConfig(W, H))
    with pytest.raises(ValueError, match="T_world_camera"):
        camera.capture(data, 2.0 * np.eye(4))
    with pytest.raises(ValueError, match="T_world_camera"):
        camera.capture(data, np.full((4, 4), np.nan))
    with pytest.raises(ValueError, match="twist_c"):
        camera.capture(data, np.eye(4), np.random.default_rng(0), twist_c=(0, 0, 0))
    with pytest.raises(ValueError, match="data must belong"):
        camera.capture(mujoco.MjData(mujoco.MjModel.from_xml_string("<mujoco/>")), np.eye(4))
    with pytest.raises(ValueError, match="baseline"):
        stereo_pair(camera, data, np.eye(4), 0.0)
    with pytest.raises(ValueError, match="groups"):
        SimulatedCamera(model, groups=(7,))


# --- OpenGL -----------------------------------------------------------------------------------------------------------


def run(program: str, gl: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "MUJOCO_GL": gl}
    return subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=300)


COMPARE = f"""
import json
import mujoco, numpy as np
from aerograsp_env.sim.gl_probe import gl_fault
from aerograsp_env.sim.rgbd_camera import RGBDCameraConfig, SimulatedCamera
fault = gl_fault()
if fault is not None:
    print(json.dumps(fault))
    raise SystemExit
from dataclasses import replace
from aerograsp_env.spatial import CAMERA_FROM_MUJOCO, transform
model = mujoco.MjModel.from_xml_string('''{SCENE}''')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
T = transform(data.cam_xmat[0].reshape(3, 3), data.cam_xpos[0]) @ CAMERA_FROM_MUJOCO
turn = transform([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [0.1, 0.0, 0.2])
ray = RGBDCameraConfig.ideal(160, 120, 0.8)
cameras = [SimulatedCamera(model, replace(ray, backend=backend)) for backend in ("ray", "gl")]
found = []
for pose in (T, T @ turn):
    a, b = (camera.capture(data, pose) for camera in cameras)
    assert (a.backend, b.backend) == ("ray", "gl")
    both = (a.clean_depth > 0) & (b.clean_depth > 0) & (a.clean_depth < 10)
    error = float(np.median(np.abs(a.clean_depth - b.clean_depth)[both]))
    colors = np.corrcoef(a.frame.rgb[both].ravel().astype(float), b.frame.rgb[both].ravel().astype(float))[0, 1]
    found.append([error, float(both.mean()), float((a.segmentation == b.segmentation)[both].mean()), float(colors)])
print(json.dumps(found))
"""


def test_opengl_draws_the_same():
    done = run(COMPARE, "egl")
    if done.returncode != 0:  # without libEGL MuJoCo cannot even be imported
        pytest.skip(f"OpenGL (EGL) does not work here: {done.stderr.splitlines()[-1]}")
    found = json.loads(done.stdout.splitlines()[-1])
    if isinstance(found, str):
        pytest.skip(f"OpenGL (EGL) does not work here: {found}")
    for error, seen, same, colors in found:
        assert error <= 1e-3  # [m]
        assert seen > 0.5 and same > 0.995 and colors > 0.85


def test_opengl_that_does_not_work_is_one_clear_error_and_rays_need_none():
    program = f"""
import sys, mujoco, numpy as np
from aerograsp_env.sim.rgbd_camera import RGBDCameraConfig, SimulatedCamera
model = mujoco.MjModel.from_xml_string('''{SCENE}''')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
SimulatedCamera(model).capture(data, np.eye(4), np.random.default_rng(0))
assert not [name for name in sys.modules if name.split(".")[0] in ("OpenGL", "glfw")]
try:
    SimulatedCamera(model, RGBDCameraConfig(backend="gl"))
except RuntimeError as error:
    assert "libegl1" in str(error) and "backend='ray'" in str(error) and "\\n" not in str(error), error
else:
    raise AssertionError("no error")
"""
    done = run(program, "disable")
    assert done.returncode == 0, done.stderr
