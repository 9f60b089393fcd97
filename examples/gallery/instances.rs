//! Pictures of instances: models that stand in many places, and that move from frame to frame.

use std::error::Error;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use outcrop::geom::Affine;
use outcrop::instance::{Instance, Instances};
use outcrop::octree::OctreeOptions;
use outcrop::render::{Control, RenderSettings, RenderedImage, Renderer, Threads};
use outcrop::scene::{Light, LightShape, Scene};
use outcrop::{BlockSource, MemoryBudget};

use crate::mesh::Mesh;
use crate::page::plan;
use crate::scenes::{camera, daylight, ground, matt, metal, shiny, sky};

/// How the pictures are made.
pub struct Making<'a> {
    pub folder: &'a Path,
    pub size: [u32; 2],
    pub quick: bool,
    pub threads: usize,
    pub budget: &'a MemoryBudget,
}

/// Models and where they stand.
struct Placed {
    sources: Vec<Arc<dyn BlockSource>>,
    triangles: Vec<u64>,
    instances: Vec<Instance>,
}

impl Placed {
    fn new(models: &[Mesh]) -> Result<Placed, Box<dyn Error>> {
        let (mut sources, mut triangles) = (Vec::new(), Vec::new());
        for mesh in models {
            sources.push(Arc::new(mesh.compile()?) as Arc<dyn BlockSource>);
            triangles.push(mesh.triangle_count() as u64);
        }
        Ok(Placed { sources, triangles, instances: Vec::new() })
    }

    fn add(&mut self, model: u32, map: Affine) {
        self.instances.push(Instance { model, map });
    }

    /// Triangles of the models, and of all instances.
    fn counts(&self) -> [u64; 2] {
        let placed = self.instances.iter().map(|instance| self.triangles[instance.model as usize]);
        [self.triangles.iter().sum(), placed.sum()]
    }

    fn open(&self, making: &Making<'_>) -> Result<Instances, Box<dyn Error>> {
        let options = OctreeOptions {
            tracers_max: making.threads as u32,
            slots_max: Some(512),
            ..OctreeOptions::default()
        };
        Ok(Instances::open(&self.sources, self.instances.clone(), making.budget, &options)?)
    }
}

fn render(
    making: &Making<'_>,
    instances: &Instances,
    scene: &Scene,
    samples: u32,
    file: &str,
) -> Result<RenderedImage, Box<dyn Error>> {
    let [width, height] = making.size;
    let settings = RenderSettings {
        samples_per_pixel: if making.quick { 2 } else { samples },
        ..RenderSettings::new(width, height)
    };
    let renderer = Renderer::over_instances(instances, scene, &settings, making.budget)?;
    let image = renderer.render(&Threads::Count(making.threads), &mut |_| Control::Continue)?;
    let path = making.folder.join(file);
    image.film.write(&path)?;
    println!(
        "{}: {} rays in {:.1} s",
        path.display(),
        image.report.effects.rays(),
        image.report.wall_seconds
    );
    Ok(image)
}

/// A number from 0 to 1, without pattern.
fn chance(place: u32, salt: u32) -> f64 {
    let mut hash = place.wrapping_mul(0x9e37_79b9) ^ salt.wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ hash >> 15).wrapping_mul(0x2c1b_3c6d);
    hash = (hash ^ hash >> 12).wrapping_mul(0x297a_2d39);
    f64::from(hash ^ hash >> 15) / f64::from(u32::MAX)
}

const UP: [f64; 3] = [0.0, 1.0, 0.0];

/// A fir one unit high, of some thousand needles.
fn fir() -> Mesh {
    let mut mesh = Mesh::new();
    let bark = mesh.material("bark", matt([0.3, 0.2, 0.13]));
    let tones = [[0.08, 0.24, 0.1], [0.11, 0.3, 0.12], [0.15, 0.34, 0.12]];
    let needles = tones.map(|tone| mesh.material("needles", matt(tone)));
    mesh.lathe(bark, [0.0; 3], &[[0.035, 0.0], [0.025, 0.3], [0.004, 0.98], [0.0, 1.0]], 12);
    for twig in 0..1400u32 {
        let height = 0.16 + 0.82 * chance(twig, 1).sqrt();
        let reach = 0.32 * (1.05 - height) * (0.6 + 0.4 * chance(twig, 2));
        let (sin, cos) = (TAU * chance(twig, 3)).sin_cos();
        let (width, droop) = (0.02 + 0.012 * chance(twig, 4), 0.35 * reach);
        let foot = [0.0, height, 0.0];
        let along = [reach * cos, -droop, reach * sin];
        let across = [-width * sin, 0.3 * width, width * cos];
        let corner = [0, 1, 2].map(|axis| foot[axis] - 0.5 * across[axis]);
        mesh.quad(needles[(twig % 3) as usize], corner, along, across);
    }
    mesh
}

/// A stone of about unit size.
fn stone() -> Mesh {
    let mut mesh = Mesh::new();
    let granite = mesh.material("granite", matt([0.42, 0.41, 0.39]));
    let profile =
        [[0.0, -0.3], [0.35, -0.28], [0.52, -0.1], [0.5, 0.12], [0.33, 0.27], [0.12, 0.33], [0.0, 0.32]];
    mesh.lathe(granite, [0.0; 3], &profile, 9);
    mesh
}

/// Two models, some thousand places, one ground.
pub fn forest(making: &Making<'_>, text: &mut String) -> Result<(), Box<dyn Error>> {
    let mut meadow = Mesh::new();
    let grass = meadow.material("grass", matt([0.22, 0.3, 0.12]));
    meadow.quad(grass, [-60.0, 0.0, -110.0], [0.0, 0.0, 130.0], [120.0, 0.0, 0.0]);
    let mut placed = Placed::new(&[fir(), stone(), meadow])?;
    placed.add(2, Affine::IDENTITY);
    for tree in 0..4000u32 {
        let [x, z] = [60.0 * (chance(tree, 11) - 0.5), -60.0 * chance(tree, 12)];
        // A clearing that a path leads to.
        if (x - 0.15 * z).abs() < 1.2 || (x * x + (z + 9.0) * (z + 9.0)) < 16.0 {
            continue;
        }
        let height = 1.4 + 1.8 * chance(tree, 13);
        let girth = height * (0.75 + 0.4 * chance(tree, 14));
        let lean = [chance(tree, 15) - 0.5, 0.0, chance(tree, 16) - 0.5];
        let map = Affine::scale([girth, height, if tree % 2 == 0 { girth } else { -girth }])
            .then(&Affine::rotation(UP, 360.0 * chance(tree, 17)))
            .then(&Affine::rotation([lean[0], 0.01, lean[2]], 6.0 * chance(tree, 18)))
            .then(&Affine::translation([x, 0.0, z]));
        placed.add(0, map);
    }
    for rock in 0..300u32 {
        let [x, z] = [24.0 * (chance(rock, 21) - 0.5), 2.0 - 26.0 * chance(rock, 22)];
        let size = 0.1 + 0.5 * chance(rock, 23).powi(4);
        let map = Affine::scale([size * (1.0 + chance(rock, 24)), size, size * (1.0 + chance(rock, 25))])
            .then(&Affine::rotation(UP, 360.0 * chance(rock, 26)))
            .then(&Affine::translation([x, 0.0, z]));
        placed.add(1, map);
    }
    let scene =
        Scene::new(camera([1.2, 2.3, 4.5], [-0.8, 1.0, -8.0], 42.0)?).with_environment(sky(making.budget)?);
    let instances = placed.open(making)?;
    let image = render(making, &instances, &scene, 36, "instances.png")?;
    let [in_models, in_all] = placed.counts();
    let report = &image.report;
    let title = "A forest of one fir and one stone";
    // Writing to a String cannot fail.
    let _ = write!(
        text,
        "## {title}\n\n![{title}](instances.png)\n\n{} instances of 3 models: {in_all} triangles to see, {in_models} in {} blocks, of \
         which {} were loaded. {} x {} pixels, {} samples each.\n\n",
        placed.instances.len(),
        report.blocks_total,
        report.trace.blocks_loaded,
        report.width,
        report.height,
        report.samples_per_pixel
    );
    text.push_str(&plan(report));
    Ok(())
}

/// Wheels that turn, in three frames, and while the shutter is open.
pub fn moving(making: &Making<'_>, text: &mut String) -> Result<(), Box<dyn Error>> {
    // A wheel of unit radius with teeth, lying flat.
    const TEETH: u32 = 24;
    let mut wheel = Mesh::new();
    let brass = wheel.material("brass", metal([0.8, 0.62, 0.3]));
    let hub = wheel.material("hub", shiny([0.25, 0.25, 0.28]));
    wheel.lathe(brass, [0.0; 3], &[[0.66, 0.0], [0.92, 0.0], [0.92, 0.16], [0.66, 0.16], [0.66, 0.0]], 96);
    wheel.lathe(hub, [0.0; 3], &[[0.0, -0.02], [0.2, -0.02], [0.2, 0.24], [0.0, 0.24]], 48);
    for tooth in 0..TEETH {
        let degrees = 360.0 / f64::from(TEETH) * f64::from(tooth);
        let (sin, cos) = degrees.to_radians().sin_cos();
        wheel.block(brass, [0.98 * cos, 0.0, -0.98 * sin], [0.15, 0.16, 0.12], degrees);
        if tooth % 4 == 0 {
            wheel.block(brass, [0.42 * cos, 0.04, -0.42 * sin], [0.6, 0.08, 0.09], degrees);
        }
    }
    let mut floor = Mesh::new();
    ground(&mut floor);
    let mut placed = Placed::new(&[wheel, floor])?;
    // One floor, and wheels of three sizes that mesh in a row.
    let wheels = [([-1.75, 0.3], 1.0), ([0.1, 0.75], 0.9), ([1.55, -0.1], 0.78), ([-0.45, -1.05], 0.86)];
    let frame_of = |turn: f64| {
        let mut instances = vec![Instance { model: 1, map: Affine::IDENTITY }];
        for (number, ([x, z], size)) in wheels.into_iter().enumerate() {
            let way = if number % 2 == 0 { 1.0 } else { -1.0 };
            let map = Affine::scale([size, 1.0, size])
                .then(&Affine::rotation(UP, way * turn / size + 4.0 * number as f64))
                .then(&Affine::translation([x, 0.25 + 0.02 * number as f64, z]));
            instances.push(Instance { model: 0, map });
        }
        instances
    };
    placed.instances = frame_of(0.0);
    let lamp = LightShape::Sphere { center: [2.5, 4.0, 2.0], radius: 0.5 };
    let scene = daylight(camera([0.2, 4.2, 4.4], [-0.1, 0.1, 0.0], 36.0)?)
        .with_light(Light::area(lamp, [6.0, 5.5, 4.5]));
    let mut instances = placed.open(making)?;
    let title = "Wheels that turn from frame to frame";
    let _ = write!(text, "## {title}\n\n");
    let mut loads = Vec::new();
    for frame in 1..=3 {
        instances.place(frame_of(9.0 * f64::from(frame - 1)))?;
        let file = format!("moving-instances-{frame}.png");
        let image = render(making, &instances, &scene, 16, &file)?;
        let _ = writeln!(text, "![frame {frame}]({file})");
        loads.push(image.report.trace.blocks_loaded);
    }
    // One picture of the whole way from the first frame to the second.
    instances.place(frame_of(0.0))?;
    let ends: Vec<_> = frame_of(9.0).into_iter().map(|instance| instance.map).enumerate().collect();
    instances.move_while_open(&ends)?;
    let image = render(making, &instances, &scene, 36, "moving-instances-blur.png")?;
    let _ = writeln!(text, "![shutter open](moving-instances-blur.png)");
    loads.push(image.report.trace.blocks_loaded);
    let new: u64 = loads[1..].iter().sum();
    let blocks: u64 = instances.octrees().iter().map(|octree| octree.blocks_touched()).sum();
    let _ = write!(
        text,
        "\nFive instances of two models. The last picture has its shutter open from the first frame to the second. The first loads {} blocks, the \
         others together {new}: of {blocks} blocks each is loaded \
         once, whatever moves. The plan and counters of the last:\n\n",
        loads[0]
    );
    text.push_str(&plan(&image.report));
    Ok(())
}
