"""The same scene in Mitsuba 3."""

import numpy as np

from ours import PANORAMA


def correlated_bsdf(mi, dr):
    """Mitsuba's `roughconductor` masks facets from both sides independently, this library together (E. Heitz 2014, equation 99). This BSDF
    is Mitsuba's, times the quotient of the two."""

    class CorrelatedConductor(mi.BSDF):
        def __init__(self, props):
            mi.BSDF.__init__(self, props)
            self.alpha = props["alpha"]
            color = mi.ScalarColor3f(*[props[f"mirror_{c}"] for c in "rgb"])
            self.inner = mi.load_dict(
                {
                    "type": "roughconductor",
                    "material": "none",
                    "distribution": "ggx",
                    "alpha": self.alpha,
                    "specular_reflectance": {"type": "rgb", "value": color},
                }
            )
            self.m_components = [self.inner.flags()]
            self.m_flags = self.inner.flags()

        def quotient(self, wi, wo):
            def lambda_of(w):
                cos2 = dr.square(w.z)
                return 0.5 * (dr.sqrt(1 + self.alpha**2 * dr.maximum(1 - cos2, 0) / cos2) - 1)

            a, b = lambda_of(wi), lambda_of(wo)
            return (1 + a) * (1 + b) / (1 + a + b)

        def sample(self, ctx, si, sample1, sample2, active=True):
            result, weight = self.inner.sample(ctx, si, sample1, sample2, active)
            good = active & (result.pdf > 0)
            return result, dr.select(good, weight * self.quotient(si.wi, result.wo), 0)

        def eval(self, ctx, si, wo, active=True):
            value = self.inner.eval(ctx, si, wo, active)
            good = active & (si.wi.z > 0) & (wo.z > 0)
            return dr.select(good, value * self.quotient(si.wi, wo), 0)

        def pdf(self, ctx, si, wo, active=True):
            return self.inner.pdf(ctx, si, wo, active)

        def eval_pdf(self, ctx, si, wo, active=True):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self):
            return f"CorrelatedConductor[alpha={self.alpha}]"

    mi.register_bsdf("correlated", lambda props: CorrelatedConductor(props))


def material_of(mi, material):
    rgb = lambda values: {"type": "rgb", "value": list(map(float, values))}
    if material.glass is not None:
        return {"type": "dielectric", "int_ior": material.glass, "ext_ior": 1.0}
    if material.mirror is not None and material.roughness > 0:
        r, g, b = map(float, material.mirror)
        inner = {"type": "correlated", "alpha": material.roughness**2, "mirror_r": r, "mirror_g": g, "mirror_b": b}
    elif material.mirror is not None:
        inner = {"type": "conductor", "material": "none", "specular_reflectance": rgb(material.mirror)}
    elif material.picture is not None:
        # As this library does, it repeats pictures, interpolates between four texels, and decodes sRGB before that.
        picture = {"type": "bitmap", "bitmap": mi.Bitmap(material.picture), "format": "variant"}
        inner = {"type": "diffuse", "reflectance": picture}
    else:
        inner = {"type": "diffuse", "reflectance": rgb(material.diffuse)}
    return {"type": "twosided", "bsdf": inner}


def write_obj(path, corners, uvs):
    text = []
    for index, triangle in enumerate(corners):
        text += [f"v {x!r} {y!r} {z!r}" for x, y, z in triangle.tolist()]
        if uvs is not None:
            text += [f"vt {u!r} {v!r}" for u, v in uvs[index].tolist()]
        numbers = range(3 * index + 1, 3 * index + 4)
        text.append("f " + " ".join(f"{i}/{i}" if uvs is not None else f"{i}" for i in numbers))
    path.write_text("\n".join(text) + "\n")
    return {"type": "obj", "filename": str(path), "face_normals": True}


def panorama_directions():
    """Where Mitsuba has the pixels of an `envmap`: columns begin at -Z and go to +X, the first and the last row are the poles."""
    width, height = PANORAMA
    angle = (np.arange(width) + 0.5) / width * 2 * np.pi
    polar = np.arange(height)[:, None] / (height - 1) * np.pi
    sine = np.sin(polar)
    return np.stack([sine * np.sin(angle), np.cos(polar) + 0 * angle, -sine * np.cos(angle)], -1)


def translate(mi, scene, folder, size):
    depth = -1 if scene.bounces else 2
    result = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": depth},
        "sensor": {
            "type": "perspective",
            "fov": float(scene.fov),
            "fov_axis": "y",
            "to_world": mi.ScalarTransform4f().look_at(scene.eye, scene.look_at, (0, 1, 0)),
            "near_clip": 1e-2,
            "far_clip": 1e4,
            "film": {
                "type": "hdrfilm",
                "width": size,
                "height": size,
                "rfilter": {"type": "box"},
                "component_format": "float32",
            },
            "sampler": {"type": "independent"},
        },
    }
    for index, mesh in enumerate(scene.meshes):
        shape = write_obj(folder / f"theirs{index}.obj", mesh.corners, mesh.uvs)
        result[f"mesh{index}"] = {**shape, "bsdf": material_of(mi, scene.materials[mesh.material])}
    for index, lamp in enumerate(scene.lamps):
        a, (u, v) = np.array(lamp.corner, float), np.array(lamp.edges, float)
        corners = np.array([[a, a + u, a + u + v], [a, a + u + v, a + v]])
        result[f"lamp{index}"] = {
            **write_obj(folder / f"lamp{index}.obj", corners, None),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": list(map(float, lamp.radiance))}},
        }
    if scene.environment is not None:
        pixels = scene.environment(panorama_directions()).astype(np.float32)
        result["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(pixels)}
    return mi.load_dict(result)


def pictures(mi, scene, folder, size, samples, seeds):
    translated = translate(mi, scene, folder, size)
    for seed in seeds:
        yield np.array(mi.render(translated, spp=samples, seed=seed)).astype(float)[..., :3]
