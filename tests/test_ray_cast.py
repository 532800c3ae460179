"""The ray caster against MuJoCo's own, and pictures of textures and lights against closed forms."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import trimesh

from aerograsp_env.sim.cameras import View
from aerograsp_env.sim.ray_cast import cast, in_shadow, shapes_of
from aerograsp_env.sim.rendering import make_renderer
from aerograsp_env.sim.shading import decode_srgb

GEOM = mujoco.mjtGeom
PRIMITIVES = (GEOM.mjGEOM_BOX, GEOM.mjGEOM_CYLINDER, GEOM.mjGEOM_SPHERE, GEOM.mjGEOM_CAPSULE, GEOM.mjGEOM_ELLIPSOID)


def crowd(seed: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """All kinds of geoms at random: overlapping, behind the camera, around it, invisible."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec()
    world = spec.worldbody
    for name, shape in (("ball", trimesh.creation.icosphere(3, 0.3)), ("ring", trimesh.creation.torus(0.3, 0.1))):
        spec.add_mesh(name=name, uservert=shape.vertices.ravel(), userface=shape.faces.ravel())
    spec.add_hfield(name="hill", size=[1.0, 1.0, 0.4, 0.1], nrow=5, ncol=5, userdata=rng.random(25))

    def place(spread: float) -> dict:
        quat = rng.normal(size=4)
        return {"pos": rng.uniform(-spread, spread, 3), "quat": quat / np.linalg.norm(quat)}

    for i in range(20):
        world.add_geom(type=PRIMITIVES[i % 5], size=rng.uniform(0.05, 0.3, 3), **place(1.5))
    for name in ("ball", "ring", "ring"):
        world.add_geom(type=GEOM.mjGEOM_MESH, meshname=name, **place(1.0))
    world.add_geom(type=GEOM.mjGEOM_HFIELD, hfieldname="hill", pos=[0.0, 0.0, -1.8])
    world.add_geom(type=GEOM.mjGEOM_PLANE, size=[4.0, 3.0, 1.0], pos=[0.0, 0.0, -2.0])
    world.add_geom(type=GEOM.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], pos=[0.0, 0.0, -3.0])
    world.add_geom(type=GEOM.mjGEOM_SPHERE, size=[0.5, 0.0, 0.0], pos=[1.0, 0.0, 0.0], rgba=[1.0, 1.0, 1.0, 0.0])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def multi_ray(model, data, origin, rays):
    count = len(rays)
    geom, distance, normal = np.empty(count, np.int32), np.empty(count), np.empty(3 * count)
    mujoco.mj_multiRay(
        *(model, data, origin, rays.ravel(), None, True, -1, geom, distance, normal, count, mujoco.mjMAXVAL)
    )
    return geom, distance, normal.reshape(-1, 3)


def bundle(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """An origin and rays: half of them a fan, half in all directions, of all lengths."""
    rng = np.random.default_rng(seed)
    fan = np.stack([np.linspace(-1.0, 1.0, count // 2), np.ones(count // 2), rng.normal(size=count // 2) * 0.2], axis=1)
    wild = rng.normal(size=(count // 2, 3)) * rng.uniform(0.01, 10.0, (count // 2, 1))
    return rng.uniform(-1.0, 1.0, 3) * (seed % 3), np.vstack([fan, wild])


@pytest.mark.parametrize("seed", range(6))
def test_rays_meet_what_mujocos_meet(seed):
    model, data = crowd(seed)
    origin, rays = bundle(seed, 6000)
    geom, distance, normal = multi_ray(model, data, origin, rays)
    hits = cast(shapes_of(model, data, model.geom_rgba[:, 3] > 0.0), origin, rays)
    np.testing.assert_array_equal(hits.geom, geom)
    hit = geom >= 0
    assert hit.mean() > 0.4 and len(np.unique(geom[hit])) > 12
    np.testing.assert_allclose(hits.distance[hit], distance[hit], rtol=1e-12)
    np.testing.assert_allclose(hits.normal[hit], normal[hit], atol=1e-12)
    assert (hits.distance[~hit] == 0.0).all()
    meshes = model.geom_type[hits.geom] == int(GEOM.mjGEOM_MESH)
    np.testing.assert_array_equal(hits.face >= 0, hit & meshes)
    assert len(cast(shapes_of(model, data, model.geom_rgba[:, 3] > 0.0), origin, rays[:0]).geom) == 0


@pytest.mark.parametrize("seed", range(3))
def test_a_faces_plane_holds_the_point_that_was_met(seed):
    model, data = crowd(seed)
    origin, rays = bundle(seed, 12000)
    hits = cast(shapes_of(model, data, np.ones(model.ngeom, bool)), origin, rays)
    on = np.flatnonzero(hits.face >= 0)
    assert on.size > 20
    for i in on:
        g, mesh = hits.geom[i], model.geom_dataid[hits.geom[i]]
        R, p = data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g]
        corners = model.mesh_vert[model.mesh_face[hits.face[i]] + model.mesh_vertadr[mesh]].astype(float) @ R.T + p
        point = origin + hits.distance[i] * rays[i]
        weights = np.linalg.lstsq(np.vstack([corners.T, np.ones(3)]), np.append(point, 1.0), rcond=None)[0]
        np.testing.assert_allclose(weights @ corners, point, atol=1e-9)
        assert weights.min() > -1e-7


@pytest.mark.parametrize("seed", range(6))
def test_shadows_are_where_mujocos_rays_from_the_light_are_stopped(seed):
    model, data = crowd(seed)
    origin, rays = bundle(seed, 6000)
    shapes = shapes_of(model, data, model.geom_rgba[:, 3] > 0.0)
    hits = cast(shapes, origin, rays)
    source = np.array([0.4, -0.6, 3.0])
    to = origin + hits.distance[:, None] * rays - source
    normal = hits.normal * -np.sign(np.einsum("ni,ni->n", hits.normal, rays))[:, None]
    on = (hits.geom >= 0) & (np.einsum("ni,ni->n", normal, to) < -0.02 * np.linalg.norm(to, axis=1))
    first, distance, _ = multi_ray(model, data, source, to[on])
    expected = (first >= 0) & (distance < 1.0 - 1e-5 / np.linalg.norm(to[on], axis=1))
    assert 0.02 < expected.mean() < 0.98
    shadow = in_shadow(shapes, source, to[on], hits.geom[on])
    np.testing.assert_array_equal(shadow, expected)


PLATE = """
<mujoco>
  <asset>
    <texture name="map" type="2d" width="4" height="4" nchannel="3" builtin="flat"/>
    <material name="map" texture="map" specular="0"/>
  </asset>
  <visual><headlight ambient="{ambient}"/></visual>
  <worldbody>
    {lights}
    <geom name="it" {shape} material="map"/>
    <camera name="c" pos="0 0 2" fovy="40"/>
  </worldbody>
</mujoco>
"""
COLORS = np.array([[220, 30, 30], [30, 220, 30], [30, 30, 220], [200, 200, 30]], np.uint8)


def plate(
    shape: str, lights: str = '<light type="directional" dir="0 0 -1"/>', ambient: str = "0.1 0.1 0.1", flat=None
):
    """A geom with an image of four quarters (or of one colour): upper left, upper right, lower left, lower right."""
    model = mujoco.MjModel.from_xml_string(PLATE.format(shape=shape, lights=lights, ambient=ambient))
    image = (
        COLORS[[[0, 0, 1, 1], [0, 0, 1, 1], [2, 2, 3, 3], [2, 2, 3, 3]]] if flat is None else np.full((4, 4, 3), flat)
    )
    model.tex_data[:] = image.astype(np.uint8).ravel()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def looked_at(model, data, direction, up, size=40, distance=3.0) -> np.ndarray:
    """A picture along `direction` towards the origin; `up` is up in it."""
    z = -np.asarray(direction, float)
    x = np.cross(up, z)
    view = View(distance * z, np.column_stack([x, np.cross(z, x), z]), 2.0 * size, 2.0 * size, size / 2, size / 2)
    return make_renderer(model, size, size).render(data, view)


@pytest.mark.parametrize(
    ("direction", "up"),
    [((-1, 0, 0), (0, 0, 1)), ((1, 0, 0), (0, 0, 1)), ((0, 1, 0), (0, 0, 1)), ((0, -1, 0), (0, 0, 1)),
     ((0, 0, -1), (0, 1, 0)), ((0, 0, 1), (0, 1, 0))],
)  # fmt: skip
@pytest.mark.parametrize("shape", ['type="box" size=".4 .4 .4"', 'type="cylinder" size=".4 .4"'])
def test_box_projection_shows_the_image_upright_and_not_mirrored_on_every_side(shape, direction, up):
    model, data = plate(shape, lights="".join(f'<light type="directional" dir="{d}"/>' for d in ("1 1 1", "-1 -1 -1")))
    picture = looked_at(model, data, direction, up).astype(int)
    for (row, column), color in zip(((16, 16), (16, 24), (24, 16), (24, 24)), COLORS.astype(int), strict=True):
        seen = picture[row, column]
        np.testing.assert_array_equal(seen > 0.6 * seen.max(), color > 150)


def test_a_meshs_texture_keeps_to_the_frame_of_its_file():
    """MuJoCo turns vertices into the axes of inertia: a long box across the file's diagonal, say."""
    box = trimesh.creation.box((0.8, 0.8, 0.3))
    box.apply_translation((0.3, -0.2, 0.1))
    text = " ".join(f"{x:.6f}" for x in box.vertices.ravel())
    faces = " ".join(str(x) for x in box.faces.ravel())
    xml = PLATE.format(shape='type="mesh" mesh="b" pos="-.3 .2 -.1"', ambient=".1 .1 .1", lights="")
    xml = xml.replace("<asset>", f'<asset><mesh name="b" vertex="{text}" face="{faces}"/>')
    model = mujoco.MjModel.from_xml_string(xml)
    model.tex_data[:] = COLORS[[[0, 0, 1, 1], [0, 0, 1, 1], [2, 2, 3, 3], [2, 2, 3, 3]]].ravel()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert not np.allclose(np.abs(model.mesh_quat[0]), [1, 0, 0, 0])  # MuJoCo did turn it
    picture = looked_at(model, data, (0, 0, -1), (0, 1, 0)).astype(int)
    for (row, column), color in zip(((16, 16), (16, 24), (24, 16), (24, 24)), COLORS.astype(int), strict=True):
        np.testing.assert_array_equal(picture[row, column] > 0.6 * picture[row, column].max(), color > 150)


def test_texture_coordinates_of_a_mesh_place_its_image():
    square = 'vertex="-.4 -.4 0 .4 -.4 0 .4 .4 0 -.4 .4 0 0 0 -.3" face="0 1 2 0 2 3 1 0 4 2 1 4 3 2 4 0 3 4"'
    turned = 'texcoord="0 1 0 0 1 0 1 1 .5 .5"'  # v runs down the image: its first row is at v = 0
    xml = PLATE.format(shape='type="mesh" mesh="b"', ambient=".1 .1 .1", lights="")
    model = mujoco.MjModel.from_xml_string(xml.replace("<asset>", f'<asset><mesh name="b" {square} {turned}/>'))
    model.tex_data[:] = COLORS[[[0, 0, 1, 1], [0, 0, 1, 1], [2, 2, 3, 3], [2, 2, 3, 3]]].ravel()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    picture = looked_at(model, data, (0, 0, -1), (0, 1, 0)).astype(int)
    # (−, −) is (u, v) = (0, 1), the lower left of the image; (+, −) the upper left; (+, +) the upper right.
    for (row, column), which in zip(((24, 16), (24, 24), (16, 24), (16, 16)), (2, 0, 1, 3), strict=True):
        seen = picture[row, column]
        np.testing.assert_array_equal(seen > 0.6 * seen.max(), COLORS[which] > 150)


def test_far_textures_blend_to_their_mean():
    model, data = plate('type="plane" size="50 50 1"')
    model.mat_texrepeat[0] = 2000.0
    picture = looked_at(model, data, (0, 0, -1), (0, 1, 0), distance=8.0).astype(int)
    assert np.ptp(picture, axis=(0, 1)).max() <= 3  # no moiré


def brightness(model, data, x=0.0) -> np.ndarray:
    """Linear colour of a plane at (x, 0, 0), seen from above."""
    position = np.array([x, 0.0, 2.0])
    view = View(position, np.eye(3), 100.0, 100.0, 0.5, 0.5)
    return decode_srgb(make_renderer(model, 1, 1).render(data, view)[0, 0] / 255.0)


def test_light_falls_off_with_the_square_of_the_distance_and_the_cosine():
    lights = '<light type="point" pos="0 0 1" attenuation="0 0 4" diffuse=".7 .7 .7"/>'
    model, data = plate('type="plane" size="9 9 1"', lights, ambient="0 0 0", flat=255)
    middle = brightness(model, data)
    np.testing.assert_allclose(middle, 0.9 / 4, rtol=0.03)  # a lamp's full strength at attenuation 4
    for x in (0.5, 1.0):
        square = 1.0 + x * x
        np.testing.assert_allclose(brightness(model, data, x), middle * square**-1.5, rtol=0.06)


def test_a_spot_ends_at_its_cutoff_and_follows_its_exponent():
    lights = '<light type="spot" pos="0 0 1" dir="0 0 -1" cutoff="30" exponent="5"/>'
    model, data = plate('type="plane" size="9 9 1"', lights, ambient="0 0 0", flat=255)
    middle, edge = brightness(model, data), np.tan(np.deg2rad(30))
    assert brightness(model, data, 1.03 * edge).max() == 0.0
    cosine = np.cos(np.arctan(0.9 * edge))
    np.testing.assert_allclose(brightness(model, data, 0.9 * edge), middle * cosine ** (1 + 5), rtol=0.03)


def test_lights_add_and_shadows_are_each_lights_own():
    first = '<light type="point" pos="-1 0 1.5" diffuse=".3 0 0"/>'
    second = '<light type="point" pos="1 0 1.5" diffuse="0 .3 0"/>'
    shape = 'type="plane" size="9 9 1"/><geom type="box" size=".02 1 .3" pos="0 0 .3"'
    for lights, expected in ((first + second, (0.0, 1.0)), (second, (0.0, 1.0)), (first, (0.0, 0.0))):
        model, data = plate(shape, lights, ambient="0 0 0", flat=255)
        red, green, blue = brightness(model, data, 0.3)  # behind the wall, seen from the first light
        assert red == expected[0] and blue == 0.0
        assert (green > 0.05) == bool(expected[1])
    model.light_castshadow[0] = False
    assert brightness(model, data, 0.3)[0] > 0.05


def test_ambient_light_scales_from_night_to_day():
    nothing = '<light type="point" diffuse="0 0 0"/>'
    values = []
    for ambient in ("0 0 0", ".05 .05 .05", ".1 .1 .1", ".4 .4 .4"):
        model, data = plate('type="plane" size="9 9 1"', nothing, ambient, flat=255)
        values.append(brightness(model, data)[1])
    assert values[0] == 0.0
    assert values[1] == pytest.approx(0.5 * values[2], rel=0.03)
    assert values[3] == values[2]
    model, data = plate(
        'type="plane" size="9 9 1"', nothing.replace("diffuse", 'ambient=".05 .05 .05" diffuse'), "0 0 0", flat=255
    )
    assert brightness(model, data)[1] == pytest.approx(values[1], rel=0.03)


def test_a_model_without_lights_has_a_sun_and_one_whose_lights_are_off_too():
    model, data = plate('type="plane" size="9 9 1"', "", flat=255)
    sunny = brightness(model, data)
    assert sunny.min() > 0.7
    lit, data = plate('type="plane" size="9 9 1"', '<light type="point" pos="0 0 1" active="false"/>', flat=255)
    np.testing.assert_array_equal(brightness(lit, data), sunny)
