"""Which camera, from one configuration: a dictionary, or a JSON or TOML file."""

from __future__ import annotations

import difflib
import inspect
import json
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from aerograsp_env.cameras.dataset import DatasetCamera
from aerograsp_env.cameras.devices import KinectCamera, RealSenseCamera, UVCCamera, ZedCamera
from aerograsp_env.cameras.interface import Camera
from aerograsp_env.cameras.ros import RosBagCamera, RosCamera

BACKENDS: dict[str, Callable[..., Camera]] = {
    "dataset": DatasetCamera,
    "uvc": UVCCamera,
    "realsense": RealSenseCamera,
    "kinect": KinectCamera,
    "zed": ZedCamera,
    "ros2": RosCamera,
    "rosbag": RosBagCamera,
}
"""Names in a configuration's `backend`, and what they make."""


def open_camera(config: str | Path | Mapping[str, Any]) -> Camera:
    """Open the camera that a configuration describes.

    Args:
        config: a dictionary with `backend` (a name in `BACKENDS`) and that backend's arguments; or the path of a JSON
            or TOML file with the same; or the path of a folder, which is a data set. A relative `path` in a file is
            relative to the file.

    Raises:
        FileNotFoundError: a file or folder that does not exist.
        ValueError: a file that is not JSON or TOML, an unknown backend or argument, or a bad value.
        CameraError: the camera does not open; `MissingPackage` if its Python package is absent.
    """
    folder = None
    if isinstance(config, str | Path):
        path = Path(config)
        if path.is_dir():
            return DatasetCamera(path)
        config, folder = _read(path), path.parent
    if not isinstance(config, Mapping):
        raise ValueError(f"config: expected a dictionary or a path, got {type(config).__name__}")
    options = dict(config)
    if "backend" not in options:
        raise ValueError(f"backend: missing in the configuration; expected one of {', '.join(BACKENDS)}")
    backend = options.pop("backend")
    if backend not in BACKENDS:
        raise ValueError(f"backend: expected one of {', '.join(BACKENDS)}, got {backend!r}{_near(backend, BACKENDS)}")
    make = BACKENDS[backend]
    known = [name for name in inspect.signature(make).parameters]
    for name in options:
        if name not in known:
            raise ValueError(
                f"{name}: unknown for backend {backend!r}; expected {', '.join(known)}{_near(name, known)}"
            )
    if folder is not None and "path" in options and not Path(options["path"]).is_absolute():
        options["path"] = folder / options["path"]
    try:
        return make(**options)
    except TypeError as error:
        raise ValueError(f"backend {backend!r}: {error}") from error


def _read(path: Path) -> Any:
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file or folder")
    try:
        text = path.read_text()
        return json.loads(text) if path.suffix.lower() == ".json" else tomllib.loads(text)
    except (json.JSONDecodeError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        kind = "JSON" if path.suffix.lower() == ".json" else "TOML"
        raise ValueError(f"{path}: expected {kind}: {error}") from error


def _near(name: Any, known: Any) -> str:
    near = difflib.get_close_matches(str(name), list(known), 1, 0.6)
    return f" (did you mean {near[0]!r}?)" if near else ""
