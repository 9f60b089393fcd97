//! Pictures of a few triangles through a query that tries every triangle: what shading and ray trees do is seen here
//! without octree, cache or blocks.

mod adaptive;
mod detail;
mod draft;
mod effects;
mod finish;
mod invariance;
#[cfg(feature = "exr")]
mod layers;
mod lens;
mod light_transport;
mod lobes;
mod media;
mod octree;
mod resample;
mod shading;
mod trees;
mod unmet;

use std::sync::Arc;

use super::film::Film;
use super::query::RayQuery;
use super::renderer::{Picture, picture};
use super::settings::RenderSettings;
use super::stage::Stage;
use glam::DVec3;

use crate::block::attributes::{CornerAttributes, PAGE_TRIANGLES};
use crate::budget::MemoryBudget;
use crate::compile::{Control, Threads};
use crate::error::{LoadError, RenderError, SourceError, TraceError};
use crate::geom::{Ray, intersect_certified};
use crate::model::MaterialRecord;
use crate::scene::{AttributeKinds, Camera, EffectPlan, Scene};
use crate::stats::TraceCounters;
use crate::texture::TextureCache;
use crate::trace::{Hit, MaterialSet, Occlusion};
use crate::units::{BlockId, Bytes, MaterialId, TriangleId};

/// A few triangles and their materials.
#[derive(Clone, Default)]
struct Mesh {
    triangles: Vec<([[f64; 3]; 3], u16)>,
    materials: Vec<MaterialRecord>,
    /// By triangle; those behind the last have none.
    attributes: Vec<CornerAttributes>,
}

impl Mesh {
    fn new(materials: impl IntoIterator<Item = MaterialRecord>) -> Mesh {
        Mesh { materials: materials.into_iter().collect(), ..Mesh::default() }
    }

    fn kinds(&self) -> AttributeKinds {
        AttributeKinds {
            uvs: self.attributes.iter().any(|attributes| attributes.uvs.is_some()),
            normals: self.attributes.iter().any(|attributes| attributes.normals.is_some()),
        }
    }

    fn plan(&self, scene: &Scene, settings: &RenderSettings) -> EffectPlan {
        EffectPlan::of_parts(scene, &self.materials, self.kinds(), &settings.effect_options())
    }

    /// A triangle whose corners have these attributes.
    fn triangle(mut self, material: u16, corners: [[f64; 3]; 3], attributes: CornerAttributes) -> Mesh {
        self.attributes.resize(self.triangles.len(), CornerAttributes::default());
        self.triangles.push((corners, material));
        self.attributes.push(attributes);
        self
    }

    /// [`Mesh::sheet`] with texture coordinates from 0 to `repeats` along `a` and `b`.
    fn card(self, material: u16, corner: [f64; 3], a: [f64; 3], b: [f64; 3], repeats: f32) -> Mesh {
        let add = |p: [f64; 3], q: [f64; 3]| [0, 1, 2].map(|axis| p[axis] + q[axis]);
        let (along, far, across) = (add(corner, a), add(add(corner, a), b), add(corner, b));
        let r = repeats;
        let uvs = |uvs| CornerAttributes { uvs: Some(uvs), normals: None };
        self.triangle(material, [corner, along, far], uvs([[0.0, 0.0], [r, 0.0], [r, r]])).triangle(
            material,
            [corner, far, across],
            uvs([[0.0, 0.0], [r, r], [0.0, r]]),
        )
    }

    /// An octahedron around the origin whose faces are cut `depth` times in four, pushed out to `radius`; `is_smooth` gives it the
    /// normals of the sphere.
    fn sphere(mut self, material: u16, center: [f64; 3], radius: f64, depth: u32, is_smooth: bool) -> Mesh {
        fn cut(corners: [DVec3; 3], depth: u32, out: &mut Vec<[DVec3; 3]>) {
            let [a, b, c] = corners;
            if depth == 0 {
                return out.push(corners);
            }
            let [d, e, f] = [(a + b).normalize(), (b + c).normalize(), (c + a).normalize()];
            for part in [[a, d, f], [d, b, e], [f, e, c], [d, e, f]] {
                cut(part, depth - 1, out);
            }
        }
        let mut faces = Vec::new();
        for signs in 0..8 {
            let sign = |axis: usize| if signs >> axis & 1 == 1 { -1.0 } else { 1.0 };
            let [x, y, z] = [DVec3::X * sign(0), DVec3::Y * sign(1), DVec3::Z * sign(2)];
            let is_even = sign(0) * sign(1) * sign(2) > 0.0;
            cut(if is_even { [x, y, z] } else { [y, x, z] }, depth, &mut faces);
        }
        for face in faces {
            let corners = face.map(|corner| (DVec3::from_array(center) + corner * radius).to_array());
            let normals = is_smooth.then(|| face.map(|corner| corner.to_array()));
            self = self.triangle(material, corners, CornerAttributes { normals, uvs: None });
        }
        self
    }

    /// A parallelogram at `corner` spanned by `a` and `b`, cut along its diagonal; its front faces `a` x `b`.
    fn sheet(mut self, material: u16, corner: [f64; 3], a: [f64; 3], b: [f64; 3]) -> Mesh {
        let add = |p: [f64; 3], q: [f64; 3]| [0, 1, 2].map(|axis| p[axis] + q[axis]);
        let (along, far, across) = (add(corner, a), add(add(corner, a), b), add(corner, b));
        self.triangles.push(([corner, along, far], material));
        self.triangles.push(([corner, far, across], material));
        self
    }

    /// A closed box, front faces outward.
    fn cuboid(self, material: u16, min: [f64; 3], max: [f64; 3]) -> Mesh {
        let [x, y, z] = [0, 1, 2].map(|axis| {
            let mut edge = [0.0; 3];
            edge[axis] = max[axis] - min[axis];
            edge
        });
        let back = |edge: [f64; 3]| edge.map(|length| -length);
        self.sheet(material, min, y, x)
            .sheet(material, min, z, y)
            .sheet(material, min, x, z)
            .sheet(material, max, back(x), back(y))
            .sheet(material, max, back(y), back(z))
            .sheet(material, max, back(z), back(x))
    }
}

/// The naive twin of the tracer.
struct Naive {
    mesh: Arc<Mesh>,
    counters: TraceCounters,
    /// Fails once this many rays were asked.
    rays_left: u64,
}

impl Naive {
    fn first(&mut self, ray: &Ray, after: Option<(f64, TriangleId)>) -> Option<Hit> {
        // The list counts as one box.
        self.counters.rays += 1;
        self.counters.box_tests += 1;
        self.counters.triangle_tests += self.mesh.triangles.len() as u64;
        let mut best: Option<Hit> = None;
        for ((vertices, material), id) in self.mesh.triangles.iter().zip(0..) {
            let Some(hit) = intersect_certified(ray, vertices, &mut self.counters.exact_fallbacks) else {
                continue;
            };
            let key = (hit.t, TriangleId(id));
            if after.is_none_or(|after| key > after || after.0.is_nan())
                && best.is_none_or(|best| key < (best.t, best.triangle))
            {
                best = Some(Hit {
                    t: hit.t,
                    u: hit.u,
                    v: hit.v,
                    triangle: TriangleId(id),
                    material: MaterialId(*material),
                    vertices: *vertices,
                });
            }
        }
        best
    }

    fn spend(&mut self, rays: &[Ray]) -> Result<(), TraceError> {
        for (index, ray) in rays.iter().enumerate() {
            ray.validate().map_err(|reason| TraceError::InvalidRay { index, reason })?;
        }
        match self.rays_left.checked_sub(rays.len() as u64) {
            Some(left) => self.rays_left = left,
            None => {
                return Err(TraceError::Load(LoadError::Source(SourceError::NoSuchBlock {
                    block: BlockId(7),
                    name: "the naive twin".to_string(),
                    count: 0,
                })));
            }
        }
        Ok(())
    }
}

impl RayQuery for Naive {
    fn closest_hits(&mut self, rays: &[Ray], hits: &mut [Option<Hit>]) -> Result<(), TraceError> {
        self.spend(rays)?;
        assert_eq!(rays.len(), hits.len());
        for (ray, hit) in rays.iter().zip(hits) {
            *hit = self.first(ray, None);
        }
        Ok(())
    }

    fn closest_hits_after(
        &mut self,
        rays: &[Ray],
        after: &[(f64, TriangleId)],
        hits: &mut [Option<Hit>],
    ) -> Result<(), TraceError> {
        self.spend(rays)?;
        assert!(rays.len() == hits.len() && rays.len() == after.len());
        for ((ray, after), hit) in rays.iter().zip(after).zip(hits) {
            *hit = self.first(ray, Some(*after));
        }
        Ok(())
    }

    fn occluded(
        &mut self,
        rays: &[Ray],
        ignore: Option<&MaterialSet>,
        out: &mut [Occlusion],
    ) -> Result<(), TraceError> {
        self.spend(rays)?;
        assert_eq!(rays.len(), out.len());
        for (ray, answer) in rays.iter().zip(out) {
            *answer = Occlusion::Clear;
            let mut hit = self.first(ray, None);
            while let Some(found) = hit {
                if ignore.is_some_and(|ignore| ignore.contains(found.material)) {
                    *answer = Occlusion::Filtered;
                    hit = self.first(ray, Some((found.t, found.triangle)));
                } else {
                    *answer = Occlusion::Blocked;
                    break;
                }
            }
        }
        Ok(())
    }

    fn corner_attributes(&mut self, triangle: TriangleId) -> Result<CornerAttributes, TraceError> {
        Ok(self.mesh.attributes.get(triangle.0 as usize).copied().unwrap_or_default())
    }

    fn may_have_normals(&self, triangle: TriangleId) -> bool {
        // As coarse as a directory, so that the same is looked up.
        let first = triangle.0 as usize / PAGE_TRIANGLES * PAGE_TRIANGLES;
        let page = self.mesh.attributes.iter().skip(first).take(PAGE_TRIANGLES);
        page.into_iter().any(|corners| corners.normals.is_some())
    }

    fn counters(&self) -> TraceCounters {
        self.counters
    }
}

/// Gives a stage the pictures of its scene.
fn open_textures(stage: &mut Stage, scene: &Scene) {
    if let Some(textures) = stage.textures_to_open(scene) {
        let budget = MemoryBudget::new(Bytes::mib(64));
        let readers = 4;
        let cache = TextureCache::open(textures, Bytes(0), readers, &budget).unwrap();
        stage.textures = Some(Arc::new(cache));
    }
}

fn render_until(
    mesh: &Mesh,
    scene: &Scene,
    settings: &RenderSettings,
    threads: &Threads,
    rays_left: u64,
    progress: &mut (dyn FnMut(super::Progress) -> Control + Send),
) -> Result<Picture, RenderError> {
    let plan = mesh.plan(scene, settings);
    let mut stage = Stage::new(scene, &mesh.materials, &plan, settings);
    open_textures(&mut stage, scene);
    let mesh = Arc::new(mesh.clone());
    let budget = MemoryBudget::new(Bytes::mib(64));
    let naive = || Ok(Naive { mesh: mesh.clone(), counters: TraceCounters::default(), rays_left });
    let picture = picture(&stage, threads, &budget, &naive, &|_| None, progress)?;
    // Only the film lives on.
    assert_eq!(budget.used(), Film::bytes_needed(&stage.grid, crate::render::Kept::by(settings)));
    Ok(picture)
}

fn render(mesh: &Mesh, scene: &Scene, settings: &RenderSettings) -> Picture {
    render_until(mesh, scene, settings, &Threads::One, u64::MAX, &mut |_| Control::Continue).unwrap()
}

/// Looks along -Z from z = 5 with parallel rays; one pixel covers 2 x 2 units around the origin.
fn straight_camera() -> Camera {
    Camera::orthographic([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 2.0).unwrap()
}

/// The colour of a picture of one pixel.
fn one_pixel(mesh: &Mesh, scene: &Scene, settings: &RenderSettings) -> ([f32; 3], Picture) {
    let picture = render(mesh, scene, &RenderSettings { width: 1, height: 1, ..*settings });
    (picture.film.pixel(0, 0), picture)
}

fn matt(diffuse: f32) -> MaterialRecord {
    MaterialRecord { diffuse: [diffuse; 3], ..MaterialRecord::default() }
}

fn mirror(specular: f32) -> MaterialRecord {
    MaterialRecord { diffuse: [0.0; 3], specular: [specular; 3], mirror: true, ..MaterialRecord::default() }
}

fn clear(refractive_index: f32) -> MaterialRecord {
    MaterialRecord { diffuse: [0.0; 3], opacity: 0.0, refractive_index, ..MaterialRecord::default() }
}

fn assert_close(found: [f32; 3], expected: [f64; 3], tolerance: f64) {
    for channel in 0..3 {
        assert!(
            (f64::from(found[channel]) - expected[channel]).abs() <= tolerance,
            "found {found:?}, expected {expected:?}"
        );
    }
}
