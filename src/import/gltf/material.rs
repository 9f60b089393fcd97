//! Metallic-roughness materials in the terms of MTL, in which the compiled file holds them.

use std::ops::Range;

use gltf::buffer::{self, View};
use gltf::image::Source;
use gltf::json::Value;
use gltf::material::AlphaMode;
use gltf::texture::{Info, WrappingMode};
use gltf::{Material, Texture};

use super::super::report::ImportReport;
use super::data_uri;
use super::document::Opened;
use crate::error::ImportError;
use crate::model::{ImageMap, MaterialImages, MaterialRecord};

/// The extension's name.
pub(super) const TEXTURE_TRANSFORM: &str = "KHR_texture_transform";

/// The material nearest to `material`, with the textures of base colour, normals, roughness, metalness and emission.
///
/// With base colour `c`, transmission `T` and refractive index `n` (appendix B of the specification): `Kd = c`,
/// `Ks = ((n - 1) / (n + 1))^2`, opacity is `1 - T` or, if blended, alpha. Metalness and roughness are the file's (roughness is
/// perceptual, `alpha = r^2`), and the Phong exponent follows from the roughness. What is metal mirrors the scene, what refracts is
/// frosted. Other dielectrics reflect by Fresnel, 4 % where they are faced: they have a highlight of that strength and mirror
/// nothing, so that matt things take no ray for the rest.
pub(super) fn record(
    opened: &Opened,
    material: &Material<'_>,
    report: &mut ImportReport,
) -> Result<MaterialRecord, ImportError> {
    let index = material.index().unwrap_or(0);
    let surface = material.pbr_metallic_roughness();
    let [red, green, blue, alpha] = surface.base_color_factor();
    // A negative colour would take light away; that of MTL is cut in the same way.
    let factor = [red, green, blue].map(|part| part.max(0.0));
    let metallic = surface.metallic_factor().clamp(0.0, 1.0);
    let roughness = surface.roughness_factor().clamp(0.0, 1.0);
    let transmission = material.transmission().map_or(0.0, |part| part.transmission_factor().clamp(0.0, 1.0));
    let stated = material.ior().filter(|&ior| {
        let is_possible = ior >= 1.0 || ior == 0.0;
        if !is_possible {
            let text =
                format!("materials[{index}]: its ior is {ior}, which must be 0 or at least 1; 1.5 is taken");
            report.warn_once(opened.path(), None, text);
        }
        is_possible
    });
    // 1.5 is what the specification gives dielectrics.
    let refractive_index = stated.unwrap_or(1.5);
    // 1 where it is 0, as the extension wants it.
    let facing = ((refractive_index - 1.0) / (refractive_index + 1.0)).powi(2);
    let opacity = match material.alpha_mode() {
        AlphaMode::Opaque => 1.0 - transmission,
        AlphaMode::Blend => alpha.clamp(0.0, 1.0) * (1.0 - transmission),
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
    let strength = material.emissive_strength().unwrap_or(1.0).max(0.0);
    let emission = material.emissive_factor().map(|part| part.max(0.0) * strength);
    let mut map = |texture: Texture<'_>, set: u32, transform: Option<&Value>| {
        image_map(opened, &texture, set, transform, report)
    };
    let mut of_info =
        |info: Info<'_>| map(info.texture(), info.tex_coord(), info.extension_value(TEXTURE_TRANSFORM));
    let finish = surface.metallic_roughness_texture();
    // A texture times nothing is not looked at.
    let finish = finish.filter(|_| roughness > 0.0 || metallic > 0.0).and_then(&mut of_info);
    let glow = material.emissive_texture().filter(|_| emission.iter().any(|part| *part > 0.0));
    let images = MaterialImages {
        diffuse: surface.base_color_texture().and_then(&mut of_info),
        roughness: finish.clone().filter(|_| roughness > 0.0),
        metalness: finish.filter(|_| metallic > 0.0),
        emission: glow.and_then(&mut of_info),
        normal: material.normal_texture().and_then(|info| {
            let transform = info.extension_value(TEXTURE_TRANSFORM);
            let map = map(info.texture(), info.tex_coord(), transform)?;
            Some(ImageMap { strength: info.scale(), ..map })
        }),
        ..MaterialImages::default()
    };
    let name = material.name().map_or_else(|| format!("material {index}"), str::to_string);
    let record = MaterialRecord {
        name,
        diffuse: factor,
        specular: [facing; 3],
        shininess: MaterialRecord::exponent_of(roughness),
        emission,
        opacity,
        transmission: through,
        // What does not bend light has 1 in MTL.
        refractive_index: if transmission > 0.0 { refractive_index.max(1.0) } else { 1.0 },
        mirror: false,
        roughness,
        metalness: metallic,
        exponent_by_roughness: true,
        images: (images != MaterialImages::default()).then(|| Box::new(images)),
    };
    let numbers = [record.diffuse, record.specular, record.emission, record.transmission];
    if numbers.iter().flatten().chain([&record.opacity, &refractive_index]).any(|number| !number.is_finite())
    {
        return Err(opened.error(format!("materials[{index}]"), "a factor is not finite"));
    }
    Ok(record)
}

/// The picture of a texture, unless it cannot be used: then a warning says why.
fn image_map(
    opened: &Opened,
    texture: &Texture<'_>,
    set: u32,
    transform: Option<&Value>,
    report: &mut ImportReport,
) -> Option<ImageMap> {
    let mut warn = |text: &str| report.warn_once(opened.path(), None, text.into());
    let Some(Lie { set, scale, offset }) = Lie::of(set, transform) else {
        warn("a texture that is turned, or whose transform makes no sense, is left out");
        return None;
    };
    if set != 0 {
        warn("a texture with texture coordinates of another set than the first is left out");
        return None;
    }
    let image = texture.source();
    let whole = match image.source() {
        Source::Uri { uri, .. } if data_uri::is_data(uri) => {
            inside_text(opened, &opened.image_texts, image.index())
        }
        Source::Uri { uri, .. } => opened.relative(uri).map(ImageMap::new),
        Source::View { view, .. } => image_inside(opened, &view),
    };
    let Some(whole) = whole else {
        warn(
            "a texture that is neither a file beside this one nor a part of one, nor data in base64, is left out",
        );
        return None;
    };
    let sampler = texture.sampler();
    let clamps = [sampler.wrap_s(), sampler.wrap_t()].map(|mode| mode == WrappingMode::ClampToEdge);
    if clamps[0] != clamps[1] || sampler.wrap_s() == WrappingMode::MirroredRepeat {
        warn("a texture that does not go on in both directions alike, or that is mirrored, is repeated");
    }
    Some(ImageMap { clamp: clamps == [true; 2], scale, offset, ..whole })
}

/// How a picture lies on a surface.
struct Lie {
    /// The set of texture coordinates.
    set: u32,
    scale: [f32; 2],
    offset: [f32; 2],
}

impl Lie {
    /// As a texture's own set and its `KHR_texture_transform` say; `None` for what an [`ImageMap`] cannot have.
    fn of(set: u32, transform: Option<&Value>) -> Option<Lie> {
        let Some(transform) = transform else { return Some(Lie { set, scale: [1.0; 2], offset: [0.0; 2] }) };
        let pair = |key: &str, default: f64| match transform.get(key) {
            None => Some([default; 2]),
            Some(pair) => match pair.as_array()?.as_slice() {
                [x, y] => Some([x.as_f64()?, y.as_f64()?]),
                _ => None,
            },
        };
        let ([x, y], [u, v]) = (pair("scale", 1.0)?, pair("offset", 0.0)?);
        let set = match transform.get("texCoord") {
            None => set,
            Some(other) => u32::try_from(other.as_u64()?).ok()?,
        };
        let is_turned = transform.get("rotation").is_some_and(|angle| angle.as_f64() != Some(0.0));
        // Texture coordinates of glTF go down from the top, those of MTL up from the bottom.
        let (scale, offset) = ([x, y].map(|x| x as f32), [u, 1.0 - y - v].map(|x| x as f32));
        let is_finite = scale.iter().chain(&offset).all(|number| number.is_finite());
        (is_finite && !is_turned).then_some(Lie { set, scale, offset })
    }
}

/// What the data URI of that number holds, if it is in base64.
fn inside_text(opened: &Opened, texts: &[Option<Range<u64>>], number: usize) -> Option<ImageMap> {
    Some(ImageMap::base64_inside(opened.file_name()?, texts.get(number)?.clone()?))
}

/// An image in a buffer that is a part of this file, or a file beside it. Whether it is one, and whether it is all there, is found out when
/// it is read.
fn image_inside(opened: &Opened, view: &View<'_>) -> Option<ImageMap> {
    let (file, begin) = match view.buffer().source() {
        buffer::Source::Bin => (opened.file_name()?.to_owned(), opened.chunk.as_ref()?.start),
        buffer::Source::Uri(uri) if data_uri::is_data(uri) => {
            (inside_text(opened, &opened.buffer_texts, view.buffer().index())?.path, 0)
        }
        buffer::Source::Uri(uri) => (opened.relative(uri)?, 0),
    };
    let start = begin.checked_add(view.offset() as u64)?;
    Some(ImageMap::inside(&file, start..start.checked_add(view.length() as u64)?))
}
