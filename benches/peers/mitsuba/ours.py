"""Writes a scene as OBJ, MTL and a scene file, and has `render` make pictures of it."""

import subprocess
from pathlib import Path

import numpy as np

# Of the panorama; its radiance is smooth over many pixels.
PANORAMA = (512, 256)


def panorama_directions():
    """Unit vectors at the middles of the pixels: the middle column is -Z, columns go on to +X."""
    width, height = PANORAMA
    angle = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    polar = (np.arange(height) + 0.5)[:, None] / height * np.pi
    sine = np.sin(polar)
    return np.stack([sine * np.sin(angle), np.cos(polar) + 0 * angle, -sine * np.cos(angle)], -1)


def write(scene, folder, bitmap):
    """All but the scene file. `bitmap` makes something that can write pictures."""
    text, corner = ["mtllib scene.mtl"], 1
    meshes = list(scene.meshes)
    for mesh in meshes:
        text.append(f"usemtl {mesh.material}")
        for index, triangle in enumerate(mesh.corners):
            text += [f"v {x!r} {y!r} {z!r}" for x, y, z in triangle.tolist()]
            # Numbered with the corners, so every corner gets one.
            uvs = mesh.uvs[index] if mesh.uvs is not None else np.zeros((3, 2))
            text += [f"vt {u!r} {v!r}" for u, v in uvs.tolist()]
            text.append("f " + " ".join(f"{i}/{i}" for i in range(corner, corner + 3)))
            corner += 3
    # Lamps are no surfaces here: a black one behind each makes them what they are in Mitsuba.
    for lamp in scene.lamps:
        a, (u, v) = np.array(lamp.corner), np.array(lamp.edges)
        text.append("usemtl black")
        text += ["v {!r} {!r} {!r}".format(*map(float, point)) for point in (a, a + u, a + u + v, a + v)]
        text.append(f"f {corner} {corner + 1} {corner + 2}")
        text.append(f"f {corner} {corner + 2} {corner + 3}")
        corner += 4
    (folder / "scene.obj").write_text("\n".join(text) + "\n")

    text = ["newmtl black", "Kd 0 0 0"]
    for name, material in scene.materials.items():
        text.append(f"newmtl {name}")
        color = lambda key, rgb: text.append("{} {!r} {!r} {!r}".format(key, *map(float, rgb)))
        if material.picture is not None:
            bitmap(material.picture).write(str(folder / f"{name}.png"))
            color("Kd", (1, 1, 1))
            text.append(f"map_Kd {name}.png")
        else:
            color("Kd", material.diffuse)
        if material.mirror is not None:
            color("Ks", material.mirror)
            text.append("illum 3")
        if material.glass is not None:
            text += ["d 0", f"Ni {material.glass!r}"]
    (folder / "scene.mtl").write_text("\n".join(text) + "\n")
    if scene.environment is not None:
        bitmap(scene.environment(panorama_directions()).astype(np.float32)).write(str(folder / "sky.exr"))


def scene_file(scene, size, samples, seed):
    numbers = lambda values: "[" + ", ".join(repr(float(x)) for x in values) + "]"
    text = [
        "background = [0, 0, 0]",
        f"interreflection = {str(scene.bounces).lower()}",
        "[[model]]",
        'file = "scene.obj"',
        "[camera]",
        f"eye = {numbers(scene.eye)}",
        f"look_at = {numbers(scene.look_at)}",
        f"fov_degrees = {scene.fov!r}",
    ]
    for lamp in scene.lamps:
        text += [
            "[[light.rectangle]]",
            f"corner = {numbers(lamp.corner)}",
            f"edges = [{numbers(lamp.edges[0])}, {numbers(lamp.edges[1])}]",
            f"radiance = {numbers(lamp.radiance)}",
        ]
    if scene.environment is not None:
        text += ["[environment]", 'file = "sky.exr"']
    for name, material in scene.materials.items():
        if material.roughness > 0:
            text += [f"[finish.{name}]", f"roughness = {material.roughness!r}"]
    text += [
        "[settings]",
        f"size = [{size}, {size}]",
        f"samples = {samples}",
        'filter = "box"',
        f"seed = {seed}",
        # Nothing is cut: what ends paths is luck that keeps the mean.
        'path_end = "roulette"',
        "contribution_bound = 0.02",
        "work_budget = 1048576",
        'memory = "256MiB"',
    ]
    return "\n".join(text) + "\n"


def run(command):
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(map(str, command))} failed:\n{done.stderr}")


def pictures(scene, folder, render, size, samples, seeds, bitmap):
    write(scene, folder, bitmap)
    run([render, folder / "scene.obj", "--compile-only"])
    for seed in seeds:
        path = folder / "scene.toml"
        path.write_text(scene_file(scene, size, samples, seed))
        picture = folder / "ours.pfm"
        run([render, path, "-o", picture])
        yield read_pfm(picture)


def read_pfm(path):
    header, size, scale, data = Path(path).read_bytes().split(b"\n", 3)
    width, height = map(int, size.split())
    if header != b"PF" or float(scale) >= 0:
        raise SystemExit(f"{path} is not a picture that `render` wrote")
    return np.frombuffer(data, "<f4").reshape(height, width, 3)[::-1].astype(float)
