//! Whole pictures of one wheel of the gears, from resident blocks: what shading adds to tracing.

#[path = "../tests/support/compiled.rs"]
mod compiled;

use std::hint::black_box;
use std::sync::Arc;

use compiled::compiled;
use criterion::{Criterion, criterion_group, criterion_main};
use outcrop::compile::{CompileOptions, Control, Threads};
use outcrop::octree::OctreeOptions;
use outcrop::procedural::Gears;
use outcrop::render::{RenderSettings, Renderer};
use outcrop::scene::{Camera, Effect, EffectSet, Light, Scene};
use outcrop::source::MemorySource;
use outcrop::units::Bytes;
use outcrop::{LazyOctree, MemoryBudget};

fn pictures(criterion: &mut Criterion) {
    let camera = Camera::pinhole(Gears::EYE, [0.0; 3], [0.0, 0.0, 1.0], 45.0).expect("a valid camera");
    let scene = Scene::new(camera)
        .with_background([0.078, 0.361, 0.753])
        .with_lights(Gears::LAMPS.map(|position| Light::point(position, [0.35; 3])));
    let budget = MemoryBudget::new(Bytes::mib(256));
    let gears = Gears::new(2).expect("n is small");
    let source =
        Arc::new(MemorySource::new(compiled(&gears, &CompileOptions::default())).expect("a whole file"));
    let options = OctreeOptions { slots_max: Some(256), ..OctreeOptions::default() };
    let octree = LazyOctree::open(source, &budget, options).expect("the budget is ample");
    let all: EffectSet = Effect::ALL.into_iter().collect();
    let secondary = EffectSet::EMPTY.with(Effect::Reflection).with(Effect::Transmission);
    for (name, switched_off) in
        [("primary", all), ("five shadows", secondary), ("everything", EffectSet::EMPTY)]
    {
        let settings = RenderSettings { switched_off, ..RenderSettings::new(256, 256) };
        let renderer = Renderer::new(&octree, &scene, &settings, &budget).expect("valid settings");
        let render = || renderer.render(&Threads::One, &mut |_| Control::Continue).expect("renders");
        let report = render().report;
        let seconds = report.seconds;
        println!(
            "{name}: {} rays; paths {:.3} s, shadows {:.3} s, shading {:.3} s",
            report.effects.rays(),
            seconds.paths,
            seconds.shadows,
            seconds.shading
        );
        criterion.bench_function(&format!("render/{name}"), |bencher| bencher.iter(|| black_box(render())));
    }
}

criterion_group! { name = benches; config = Criterion::default().sample_size(10); targets = pictures }
criterion_main!(benches);
