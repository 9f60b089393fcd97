//! A source that fails in the middle of a render ends it with an error that names the block: never a hole in the image,
//! never a panic, and the octree is as good as before.

#[path = "support/compiled.rs"]
mod compiled;

use std::sync::Arc;

use compiled::compiled;
use outcrop::compile::{CompileOptions, Control, Threads};
use outcrop::error::{LoadError, RenderError, TraceError};
use outcrop::octree::OctreeOptions;
use outcrop::procedural::{Gears, Tessellation};
use outcrop::render::{RenderSettings, Renderer};
use outcrop::scene::Scene;
use outcrop::source::testing::{FaultRates, FaultySource};
use outcrop::source::{BlockSource, MemorySource};
use outcrop::units::Bytes;
use outcrop::{LazyOctree, MemoryBudget};

/// Toothed wheels in small blocks.
fn gears() -> Vec<u8> {
    let options = CompileOptions { block_bytes: 8192, ..CompileOptions::default() };
    compiled(&Gears::with_tessellation(1, Tessellation::new(12).unwrap()).unwrap(), &options)
}

struct Picture {
    pixels: Vec<[f32; 3]>,
    loads: u64,
}

/// Renders twice through one octree with few slots, so that blocks are read again and again.
fn rendered(source: Arc<dyn BlockSource>, threads: &Threads) -> [Result<Picture, RenderError>; 2] {
    let budget = MemoryBudget::new(Bytes::mib(64));
    let options = OctreeOptions { tracers_max: 2, slots_max: Some(3), ..OctreeOptions::default() };
    let scene = Scene::automatic(&source.model().bounds, 1.0).with_automatic_lights();
    let octree = LazyOctree::open(source, &budget, options).unwrap();
    let settings = RenderSettings { tile_size: 8, ..RenderSettings::new(32, 32) };
    let renderer = Renderer::new(&octree, &scene, &settings, &budget).unwrap();
    [(); 2].map(|()| {
        let image = renderer.render(threads, &mut |_| Control::Continue)?;
        assert!(image.film.is_complete());
        Ok(Picture { pixels: image.film.pixels().to_vec(), loads: image.report.trace.blocks_loaded })
    })
}

#[test]
fn a_bad_block_ends_the_render_with_an_error_and_not_with_a_hole() {
    let file = gears();
    let source = || MemorySource::new(file.clone()).unwrap();
    let [reference, again] = rendered(Arc::new(source()), &Threads::One).map(Result::unwrap);
    assert!(reference.pixels == again.pixels);
    // About as many renders fail as not.
    let rate = 0.5 / reference.loads as f64;
    let kinds = [
        FaultRates { io_errors: rate, ..FaultRates::default() },
        FaultRates { short_reads: rate, ..FaultRates::default() },
        FaultRates { bit_flips: rate, ..FaultRates::default() },
    ];
    for (kind, rates) in kinds.into_iter().enumerate() {
        let (mut failed, mut complete) = (0, 0);
        for seed in 0..10 {
            let faulty = Arc::new(FaultySource::new(source(), seed, rates));
            let threads = if seed % 2 == 0 { Threads::One } else { Threads::Count(2) };
            for result in rendered(faulty.clone(), &threads) {
                match result {
                    Ok(picture) => {
                        assert!(picture.pixels == reference.pixels, "kind {kind}, seed {seed}");
                        complete += 1;
                    }
                    Err(RenderError::Trace(TraceError::Load(error))) => {
                        assert!(faulty.fault_count() > 0);
                        let damaged = matches!(error, LoadError::Block(_));
                        assert_eq!(damaged, kind > 0, "kind {kind}, seed {seed}: {error}");
                        assert!(error.to_string().contains("block "), "{error}");
                        failed += 1;
                    }
                    Err(error) => panic!("kind {kind}, seed {seed}: {error}"),
                }
            }
        }
        assert!(failed > 0 && complete > 0, "kind {kind}: {failed} failed, {complete} complete");
    }
}
