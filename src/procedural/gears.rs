//! Toothed wheels that mesh, in layers above a mirror: the family of test scenes with any number of triangles.
//!
//! It is of the kind of the "gears" scene of Eric Haines' Standard Procedural Databases ("A Proposal for
//! Standard Graphics Environments", IEEE CG&A 7(11), 1987) with the same counts, layout and standard view.

use super::Shape;
use super::tessellation::{Pattern, Tessellation};
use crate::error::CompileError;
use crate::import::MeshSink;
use crate::model::MaterialRecord;
use crate::units::MaterialId;

/// `n` x `n` x `n` wheels above one floor.
///
/// The floor is the square -2 ..= 2 at z = 0. The wheels lie in `n` layers of `n` x `n`, axis along z, inside -1 ..= 1 in
/// x and y and 0 ..= 1 in z; each meshes with its neighbours in the layer and none touches another. Each wheel is a
/// closed surface of 572 coarse triangles, the floor is 2; each of them is cut by the [`Tessellation`].
///
/// Materials: 0 the floor (a mirror in part), 1 glass (about every third wheel), 2 to 13 opaque colours.
///
/// The standard view is from [`Gears::EYE`] at the origin, up z, 45 degrees vertically, with point lights at [`Gears::LAMPS`].
///
/// ```
/// use outcrop::procedural::{Gears, Shape};
/// assert_eq!(Gears::new(1)?.triangle_count(), 27_552);
/// assert_eq!(Gears::new(8)?.triangle_count(), 14_057_568);
/// # Ok::<(), outcrop::error::CompileError>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Gears {
    n: u32,
    tessellation: Tessellation,
}

const TEETH: u32 = 36;
/// Corners of a wheel's outline: four per tooth.
const OUTLINE: u32 = 4 * TEETH;
const WHEEL_TRIANGLES: u64 = 4 * OUTLINE as u64 - 4;
const FLOOR: [[f32; 3]; 4] = [[-2.0, -2.0, 0.0], [2.0, -2.0, 0.0], [2.0, 2.0, 0.0], [-2.0, 2.0, 0.0]];
const FLOOR_TRIANGLES: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];
const COLOURS: u32 = 12;

/// Tooth shape in pitch radii: a tooth reaches `ADDENDUM` beyond the pitch circle, a gap `DEDENDUM` inside it.
const ADDENDUM: f64 = 1.0 / 18.0;
const DEDENDUM: f64 = 1.25 / 18.0;
/// Half the angle that a tooth takes at its foot and at its tip, as a part of the angle from tooth to tooth.
const FOOT: f64 = 0.30;
const TIP: f64 = 0.14;

impl Gears {
    /// The eye of the standard view.
    pub const EYE: [f64; 3] = [-1.1, -2.1, 2.6];
    /// The point lights of the standard view.
    pub const LAMPS: [[f64; 3]; 5] =
        [[2.0, 4.0, 4.0], [-2.0, 4.0, 3.0], [2.0, -2.5, 2.5], [-1.0, -4.0, 2.0], [-1.111, -2.121, 2.626]];

    /// The standard tessellation: 27,456 `n`^3 + 96 triangles.
    ///
    /// # Errors
    /// [`CompileError::Limit`] if `n` is 0 or the vertices cannot be numbered with 32 bits (`n` > 67).
    pub fn new(n: u32) -> Result<Gears, CompileError> {
        Gears::with_tessellation(n, Tessellation::STANDARD)
    }

    /// 572 `n`^3 + 2 coarse triangles, each cut by `tessellation`.
    ///
    /// # Errors
    /// [`CompileError::Limit`] if `n` is 0 or the vertices cannot be numbered with 32 bits.
    pub fn with_tessellation(n: u32, tessellation: Tessellation) -> Result<Gears, CompileError> {
        let limit = |reason: &str| CompileError::Limit { reason: reason.to_string() };
        if n == 0 {
            return Err(limit("gears need at least one wheel: choose n = 1 or more"));
        }
        // 1,024 wheels per edge are past the limit at any tessellation; the sums below cannot overflow under it.
        if n > 1024 || vertex_count(n, tessellation) > u64::from(u32::MAX) {
            return Err(limit(
                "the vertices of these gears cannot be numbered with 32 bits: choose a smaller n or tessellation",
            ));
        }
        Ok(Gears { n, tessellation })
    }

    /// Positions of a wheel's coarse vertices: the outline at the top, then at the bottom.
    fn wheel(&self, cell: [u32; 3]) -> Vec<[f32; 3]> {
        let n = f64::from(self.n);
        // The tips of the outermost teeth reach -1 and 1.
        let radius = 1.0 / (n + ADDENDUM);
        let center = [0, 1].map(|axis| (2.0 * f64::from(cell[axis]) + 1.0 - n) * radius);
        let top = 1.0 - f64::from(cell[2]) / n;
        let bottom = top - (0.4 / n).min(0.1);
        // Neighbours are turned by half a tooth against each other, so that a tooth meets a gap.
        let phase = if cell.iter().sum::<u32>() % 2 == 0 { 0.0 } else { 0.5 };
        let outline = |z: f64| {
            (0..OUTLINE).map(move |corner| {
                let (shift, reach) =
                    [(-FOOT, -DEDENDUM), (-TIP, ADDENDUM), (TIP, ADDENDUM), (FOOT, -DEDENDUM)]
                        [corner as usize % 4];
                let turn = (f64::from(corner / 4) + phase + shift) / f64::from(TEETH);
                let (sin, cos) = libm::sincos(turn * std::f64::consts::TAU);
                let r = radius * (1.0 + reach);
                [center[0] + r * cos, center[1] + r * sin, z].map(|x| x as f32)
            })
        };
        outline(top).chain(outline(bottom)).collect()
    }

    fn material(cell: [u32; 3]) -> MaterialId {
        let [i, j, k] = cell;
        MaterialId(if (i + j + k) % 3 == 0 { 1 } else { 2 + ((5 * i + 3 * j + 7 * k) % COLOURS) as u16 })
    }
}

impl Shape for Gears {
    fn vertex_count(&self) -> u64 {
        vertex_count(self.n, self.tessellation)
    }

    fn triangle_count(&self) -> u64 {
        triangle_count(self.n, self.tessellation)
    }

    fn emit(&self, sink: &mut dyn MeshSink) -> Result<(), CompileError> {
        for material in materials() {
            sink.material(material)?;
        }
        let floor = Pattern::new(&FLOOR_TRIANGLES, self.tessellation);
        floor.emit(&FLOOR, 0, MaterialId(0), sink)?;
        let wheel = Pattern::new(&wheel_triangles(), self.tessellation);
        let mut first_vertex = floor.vertex_count() as u32;
        for k in 0..self.n {
            for j in 0..self.n {
                for i in 0..self.n {
                    let cell = [i, j, k];
                    wheel.emit(&self.wheel(cell), first_vertex, Gears::material(cell), sink)?;
                    first_vertex += wheel.vertex_count() as u32;
                }
            }
        }
        sink.vertices_complete()
    }
}

fn triangle_count(n: u32, tessellation: Tessellation) -> u64 {
    let coarse = WHEEL_TRIANGLES * u64::from(n).pow(3) + FLOOR_TRIANGLES.len() as u64;
    coarse * u64::from(tessellation.triangles_per_face())
}

fn vertex_count(n: u32, tessellation: Tessellation) -> u64 {
    let per_face = u64::from(tessellation.triangles_per_face());
    // Euler: a sphere of F triangles has F / 2 + 2 vertices; a disk with B border edges (F + B) / 2 + 1.
    let wheel = WHEEL_TRIANGLES * per_face / 2 + 2;
    let floor = (2 * per_face + 4 * u64::from(tessellation.segments())) / 2 + 1;
    wheel * u64::from(n).pow(3) + floor
}

/// The coarse faces of a wheel, seen counter-clockwise from outside.
fn wheel_triangles() -> Vec<[u32; 3]> {
    let mut cap = Vec::new();
    for tooth in 0..TEETH {
        let [a, b, c, d] = [0, 1, 2, 3].map(|corner| 4 * tooth + corner);
        cap.extend([[a, b, c], [a, c, d]]);
    }
    // The feet of the teeth make a convex polygon: cut off every other corner until a triangle is left.
    let mut ring: Vec<u32> = (0..TEETH).flat_map(|tooth| [4 * tooth, 4 * tooth + 3]).collect();
    while ring.len() > 3 {
        let kept = ring.iter().copied().step_by(2).collect();
        for i in (1..ring.len()).step_by(2) {
            cap.push([ring[i - 1], ring[i], ring[(i + 1) % ring.len()]]);
        }
        ring = kept;
    }
    cap.push([ring[0], ring[1], ring[2]]);

    let mut triangles = cap.clone();
    triangles.extend(cap.iter().map(|&[a, b, c]| [a + OUTLINE, c + OUTLINE, b + OUTLINE]));
    for i in 0..OUTLINE {
        let next = (i + 1) % OUTLINE;
        triangles.push([i + OUTLINE, next + OUTLINE, next]);
        triangles.push([i + OUTLINE, next, i]);
    }
    triangles
}

fn materials() -> Vec<MaterialRecord> {
    let mut materials = vec![
        MaterialRecord {
            name: "floor".to_string(),
            diffuse: [0.3, 0.255, 0.21],
            specular: [0.4; 3],
            shininess: 64.0,
            mirror: true,
            ..MaterialRecord::default()
        },
        MaterialRecord {
            name: "glass".to_string(),
            diffuse: [0.2, 0.12, 0.08],
            opacity: 0.2,
            refractive_index: 1.1,
            ..MaterialRecord::default()
        },
    ];
    materials.extend((0..COLOURS).map(|colour| MaterialRecord {
        name: format!("colour{colour:02}"),
        diffuse: pastel(colour),
        ..MaterialRecord::default()
    }));
    materials
}

/// Evenly spaced hues, in steps of 1/64 so that a text file holds them exactly in few digits.
fn pastel(colour: u32) -> [f32; 3] {
    let turn = 3.0 * colour as f32 / COLOURS as f32;
    [0.0, 1.0, 2.0].map(|peak| {
        let away = (turn - peak).abs();
        let away = away.min(3.0 - away).min(1.0);
        (64.0 * (1.0 - 0.75 * away)).round() / 64.0
    })
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;
    use crate::import::MeshBuffer;
    use crate::procedural::open_edges;

    fn mesh(n: u32, tessellation: u32) -> (Gears, MeshBuffer) {
        let gears = Gears::with_tessellation(n, Tessellation::new(tessellation).unwrap()).unwrap();
        let mut mesh = MeshBuffer::new();
        gears.emit(&mut mesh).unwrap();
        (gears, mesh)
    }

    #[test]
    fn counts_are_those_of_the_family() {
        for (n, triangles) in [(1, 27_552), (2, 219_744), (4, 1_757_280), (8, 14_057_568), (16, 112_459_872)]
        {
            assert_eq!(Gears::new(n).unwrap().triangle_count(), triangles);
        }
        for (n, tessellation) in [(1, 1), (1, 48), (2, 3), (3, 4)] {
            let (gears, mesh) = mesh(n, tessellation);
            assert_eq!(mesh.triangles.len() as u64, gears.triangle_count());
            assert_eq!(mesh.vertices.len() as u64, gears.vertex_count());
        }
    }

    #[test]
    fn sizes_past_the_limit_are_refused() {
        assert!(Gears::new(0).is_err());
        assert!(Gears::new(67).is_ok());
        assert!(Gears::new(68).is_err());
        assert!(Gears::new(u32::MAX).is_err());
    }

    #[test]
    fn wheels_are_closed_and_the_floor_is_open() {
        let (_, mesh) = mesh(2, 48);
        let floor = 96;
        assert_eq!(open_edges(&mesh.triangles[0..floor]), 16);
        assert_eq!(open_edges(&mesh.triangles[floor..]), 0);
    }

    #[test]
    fn no_wheel_vertex_has_a_twin_at_its_place() {
        let (_, mesh) = mesh(2, 48);
        let mut seen = HashMap::new();
        for (index, vertex) in mesh.vertices.iter().enumerate() {
            let twin = seen.insert(vertex.map(f64::to_bits), index);
            assert_eq!(twin, None, "{vertex:?}");
        }
    }

    #[test]
    fn wheels_stay_in_their_place_and_have_volume() {
        let (_, mesh) = mesh(3, 1);
        let mut volume = 0.0;
        for triangle in 2..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(triangle);
            for [x, y, z] in [a, b, c] {
                assert!(x.abs() <= 1.0 && y.abs() <= 1.0 && z > 0.0 && z <= 1.0);
            }
            let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
            volume += (a[0] * cross[0] + a[1] * cross[1] + a[2] * cross[2]) / 6.0;
        }
        // Positive: the surfaces are seen counter-clockwise from outside. About 27 discs.
        let radius: f64 = 1.0 / 3.0;
        let discs = 27.0 * std::f64::consts::PI * radius * radius * 0.1;
        assert!(volume > 0.9 * discs && volume < 1.05 * discs, "{volume} {discs}");
    }

    #[test]
    fn teeth_of_neighbours_interlock_without_touching() {
        let gears = Gears::new(2).unwrap();
        let outline = |i, j| {
            let corners = gears.wheel([i, j, 0]);
            let at = |k: usize| corners[k % OUTLINE as usize].map(f64::from);
            (0..OUTLINE as usize).map(|k| [at(k), at(k + 1)]).collect::<Vec<_>>()
        };
        let turn = |a: [f64; 3], b: [f64; 3], c: [f64; 3]| {
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0
        };
        let first = outline(0, 0);
        for second in [outline(1, 0), outline(0, 1)] {
            for &[a, b] in &first {
                for &[c, d] in &second {
                    let cross = turn(a, b, c) != turn(a, b, d) && turn(c, d, a) != turn(c, d, b);
                    assert!(!cross, "{a:?} {b:?} meets {c:?} {d:?}");
                }
            }
        }
        let right = first.iter().map(|[a, _]| a[0]).fold(f64::MIN, f64::max);
        let left = outline(1, 0).iter().map(|[a, _]| a[0]).fold(f64::MAX, f64::min);
        assert!(left < right, "the wheels do not reach into each other");
    }

    #[test]
    fn every_third_wheel_or_so_is_glass() {
        let (_, mesh) = mesh(4, 1);
        let glass = mesh.triangle_materials.iter().filter(|material| material.0 == 1).count();
        let share = glass as f64 / mesh.triangles.len() as f64;
        assert!((0.3..0.37).contains(&share), "{share}");
        assert!(
            mesh.triangle_materials.iter().all(|material| usize::from(material.0) < mesh.materials.len())
        );
    }

    #[test]
    fn emits_the_same_each_time() {
        assert!(mesh(2, 12).1 == mesh(2, 12).1);
    }
}
