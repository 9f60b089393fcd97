//! I5 from end to end: a compiled file that is cut off or has bits flipped gives a typed error or the same hits, never a
//! panic and never a wrong hit.

#[path = "support/compiled.rs"]
mod compiled;
#[path = "support/numbers.rs"]
mod numbers;

use std::sync::Arc;

use compiled::compiled;
use numbers::Random;
use outcrop::compile::CompileOptions;
use outcrop::error::Error;
use outcrop::geom::Ray;
use outcrop::octree::OctreeOptions;
use outcrop::procedural::{GlassStack, Shape, Soup};
use outcrop::source::MemorySource;
use outcrop::trace::Hit;
use outcrop::units::Bytes;
use outcrop::{LazyOctree, MemoryBudget};

/// Rays through all of the models below, so that every block is read.
fn rays() -> Vec<Ray> {
    let mut rays = Vec::new();
    for i in 0..8 {
        for j in 0..8 {
            let [x, y] = [i, j].map(|k| (f64::from(k) + 0.37) / 4.0 - 1.0);
            rays.push(Ray::new([x, y, 9.0], [0.01, -0.02, -1.0]));
            rays.push(Ray::new([9.0, x, y], [-1.0, 0.02, 0.01]));
        }
    }
    rays
}

fn traced(file: Vec<u8>) -> Result<(Vec<Option<Hit>>, u64), Error> {
    let budget = MemoryBudget::new(Bytes::mib(16));
    let source = Arc::new(MemorySource::new(file)?);
    let octree =
        LazyOctree::open(source, &budget, OctreeOptions { slots_max: Some(8), ..OctreeOptions::default() })?;
    let mut tracer = octree.tracer()?;
    let rays = rays();
    let mut hits = vec![None; rays.len()];
    tracer.closest_hits(&rays, &mut hits)?;
    Ok((hits, octree.blocks_touched()))
}

fn models() -> [Vec<u8>; 2] {
    let options = CompileOptions { block_bytes: 4096, ..CompileOptions::default() };
    let shapes: [&dyn Shape; 2] =
        [&GlassStack::new(12, 0.3, 0.5, 1.5).unwrap(), &Soup::new(600, 0.3, 4).unwrap()];
    shapes.map(|shape| compiled(shape, &options))
}

#[test]
fn every_truncation_is_an_error() {
    for file in models() {
        assert!(traced(file.clone()).is_ok());
        for length in 0..file.len() {
            assert!(traced(file[..length].to_vec()).is_err(), "cut off at byte {length}");
        }
        let longer = [&file[..], &[0]].concat();
        assert!(traced(longer).is_err(), "a byte too many");
    }
}

fn flip_bits(count: u64, seed: u64) {
    let mut random = Random(seed);
    for file in models() {
        let (expected, touched) = traced(file.clone()).unwrap();
        assert!(touched >= 1 && expected.iter().flatten().count() > 20);
        let mut caught = 0;
        for _ in 0..count / 2 {
            let mut damaged = file.clone();
            // One bit, or a few.
            for _ in 0..=random.below(3) {
                random.flip(&mut damaged);
            }
            match traced(damaged) {
                Ok((hits, _)) => assert!(hits == expected, "a damaged file gave other hits"),
                Err(_) => caught += 1,
            }
        }
        // What is not caught lies in padding or in blocks that no ray reached.
        assert!(10 * caught > 9 * (count / 2), "only {caught} of {} noticed", count / 2);
    }
}

#[test]
fn a_hundred_thousand_flipped_bits_are_an_error_or_change_nothing() {
    flip_bits(100_000, 1);
}
