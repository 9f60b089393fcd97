//! The hard cases of `tests/hard_cases` in every tier and with every peer: how many rays each gets wrong, by exact
//! integers. Prints `docs/results/hard-cases.md`'s table.

use std::collections::HashMap;
use std::path::Path;

use outcrop::compile::PrecisionChoice;
use outcrop::geom::Precision;
use outcrop::import::VertexBatch;
use outcrop::octree::Tier;
use outcrop::units::Bytes;

use crate::cases::{self, Case};
use crate::embree::{Embree, Mode};
use crate::engine::Engine;
use crate::leaks::compile;
use crate::mesh::Mesh;
use crate::obvhs_engine::Obvhs;
use crate::outcrop_engine::{Outcrop, open};
use crate::parry_engine::Parry;
use crate::rays::{Ray32, Rays, trace_closest};
use crate::truth::{Truth, Verdict};

/// How far `t` may be off, of itself.
const TOLERANCE: f64 = 1e-4;

/// Failures of one tracer in one case.
#[derive(Clone, Copy, Default)]
struct Failures {
    lost: usize,
    wrong: usize,
}

/// Prints the table. An error if `Certified` or `Exact` fails anywhere.
pub fn run() -> Result<(), String> {
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    let mut is_sound = true;
    let mut totals: Vec<Failures> = Vec::new();
    for (index, case) in cases::all().iter().enumerate() {
        let results = failures(case, folder.path())?;
        if index == 0 {
            let names: Vec<&str> = results.iter().map(|(name, _)| *name).collect();
            println!("| case | rays | {} |", names.join(" | "));
            println!("|---|---|{}", "---|".repeat(names.len()));
            totals = vec![Failures::default(); names.len()];
        }
        let rounded = if case.precision == Precision::Float32 { "" } else { " *" };
        print!("| `{}`{rounded} | {} |", case.name, case.rays.len());
        for ((name, failures), total) in results.iter().zip(&mut totals) {
            print!(" {} |", cell(failures));
            (total.lost, total.wrong) = (total.lost + failures.lost, total.wrong + failures.wrong);
            is_sound &= !matches!(*name, "certified" | "exact") || failures.lost + failures.wrong == 0;
        }
        println!();
    }
    print!("| all | |");
    totals.iter().for_each(|total| print!(" {} |", cell(total)));
    println!();
    if is_sound { Ok(()) } else { Err("a certified hit is wrong".to_string()) }
}

fn cell(failures: &Failures) -> String {
    match failures {
        Failures { lost: 0, wrong: 0 } => "0".to_string(),
        Failures { lost, wrong } => format!("{lost} + {wrong}"),
    }
}

/// What each tracer makes of the case.
fn failures(case: &Case, folder: &Path) -> Result<Vec<(&'static str, Failures)>, String> {
    let mut places: HashMap<[u64; 3], u32> = HashMap::new();
    let mut vertices: Vec<[f64; 3]> = Vec::new();
    let mut index = |p: [f64; 3]| {
        *places.entry(p.map(f64::to_bits)).or_insert_with(|| {
            vertices.push(p);
            vertices.len() as u32 - 1
        })
    };
    let triangles: Vec<[u32; 3]> = case.triangles.iter().map(|triangle| triangle.map(&mut index)).collect();
    let single: Vec<[f32; 3]> = vertices.iter().map(|p| p.map(|x| x as f32)).collect();
    let mut mesh = Mesh { vertices: single.clone(), triangles: triangles.clone(), ..Mesh::default() };
    Embree::pad(&mut mesh);
    let mut rays = Rays::default();
    for ray in &case.rays {
        rays.single.push(Ray32 {
            origin: ray.origin.map(|x| x as f32),
            direction: ray.direction.map(|x| x as f32),
            t_max: ray.t_max as f32,
        });
        rays.double.push(*ray);
    }
    let truths: Vec<Truth> = case.rays.iter().map(|ray| Truth::of(ray, &case.triangles)).collect();
    let mut results = Vec::new();
    let mut record = |name: &'static str, engine: &mut dyn Engine| {
        let mut failures = Failures::default();
        for (truth, found) in truths.iter().zip(trace_closest(engine, &rays)) {
            let found = found.is_hit().then_some((found.t, found.triangle as usize));
            match truth.judge(found, &case.triangles, TOLERANCE) {
                Verdict::Right => {}
                Verdict::Lost => failures.lost += 1,
                Verdict::Invented | Verdict::Misplaced | Verdict::NotTheLowest => failures.wrong += 1,
            }
        }
        results.push((name, failures));
    };

    let path = folder.join("case.outcrop");
    let text = |error: outcrop::error::CompileError| error.to_string();
    match case.precision {
        Precision::Float32 => {
            compile(&path, PrecisionChoice::Float32, VertexBatch::Float32(&single), &triangles)
                .map_err(text)?;
        }
        Precision::Lattice(lattice) => {
            let precision = PrecisionChoice::Lattice { exponent: lattice.exponent };
            compile(&path, precision, VertexBatch::Float64(&vertices), &triangles).map_err(text)?;
        }
    }
    for tier in Tier::ALL {
        let octree = open(&path, Bytes::mib(256), tier)?;
        record(tier.name(), &mut Outcrop::new(tier.name(), &octree)?);
    }
    for mode in [Mode::DEFAULT, Mode::ROBUST] {
        record(mode.name, &mut Embree::new(&mesh, mode)?);
    }
    record("parry3d", &mut Parry::new(&mesh));
    record("obvhs", &mut Obvhs::new(&mesh));
    Ok(results)
}
