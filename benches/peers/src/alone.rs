//! One kind of ray, traced by outcrop alone: for profilers, and for two versions of this program in turn.

use std::path::Path;

use outcrop::octree::Tier;
use outcrop::units::Bytes;

use crate::clock::{measure, median};
use crate::engine::{Engine, Found};
use crate::mesh::Mesh;
use crate::outcrop_engine::{self, Outcrop};
use crate::rays::{bounce, primary, shadow, trace_closest};

/// Traces `kind` (`primary`, `shadow` or `bounce`) of the standard view of `compiled`, of which `model` is the source, once to
/// load and `repetitions` times for the median, which it prints with the least.
pub fn run(
    (model, compiled): (&Path, &Path),
    kind: &str,
    tier: Tier,
    size: usize,
    repetitions: usize,
) -> Result<(), String> {
    let mesh = Mesh::read(model).map_err(|error| error.to_string())?;
    // Room for every block.
    let octree = outcrop_engine::open(compiled, Bytes(16 << 30), tier)?;
    let mut engine = Outcrop::new("outcrop", &octree)?;
    let (first, _) = primary(size);
    let rays = match kind {
        "primary" => first,
        "shadow" | "bounce" => {
            let hits = trace_closest(&mut engine, &first);
            if kind == "shadow" { shadow(&mesh, &first, &hits) } else { bounce(&mesh, &first, &hits) }
        }
        _ => return Err(format!("{kind} is none of primary, shadow and bounce")),
    };
    let (mut found, mut blocked) = (vec![Found::NONE; rays.len()], vec![false; rays.len()]);
    let mut once = || {
        for range in rays.calls() {
            if kind == "shadow" {
                engine.occluded(&rays, range.clone(), &mut blocked[range]);
            } else {
                engine.closest(&rays, range.clone(), &mut found[range]);
            }
        }
    };
    once();
    let times: Vec<f64> =
        (0..repetitions).map(|_| measure(&mut once) / rays.len().max(1) as f64 * 1e9).collect();
    let least = times.iter().copied().fold(f64::INFINITY, f64::min);
    // Whatever was answered, so that two programs can be compared by it.
    let sum: f64 = found.iter().map(|found| if found.is_hit() { found.t } else { 0.0 }).sum();
    println!(
        "{} {kind} rays: median {:.1} ns, least {least:.1} ns; sum of t {sum:.17e}, {} blocked",
        rays.len(),
        median(times),
        blocked.iter().filter(|blocked| **blocked).count()
    );
    Ok(())
}
