//! What each pixel took: a part of the whole that adds up, and does not depend on what was in memory.

#[path = "support/compiled.rs"]
mod compiled;

use std::sync::Arc;

use compiled::compiled;
use outcrop::compile::{CompileOptions, Control};
use outcrop::octree::{LazyOctree, OctreeOptions};
use outcrop::procedural::Gears;
use outcrop::render::{AdaptiveSampling, PixelCost, RenderSettings, RenderedImage, Renderer, Threads};
use outcrop::scene::{Camera, Light, Scene};
use outcrop::source::MemorySource;
use outcrop::units::Bytes;
use outcrop::{BlockSource, MemoryBudget};

fn scene() -> Scene {
    let camera = Camera::pinhole(Gears::EYE, [0.0; 3], [0.0, 0.0, 1.0], 45.0).unwrap();
    Scene::new(camera).with_lights(Gears::LAMPS.map(|position| Light::point(position, [0.5; 3])))
}

fn render(bytes: &[u8], settings: &RenderSettings, slots_max: Option<u32>, threads: usize) -> RenderedImage {
    let budget = MemoryBudget::new(Bytes::mib(256));
    let source: Arc<dyn BlockSource> = Arc::new(MemorySource::new(bytes.to_vec()).unwrap());
    let options = OctreeOptions { tracers_max: threads as u32, slots_max, ..Default::default() };
    let octree = LazyOctree::open(source, &budget, options).unwrap();
    let renderer = Renderer::new(&octree, &scene(), settings, &budget).unwrap();
    renderer.render(&Threads::Count(threads), &mut |_| Control::Continue).unwrap()
}

fn sums(costs: &[PixelCost]) -> [u64; 2] {
    costs.iter().fold([0, 0], |[boxes, triangles], cost| {
        [boxes + u64::from(cost.box_tests), triangles + u64::from(cost.triangle_tests)]
    })
}

#[test]
fn costs_add_up_and_do_not_depend_on_memory() {
    let options = CompileOptions { block_bytes: 8 << 10, ..Default::default() };
    let bytes = compiled(&Gears::new(1).unwrap(), &options);
    for samples in [1, 5] {
        let plain = RenderSettings { samples_per_pixel: samples, ..RenderSettings::new(40, 30) };
        let settings = RenderSettings { keep_costs: true, ..plain };
        let without = render(&bytes, &plain, None, 1);
        assert_eq!(without.film.costs(), None);
        let first = render(&bytes, &settings, None, 1);
        assert_eq!(first.film.pixels(), without.film.pixels(), "it shows");
        let costs = first.film.costs().unwrap();
        assert_eq!(costs.len(), 40 * 30);
        let trace = &first.report.trace;
        assert_eq!(sums(costs), [trace.box_tests, trace.triangle_tests]);
        // Rays past the model are cheaper than those that enter it.
        let cheapest = costs.iter().map(|cost| cost.box_tests).min().unwrap();
        let dearest = costs.iter().map(|cost| cost.box_tests).max().unwrap();
        assert!(dearest > 10 * cheapest && cheapest > 0, "{cheapest} {dearest}");
        let small = render(&bytes, &RenderSettings { tile_size: 7, ..settings }, Some(3), 2);
        assert_eq!(small.film.costs(), Some(costs));
    }
}

#[test]
fn adaptive_pixels_cost_what_their_own_samples_do() {
    let bytes = compiled(&Gears::new(1).unwrap(), &CompileOptions::default());
    let adaptive = AdaptiveSampling { samples_min: 4, error: 0.02, confidence: 0.9 };
    let settings = RenderSettings {
        samples_per_pixel: 16,
        adaptive: Some(adaptive),
        keep_statistics: true,
        keep_costs: true,
        ..RenderSettings::new(24, 24)
    };
    let one = render(&bytes, &settings, None, 1);
    let costs = one.film.costs().unwrap();
    let tiles = render(&bytes, &RenderSettings { tile_size: 5, ..settings }, None, 2);
    assert_eq!(tiles.film.costs(), Some(costs), "what tiles trace around themselves is not theirs");
    // One tile has no border, so all that was traced belongs to its pixels.
    assert_eq!(sums(costs), [one.report.trace.box_tests, one.report.trace.triangle_tests]);
    let statistics = one.film.statistics().unwrap();
    let per_sample = |few: bool| {
        let chosen = costs.iter().zip(statistics).filter(|(_, pixel)| (pixel.samples == 4) == few);
        let (cost, count) =
            chosen.fold((0, 0), |(cost, count), (pixel, _)| (cost + u64::from(pixel.box_tests), count + 1));
        (cost, count)
    };
    let ((few, few_count), (many, many_count)) = (per_sample(true), per_sample(false));
    assert!(few_count > 0 && many_count > 0);
    assert!(many / many_count > few / few_count, "{many} / {many_count}, {few} / {few_count}");
}
