//! Bumps: pictures of heights or of normals bend the normal that light falls on.

use glam::DVec3;

use super::maps::Placed;
use super::normals::facing;
use super::query::SurfaceQuery;
use crate::error::TraceError;
use crate::render::query::RayQuery;
use crate::trace::Hit;

/// The directions in which texture coordinates grow on a triangle, and how much of them there is.
#[derive(Clone, Copy, Debug)]
pub(super) struct TextureFrame {
    /// Movement per unit of u, and of v.
    along: [DVec3; 2],
    /// Twice the triangle's area in texture coordinates, and in space.
    pub areas: [f64; 2],
}

impl TextureFrame {
    /// None if the texture coordinates of the corners lie on a line.
    pub fn of(hit: &Hit, uvs: &[[f32; 2]; 3]) -> Option<TextureFrame> {
        let [a, b, c] = hit.vertices.map(DVec3::from_array);
        let (first, second) = (b - a, c - a);
        let [uv_a, uv_b, uv_c] = uvs.map(|uv| uv.map(f64::from));
        let step = |to: [f64; 2]| [to[0] - uv_a[0], to[1] - uv_a[1]];
        let ([du1, dv1], [du2, dv2]) = (step(uv_b), step(uv_c));
        let determinant = du1 * dv2 - du2 * dv1;
        let along_u = (first * dv2 - second * dv1) / determinant;
        let along_v = (second * du1 - first * du2) / determinant;
        let is_sound = along_u.is_finite() && along_v.is_finite();
        let areas = [determinant.abs(), first.cross(second).length()];
        is_sound.then_some(TextureFrame { along: [along_u, along_v], areas })
    }

    /// Unit vectors along u and v in the plane of `normal`, v on the side where it grows.
    fn tangents(&self, normal: DVec3) -> Option<[DVec3; 2]> {
        let [u, v] = self.along;
        let u = (u - normal * normal.dot(u)).try_normalize()?;
        let across = normal.cross(u);
        Some([u, if across.dot(v) < 0.0 { -across } else { across }])
    }
}

/// What a bent normal is made from.
pub(super) struct Bend<'f> {
    pub frame: &'f TextureFrame,
    pub uv: [f64; 2],
    /// The normal of the front side, and whether that is not the side that is seen.
    pub front: DVec3,
    pub is_behind: bool,
    pub view: DVec3,
}

impl Bend<'_> {
    /// By a picture of normals: red along u, green along v, blue away from the surface, 0 to 1 for -1 to 1.
    pub fn by_normals<Q: RayQuery>(
        &self,
        map: &Placed,
        level: f64,
        query: &mut SurfaceQuery<'_, Q>,
    ) -> Result<Option<DVec3>, TraceError> {
        let Some([u, v]) = self.frame.tangents(self.front) else { return Ok(None) };
        query.counters.bump_reads += 1;
        let [x, y, z, _] = query.look_up(map, self.uv, level)?.map(|channel| 2.0 * channel - 1.0);
        Ok(self.seen((u * x + v * y) * map.strength + self.front * z))
    }

    /// By a picture of heights: from black to white over one texel is a slope of the map's strength.
    pub fn by_heights<Q: RayQuery>(
        &self,
        map: &Placed,
        level: f64,
        query: &mut SurfaceQuery<'_, Q>,
    ) -> Result<Option<DVec3>, TraceError> {
        let Some([u, v]) = self.frame.tangents(self.front) else { return Ok(None) };
        // One texel of the size that is looked up, to either side.
        let texels = libm::exp2(level.max(0.0));
        // A picture may be laid on turned around; a step is one along the surface all the same.
        let density = map.density().map(f64::abs);
        let mut slopes = [0.0; 2];
        for (axis, slope) in slopes.iter_mut().enumerate() {
            if density[axis] == 0.0 {
                continue;
            }
            let mut height = |side: f64| -> Result<f64, TraceError> {
                let mut uv = self.uv;
                uv[axis] += side * texels / density[axis];
                query.counters.bump_reads += 1;
                Ok(query.look_up(map, uv, level)?[0])
            };
            *slope = map.strength * (height(1.0)? - height(-1.0)?) / (2.0 * texels);
        }
        Ok(self.seen(self.front - u * slopes[0] - v * slopes[1]))
    }

    /// A normal of the front side, on the side that is seen.
    fn seen(&self, front: DVec3) -> Option<DVec3> {
        let normal = front.try_normalize()?;
        Some(facing(if self.is_behind { -normal } else { normal }, self.view))
    }
}
