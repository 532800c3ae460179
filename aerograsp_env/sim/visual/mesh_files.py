"""Objects from mesh files: any format that trimesh reads, or a folder laid out as the YCB objects are.

Calli, Walsman, Singh, Srinivasa, Abbeel and Dollar 2015, "Benchmarking in manipulation research: the YCB object and
model set", IEEE Robotics and Automation Magazine 22(3), hand out one folder an object, with a `google_16k`, `poisson`
or `tsdf` folder and a `textured.obj` in it; a simulator's collection has `textured_simple_reoriented.obj`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from aerograsp_env.sim.visual import CLASSES
from aerograsp_env.sim.visual.looks import Look
from aerograsp_env.sim.visual.objects import Part, VisualObject, only
from aerograsp_env.sim.visual.solids import signed_volume

YCB_FILES = (
    "google_16k/textured.obj",
    "google_64k/textured.obj",
    "google_512k/textured.obj",
    "poisson/textured.obj",
    "tsdf/textured.obj",
    "textured_simple_reoriented.obj",
    "textured_simple.obj",
    "textured.obj",
)
"""Where a YCB object's folder has its mesh, the first that is there."""

LARGEST = 2.0  # [m] extent beyond which a mesh is taken to be in other units


def object_from_mesh(path: str | Path, label: str, *, scale: float = 1.0) -> VisualObject:
    """A mesh as an object of one colour, the mean of its texture or of its vertices' colours.

    Its axes are the file's, its origin the middle of the bounding box; it has no symmetries. A surface that is not
    closed is drawn as it is.

    Args:
        path: a file, or the folder of a YCB object.
        label: the class that it counts as.
        scale: metres a unit of the file.

    Raises:
        FileNotFoundError: no such file, or a folder without a mesh where YCB has it.
        ValueError: an unknown label, or a mesh that cannot be read, has no faces, is not finite, is flat, or is too
            large to be in metres.
    """
    if label not in CLASSES:
        raise ValueError(f"label: expected one of {', '.join(CLASSES)}, got {label!r}")
    if not 0.0 < scale < np.inf:
        raise ValueError(f"scale: expected a positive factor, got {scale}")
    file = mesh_file(path)
    mesh = _load(file)
    vertices, faces = np.asarray(getattr(mesh, "vertices", ())), np.asarray(getattr(mesh, "faces", ()))
    if len(vertices) == 0 or len(faces) == 0:
        raise ValueError(f"{file}: expected a mesh with faces, got {len(vertices)} vertices and {len(faces)} faces")
    vertices = vertices.astype(np.float64) * scale
    if not np.isfinite(vertices).all():
        raise ValueError(f"{file}: expected finite vertices, {int((~np.isfinite(vertices)).any(axis=1).sum())} are not")
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if (high - low).max() > LARGEST:
        raise ValueError(f"{file}: {(high - low).max():.4g} m across; if its units are millimetres, pass scale=0.001")
    if np.linalg.matrix_rank(vertices - low, tol=1e-6) < 3:
        raise ValueError(f"{file}: expected a body, got points in one plane")
    vertices = vertices - 0.5 * (low + high)
    triangles = faces.astype(np.int32)
    if signed_volume(vertices, triangles) < 0.0:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    return VisualObject(label, (Part(vertices, triangles, Look(_color(mesh))),), only(), file.stem)


def mesh_file(path: str | Path) -> Path:
    """The mesh that a path means: the file itself, or that of a YCB object's folder.

    Raises:
        FileNotFoundError: neither a file nor such a folder.
    """
    place = Path(path)
    if place.is_file():
        return place
    if not place.is_dir():
        raise FileNotFoundError(f"mesh: no file or folder {place}")
    for name in YCB_FILES:
        if (place / name).is_file():
            return place / name
    raise FileNotFoundError(f"mesh: the folder {place} has none of {', '.join(YCB_FILES)}")


def _load(file: Path) -> Any:
    import trimesh

    try:
        return trimesh.load(file, force="mesh", process=False)
    except Exception as error:  # readers of a dozen formats raise as many kinds
        raise ValueError(f"{file}: cannot be read as a triangle mesh ({error})") from error


def _color(mesh: Any) -> tuple[float, float, float]:
    """Mean sRGB of the texture, or of the vertices; grey if there is neither."""
    visual: Any = getattr(mesh, "visual", None)
    try:
        if getattr(visual, "kind", None) == "texture":
            visual = visual.to_color()
        if getattr(visual, "kind", None) in ("vertex", "face"):
            r, g, b = np.asarray(visual.vertex_colors, dtype=np.float64)[:, :3].mean(axis=0) / 255.0
            return float(r), float(g), float(b)
    except (AttributeError, ValueError, TypeError, IndexError):  # a texture that is named but absent
        pass
    return 0.6, 0.6, 0.6
