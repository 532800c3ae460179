"""Protocols and frozen values: what they accept, what they refuse, and that they cannot be changed."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from aerograsp_env.interfaces import RGBD, Detection, Detector, Grasp, Intrinsics, Policy

CAMERA = Intrinsics(width=8, height=6, fx=10.0, fy=11.0, cx=3.5, cy=2.5)


class Still:
    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        return np.zeros(3), state


class Blind:
    def detect(self, frame: RGBD) -> list[Detection]:
        return []


def test_protocols_are_checked_at_run_time() -> None:
    policy: Policy = Still()  # mypy checks the signatures here
    detector: Detector = Blind()
    assert isinstance(policy, Policy)
    assert isinstance(detector, Detector)
    assert not isinstance(detector, Policy)
    assert not isinstance(lambda observation: observation, Policy)


def test_stable_baselines_signature() -> None:
    """Argument names and order of Stable-Baselines3's predict, which its `evaluate_policy` relies on."""
    names = Policy.predict.__code__.co_varnames[: Policy.predict.__code__.co_argcount]
    assert names == ("self", "observation", "state", "episode_start", "deterministic")


# --- intrinsics --------------------------------------------------------------


def test_intrinsics_project_and_are_a_tuple() -> None:
    u, v, w = CAMERA.matrix @ [0.2, -0.1, 2.0]
    assert (u / w, v / w) == pytest.approx((3.5 + 10 * 0.1, 2.5 - 11 * 0.05))
    assert tuple(CAMERA) == (8, 6, 10.0, 11.0, 3.5, 2.5, None, None)
    assert isinstance(CAMERA, tuple)
    assert CAMERA._replace(fx=12.0).fx == 12.0
    assert isinstance(CAMERA._replace(fx=12.0), Intrinsics)
    with pytest.raises(AttributeError):
        CAMERA.fx = 1.0  # type: ignore[misc]


def test_intrinsics_arrays_are_read_only_copies() -> None:
    distortion, T = np.zeros(5), np.eye(4)
    camera = CAMERA._replace(distortion=distortion, T_color_depth=T)
    distortion[0] = T[0, 3] = 9.0
    assert camera.distortion is not None and camera.T_color_depth is not None
    assert camera.distortion[0] == 0.0 and camera.T_color_depth[0, 3] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        camera.T_color_depth[0, 3] = 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, "width: expected a positive whole number of pixels, got 0"),
        ({"height": 6.5}, "height: expected a positive whole number"),
        ({"fx": -1.0}, "fx: expected a positive focal length"),
        ({"fy": math.nan}, "fy: expected a positive focal length"),
        ({"cx": math.inf}, "cx: expected a finite coordinate"),
        ({"distortion": [0.1, 0.2]}, "distortion: expected 4, 5, 8, 12 or 14 coefficients, got 2"),
        ({"T_color_depth": np.diag([1, 1, -1, 1])}, "T_color_depth: expected det"),
        ({"T_color_depth": np.eye(3)}, r"T_color_depth: expected shape \(..., 4, 4\)"),
    ],
)
def test_bad_intrinsics(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Intrinsics(**{**CAMERA._asdict(), **change})
    with pytest.raises(ValueError, match=message):
        CAMERA._replace(**change)


# --- values ------------------------------------------------------------------

FRAME: dict[str, Any] = {
    "rgb": np.zeros((6, 8, 3), np.uint8),
    "depth": np.ones((6, 8), np.float32),
    "intrinsics": CAMERA,
}
DETECTION: dict[str, Any] = {
    "label": "wrench",
    "score": 0.9,
    "box": [1.0, 2.0, 3.0, 5.0],
    "T_c_object": np.eye(4),
    "covariance": 1e-4 * np.eye(6),
}
GRASP: dict[str, Any] = {"center": [0, 0, 0.5], "closing_axis": [1, 0, 0], "approach_axis": [0, 0, -1], "width": 0.06}


def test_good_values_are_kept() -> None:
    frame = RGBD(**FRAME, stamp=1.5, T_world_camera=np.eye(4))
    assert frame.rgb is FRAME["rgb"] and frame.stamp == 1.5
    assert RGBD(**FRAME).T_world_camera is None
    detection = Detection(**DETECTION)
    np.testing.assert_array_equal(detection.box, [1, 2, 3, 5])
    assert Detection("wrench", 1, [0, 0, 1, 1]).covariance is None  # type: ignore[arg-type]
    grasp = Grasp(**GRASP)
    assert grasp.center.dtype == np.float64


@pytest.mark.parametrize(("kind", "fields"), [(RGBD, FRAME), (Detection, DETECTION), (Grasp, GRASP)])
def test_values_are_frozen(kind: Any, fields: dict[str, Any]) -> None:
    value = kind(**fields)
    name = next(iter(fields))
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(value, name, fields[name])
    assert value == value and value != kind(**fields)  # identity: arrays have no single truth value
    for field in ("box", "T_c_object", "center"):
        if hasattr(value, field):
            with pytest.raises(ValueError, match="read-only"):
                getattr(value, field)[0] = 1.0


def test_values_do_not_alias_their_arguments() -> None:
    center = np.array([0, 0, 0.5])
    grasp = Grasp(**{**GRASP, "center": center})
    center[0] = 1.0
    assert grasp.center[0] == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rgb": np.zeros((6, 8), np.uint8)}, r"rgb: expected an array of \(6, 8, 3\) uint8, got \(6, 8\) uint8"),
        ({"rgb": np.zeros((6, 8, 3))}, r"rgb: expected .* uint8, got \(6, 8, 3\) float64"),
        ({"rgb": None}, "rgb: expected .* got NoneType"),
        ({"depth": np.ones((6, 8))}, r"depth: expected an array of \(6, 8\) float32, got \(6, 8\) float64"),
        ({"depth": np.ones((8, 6), np.float32)}, "depth: expected an array"),
        ({"depth": np.full((6, 8), np.nan, np.float32)}, "depth: expected finite values ≥ 0"),
        ({"depth": np.full((6, 8), -1, np.float32)}, "depth: expected finite values ≥ 0"),
        ({"intrinsics": tuple(CAMERA)}, "intrinsics: expected Intrinsics, got tuple"),
        ({"stamp": math.nan}, "stamp: expected a finite time"),
        ({"T_world_camera": 2 * np.eye(4)}, "T_world_camera: expected a last row"),
        ({"T_world_camera": np.eye(4)[None]}, r"T_world_camera: expected shape \(4, 4\), got \(1, 4, 4\)"),
    ],
)
def test_bad_frames(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RGBD(**{**FRAME, **change})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"label": ""}, "label: expected the name of a class"),
        ({"score": 1.1}, r"score: expected a value in \[0, 1\], got 1.1"),
        ({"score": math.nan}, "score: expected"),
        ({"box": [1, 2, 1, 5]}, "box: expected x1 < x2 and y1 < y2, got"),
        ({"box": [1, 2, 3]}, r"box: expected shape \(..., 4\), got \(3,\)"),
        ({"T_c_object": np.diag([1, 1, -1, 1])}, "T_c_object: expected det"),
        ({"covariance": np.eye(3)}, "covariance: expected shape"),
        ({"covariance": np.eye(6) + np.eye(6, k=1)}, "covariance: expected a symmetric"),
        ({"covariance": -np.eye(6)}, "covariance: expected no negative eigenvalue, got -1"),
    ],
)
def test_bad_detections(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Detection(**{**DETECTION, **change})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"center": [0, 0, math.nan]}, "center: expected finite"),
        ({"closing_axis": [2, 0, 0]}, "closing_axis: expected a unit vector, got length 2"),
        ({"approach_axis": [0, 0, 0]}, "approach_axis: expected a unit vector, got length 0"),
        (
            {"approach_axis": [0.6, 0, 0.8]},
            "approach_axis: expected an axis orthogonal to closing_axis, got cosine 0.6",
        ),
        ({"width": 0.0}, r"width: expected a positive opening \[m\], got 0.0"),
    ],
)
def test_bad_grasps(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Grasp(**{**GRASP, **change})
