"""From the names that users pass to Detect-v0 to checked values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from aerograsp_env.envs.detect_action import POSITION_SCALE
from aerograsp_env.envs.detect_motion import MOTIONS
from aerograsp_env.envs.options import choose, instance, randomization
from aerograsp_env.sim.manipulation.config import ManipulationRandomizeConfig
from aerograsp_env.sim.rendering import BACKENDS
from aerograsp_env.sim.rgbd_camera import RGBDCameraConfig
from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.sim.visual.mesh_files import object_from_mesh
from aerograsp_env.sim.visual.objects import VisualObject
from aerograsp_env.sim.visual.scenes import LEVELS
from aerograsp_env.sim.wind import WIND_LEVELS, WindConfig

SENSORS = ("rgbd", "stereo")
EXPOSURE = {"easy": 0.008, "cluttered": 0.008, "dark": 0.02, "blurred": 0.06}  # [s], unless the camera's config says
BASELINE = 0.12  # of the stereo pair [m]
START_OPTIONS = ("motion", "wind_direction")


@dataclass(frozen=True)
class DetectOptions:
    """Everything that defines the task, checked."""

    level: str
    labels: tuple[str, ...]
    mesh: VisualObject | None  # what objects are instead of random ones of the one label
    motion: str
    sensors: str
    camera: RGBDCameraConfig
    wind: WindConfig
    vehicle: ManipulationRandomizeConfig | None  # what of the vehicle is drawn per episode


def detect_options(
    *,
    level: str = "easy",
    labels: Sequence[str] | str | None = None,
    mesh: str | Path | None = None,
    motion: str = "any",
    sensors: str = "rgbd",
    camera_backend: str = "ray",
    camera_config: RGBDCameraConfig | dict | None = None,
    wind: str | WindConfig | dict = "light",
    randomize: bool | ManipulationRandomizeConfig | dict = False,
) -> DetectOptions:
    """The options by name.

    Raises:
        ValueError: a value that is not valid, naming the nearest that is.
    """
    names = _labels(labels)
    chosen = choose("level", level, LEVELS)
    return DetectOptions(
        level=chosen,
        labels=names,
        mesh=None if mesh is None else _mesh(mesh, names),
        motion=choose("motion", motion, MOTIONS),
        sensors=choose("sensors", sensors, SENSORS),
        camera=_camera(camera_config, choose("camera_backend", camera_backend, BACKENDS), chosen),
        wind=instance("wind", wind, WindConfig, WIND_LEVELS),
        vehicle=randomization(randomize, ManipulationRandomizeConfig),
    )


def _labels(labels: Sequence[str] | str | None) -> tuple[str, ...]:
    if labels is None:
        return CLASSES
    names = (labels,) if isinstance(labels, str) else tuple(labels)
    if not names:
        raise ValueError(f"labels: expected at least one of {', '.join(CLASSES)}, got none")
    return tuple(dict.fromkeys(choose("labels", name, CLASSES) for name in names))


def _mesh(path: str | Path, labels: tuple[str, ...]) -> VisualObject:
    if len(labels) != 1:
        raise ValueError(f"mesh: expected labels= with the one class that it counts as, got {len(labels)} labels")
    if not Path(path).exists():
        raise ValueError(f"mesh: no such file or folder: {path}")
    return object_from_mesh(path, labels[0])


def _camera(config: RGBDCameraConfig | dict | None, backend: str, level: str) -> RGBDCameraConfig:
    if isinstance(config, RGBDCameraConfig):
        camera = config
    else:
        camera = RGBDCameraConfig() if config is None else instance("camera_config", config, RGBDCameraConfig)
        camera = replace(camera, image_noise=replace(camera.image_noise, exposure_time=EXPOSURE[level]))
    if camera.max_depth > POSITION_SCALE:
        raise ValueError(
            f"camera_config: expected a max_depth of at most {POSITION_SCALE:g} m, which a full action means, "
            f"got {camera.max_depth:g}"
        )
    return replace(camera, backend=backend) if backend != "ray" else camera


def check_start(options: dict[str, Any] | None) -> dict[str, Any]:
    """Reset's options, or an error that names the unknown one and lists the known."""
    given = dict(options or {})
    for key in given:
        if key not in START_OPTIONS:
            raise ValueError(f"unknown reset option {key!r}; known: {', '.join(START_OPTIONS)}")
    if "motion" in given:
        choose("options['motion']", given["motion"], MOTIONS)
    return given
