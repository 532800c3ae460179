"""`aerograsp bench aerograsp/Detect-v0 --speed`: an RGB-D frame beside the bare cast and OpenGL; policies' frames/s.

The scene has 40 geoms, two of them meshes of 5120 faces, and one light. A frame is colour with image textures and exact
shadows, depth and segmentation. The bare cast is one call of `mujoco.mj_multiRay` with the same rays, without normals.
OpenGL draws colour, depth and segmentation, where it works. All in turns, in one process, warm, in processor time
(other programs then disturb less; OpenGL in software may use several threads, whose times add); each ratio is the
median of the ratios of its turns.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
import trimesh

from aerograsp_env.sim.cameras import View, pose_view
from aerograsp_env.sim.depth_view import look_at
from aerograsp_env.sim.gl_probe import gl_fault
from aerograsp_env.sim.ray_kernel import pixel_rays
from aerograsp_env.sim.rendering import make_renderer
from aerograsp_env.sim.rgbd_camera import RGBDCameraConfig, SimulatedCamera
from aerograsp_env.spatial import transform
from agents import detect_speed
from agents.arguments import Parser, add_json, guarded, positive_int
from agents.files import write_json
from agents.provenance import provenance
from agents.table import aligned

GEOMS, SIZES, TARGET = 40, (64, 160, 320), 2.5
_EYE, _MIDDLE = np.array([1.1, -1.0, 0.9]), np.array([0.0, 0.0, 0.1])


class Row(NamedTuple):
    """One size of image, square."""

    size: int  # [px] a side
    cast_seconds: float  # the bare cast
    frame_seconds: float  # ours
    noisy_seconds: float  # ours with depth noise, image noise and motion blur
    ratio: float  # median of ours / bare cast
    gl_seconds: float | None
    gl_ratio: float | None  # median of ours / OpenGL


def scene(seed: int = 0) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The scene: a floor, two meshes and 37 primitives, most of them textured."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec()
    world = spec.worldbody
    spec.add_texture(
        name="image",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        **{"rgb1": [1.0, 0.3, 0.2], "rgb2": [0.2, 0.3, 1.0], "width": 256, "height": 256},
    )
    material = spec.add_material(name="image")
    material.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = "image"
    ball = trimesh.creation.icosphere(4, 0.12)
    vertices = ball.vertices * (1.0 + 0.15 * np.sin(20.0 * ball.vertices[:, :1]))
    for name, x in (("left", -0.25), ("right", 0.25)):
        spec.add_mesh(name=name, uservert=vertices.ravel(), userface=ball.faces.ravel())
        world.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, pos=[x, 0.0, 0.15], material="image")
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], material="image")
    kinds = [getattr(mujoco.mjtGeom, f"mjGEOM_{k}") for k in ("BOX", "CYLINDER", "SPHERE", "CAPSULE", "ELLIPSOID")]
    for i in range(GEOMS - 3):
        quat = rng.normal(size=4)
        options = {"material": "image"} if i % 2 else {"rgba": [*rng.random(3), 1.0]}
        position = [*rng.uniform(-0.8, 0.8, 2), rng.uniform(0.05, 0.4)]
        size = rng.uniform(0.02, 0.08, 3)
        world.add_geom(type=kinds[i % 5], size=size, pos=position, quat=quat / np.linalg.norm(quat), **options)
    world.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=[-0.4, -0.3, -0.85])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def measure(repeats: int = 21, sizes: Sequence[int] = SIZES) -> tuple[list[Row], str | None]:
    """Measure all sizes, in a process of its own. Returns rows, and why OpenGL was left out, or None."""
    program = "import sys; from agents.camera_speed import _worker; _worker(*map(int, sys.argv[1:]))"
    for platform in dict.fromkeys((os.environ.get("MUJOCO_GL", "egl"), "disable")):
        environment = {**os.environ, "MUJOCO_GL": platform, "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-c", program, *map(str, (repeats, *sizes))]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, errors="replace")
        if done.returncode == 0:
            document = json.loads(done.stdout.splitlines()[-1])
            return [Row(*row) for row in document["rows"]], document["fault"]
    raise RuntimeError(f"the measurement failed: {done.stderr.strip().splitlines()[-1:]}")


def _worker(repeats: int, *sizes: int) -> None:
    fault = gl_fault()
    model, data = scene()
    print(json.dumps({"rows": [_compare(model, data, size, repeats, fault is None) for size in sizes], "fault": fault}))


def _compare(model: mujoco.MjModel, data: mujoco.MjData, size: int, repeats: int, gl: bool) -> Row:
    config = RGBDCameraConfig(size, size)
    forward = (_MIDDLE - _EYE) / np.linalg.norm(_MIDDLE - _EYE)
    pose = transform(look_at(forward), _EYE)
    view, camera, rng = pose_view(pose, config.intrinsics), SimulatedCamera(model, config), np.random.default_rng(0)
    ours = make_renderer(model, size, size)
    tried: dict[str, Callable[[], object]] = {
        "cast": _bare_cast(model, data, view, size),
        "frame": lambda: ours.frame(data, view),
        "noisy": lambda: camera.capture(data, pose, rng, twist_c=(0.2, 0.0, 0.0, 0.0, 0.3, 0.0)),
    }
    if gl:
        other = make_renderer(model, size, size, "gl")
        tried["gl"] = lambda: other.frame(data, view)
    seconds: dict[str, list[float]] = {name: [] for name in tried}
    for _ in range(repeats + 1):
        for name, run in tried.items():
            start = time.process_time()
            run()
            seconds[name].append(time.process_time() - start)
    took = {name: np.array(values[1:]) for name, values in seconds.items()}  # the first warms up
    middle = {name: float(np.median(values)) for name, values in took.items()}
    return Row(
        *(size, middle["cast"], middle["frame"], middle["noisy"], float(np.median(took["frame"] / took["cast"]))),
        *((middle["gl"], float(np.median(took["frame"] / took["gl"]))) if gl else (None, None)),
    )


def _bare_cast(model: mujoco.MjModel, data: mujoco.MjData, view: View, size: int) -> Callable[[], object]:
    rays = pixel_rays(size, size, view.R_w_c, view.fx, view.fy, view.cx - 0.5, view.cy - 0.5).ravel()
    count = size * size
    geom, distance = np.empty(count, np.int32), np.empty(count)
    return lambda: mujoco.mj_multiRay(
        *(model, data, view.position, rays, None, True, -1, geom, distance, None, count, mujoco.mjMAXVAL)
    )


def table(rows: list[Row], fault: str | None) -> str:
    """Text for a terminal."""
    lines = [
        ["image", "bare cast [ms]", "frame [ms]", "with noise [ms]", "OpenGL [ms]", "frame / cast", "frame / OpenGL"]
    ]
    for row in rows:
        gl = ("–", "–") if row.gl_seconds is None else (f"{1e3 * row.gl_seconds:.1f}", f"{row.gl_ratio:.2f}")
        times = (f"{1e3 * s:.1f}" for s in (row.cast_seconds, row.frame_seconds, row.noisy_seconds))
        lines.append([f"{row.size}×{row.size}", *times, gl[0], f"{row.ratio:.2f}", gl[1]])
    note = f"Processor time, medians. Wanted: frame / cast ≤ {TARGET} and frame / OpenGL < 1 at {SIZES[0]}×{SIZES[0]}."
    return aligned(lines, [note] + ([f"OpenGL does not work here: {fault}"] if fault else []))


def main(argv: list[str]) -> int:
    """Print the table."""
    parser = Parser(prog="aerograsp bench aerograsp/Detect-v0 --speed", description=__doc__)
    parser.add_argument("--repeats", metavar="R", type=positive_int, default=21, help="of every measurement")
    parser.add_argument("--flights", metavar="N", type=positive_int, default=3, help="of every policy and level")
    add_json(parser)
    args = parser.parse_args(argv)
    rows, fault = measure(args.repeats)
    if args.json != "-":
        print(table(rows, fault))
    policies = [detect_speed.policy_speed(name, args.flights) for name in detect_speed.POLICIES]
    if args.json != "-":
        print("\n" + detect_speed.table(policies))
    if args.json:
        facts = provenance(" ".join([parser.prog, *argv]))
        write_json(
            args.json,
            {
                "provenance": facts,
                "rows": [row._asdict() for row in rows],
                "opengl": fault or "works",
                "policies": [row._asdict() for row in policies],
            },
        )
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp bench", main, sys.argv[1:]))
