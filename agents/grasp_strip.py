"""One object from its view to its grasp, in three pictures: `python -m agents.grasp_strip docs/grasp_plan.png`."""

from __future__ import annotations

import argparse
import sys
from typing import Any

import gymnasium
import numpy as np
import trimesh

import aerograsp_env  # noqa: F401  registers the ids
from aerograsp_env.envs.grasp_plan import encode_grasp, unpack_cloud
from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.gripper import GripperConfig, gripper_pose
from agents.arguments import guarded
from agents.files import write_atomic
from agents.pictures import png
from baselines.grasping.planning import propose

OBJECT, SEED = "bottle", 1
SIZE, CUT = (640, 480), (slice(30, 350), slice(130, 490))  # of the renderings [px], and what is shown of them
CELLS = 26  # of the surface, along what was seen
GRIPPER_COLOR = (0.30, 0.34, 0.40)


def strip(name: str = OBJECT, seed: int = SEED) -> bytes:
    """PNG: what the depth camera saw, what the planner makes of it, and what physics says to its best grasp."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    env = gymnasium.make(
        "aerograsp/GraspPlan-v0",
        render_mode="rgb_array",
        camera="front",
        width=SIZE[0],
        height=SIZE[1],
        render_samples=2,
    )
    world: Any = env.unwrapped
    observation, _ = env.reset(seed=seed, options={"object": name, "occluded": False})
    cloud = unpack_cloud(observation)
    seen: Any = env.render()
    found = propose(cloud.points, cloud.normals, cloud.noise, cloud.viewpoint, np.random.default_rng(0))
    if not len(found):
        raise ValueError(f"object: expected one with a grasp, got {name} from seed {seed}, which has none")
    grasp = found.grasp(0)
    *_, info = env.step(encode_grasp(grasp, world.gripper))
    held: Any = env.render()
    env.close()

    figure = Figure(figsize=(8.6, 2.8), layout="constrained")
    FigureCanvasAgg(figure)
    for place, picture, title in (
        (1, seen, "a depth camera sees one side"),
        (3, held, f"physics judges its best grasp: {info['termination']}"),
    ):
        axis = figure.add_subplot(1, 3, place)
        axis.imshow(picture[CUT])
        axis.set_title(title, fontsize=8.5)
        axis.axis("off")
    axis = figure.add_subplot(1, 3, 2, projection="3d", computed_zorder=True)
    bar = _guess(axis, found.estimate.model, cloud, grasp, world.gripper)
    axis.set_title("the planner completes it, and says how surely", fontsize=8.5)
    colors = figure.colorbar(bar, ax=axis, shrink=0.5, aspect=30, pad=0.0, location="bottom")
    colors.set_label("standard deviation [mm]", fontsize=8)
    colors.ax.tick_params(labelsize=8)
    return png(figure)


def _guess(axis: Any, model: Any, cloud: Any, grasp: Grasp, gripper: GripperConfig) -> Any:
    """The estimated surface coloured by its standard deviation, the gripper at the grasp; returns what is coloured."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    surface = model.surface(float(np.ptp(cloud.points, axis=0).max()) / CELLS)
    says = model.predict(surface.vertices, gradient=True, variance=True)
    deviation = 1e3 * np.sqrt(says.variance) / np.linalg.norm(says.gradient, axis=1)
    of_face = deviation[surface.faces].mean(axis=1)
    norm = Normalize(0.0, float(np.percentile(of_face, 97)))
    shade = 0.75 + 0.25 * surface.face_normals @ np.array([0.0, 0.0, 1.0])
    colors = colormaps["viridis"](norm(of_face))
    colors[:, :3] *= np.clip(shade, 0.5, 1.0)[:, None]
    facets, facet_colors = [surface.vertices[surface.faces]], [colors]
    T = gripper_pose(grasp)
    for box in gripper.boxes(grasp.width):  # in small facets: the picture is sorted by their middles
        part = trimesh.creation.box(2.0 * np.asarray(box.half_size)).apply_translation(box.center).apply_transform(T)
        fine = part.subdivide_to_size(0.006)
        light = np.clip(0.75 + 0.25 * fine.face_normals[:, 2], 0.5, 1.0)
        facets.append(fine.vertices[fine.faces])
        facet_colors.append(np.column_stack([light[:, None] * GRIPPER_COLOR, np.ones(len(light))]))
    every, every_color = np.concatenate(facets), np.concatenate(facet_colors)
    axis.add_collection3d(Poly3DCollection(every, facecolors=every_color, edgecolors=every_color, linewidths=0.3))
    away = cloud.viewpoint / np.linalg.norm(cloud.viewpoint)
    axis.view_init(elev=12.0, azim=np.degrees(np.arctan2(away[1], away[0])) - 50.0)
    middle, half = surface.vertices.mean(axis=0), 0.38 * float(np.ptp(surface.vertices, axis=0).max())
    axis.set(xlim=middle[0] + (-half, half), ylim=middle[1] + (-half, half), zlim=middle[2] + (-half, half))
    axis.set_box_aspect((1, 1, 1), zoom=1.15)
    axis.axis("off")
    return ScalarMappable(norm, "viridis")


def main(argv: list[str]) -> int:
    """`python -m agents.grasp_strip`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", help="the PNG to write")
    parser.add_argument("--object", default=OBJECT)
    parser.add_argument("--seed", type=int, default=SEED)
    args = parser.parse_args(argv)
    write_atomic(args.file, strip(args.object, args.seed))
    return 0


if __name__ == "__main__":
    sys.exit(guarded("grasp_strip", main, sys.argv[1:]))
