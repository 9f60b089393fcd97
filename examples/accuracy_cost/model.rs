//! The model that is measured, compiled with any options, and the view of it.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use outcrop::compile::{CompileOptions, CompileReport, Control, Threads, compile_file, compile_shape};
use outcrop::octree::{OctreeOptions, Tier};
use outcrop::procedural::{Assembly, Gears, GlassStack, Icosphere};
use outcrop::scene::{Camera, Light, Scene};
use outcrop::source::DiskSource;
use outcrop::units::Bytes;
use outcrop::{BlockSource, LazyOctree, MemoryBudget};

/// Where the geometry comes from.
pub enum Model {
    Made(Box<Assembly>),
    File(PathBuf),
}

impl Model {
    /// The file, or gears, a stack of glass and something far away.
    pub fn new(file: Option<PathBuf>, quick: bool) -> Result<Model, Box<dyn Error>> {
        let Some(path) = file else {
            let far = Icosphere::new(1e4, [1.435e4, 9.85e4, -4.97e4], 5)?;
            let assembly = Assembly::new()
                .with(Gears::new(if quick { 1 } else { 2 })?, 1.0, [0.0; 3])
                .with(GlassStack::new(3, 0.45, 0.3, 1.2)?, 0.32, [-1.5, -0.75, 0.01])
                .with(far, 1.0, [0.0; 3]);
            return Ok(Model::Made(Box::new(assembly)));
        };
        Ok(Model::File(path))
    }

    pub fn name(&self) -> String {
        match self {
            Model::Made(_) => "gears, a stack of glass, and a sphere 100,000 units away".to_string(),
            Model::File(path) => path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        }
    }

    /// Compiles it to `path`.
    pub fn compile(&self, path: &Path, options: CompileOptions) -> Result<CompileReport, Box<dyn Error>> {
        let budget = MemoryBudget::new(Bytes::mib(512));
        let options = CompileOptions { threads: Threads::Count(2), ..options };
        let mut progress = |_| Control::Continue;
        match self {
            Model::Made(shape) => Ok(compile_shape(&**shape, path, &options, &budget, &mut progress)?),
            Model::File(file) => Ok(compile_file(file, path, &options, &budget, &mut progress)?),
        }
    }

    /// What is seen: the standard view of the gears, or the whole of a file.
    pub fn scene(&self, source: &dyn BlockSource) -> Result<Scene, Box<dyn Error>> {
        match self {
            Model::Made(_) => Ok(Scene::new(Camera::pinhole(Gears::EYE, [0.0; 3], [0.0, 0.0, 1.0], 45.0)?)
                .with_background([0.46, 0.58, 0.73])
                .with_ambient([0.1; 3])
                .with_light(Light::point([2.0, -2.5, 2.5], [0.6; 3]))
                .with_light(Light::point([-2.0, 4.0, 3.0], [0.4; 3]))),
            Model::File(_) => Ok(Scene::automatic(&source.model().bounds, 1.0)),
        }
    }

    /// The size of a pixel in the middle of what is seen, in units of the model.
    pub fn pixel(&self, scene: &Scene, source: &dyn BlockSource, size: u32) -> f64 {
        let target = match self {
            Model::Made(_) => [0.0; 3],
            Model::File(_) => source.model().bounds.center(),
        };
        let eye = scene.camera().eye();
        let distance = (0..3).map(|axis| (target[axis] - eye[axis]).powi(2)).sum::<f64>().sqrt();
        let view = scene.camera().view(size, size);
        let [a, b] =
            [0.5, 1.5].map(|x| view.ray(0.5 * f64::from(size) - 1.0 + x, 0.5 * f64::from(size)).direction);
        distance * (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
    }
}

/// A compiled model, open.
pub struct Open {
    pub octree: LazyOctree,
    pub source: Arc<dyn BlockSource>,
    pub budget: MemoryBudget,
}

/// Threads that may render at once.
pub const TRACERS_MAX: u32 = 8;

/// Opens a compiled file with room for all of its blocks, unless `options` say otherwise.
pub fn open(path: &Path, options: OctreeOptions) -> Result<Open, Box<dyn Error>> {
    let budget = MemoryBudget::new(Bytes::mib(4096));
    let source: Arc<dyn BlockSource> = Arc::new(DiskSource::open(path)?);
    let slots_max = options.slots_max.or(Some((source.model().blocks.len() as u32).clamp(TRACERS_MAX, 8192)));
    let options = OctreeOptions { tracers_max: TRACERS_MAX, slots_max, ..options };
    let octree = LazyOctree::open(Arc::clone(&source), &budget, options)?;
    Ok(Open { octree, source, budget })
}

/// [`open`] in one of the tiers.
pub fn open_tier(path: &Path, tier: Tier) -> Result<Open, Box<dyn Error>> {
    open(path, OctreeOptions { tier, ..OctreeOptions::default() })
}
