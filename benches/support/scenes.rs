//! The three scenes on which accesses and costs are recorded.

use std::error::Error;
use std::path::Path;
use std::sync::Arc;

use outcrop::compile::{CompileOptions, Control, compile_shape};
use outcrop::octree::OctreeOptions;
use outcrop::procedural::{Gears, Shape, TorusField};
use outcrop::source::DiskSource;
use outcrop::units::Bytes;
use outcrop::{LazyOctree, MemoryBudget};

use crate::paths::Paths;

pub struct Scene {
    pub name: &'static str,
    pub shape: Box<dyn Shape>,
    pub paths: Paths,
}

impl Scene {
    /// Scenes of about equal triangle counts: `n` wheels to an edge.
    pub fn three(n: u32) -> Result<[Scene; 3], Box<dyn Error>> {
        let gears = |name, paths| -> Result<Scene, Box<dyn Error>> {
            Ok(Scene { name, shape: Box::new(Gears::new(n)?), paths })
        };
        let tori = TorusField::new(4, 40 * n, 5 * n.pow(2), 1)?;
        Ok([
            gears("gears, opaque, three bounces", Paths::Diffuse(3))?,
            gears("gears, glass to depth 12", Paths::Glass(12))?,
            Scene { name: "tori, opaque, three bounces", shape: Box::new(tori), paths: Paths::Diffuse(3) },
        ])
    }

    /// Compiles the model into `directory` and opens it with room for all of it.
    pub fn open(&self, directory: &Path) -> Result<LazyOctree, Box<dyn Error>> {
        let compiled = directory.join("scene.outcrop");
        let budget = MemoryBudget::new(Bytes::mib(2048));
        let (options, go_on) = (CompileOptions::default(), &mut |_| Control::Continue);
        compile_shape(&*self.shape, &compiled, &options, &budget, go_on)?;
        let source = Arc::new(DiskSource::open(&compiled)?);
        Ok(LazyOctree::open(source, &budget, OctreeOptions::default())?)
    }
}
