"""Looks change nothing but pictures."""

import mujoco
import numpy as np
import pytest

from aerograsp_env.sim.airframe import AIRFRAMES
from aerograsp_env.sim.config import DockConfig
from aerograsp_env.sim.scene import JOINT_NAMES, build_model
from aerograsp_env.sim.scene_look import CAMERAS, camera_heading
from aerograsp_env.sim.scene_view import SceneView, joint_qualities, quality_color


@pytest.mark.parametrize("airframe", AIRFRAMES.values(), ids=AIRFRAMES)
def test_looks_leave_the_physics_alone(airframe):
    tool = DockConfig().tool
    bare, full = build_model(airframe, tool), build_model(airframe, tool, look=True)
    assert full.ngeom > bare.ngeom
    for name in (
        "body_mass",
        "body_inertia",
        "body_ipos",
        "body_iquat",
        "body_pos",
        "dof_damping",
        "jnt_stiffness",
        "qpos0",
    ):
        np.testing.assert_allclose(getattr(full, name), getattr(bare, name), rtol=1e-12, atol=1e-15, err_msg=name)
    solid = [int(((m.geom_contype != 0) | (m.geom_conaffinity != 0)).sum()) for m in (bare, full)]
    assert solid[0] == solid[1] == bare.ngeom
    ends = []
    for model in (bare, full):
        data = mujoco.MjData(model)
        data.ctrl[:] = 1.05 * 9.81 * model.body_mass.sum() / 6
        mujoco.mj_step(model, data, nstep=200)
        ends.append(data.qpos.copy())
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def test_total_tool_mass_is_the_thesis_150_g():
    model = build_model(DockConfig().airframe, DockConfig().tool)
    names = ("tool_tip", "tool_link3", "tool_link2", "tool_link1", "tool_riser", "tool_base")
    assert sum(model.body(name).mass[0] for name in names) == pytest.approx(0.150)


@pytest.mark.parametrize("camera", CAMERAS)
def test_every_camera_sees_the_tool(camera):
    config = DockConfig()
    model = build_model(config.airframe, config.tool)
    data = mujoco.MjData(model)
    data.qpos[:3] = [-0.57, -0.2, 3.335]
    data.qpos[8:13] = [0, -0.4, 1.9, 0.1, 0]  # θ4 … θ0, about the docked pose
    mujoco.mj_forward(model, data)
    before = data.qpos.copy()
    view = SceneView(config, 120, 90, camera)
    image = view.draw(data, "rgb_array")
    depth = view.draw(data, "depth_array")
    assert image is not None and image.shape == (90, 120, 3) and depth is not None and depth.shape == (90, 120)
    yellow = (image[..., 0] > 150) & (image[..., 1] > 100) & (image[..., 2] < 90)
    assert yellow.sum() >= 10  # clamp and front propellers
    np.testing.assert_array_equal(data.qpos, before)
    forward = -view._model.camera(camera).mat0.reshape(3, 3)[:, 2]
    assert np.arctan2(forward[1], forward[0]) == pytest.approx(camera_heading(camera), abs=1e-6)
    view.close()


def test_joint_colors_follow_the_distance_to_saturation():
    config = DockConfig()
    center, half = np.asarray(config.tool.centers), 0.5 * config.tool.signal_range
    np.testing.assert_allclose(joint_qualities(config, center), 1.0)
    np.testing.assert_allclose(joint_qualities(config, center + half), 0.0, atol=1e-12)
    np.testing.assert_allclose(joint_qualities(config, center - 0.5 * half), 0.5)
    assert len(JOINT_NAMES) == 5
    red, amber, green = quality_color(0.0), quality_color(0.5), quality_color(1.0)
    assert red[0] > 2 * red[1] and green[1] > 2 * green[0] and min(amber[0], amber[1]) > 2 * amber[2]
