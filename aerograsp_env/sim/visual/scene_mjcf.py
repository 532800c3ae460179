"""A scene as a MuJoCo model that cameras can draw; nothing in it moves or touches."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from aerograsp_env.sim.visual.looks import Look
from aerograsp_env.sim.visual.placing import Placed
from aerograsp_env.sim.visual.scenes import Ground, Light, Scene
from aerograsp_env.sim.visual.textures import texture_image

_GROUND_PIXELS, _PART_PIXELS = 192, 64  # of the textures
_FULL_LIGHT = 0.7 / 0.9  # of MuJoCo's diffuse, that lights a white surface fully in the ray renderer
_FULL_AMBIENT = 0.1 / 0.23  # of MuJoCo's ambient, that does so from all sides
_MESH, _PLANE = mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_PLANE
_SHAPES = {"plane": _PLANE, "box": mujoco.mjtGeom.mjGEOM_BOX, "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER}


class SceneModel(NamedTuple):
    """A compiled scene."""

    scene: Scene
    model: mujoco.MjModel
    data: mujoco.MjData
    geom_object: NDArray[np.int32]  # (ngeom,) index into `scene.objects`, or −1
    geom_ground: NDArray[np.bool_]  # (ngeom,) floors, tables, walls, pipes

    def relight(self, scene: Scene) -> SceneModel:
        """The same model lit as another scene, whose things must be the same."""
        _set_lights(self.model, scene)
        mujoco.mj_forward(self.model, self.data)
        return self._replace(scene=scene)


def compile_scene(scene: Scene) -> SceneModel:
    """The scene's model, its kinematics up to date."""
    spec = mujoco.MjSpec()
    spec.option.gravity = np.zeros(3)
    looks: dict[tuple[Look, float, int], str] = {}
    owner: list[int] = []
    for index, ground in enumerate(scene.grounds):
        _add_ground(spec, ground, f"ground{index}", looks)
        owner.append(-2)
    placed = [*enumerate(scene.objects), *((-1, other) for other in scene.distractors)]
    for number, (index, item) in enumerate(placed):
        owner += [index] * _add_object(spec, item, f"thing{number}", looks)
    for _ in range(3):
        spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    model = spec.compile()
    _set_lights(model, scene)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    owners = np.array(owner, dtype=np.int32)
    return SceneModel(scene, model, data, np.maximum(owners, -1), owners == -2)


def _add_ground(spec: mujoco.MjSpec, ground: Ground, name: str, looks: dict[tuple[Look, float, int], str]) -> None:
    material = _material(spec, ground.look, ground.repeat, _GROUND_PIXELS, looks)
    position, quaternion = _pose(ground.T_world_ground)
    spec.worldbody.add_geom(
        name=name,
        type=_SHAPES[ground.shape],
        size=ground.size,
        pos=position,
        quat=quaternion,
        material=material,
        contype=0,
        conaffinity=0,
    )


def _add_object(spec: mujoco.MjSpec, placed: Placed, name: str, looks: dict[tuple[Look, float, int], str]) -> int:
    """Adds a body with a geom a part; returns how many."""
    position, quaternion = _pose(placed.T_world_object)
    body = spec.worldbody.add_body(name=name, pos=position, quat=quaternion)
    for index, part in enumerate(placed.object.parts):
        mesh = spec.add_mesh(name=f"{name}-{index}")
        drawn = placed.object.shaded[index]
        mesh.uservert, mesh.userface = drawn.vertices.ravel(), drawn.faces.ravel()
        mesh.usernormal, mesh.userfacenormal = drawn.normals.ravel(), drawn.faces.ravel()  # MuJoCo: one a vertex
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        material = _material(spec, part.look, 1.0, _PART_PIXELS, looks)
        body.add_geom(
            name=f"{name}-{index}",
            type=_MESH,
            meshname=mesh.name,
            material=material,
            contype=0,
            conaffinity=0,
            mass=0.0,
        )
    return len(placed.object.parts)


def _material(
    spec: mujoco.MjSpec, look: Look, repeat: float, pixels: int, looks: dict[tuple[Look, float, int], str]
) -> str:
    key = (look, repeat, pixels)
    if key not in looks:
        name = f"look{len(looks)}"
        looks[key] = name
        material = spec.add_material(
            name=name,
            rgba=[*look.rgb, 1.0],
            specular=look.specular,
            shininess=look.shininess,
            texrepeat=[repeat, repeat],
            texuniform=pixels == _GROUND_PIXELS,
        )
        if look.texture is not None:
            image = texture_image(look.texture, look.rgb, look.seed, pixels)
            texture = spec.add_texture(
                name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=pixels, height=pixels, nchannel=3
            )
            texture.data = image.tobytes()
            material.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = name
            material.rgba = np.ones(4)
    return looks[key]


def _set_lights(model: mujoco.MjModel, scene: Scene) -> None:
    model.vis.headlight.active = 1
    model.vis.headlight.ambient[:] = 0.1 * scene.sky * min(1.0, float(scene.ambient.mean()) / 0.2)
    model.light_active[:] = 0
    sky_share = 0.23 * scene.sky * min(1.0, float(scene.ambient.mean()) / 0.2)  # comes as daylight already
    rest = np.maximum(scene.ambient - sky_share, 0.0)
    for index, light in enumerate(scene.lights):
        _set_light(model, index, light)
        model.light_ambient[index] = rest * _FULL_AMBIENT if index == 0 else 0.0


def _set_light(model: mujoco.MjModel, index: int, light: Light) -> None:
    directional = light.kind == "directional"
    model.light_active[index] = 1
    model.light_type[index] = int(
        mujoco.mjtLightType.mjLIGHT_DIRECTIONAL if directional else mujoco.mjtLightType.mjLIGHT_POINT
    )
    model.light_pos[index], model.light_dir[index] = light.position, light.direction
    model.light_diffuse[index] = light.color * _FULL_LIGHT
    model.light_specular[index] = 0.3
    distance = float(np.linalg.norm(light.position))
    # a lamp fades with the square of the distance; at the things it is as bright as its colour says
    model.light_attenuation[index] = (1.0, 0.0, 0.0) if directional else (0.3, 0.0, 0.7 / max(distance, 0.3) ** 2)
    model.light_castshadow[index] = light.shadow


def _pose(T: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
