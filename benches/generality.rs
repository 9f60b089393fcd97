//! What generality costs: a matt scene by the renderer, which knows every effect, and by a loop that knows nothing but a camera, matt
//! surfaces, lights that weaken not and shadows. Both ask the same queries, and their pictures must be the same to the bit.
//!
//! Without arguments the pictures are compared. `full` and `small` make one of them inside `measured`, for counts of instructions;
//! `benches/generality.sh` counts both and fails if one is too large for the other. By hand:
//!
//! ```text
//! cargo bench --bench generality --no-run            # names the program
//! PROGRAM --compiled bricks.outcrop                  # keeps the compiled model there, as compiling does not run in valgrind
//! valgrind --tool=callgrind --toggle-collect='*measured*' PROGRAM --compiled bricks.outcrop full
//! valgrind --tool=callgrind --toggle-collect='*measured*' PROGRAM --compiled bricks.outcrop small
//! ```
//!
//! `--beyond chrome | glass | rough | smooth` puts a sheet of another kind behind the camera, where no ray comes: it should cost
//! nothing (I6). `--wheels N` and `--size N` choose the model (gears of 27,456 N^3 triangles, all of one matt material; a file that
//! is there already is taken as it is) and the picture. All blocks are in memory before anything is measured.

#[path = "../tests/support/compiled.rs"]
mod compiled;

use std::error::Error;
use std::sync::Arc;

use compiled::compiled;
use glam::DVec3;
use outcrop::compile::{CompileOptions, Control, Threads};
use outcrop::error::CompileError;
use outcrop::geom::{Ray, offset_origin};
use outcrop::import::{CornerIndices, MeshBuffer, MeshSink, VertexBatch};
use outcrop::model::MaterialRecord;
use outcrop::octree::OctreeOptions;
use outcrop::procedural::{Gears, Shape};
use outcrop::render::{RenderSettings, Renderer};
use outcrop::scene::{Camera, Finish, Light, Scene, Surface};
use outcrop::source::MemorySource;
use outcrop::trace::{Hit, Occlusion};
use outcrop::units::Bytes;
use outcrop::{BlockSource, LazyOctree, MemoryBudget};

const DIFFUSE: [f32; 3] = [0.5, 0.375, 0.25];
const BACKGROUND: [f32; 3] = [0.078, 0.361, 0.753];
const AMBIENT: [f32; 3] = [0.0625, 0.0625, 0.125];
const TILE: u32 = 32;

/// What stands behind the camera.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Beyond {
    Chrome,
    Glass,
    RoughChrome,
    /// Of bricks, whose corners have normals.
    Smooth,
}

impl Beyond {
    fn parse(name: &str) -> Option<Beyond> {
        Some(match name {
            "chrome" => Beyond::Chrome,
            "glass" => Beyond::Glass,
            "rough" => Beyond::RoughChrome,
            "smooth" => Beyond::Smooth,
            _ => return None,
        })
    }

    fn material(self) -> MaterialRecord {
        let plain = MaterialRecord { name: "sheet".into(), diffuse: DIFFUSE, ..MaterialRecord::default() };
        match self {
            Beyond::Chrome | Beyond::RoughChrome => {
                MaterialRecord { specular: [0.5; 3], mirror: true, ..plain }
            }
            Beyond::Glass => MaterialRecord { opacity: 0.2, refractive_index: 1.5, ..plain },
            Beyond::Smooth => plain,
        }
    }

    /// Cells of the sheet along its sides: as many triangles as two pages of attributes hold.
    const CELLS: [u32; 2] = [64, 32];

    fn vertices() -> Vec<[f64; 3]> {
        let [columns, rows] = Beyond::CELLS;
        let place = |cell: u32, of: u32| f64::from(cell) / f64::from(of) - 0.5;
        let vertex =
            |x, y| [4.0 * Gears::EYE[0] + place(x, columns), 4.0 * Gears::EYE[1] + place(y, rows), 12.0];
        (0..=rows).flat_map(|y| (0..=columns).map(move |x| vertex(x, y))).collect()
    }

    fn triangles() -> Vec<[u32; 3]> {
        let [columns, rows] = Beyond::CELLS;
        let corner = |x, y| y * (columns + 1) + x;
        let cells = (0..rows).flat_map(|y| (0..columns).map(move |x| [x, y]));
        let halves = cells.flat_map(|[x, y]| {
            let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)];
            [[a, b, c], [a, c, d]]
        });
        halves.collect()
    }
}

/// The gears, every one of matt bricks, and what stands behind the camera.
struct Bricks(Gears, Option<Beyond>);

impl Shape for Bricks {
    fn vertex_count(&self) -> u64 {
        self.0.vertex_count() + self.1.map_or(0, |_| Beyond::vertices().len() as u64)
    }

    fn triangle_count(&self) -> u64 {
        self.0.triangle_count() + self.1.map_or(0, |_| Beyond::triangles().len() as u64)
    }

    fn is_double(&self) -> bool {
        true
    }

    fn emit(&self, sink: &mut dyn MeshSink) -> Result<(), CompileError> {
        let mut mesh = MeshBuffer::new();
        self.0.emit(&mut mesh)?;
        let bricks = MaterialRecord { name: "bricks".into(), diffuse: DIFFUSE, ..MaterialRecord::default() };
        let bricks = sink.material(bricks)?;
        sink.vertices(VertexBatch::Float64(&mesh.vertices))?;
        let Some(beyond) = self.1 else {
            sink.vertices_complete()?;
            return sink.triangles(&mesh.triangles, bricks);
        };
        // First, so that it has pages of attributes for itself.
        let sheet = sink.material(beyond.material())?;
        let first = mesh.vertices.len() as u32;
        sink.vertices(VertexBatch::Float64(&Beyond::vertices()))?;
        sink.vertices_complete()?;
        let triangles: Vec<_> =
            Beyond::triangles().into_iter().map(|corners| corners.map(|corner| first + corner)).collect();
        if beyond == Beyond::Smooth {
            sink.normals(&[[0.0, 0.6, 0.8]])?;
            let normals = vec![[0; 3]; triangles.len()];
            let corners = CornerIndices { uvs: None, normals: Some(&normals) };
            sink.triangles_with_attributes(&triangles, corners, sheet)?;
        } else {
            sink.triangles(&triangles, sheet)?;
        }
        sink.triangles(&mesh.triangles, bricks)
    }
}

/// A picture, row by row.
type Picture = Vec<[f32; 3]>;

/// All that is counted happens below this.
#[inline(never)]
fn measured(make: &dyn Fn() -> Result<Picture, Box<dyn Error>>) -> Result<Picture, Box<dyn Error>> {
    make()
}

/// By the renderer.
fn full(
    octree: &LazyOctree,
    scene: &Scene,
    size: u32,
    budget: &MemoryBudget,
) -> Result<Picture, Box<dyn Error>> {
    // Nothing is cut: the small loop does not know how.
    let settings =
        RenderSettings { contribution_bound: 0.0, tile_size: TILE, ..RenderSettings::new(size, size) };
    let renderer = Renderer::new(octree, scene, &settings, budget)?;
    let film = renderer.render(&Threads::One, &mut |_| Control::Continue)?.film;
    let mut picture = Vec::with_capacity((size * size) as usize);
    (0..size).for_each(|y| picture.extend_from_slice(film.row(y)));
    Ok(picture)
}

/// A point that lights are asked for.
struct Point {
    pixel: usize,
    diffuse: DVec3,
    position: DVec3,
    normal: DVec3,
    origin: [f64; 3],
}

/// By a renderer for matt scenes alone: the same tiles, batches and order of pixels, so that queries have the same work.
fn small(octree: &LazyOctree, scene: &Scene, size: u32) -> Result<Picture, Box<dyn Error>> {
    let mut tracer = octree.tracer()?;
    let view = scene.camera().view(size, size);
    let wide = |color: [f32; 3]| DVec3::from_array(color.map(f64::from));
    let (background, ambient) = (wide(scene.background()), wide(scene.ambient()));
    let materials = &octree.model().materials;
    let diffuse: Vec<DVec3> =
        materials.iter().map(|record| DVec3::from_array(Surface::from_record(record).diffuse)).collect();
    let lights: Vec<(DVec3, DVec3)> = scene
        .lights()
        .iter()
        .map(|light| match *light {
            Light::Point { position, intensity, .. } => (DVec3::from_array(position), wide(intensity)),
            _ => unreachable!("this bench has point lights only"),
        })
        .collect();
    let mut picture = vec![[0.0; 3]; (size * size) as usize];
    let count = (TILE * TILE) as usize;
    let (mut pixels, mut rays) = (Vec::with_capacity(count), Vec::with_capacity(count));
    let mut hits: Vec<Option<Hit>> = vec![None; count];
    let (mut radiance, mut points) = (Vec::with_capacity(count), Vec::with_capacity(count));
    let shadows = count * lights.len().clamp(1, 4);
    let mut shadow_rays: Vec<Ray> = Vec::with_capacity(shadows);
    let mut claims: Vec<(usize, DVec3)> = Vec::with_capacity(shadows);
    let mut occlusion = vec![Occlusion::Clear; shadows];
    for tile in 0..size.div_ceil(TILE) * size.div_ceil(TILE) {
        let corner = [tile % size.div_ceil(TILE) * TILE, tile / size.div_ceil(TILE) * TILE];
        pixels.clear();
        rays.clear();
        radiance.clear();
        points.clear();
        for code in 0..TILE * TILE {
            let [x, y] = [corner[0] + every_other_bit(code), corner[1] + every_other_bit(code >> 1)];
            if x < size && y < size {
                pixels.push((y * size + x) as usize);
                rays.push(view.ray(f64::from(x) + 0.5, f64::from(y) + 0.5));
            }
        }
        tracer.closest_hits(&rays, &mut hits[..rays.len()])?;
        for (index, (ray, hit)) in rays.iter().zip(&hits).enumerate() {
            let Some(hit) = hit else {
                radiance.push(background);
                continue;
            };
            let direction = DVec3::from_array(ray.direction);
            let geometric = DVec3::from_array(hit.normal());
            let is_behind = geometric.dot(direction) > 0.0;
            let normal = geometric.try_normalize().map_or(-direction, |n| if is_behind { -n } else { n });
            let (position, error) = (hit.position(), hit.position_error());
            let origin = offset_origin(position, error, hit.normal(), normal.to_array());
            let diffuse = diffuse[usize::from(hit.material.0)];
            radiance.push(diffuse * ambient);
            points.push(Point {
                pixel: index,
                diffuse,
                position: DVec3::from_array(position),
                normal,
                origin,
            });
        }
        let mut resolve = |rays: &mut Vec<Ray>, claims: &mut Vec<(usize, DVec3)>, radiance: &mut [DVec3]| {
            tracer.occluded(rays, None, &mut occlusion[..rays.len()])?;
            for ((pixel, light), occlusion) in claims.iter().zip(&occlusion) {
                if *occlusion == Occlusion::Clear {
                    radiance[*pixel] += *light;
                }
            }
            rays.clear();
            claims.clear();
            Ok::<(), Box<dyn Error>>(())
        };
        for (light, intensity) in &lights {
            for point in &points {
                let offset = *light - point.position;
                let cosine = (offset / offset.length_squared().sqrt()).dot(point.normal);
                if cosine > 0.0 {
                    claims.push((point.pixel, point.diffuse * cosine * *intensity));
                    let toward = *light - DVec3::from_array(point.origin);
                    shadow_rays.push(Ray { t_max: 1.0, ..Ray::new(point.origin, toward.to_array()) });
                    if claims.len() == shadows {
                        resolve(&mut shadow_rays, &mut claims, &mut radiance)?;
                    }
                }
            }
        }
        resolve(&mut shadow_rays, &mut claims, &mut radiance)?;
        for (pixel, radiance) in pixels.iter().zip(&radiance) {
            picture[*pixel] = radiance.to_array().map(|channel| channel as f32);
        }
    }
    Ok(picture)
}

/// Bits 0, 2, 4, ... of `code`, moved together.
fn every_other_bit(code: u32) -> u32 {
    (0..16).map(|bit| (code >> (2 * bit) & 1) << bit).sum()
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut which, mut wheels, mut size, mut path, mut beyond) = (None, 1, 256, None, None);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut number =
            || -> Result<u32, Box<dyn Error>> { Ok(arguments.next().ok_or("a number is missing")?.parse()?) };
        match argument.as_str() {
            // From cargo.
            "--bench" | "--test" => {}
            "--wheels" => wheels = number()?,
            "--size" => size = number()?,
            "--compiled" => path = Some(arguments.next().ok_or("a path is missing")?),
            "--beyond" => {
                let name = arguments.next().ok_or("what stands behind the camera is missing")?;
                beyond = Some(Beyond::parse(&name).ok_or("known are chrome, glass, rough, smooth")?);
            }
            "full" | "small" => which = Some(argument),
            other => {
                let known = "full, small, --wheels N, --size N, --beyond KIND, --compiled PATH";
                return Err(format!("{other}: known are {known}").into());
            }
        }
    }
    let file = match &path {
        Some(path) if std::fs::exists(path)? => std::fs::read(path)?,
        _ => compiled(&Bricks(Gears::new(wheels)?, beyond), &CompileOptions::default()),
    };
    if let Some(path) = path {
        std::fs::write(path, &file)?;
    }
    let source: Arc<dyn BlockSource> = Arc::new(MemorySource::new(file)?);
    let budget = MemoryBudget::new(Bytes::mib(1024));
    let blocks = source.model().block_id_count();
    let options = OctreeOptions { slots_max: Some(blocks), ..OctreeOptions::default() };
    let octree = LazyOctree::open(source, &budget, options)?;
    let camera = Camera::pinhole(Gears::EYE, [0.0; 3], [0.0, 0.0, 1.0], 45.0)?;
    let mut scene = Scene::new(camera)
        .with_background(BACKGROUND)
        .with_ambient(AMBIENT)
        .with_lights(Gears::LAMPS[..2].iter().map(|position| Light::point(*position, [0.75, 0.5, 0.625])));

    if beyond == Some(Beyond::RoughChrome) {
        scene = scene.with_finish("sheet", Finish::rough(0.4));
    }

    let general = || full(&octree, &scene, size, &budget);
    let special = || small(&octree, &scene, size);
    // The first picture also loads what is needed.
    let (one, other) = (general()?, special()?);
    let bits = |picture: &Picture| picture.iter().map(|pixel| pixel.map(f32::to_bits)).collect::<Vec<_>>();
    if bits(&one) != bits(&other) {
        return Err("the two pictures differ".into());
    }
    let distinct: std::collections::BTreeSet<_> = bits(&one).into_iter().collect();
    if distinct.len() < 16 {
        return Err(format!("only {} colours: the picture shows nothing", distinct.len()).into());
    }
    println!(
        "{size} x {size} pixels, {} triangles: both pictures are the same",
        octree.model().triangle_count
    );
    let third = match which.as_deref() {
        Some("full") => measured(&general)?,
        Some(_) => measured(&special)?,
        None => one.clone(),
    };
    if bits(&third) != bits(&one) {
        return Err("the picture that was measured differs".into());
    }
    Ok(())
}
