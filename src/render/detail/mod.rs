//! What a hit looks like beyond its triangle and its material: the part of shading that reads attributes of corners and pictures.
//!
//! Only the *Detailed* path loop comes here ([`super::hot`]), and only for materials that show a difference; and shadow rays of any
//! loop that pass what is metal in places. Cut-outs are decided before, in [`query`].

mod bump;
pub(super) mod forced;
pub(super) mod maps;
pub(super) mod normals;
pub(super) mod query;

use glam::DVec3;

use self::bump::{Bend, TextureFrame};
use self::maps::{MaterialMaps, Placed};
use self::normals::smooth;
use self::query::{SurfaceQuery, interpolate};
use super::counters::EffectCounters;
use super::query::RayQuery;
use super::stage::{Shader, Stage};
use crate::error::TraceError;
use crate::scene::{Look, METALNESS_CHANNEL, ROUGHNESS_CHANNEL, Variation};
use crate::trace::Hit;

/// How wide a ray is where it begins, and how much wider it becomes along a unit of its way: what of a picture it sees at once.
///
/// T. Akenine-Moller and others, "Texture Level of Detail Strategies for Real-Time Ray Tracing", Ray Tracing Gems, 2019, section
/// 20.3.4, without the curvature of surfaces.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Cone {
    pub width: f64,
    pub spread: f64,
}

impl Cone {
    /// What a diffuse bounce sees: so wide that small sizes of pictures do.
    const BOUNCE_SPREAD: f64 = 0.5;

    pub fn width_at(self, t: f64) -> f64 {
        self.width + self.spread * t
    }

    /// From a hit at `t` on, by a lobe of a certain roughness, or by a diffuse bounce.
    pub fn on(self, t: f64, alpha: f64, is_bounce: bool) -> Cone {
        let least = if is_bounce { Self::BOUNCE_SPREAD } else { alpha.min(Self::BOUNCE_SPREAD) };
        Cone { width: self.width_at(t), spread: self.spread.max(least) }
    }
}

/// See the module's text.
#[derive(Clone, Copy, Debug)]
pub(super) struct Detail {
    /// The unit normal that light falls on.
    pub normal: DVec3,
    /// From the triangle to where rays on the side that is seen begin, beside their offset.
    pub lift: DVec3,
    /// The material's terms at this place, if they are others than elsewhere.
    pub shader: Option<Shader>,
    /// What forced effects found: to be multiplied by zero. Finite.
    pub forced: DVec3,
}

/// How a triangle is seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// The triangle's unit normal, on the side of `view`.
    pub geometric: DVec3,
    /// Whether that is not the front side.
    pub is_behind: bool,
    /// Unit, back along the ray.
    pub view: DVec3,
    /// Width of the ray's cone.
    pub width: f64,
}

impl Detail {
    pub fn at<Q: RayQuery>(
        stage: &Stage,
        query: &mut SurfaceQuery<'_, Q>,
        counters: &mut EffectCounters,
        hit: &Hit,
        shader: &Shader,
        seen: &Seen,
    ) -> Result<Detail, TraceError> {
        let mut detail =
            Detail { normal: seen.geometric, lift: DVec3::ZERO, shader: None, forced: DVec3::ZERO };
        if let Some(forced) = &stage.forced_details {
            detail.forced = forced.work(query, hit, seen)?;
        }
        let maps = stage.maps(hit.material);
        let is_smooth = stage.is_smooth(shader) && query.may_have_normals(hit.triangle);
        if !(is_smooth || maps.are_seen()) {
            return Ok(detail);
        }
        let attributes = query.attributes(hit)?;
        if is_smooth && let Some(normals) = &attributes.normals {
            counters.smooth_hits += 1;
            let found = smooth(hit, normals, seen.geometric, seen.view);
            (detail.normal, detail.lift) = (found.normal, found.lift);
        }
        let Some(uvs) = attributes.uvs.filter(|_| maps.are_seen()) else {
            if maps.change_finish() {
                detail.shader = Some(local_terms(maps, query, shader, None, |_| f64::INFINITY)?);
            }
            return Ok(detail);
        };
        let uv = interpolate(&uvs, hit);
        let frame = TextureFrame::of(hit, &uvs);
        let level = |map: &Placed| frame.as_ref().map_or(0.0, |frame| level(map, frame, seen));
        if maps.change_terms() {
            detail.shader = Some(local_terms(maps, query, shader, Some(uv), level)?);
        }
        if let Some(frame) = &frame
            && shader.depends_on_normal
        {
            let is_behind = seen.is_behind;
            let front = if is_behind { -detail.normal } else { detail.normal };
            let bend = Bend { frame, uv, front, is_behind, view: seen.view };
            let bent = match (&maps.normal, &maps.bump) {
                (Some(map), _) => bend.by_normals(map, level(map), query)?,
                (None, Some(map)) => bend.by_heights(map, level(map), query)?,
                (None, None) => None,
            };
            detail.normal = bent.unwrap_or(detail.normal);
        }
        Ok(detail)
    }
}

/// The share of light that passes straight through a hit, for shadows: the material's, unless a picture says that it is metal in
/// places. Shadow rays have no width: the picture is looked up in its largest size.
///
/// # Errors
/// Those of the query.
pub(super) fn transmission_at<Q: RayQuery>(
    stage: &Stage,
    query: &mut SurfaceQuery<'_, Q>,
    hit: &Hit,
) -> Result<f64, TraceError> {
    let (shader, maps) = (stage.shader(hit.material), stage.maps(hit.material));
    let (Some(mixture), Some(map)) = (&maps.mixture, &maps.metalness) else {
        return Ok(shader.transmission_max);
    };
    if shader.transmission_max == 0.0 || !mixture.transmits_by_metalness() {
        return Ok(shader.transmission_max);
    }
    let uv = query.attributes(hit)?.uvs.map(|uvs| interpolate(&uvs, hit));
    query.counters.finish_reads += 1;
    let level = if uv.is_some() { 0.0 } else { f64::INFINITY };
    let texel = query.look_up(map, uv.unwrap_or_default(), level)?;
    let share = share(Some(texel), METALNESS_CHANNEL, maps.variation.metalness);
    Ok(mixture.transmission_at(mixture.metalness * share))
}

/// What a lookup says, within what bounds on light were told, whatever is in a file; all of the factor without one.
fn share(numbers: Option<[f64; 4]>, channel: usize, range: Option<[f64; 2]>) -> f64 {
    let [least, most] = range.unwrap_or([0.0, 1.0]);
    numbers.map_or(1.0, |numbers| numbers[channel].max(least).min(most))
}

/// The terms of a material at texture coordinates; `level` says in which size a picture is looked up. Where a triangle has no
/// coordinates, colours are not looked up, and roughness and metalness are those of its smallest size, the mean: so they are
/// between its least and its greatest number wherever a ray may go.
fn local_terms<Q: RayQuery>(
    maps: &MaterialMaps,
    query: &mut SurfaceQuery<'_, Q>,
    shader: &Shader,
    uv: Option<[f64; 2]>,
    level: impl Fn(&Placed) -> f64,
) -> Result<Shader, TraceError> {
    let mut local = *shader;
    let mut color = |map: &Option<Placed>| -> Result<DVec3, TraceError> {
        let (Some(map), Some(uv)) = (map, uv) else { return Ok(DVec3::ONE) };
        query.counters.texture_reads += 1;
        let [red, green, blue, _] = query.look_up(map, uv, level(map))?;
        Ok(DVec3::new(red, green, blue))
    };
    let (diffuse, specular) = (color(&maps.diffuse)?, color(&maps.specular)?);
    if maps.emission.is_some() {
        local.emission *= color(&maps.emission)?;
        local.glows = local.emission != DVec3::ZERO;
    }
    let Some(mixture) = &maps.mixture else {
        local.diffuse *= diffuse;
        local.mirror *= specular;
        local.highlight *= specular;
        local.area_highlight *= specular;
        return Ok(local);
    };
    let mut numbers = |map: &Placed| -> Result<[f64; 4], TraceError> {
        query.counters.finish_reads += 1;
        Ok(query.look_up(map, uv.unwrap_or_default(), level(map))?)
    };
    let roughness = maps.roughness.as_ref().map(&mut numbers).transpose()?;
    let metalness = match &maps.metalness {
        // glTF has both in one image.
        both if *both == maps.roughness => roughness,
        other => other.as_ref().map(&mut numbers).transpose()?,
    };
    let Variation { metalness: metal, roughness: rough } = maps.variation;
    local.mix(&mixture.at(&Look {
        diffuse,
        specular,
        metalness: mixture.metalness * share(metalness, METALNESS_CHANNEL, metal),
        roughness: mixture.roughness * share(roughness, ROUGHNESS_CHANNEL, rough),
    }));
    Ok(local)
}

/// The size of a picture whose texels are as wide as the ray.
fn level(map: &Placed, frame: &TextureFrame, seen: &Seen) -> f64 {
    let [uv_area, area] = frame.areas;
    let [across, down] = map.density();
    let texels = (uv_area * (across * down).abs() / area).sqrt();
    // The ray's foot is longer the flatter it meets the surface.
    let cosine = seen.geometric.dot(seen.view).abs().max(1e-3);
    libm::log2(seen.width * texels / cosine)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cones_grow_along_the_way_and_by_lobes() {
        let cone = Cone { width: 0.5, spread: 0.01 };
        assert_eq!(cone.width_at(50.0), 1.0);
        let mirror = cone.on(50.0, 0.0, false);
        assert_eq!((mirror.width, mirror.spread), (1.0, 0.01));
        assert_eq!(cone.on(50.0, 0.2, false).spread, 0.2);
        assert_eq!(cone.on(50.0, 0.0, true).spread, Cone::BOUNCE_SPREAD);
    }
}
