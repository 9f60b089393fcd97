//! A query that knows what is on surfaces: it reads attributes and textures, and passes by where a surface is cut out.
//!
//! A cut-out is geometry to all above: neither camera rays nor bounces nor shadows see what is not there. Whether a hit is cut out is a
//! pure function of triangle and place, looked up in the largest size of the picture, so every ray finds the same. A ray goes
//! on behind it in the order of (t, triangle id), so that nothing is lost or met twice.

use super::forced::STAND_IN_UVS;
use super::maps::{CutOut, MaterialMaps, Placed};
use crate::access::BlockSketch;
use crate::block::attributes::CornerAttributes;
use crate::error::{LoadError, TraceError};
use crate::geom::Ray;
use crate::render::query::RayQuery;
use crate::render::stage::Stage;
use crate::stats::TraceCounters;
use crate::texture::TextureReader;
use crate::trace::{Hit, MaterialSet, Occlusion};
use crate::units::TriangleId;

/// What was looked up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct DetailCounters {
    /// Hits whose triangle was asked for the attributes of its corners.
    pub attribute_lookups: u64,
    /// Lookups in pictures of colours.
    pub texture_reads: u64,
    /// Hits of which it was asked whether they are cut out, and those that are.
    pub cutout_tests: u64,
    pub cutouts_passed: u64,
    /// Queries that carried rays on behind them.
    pub cutout_rays: u64,
    /// Lookups in pictures of heights and normals.
    pub bump_reads: u64,
    /// Lookups in pictures of roughness and metalness.
    pub finish_reads: u64,
    /// Lookups of any kind, and queries, of forced effects.
    pub forced_lookups: u64,
    pub forced_rays: u64,
}

/// See the module's text.
pub(crate) struct SurfaceQuery<'s, Q> {
    stage: &'s Stage,
    pub geometry: Q,
    textures: Option<TextureReader<'s>>,
    pub counters: DetailCounters,
    /// Rays on their way behind cut-outs: which of the call's, the ray, and the hit that it passed.
    places: Vec<u32>,
    rays: Vec<Ray>,
    after: Vec<(f64, TriangleId)>,
    hits: Vec<Option<Hit>>,
    /// When the rays of the call are traced, if instances move.
    times: Vec<f64>,
}

impl<Q> SurfaceQuery<'_, Q> {
    /// What the lists take at most for calls of `count` rays.
    pub fn bytes_needed(stage: &Stage, count: usize) -> usize {
        let per_ray =
            size_of::<u32>() + size_of::<Ray>() + size_of::<(f64, TriangleId)>() + size_of::<Option<Hit>>();
        // Vectors double as they grow.
        if stage.cut_outs.is_some() { 4 * count * per_ray } else { 0 }
    }
}

impl<'s, Q: RayQuery> SurfaceQuery<'s, Q> {
    pub fn new(stage: &'s Stage, geometry: Q) -> SurfaceQuery<'s, Q> {
        SurfaceQuery {
            stage,
            geometry,
            textures: stage.textures.as_deref().map(|cache| cache.reader()),
            counters: DetailCounters::default(),
            places: Vec::new(),
            rays: Vec::new(),
            after: Vec::new(),
            hits: Vec::new(),
            times: Vec::new(),
        }
    }

    /// The attributes of the triangle of a hit.
    pub fn attributes(&mut self, hit: &Hit) -> Result<CornerAttributes, TraceError> {
        self.counters.attribute_lookups += 1;
        self.geometry.corner_attributes(hit.triangle)
    }

    /// [`SurfaceQuery::attributes`] for a forced effect.
    pub(super) fn forced_attributes(&mut self, hit: &Hit) -> Result<CornerAttributes, TraceError> {
        self.counters.forced_lookups += 1;
        self.geometry.corner_attributes(hit.triangle)
    }

    /// Whether surfaces are asked for cut-outs although there are none.
    fn forces_cut_outs(&self) -> bool {
        self.stage.forced_details.is_some_and(|forced| forced.cut_outs)
    }

    /// A picture at texture coordinates. Black where there are no pictures at all.
    pub fn look_up(&mut self, map: &Placed, uv: [f64; 2], level: f64) -> Result<[f64; 4], LoadError> {
        match &mut self.textures {
            Some(reader) => reader.sample(map.texture, map.coordinates(uv), level, map.address),
            None => Ok([0.0; 4]),
        }
    }

    /// Whether the surface is not there at a hit.
    pub(in crate::render) fn is_cut_out(&mut self, hit: &Hit) -> Result<bool, TraceError> {
        let MaterialMaps { cut_out, .. } = *self.stage.maps(hit.material);
        let Some(CutOut { map, channel, threshold }) = cut_out else { return Ok(false) };
        if self.forces_cut_outs() {
            let uvs = self.forced_attributes(hit)?.uvs.unwrap_or(STAND_IN_UVS);
            self.counters.forced_lookups += 1;
            return Ok(self.look_up(&map, interpolate(&uvs, hit), 0.0)?[channel] < threshold);
        }
        self.counters.cutout_tests += 1;
        let Some(uvs) = self.attributes(hit)?.uvs else { return Ok(false) };
        let texel = self.look_up(&map, interpolate(&uvs, hit), 0.0)?;
        let is_cut = texel[channel] < threshold;
        self.counters.cutouts_passed += u64::from(is_cut);
        Ok(is_cut)
    }

    /// Takes every ray of a call on until it has a hit on something that is there, or none.
    fn pass_cut_outs(&mut self, rays: &[Ray], hits: &mut [Option<Hit>]) -> Result<(), TraceError> {
        self.forget();
        for (place, (ray, hit)) in (0u32..).zip(rays.iter().zip(hits.iter())) {
            if let Some(hit) = hit
                && self.is_cut_out(hit)?
            {
                self.put(place, ray, (hit.t, hit.triangle));
            }
        }
        self.walk(|place, hit, is_cut_out| {
            if !is_cut_out {
                hits[place as usize] = hit.copied();
            }
            is_cut_out
        })
    }

    /// What really lies between the ends of rays of which it is known that they meet cut-out or ignored materials only.
    fn occluded_behind_cut_outs(
        &mut self,
        rays: &[Ray],
        ignore: Option<&MaterialSet>,
        out: &mut [Occlusion],
    ) -> Result<(), TraceError> {
        self.forget();
        for (place, (ray, occlusion)) in (0u32..).zip(rays.iter().zip(out.iter_mut())) {
            if *occlusion == Occlusion::Filtered {
                *occlusion = Occlusion::Clear;
                // NaN: from the first hit on.
                self.put(place, ray, (f64::NAN, TriangleId(0)));
            }
        }
        self.walk(|place, hit, is_cut_out| {
            let Some(hit) = hit else { return false };
            if is_cut_out {
                return true;
            }
            let is_ignored = ignore.is_some_and(|ignore| ignore.contains(hit.material));
            out[place as usize] = if is_ignored { Occlusion::Filtered } else { Occlusion::Blocked };
            is_ignored
        })
    }

    /// Nothing is on its way.
    fn forget(&mut self) {
        self.places.clear();
        self.rays.clear();
        self.after.clear();
    }

    /// Sets a ray of the call on its way, from behind a hit.
    fn put(&mut self, place: u32, ray: &Ray, after: (f64, TriangleId)) {
        self.places.push(place);
        self.rays.push(*ray);
        self.after.push(after);
    }

    /// Tells `goes_on` the next hit of each ray on its way, if there is one, and whether it is cut out; behind a hit of which it
    /// gives true, the ray goes on.
    fn walk(&mut self, mut goes_on: impl FnMut(u32, Option<&Hit>, bool) -> bool) -> Result<(), TraceError> {
        while !self.places.is_empty() {
            let count = self.places.len();
            let are_forced = self.forces_cut_outs();
            let counters = &mut self.counters;
            *if are_forced { &mut counters.forced_rays } else { &mut counters.cutout_rays } += count as u64;
            self.hits.resize(self.hits.len().max(count), None);
            if !self.times.is_empty() {
                let times = &self.times;
                self.geometry.at_times(&mut self.places.iter().map(|place| times[*place as usize]));
            }
            self.geometry.closest_hits_after(&self.rays, &self.after, &mut self.hits[..count])?;
            let mut left = 0;
            for index in 0..count {
                let found = self.hits[index];
                let is_cut_out = match &found {
                    Some(hit) => self.is_cut_out(hit)?,
                    None => false,
                };
                let place = self.places[index];
                if goes_on(place, found.as_ref(), is_cut_out)
                    && let Some(hit) = found
                {
                    self.places[left] = place;
                    self.rays[left] = self.rays[index];
                    self.after[left] = (hit.t, hit.triangle);
                    left += 1;
                }
            }
            self.places.truncate(left);
            self.rays.truncate(left);
            self.after.truncate(left);
        }
        Ok(())
    }
}

/// Texture coordinates at a hit.
pub(super) fn interpolate(uvs: &[[f32; 2]; 3], hit: &Hit) -> [f64; 2] {
    let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];
    [0, 1].map(|axis| {
        let [a, b, c] = uvs.map(|uv| f64::from(uv[axis]));
        weights[0] * a + weights[1] * b + weights[2] * c
    })
}

impl<Q: RayQuery> RayQuery for SurfaceQuery<'_, Q> {
    fn closest_hits(&mut self, rays: &[Ray], hits: &mut [Option<Hit>]) -> Result<(), TraceError> {
        self.geometry.closest_hits(rays, hits)?;
        if self.stage.cut_outs.is_some() { self.pass_cut_outs(rays, hits) } else { Ok(()) }
    }

    fn closest_hits_after(
        &mut self,
        rays: &[Ray],
        after: &[(f64, TriangleId)],
        hits: &mut [Option<Hit>],
    ) -> Result<(), TraceError> {
        self.geometry.closest_hits_after(rays, after, hits)?;
        if self.stage.cut_outs.is_some() { self.pass_cut_outs(rays, hits) } else { Ok(()) }
    }

    fn occluded(
        &mut self,
        rays: &[Ray],
        ignore: Option<&MaterialSet>,
        out: &mut [Occlusion],
    ) -> Result<(), TraceError> {
        let stage = self.stage;
        let Some(cut_outs) = &stage.cut_outs else { return self.geometry.occluded(rays, ignore, out) };
        // All that may be passed; what is passed is looked at one by one.
        let passed = match ignore {
            Some(_) => &cut_outs.or_transparent,
            None => &cut_outs.materials,
        };
        self.geometry.occluded(rays, Some(passed), out)?;
        self.occluded_behind_cut_outs(rays, ignore, out)
    }

    fn at_times(&mut self, times: &mut dyn Iterator<Item = f64>) {
        // Where nothing is cut out, no ray goes on by itself.
        if self.stage.cut_outs.is_none() {
            return self.geometry.at_times(times);
        }
        self.times.clear();
        self.times.extend(times);
        self.geometry.at_times(&mut self.times.iter().copied());
    }

    fn at_time(&mut self, time: f64) {
        self.geometry.at_time(time);
    }

    fn corner_attributes(&mut self, triangle: TriangleId) -> Result<CornerAttributes, TraceError> {
        self.geometry.corner_attributes(triangle)
    }

    fn may_have_normals(&self, triangle: TriangleId) -> bool {
        self.geometry.may_have_normals(triangle)
    }

    fn counters(&self) -> TraceCounters {
        self.geometry.counters()
    }

    fn take_touched(&mut self) -> BlockSketch {
        self.geometry.take_touched()
    }
}
