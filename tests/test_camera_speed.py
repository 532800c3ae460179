"""The comparison of frames with bare casts: what it measures is what it says."""

from __future__ import annotations

import mujoco
import numpy as np

from agents.camera_speed import GEOMS, SIZES, Row, measure, scene, table
from agents.detect_speed import policy_speed
from agents.detect_speed import table as speeds


def test_the_scene_has_forty_geoms_and_two_meshes_of_five_thousand_faces() -> None:
    model, _ = scene()
    assert model.ngeom == GEOMS == 40
    meshes = model.geom_dataid[model.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH)]
    assert len(meshes) == 2 and (model.mesh_facenum[meshes] == 5120).all()
    assert model.ntex == 1 and model.nlight == 1


def test_each_size_is_measured_and_shown() -> None:
    rows, fault = measure(repeats=1, sizes=(16, 32))
    assert [row.size for row in rows] == [16, 32] and SIZES[0] == 64
    assert all(row.cast_seconds > 0.0 and row.frame_seconds > 0.0 and row.ratio > 0.0 for row in rows)
    assert all((row.gl_ratio is None) == (fault is not None) for row in rows)
    text = table([Row(64, 1e-3, 2e-3, 3e-3, 2.0, None, None)], "no EGL")
    assert "64×64" in text and "2.00" in text and "no EGL" in text
    assert np.isfinite([row.noisy_seconds for row in rows]).all()


def test_the_frames_of_a_policy_are_timed() -> None:
    row = policy_speed("clusters+icp", flights=1, frames=2)
    assert row.frames == 4 and row.mean_seconds > 0.0 and row.late_seconds > 0.0
    text = speeds([row._replace(mean_seconds=0.05, late_seconds=0.1)])
    assert "50.0" in text and "100.0" in text and "20.0" in text and "clusters+icp" in text
