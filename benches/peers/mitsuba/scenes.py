"""Scenes that both renderers are given: geometry, materials, light and camera in plain numbers.

Everything is a number that f32 holds, so both read the same scene.
"""

from dataclasses import dataclass, field, replace
from typing import Callable, Optional

import numpy as np


@dataclass(frozen=True)
class Material:
    """Lambert, unless it is a mirror or glass."""

    diffuse: tuple = (0.0, 0.0, 0.0)
    mirror: Optional[tuple] = None
    # GGX with alpha = roughness^2.
    roughness: float = 0.0
    # Refractive index of clear glass.
    glass: Optional[float] = None
    # Rows from the top, RGB, 8 bit sRGB; multiplies nothing: `diffuse` is 1 then.
    picture: Optional[np.ndarray] = None


@dataclass
class Mesh:
    material: str
    # Triangles: (n, 3, 3).
    corners: np.ndarray
    # (n, 3, 2), (0, 0) at the picture's lower left corner.
    uvs: Optional[np.ndarray] = None


@dataclass(frozen=True)
class Lamp:
    """A parallelogram that shines to the side of `edges[0]` x `edges[1]` and is black otherwise."""

    corner: tuple
    edges: tuple
    radiance: tuple


@dataclass
class Scene:
    name: str
    eye: tuple
    look_at: tuple
    fov: float
    materials: dict
    meshes: list
    lamps: list = field(default_factory=list)
    # Radiance by unit direction, (..., 3) to (..., 3), above +Y.
    environment: Optional[Callable] = None
    # Light that was diffusely reflected before it lights a surface.
    bounces: bool = True


def quad(a, b, c, d):
    """Two triangles."""
    return np.float32([[a, b, c], [a, c, d]]).astype(float)


QUAD_UVS = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], float)


def box(low, high, turn=0.0):
    """Twelve triangles that face outward, turned by `turn` degrees about the vertical through its middle."""
    low, high = np.array(low, float), np.array(high, float)
    points = np.array([[(low, high)[i >> axis & 1][axis] for axis in range(3)] for i in range(8)])
    middle = (low + high) / 2
    sine, cosine = np.sin(np.radians(turn)), np.cos(np.radians(turn))
    x, z = points[:, 0] - middle[0], points[:, 2] - middle[2]
    points[:, 0], points[:, 2] = middle[0] + cosine * x + sine * z, middle[2] - sine * x + cosine * z
    sides = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
    return np.concatenate([quad(*points[list(side)]) for side in sides])


def ball(middle, radius, halvings=3):
    """Flat triangles that face outward; both renderers see facets, not a sphere."""
    golden = (1 + 5**0.5) / 2
    points = [(a, b * golden, 0) for a in (-1, 1) for b in (-1, 1)]
    points = np.array([np.roll(p, shift) for shift in range(3) for p in points], float)
    edge = 2.0
    faces = []
    for i in range(12):
        for j in range(i + 1, 12):
            for k in range(j + 1, 12):
                three = points[[i, j, k]]
                sides = [np.linalg.norm(three[m] - three[m - 1]) for m in range(3)]
                if max(abs(side - edge) for side in sides) < 1e-9:
                    outward = np.dot(np.cross(three[1] - three[0], three[2] - three[0]), three.sum(0))
                    faces.append(three if outward > 0 else three[::-1])
    faces = np.array(faces)
    for _ in range(halvings):
        a, b, c = faces[:, 0], faces[:, 1], faces[:, 2]
        ab, bc, ca = a + b, b + c, c + a
        faces = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        faces = faces / np.linalg.norm(faces, axis=2, keepdims=True)
    faces = faces / np.linalg.norm(faces, axis=2, keepdims=True)
    return np.float32(np.array(middle) + radius * faces).astype(float)


def room(name, inside, hole=((213.0, 227.0), (343.0, 332.0)), radiance=(18.4, 15.6, 8.0)):
    """The Cornell box (www.graphics.cornell.edu/online/box/data.html) with linear RGB reflectances in place of spectra, the lamp
    in the plane of the ceiling, in a hole of it."""
    # As f32 has it: a lamp even a little above its hole would be hidden here.
    top = float(np.float32(548.8))
    (x0, z0), (x1, z1) = hole
    corners = lambda y, ax, az, bx, bz: quad((ax, y, az), (bx, y, az), (bx, y, bz), (ax, y, bz))
    white = np.concatenate(
        [
            quad((552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2)),
            quad((549.6, 0, 559.2), (0, 0, 559.2), (0, top, 559.2), (556, top, 559.2)),
            corners(top, 0, 0, 556, z0),
            corners(top, 0, z1, 556, 559.2),
            corners(top, 0, z0, x0, z1),
            corners(top, x1, z0, 556, z1),
        ]
    )
    materials = {
        "white": Material((0.725, 0.71, 0.68)),
        "red": Material((0.63, 0.065, 0.05)),
        "green": Material((0.14, 0.45, 0.091)),
    }
    meshes = [
        Mesh("white", white),
        Mesh("green", quad((0, 0, 559.2), (0, 0, 0), (0, top, 0), (0, top, 559.2))),
        Mesh("red", quad((552.8, 0, 0), (549.6, 0, 559.2), (556, top, 559.2), (556, top, 0))),
    ]
    more, meshes_inside = inside
    lamp = Lamp((x0, top, z0), ((x1 - x0, 0, 0), (0, 0, z1 - z0)), radiance)
    return Scene(
        name, (278, 273, -800), (278, 273, 0), 39.3077, {**materials, **more}, meshes + meshes_inside, [lamp]
    )


def cornell():
    """Matt surfaces that light each other."""
    short = [(130, 165, 65), (82, 165, 225), (240, 165, 272), (290, 165, 114)]
    tall = [(423, 330, 247), (265, 330, 296), (314, 330, 456), (472, 330, 406)]
    blocks = []
    for block in (short, tall):
        foot = [(x, 0, z) for x, _, z in block]
        blocks.append(quad(*block))
        for i in range(4):
            blocks.append(quad(block[i], foot[i], foot[i - 1], block[i - 1]))
    return room("cornell", ({}, [Mesh("white", np.concatenate(blocks))]))


def cornell_specular():
    """The same room with a mirror block, a ball of glass and a larger lamp, whose caustics are less noisy."""
    materials = {"silver": Material(mirror=(0.9, 0.85, 0.8)), "glass": Material(glass=1.5)}
    meshes = [
        Mesh("silver", box((290, 0, 250), (450, 330, 410), -30)),
        Mesh("glass", ball((180, 110, 190), 100)),
    ]
    return room("cornell-specular", (materials, meshes), ((143.0, 177.0), (413.0, 382.0)), (5.0, 4.5, 3.5))


def noise(width, height, seed, low=20, high=250):
    return np.random.default_rng(seed).integers(low, high, (height, width, 3), dtype=np.uint8)


def textures():
    """Pictures of few texels, looked up between them, repeated and across seams; direct light only, since bounces look up smaller
    sizes of pictures here and the largest in Mitsuba."""
    rows, columns = np.indices((8, 8))
    checker = np.where(((rows + columns) % 2 == 0)[..., None], [230, 200, 40], [30, 60, 160]).astype(np.uint8)
    ramp = np.stack([np.tile(np.linspace(10, 245, 16), (4, 1))] * 3, -1)
    ramp = (ramp * np.array([1.0, 0.6, 0.3])).astype(np.uint8)
    materials = {
        "tiles": Material(picture=checker),
        "noise": Material(picture=noise(13, 9, 5)),
        "ramp": Material(picture=ramp),
        "plain": Material((0.5, 0.5, 0.5)),
    }
    block = box((-1.5, 0, -0.6), (-0.3, 1.1, 0.6), 25)
    spot = box((0.6, 0, -0.2), (1.5, 0.7, 0.7), -15)
    meshes = [
        Mesh("tiles", quad((-3, 0, 3), (3, 0, 3), (3, 0, -3), (-3, 0, -3)), QUAD_UVS * 2.0 - 0.25),
        Mesh("noise", quad((-3, 0, -3), (3, 0, -3), (3, 4, -3), (-3, 4, -3)), QUAD_UVS * [1.5, 1.0]),
        Mesh("ramp", block, np.tile(QUAD_UVS, (6, 1, 1))),
        Mesh("plain", spot),
    ]
    lamp = Lamp((-0.75, 3.875, 1.25), ((1.5, 0, 0), (0, 0, 1.5)), (24.0, 23.0, 22.0))
    return Scene("textures", (0.6, 2.6, 5.2), (0.0, 0.9, -0.5), 42, materials, meshes, [lamp], bounces=False)


def sky(direction):
    """A dome that is bluer above, a ground and two wide suns; smooth, so that rows of pixels may lie where each renderer has them."""
    up = direction[..., 1:2]
    dome = np.array([0.35, 0.5, 0.8]) * (0.6 + 0.4 * up) + np.array([0.35, 0.25, 0.1]) * np.exp(-8 * up**2)
    result = dome + 0.2
    for toward, color, width in (((0.6, 0.55, 0.4), (14, 12, 9), 60.0), ((-0.8, 0.3, -0.3), (3, 1.2, 0.6), 25.0)):
        toward = np.array(toward) / np.linalg.norm(toward)
        result = result + np.array(color) * np.exp(width * (direction @ toward - 1))[..., None]
    return result


def environment():
    """A panorama that lights matt, rough, mirroring and refracting things, with bounces."""
    materials = {
        "floor": Material((0.6, 0.55, 0.5)),
        "clay": Material((0.7, 0.3, 0.2)),
        "silver": Material(mirror=(0.95, 0.9, 0.85)),
        "brushed": Material(mirror=(0.9, 0.6, 0.35), roughness=0.5),
        "glass": Material(glass=1.5),
    }
    meshes = [
        Mesh("floor", quad((-4, 0, 4), (4, 0, 4), (4, 0, -4), (-4, 0, -4))),
        Mesh("clay", box((-2.3, 0, -1.6), (-1.1, 1.3, -0.4), 30)),
        Mesh("brushed", ball((0.0, 0.81, -0.6), 0.8)),
        Mesh("silver", ball((1.8, 0.71, -0.9), 0.7)),
        Mesh("glass", ball((0.9, 0.51, 0.9), 0.5)),
    ]
    eye, look_at = (0.3, 2.4, 6.4), (0.1, 0.5, 0.0)
    return Scene("environment", eye, look_at, 38, materials, meshes, environment=sky)


SCENES = {make().name: make for make in (cornell, cornell_specular, textures, environment)}


def with_diffuse_times(scene, factor):
    """The same scene with every diffuse reflectance multiplied: what the comparison must find."""

    def scaled(material):
        picture = material.picture
        if picture is not None:
            linear = np.where(picture <= 10, picture / 255 / 12.92, ((picture / 255 + 0.055) / 1.055) ** 2.4) * factor
            picture = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
            picture = np.clip(picture * 255 + 0.5, 0, 255).astype(np.uint8)
        return replace(material, diffuse=tuple(factor * x for x in material.diffuse), picture=picture)

    return replace(scene, materials={name: scaled(material) for name, material in scene.materials.items()})
