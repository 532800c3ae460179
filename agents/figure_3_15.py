"""Thesis figure 3.15: a feature model keeps the pose of an object of which half is hidden.

`aerograsp reproduce figure-3.15 [--out PNG] [--json FILE]`
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import RGBD
from aerograsp_env.metrics import rotation_error, translation_error
from aerograsp_env.sim.rgbd_camera import RGBDCameraConfig
from aerograsp_env.sim.visual.viewpoints import look_at
from agents.feature_scenes import CAMERA, FeatureScene, frame, orbit, stereo_sequence
from agents.feature_scenes import SIZE as CARTON_SIZE
from agents.pictures import figure_grid, png
from agents.reproduction import Reproduction, Request, text_table
from agents.seeds import TRAIN_SEED
from agents.statistics import bootstrap_interval, mean
from baselines.detection.feature_learning import LearnedModel, learn_from_stereo
from baselines.detection.feature_model import FeatureModel
from baselines.detection.projection import project

FRAMES, VIEWS = 60, 40
WITHIN = 0.02  # [m]
HIDDEN = 0.5  # of the object's visible pixels
FEATURE = "sift"
CARTON = 1  # the object's seed

NOTES = """\
{frames} noisy frames of a camera that passes a printed carton at 0.45 to 0.75 m, turning {degrees:.0f}° about it; a
board hides half of the carton's pixels ({low:.0%} to {high:.0%}, counted), its edge turning. The model has {points}
points from {views} stereo pairs in other surroundings. "Alone": each frame by itself; "following": the last pose found
is tried too. Found, but farther off than 2 cm: {false}."""


class Track(NamedTuple):
    """A model through a sequence; infinite errors where there is no pose."""

    position: NDArray[np.float64]  # (N,) [m]
    rotation: NDArray[np.float64]  # (N,) [rad]
    inliers: NDArray[np.int64]  # (N,)
    poses: list[NDArray[np.float64] | None]


def learn(views: int, config: RGBDCameraConfig = CAMERA, feature: str = FEATURE) -> LearnedModel:
    """The carton's model, from stereo pairs once around it."""
    scene = FeatureScene(CARTON, TRAIN_SEED, config)
    sequence = stereo_sequence(scene, orbit(views), np.random.default_rng(TRAIN_SEED))
    return learn_from_stereo(
        sequence.pairs, scene.rig, feature, sequence.masks, 1500, T_c_object=sequence.T_c_object, name="carton"
    )


def way(count: int, rng: np.random.Generator, turn: float = 2.2) -> NDArray[np.float64]:
    """(count, 4, 4) T_world_camera of a vehicle that flies past the carton and sways."""
    start = rng.uniform(-np.pi, np.pi)
    phase = rng.uniform(-np.pi, np.pi, 4)
    poses = []
    for s in np.linspace(0.0, 1.0, count):
        azimuth, elevation = start + turn * s, np.radians(30.0 + 12.0 * np.sin(5.0 * s + phase[0]))
        distance = 0.6 + 0.15 * np.sin(7.0 * s + phase[1])
        flat = distance * np.cos(elevation)
        eye = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), 0.08 + distance * np.sin(elevation)])
        target = [0.03 * np.sin(11.0 * s + phase[2]), 0.0, 0.5 * CARTON_SIZE[2]]
        poses.append(look_at(eye, np.array(target), np.radians(6.0) * np.sin(9.0 * s + phase[3])))
    return np.array(poses)


def sequence(
    seed: int, count: int, hidden: float, config: RGBDCameraConfig = CAMERA
) -> tuple[list[RGBD], NDArray[np.float64], NDArray[np.float64]]:
    """Frames, the true T_c_object (N, 4, 4), and the share (N,) of the carton that is hidden."""
    scene, rng = FeatureScene(CARTON, seed, config), np.random.default_rng(seed)
    frames, truths, shares = [], [], []
    angle = rng.uniform(-np.pi, np.pi)
    for k, T in enumerate(way(count, rng)):
        shares.append(scene.hide(T, hidden, angle + 2.0 * np.pi * k / count) if hidden > 0.0 else 0.0)
        taken, truth = frame(scene, T, rng)
        frames.append(taken)
        truths.append(truth)
    return frames, np.array(truths), np.array(shares)


def follow(model: FeatureModel, frames: Sequence[RGBD], truths: NDArray[np.float64], guess: bool) -> Track:
    """Locate the model in every frame, with the last pose found for a guess or without."""
    last, position, rotation, inliers, poses = None, [], [], [], []
    for taken, truth in zip(frames, truths, strict=True):
        found = model.locate(taken.rgb, taken.intrinsics, T_guess=last if guess else None)
        T = found.T_c_object
        position.append(np.inf if T is None else float(translation_error(T, truth)))
        rotation.append(np.inf if T is None else float(rotation_error(T, truth)))
        inliers.append(found.inliers)
        poses.append(T)
        last = T if T is not None else last
    return Track(np.array(position), np.array(rotation), np.array(inliers), poses)


def run(request: Request, frames: int = FRAMES, views: int = VIEWS, config: RGBDCameraConfig = CAMERA) -> Reproduction:
    """How often the pose is kept within 2 cm, half hidden and whole."""
    learned = learn(views, config)
    hidden, truths, shares = sequence(request.seed, frames, HIDDEN, config)
    whole, whole_truths, _ = sequence(request.seed, frames, 0.0, config)
    tracks = {
        "half hidden, following": follow(learned.model, hidden, truths, True),
        "half hidden, alone": follow(learned.model, hidden, truths, False),
        "whole, alone": follow(learned.model, whole, whole_truths, False),
    }
    rows = [["", "found", "within 2 cm", "95 %", "position [mm]", "rotation [°]", "inliers"]]
    data: dict[str, Any] = {
        "feature": FEATURE, "frames": frames, "views": views, "hidden": shares, "points": len(learned.model),
        "model": {"rmse": learned.rmse, "scale": learned.scale, "scale_spread": learned.scale_spread},
        "tracks": {},
    }  # fmt: skip
    for name, track in tracks.items():
        near, found = track.position < WITHIN, np.isfinite(track.position)
        low, high = bootstrap_interval(near.astype(float), statistic=mean)
        data["tracks"][name] = {"position": track.position, "rotation": track.rotation, "inliers": track.inliers}
        data["tracks"][name] |= {"within": float(near.mean()), "interval": (low, high)}
        rows.append(
            [name, f"{found.mean():.1%}", f"{near.mean():.1%}", f"{low:.1%} … {high:.1%}",
             f"{1e3 * np.median(track.position):.1f}", f"{np.degrees(np.median(track.rotation)):.2f}",
             f"{np.median(track.inliers):.0f}"]
        )  # fmt: skip
    false = {n: int((np.isfinite(t.position) & (t.position >= WITHIN)).sum()) for n, t in tracks.items()}
    text = text_table(rows, 1) + "\n"
    text += NOTES.format(
        frames=frames, degrees=np.degrees(2.2), low=shares.min(), high=shares.max(), points=len(learned.model),
        views=len(learned.frames), false=", ".join(f"{count} {name}" for name, count in false.items()),
    )  # fmt: skip
    picture = _picture(learned.model, hidden, tracks) if request.picture else None
    return Reproduction(text, data, picture)


def overlay(model: FeatureModel, taken: RGBD, T_c_object: NDArray[np.float64] | None) -> NDArray[np.uint8]:
    """The frame with the carton's edges and the model's axes where they were found."""
    image = taken.rgb.copy()
    if T_c_object is None:
        return image
    corners = 0.5 * np.array(CARTON_SIZE) * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    pixels = project(corners, taken.intrinsics, T_c_object)
    for a in range(8):
        for bit in (1, 2, 4):
            if not a & bit:
                cv2.line(image, _whole(pixels[a]), _whole(pixels[a | bit]), (40, 255, 60), 2, cv2.LINE_AA)
    axes = project(0.08 * np.concatenate([np.zeros((1, 3)), np.eye(3)]), taken.intrinsics, T_c_object)
    for k, color in enumerate(((255, 40, 40), (40, 200, 40), (60, 80, 255))):
        cv2.line(image, _whole(axes[0]), _whole(axes[1 + k]), color, 3, cv2.LINE_AA)
    return image


def _whole(pixel: NDArray[np.float64]) -> tuple[int, int]:
    return round(float(pixel[0])), round(float(pixel[1]))


def _picture(model: FeatureModel, frames: Sequence[RGBD], tracks: dict[str, Track]) -> bytes:
    figure, axes = figure_grid(2, 3, (13.0, 7.0))
    shown = np.linspace(0, len(frames) - 1, 5).round().astype(int)
    following = next(iter(tracks.values()))
    for axis, k in zip(axes[:5], shown, strict=True):
        axis.imshow(overlay(model, frames[k], following.poses[k]))
        error = following.position[k]
        axis.set_title(f"frame {k}: " + (f"{1e3 * error:.0f} mm" if np.isfinite(error) else "not found"), fontsize=9)
        axis.set_axis_off()
    for name, track in tracks.items():
        axes[5].semilogy(1e3 * np.where(np.isfinite(track.position), track.position, np.nan), ".-", lw=0.8, label=name)
    axes[5].axhline(1e3 * WITHIN, color="#888888", lw=0.8)
    axes[5].set(xlabel="frame", ylabel="position error [mm]")
    axes[5].legend(frameon=False, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=1)
    return png(figure)
