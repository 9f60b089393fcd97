//! The smallest use from another renderer: open, budget, intersect, occluded.
//!
//! `cargo run --release --example embed -- MODEL.outcrop` (`render MODEL --compile-only` makes that file)

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use outcrop::geom::Ray;
use outcrop::octree::OctreeOptions;
use outcrop::source::DiskSource;
use outcrop::trace::Occlusion;
use outcrop::units::Bytes;
use outcrop::{LazyOctree, MemoryBudget};

const USAGE: &str = "usage: embed MODEL.outcrop   (render MODEL --compile-only makes that file)";

fn main() -> ExitCode {
    let path = match std::env::args_os().nth(1) {
        Some(argument) if argument == "--help" || argument == "-h" => {
            println!("{USAGE}");
            return ExitCode::SUCCESS;
        }
        Some(path) => PathBuf::from(path),
        None => {
            eprintln!("{USAGE}");
            return ExitCode::FAILURE;
        }
    };
    match look_through(&path) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Sends one ray through the middle of the model.
fn look_through(path: &Path) -> Result<(), Box<dyn Error>> {
    let budget = MemoryBudget::new(Bytes::mib(64));
    let source = Arc::new(DiskSource::open(path)?);
    let octree = LazyOctree::open(source, &budget, OctreeOptions::default())?;
    let mut tracer = octree.tracer()?;

    // From outside the model's box through its middle.
    let bounds = octree.model().bounds;
    let direction = [0, 1, 2].map(|axis| bounds.center()[axis] - bounds.max[axis]);
    let eye = [0, 1, 2].map(|axis| bounds.max[axis] - direction[axis]);
    let ray = Ray::new(eye, direction);
    let Some(hit) = tracer.closest_hit(&ray)? else {
        println!("the ray through the middle hits nothing");
        return Ok(());
    };
    println!("triangle {} at {:?}, normal {:?}", hit.triangle.0, hit.position(), hit.normal());

    // Nothing can be in between: that is what closest means.
    let mut occlusion = [Occlusion::Clear];
    tracer.occluded(&[Ray { t_max: hit.t * 0.999, ..ray }], None, &mut occlusion)?;
    println!("on the way there: {:?}; reserved {} of {}", occlusion[0], budget.peak(), budget.limit());
    Ok(())
}
