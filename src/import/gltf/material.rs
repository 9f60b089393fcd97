//! Metallic-roughness materials in the terms of MTL, in which the compiled file holds them.

use gltf::Material;
use gltf::material::AlphaMode;

use super::super::report::ImportReport;
use super::document::Opened;
use crate::error::ImportError;
use crate::model::MaterialRecord;

/// Metals smoother than this mirror the scene; rougher ones only have a highlight.
const MIRROR_ROUGHNESS_MAX: f32 = 0.25;

/// The material nearest to `material`. Its textures are not read: their factors stand alone.
///
/// With base colour `c`, metalness `m`, roughness `r`, transmission `T` and refractive index `n` (appendix B of the
/// specification): `Kd = c (1 - m) (1 - T)`, `Ks = f (1 - m) + c m` with `f = ((n - 1) / (n + 1))^2`, the Phong exponent is
/// `2 / r^4 - 2`, opacity is `1 - T` or, if blended, alpha.
pub(super) fn record(
    opened: &Opened,
    material: &Material<'_>,
    report: &mut ImportReport,
) -> Result<MaterialRecord, ImportError> {
    let index = material.index().unwrap_or(0);
    let surface = material.pbr_metallic_roughness();
    let [red, green, blue, alpha] = surface.base_color_factor();
    let (color, metallic) = ([red, green, blue], surface.metallic_factor().clamp(0.0, 1.0));
    let roughness = surface.roughness_factor().clamp(0.0, 1.0);
    let transmission = material.transmission().map_or(0.0, |part| part.transmission_factor().clamp(0.0, 1.0));
    // 1.5 is what the specification gives dielectrics.
    let refractive_index = material.ior().unwrap_or(1.5);
    let facing = ((refractive_index - 1.0) / (refractive_index + 1.0)).powi(2);
    let opacity = match material.alpha_mode() {
        AlphaMode::Opaque => 1.0 - transmission * (1.0 - metallic),
        AlphaMode::Blend => alpha.clamp(0.0, 1.0) * (1.0 - transmission * (1.0 - metallic)),
        AlphaMode::Mask if alpha < material.alpha_cutoff().unwrap_or(0.5) => 0.0,
        AlphaMode::Mask => 1.0,
    };
    let through = material.volume().map_or([1.0; 3], |volume| {
        let distance = volume.attenuation_distance();
        volume.attenuation_color().map(|color| match distance.is_finite() && distance > 0.0 {
            true => color.clamp(0.0, 1.0).powf(1.0 / distance),
            false => 1.0,
        })
    });
    let emission = material.emissive_factor().map(|part| part * material.emissive_strength().unwrap_or(1.0));
    if surface.base_color_texture().is_some()
        || surface.metallic_roughness_texture().is_some()
        || material.normal_texture().is_some()
        || material.emissive_texture().is_some()
    {
        report.warn_once(opened.path(), None, "textures are not read; their factors stand alone".into());
    }
    let name = material.name().map_or_else(|| format!("material {index}"), str::to_string);
    let record = MaterialRecord {
        name,
        diffuse: color.map(|part| part * (1.0 - metallic) * (1.0 - transmission)),
        specular: color.map(|part| facing * (1.0 - metallic) + part * metallic),
        // An exponent beyond a million is a mirror's.
        shininess: (2.0 / roughness.powi(4) - 2.0).clamp(1.0, 1e6),
        emission,
        opacity,
        transmission: through,
        // What does not bend light has 1 in MTL.
        refractive_index: if transmission > 0.0 { refractive_index } else { 1.0 },
        mirror: metallic > 0.5 && roughness <= MIRROR_ROUGHNESS_MAX,
    };
    let numbers = [record.diffuse, record.specular, record.emission, record.transmission];
    if numbers.iter().flatten().chain([&record.opacity, &refractive_index]).any(|number| !number.is_finite())
    {
        return Err(opened.error(format!("materials[{index}]"), "a factor is not finite"));
    }
    Ok(record)
}
