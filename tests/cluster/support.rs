//! A small model, a scene for it, and the picture that one machine makes of it.

use std::sync::{Arc, OnceLock};
use std::time::Duration;

use outcrop::cluster::{CoordinatorOptions, Job, RemoteOptions, RoleOptions, WorkerOptions, model_key};
use outcrop::compile::{CompileOptions, Control, Threads};
use outcrop::octree::OctreeOptions;
use outcrop::procedural::{Gears, Tessellation};
use outcrop::render::{RenderSettings, Renderer};
use outcrop::scene::{Camera, Light, Scene};
use outcrop::schedule::SchedulerOptions;
use outcrop::source::MemorySource;
use outcrop::units::Bytes;
use outcrop::{BlockSource, LazyOctree, MemoryBudget};

use super::compiled::compiled;

/// A compiled file of gears with mirrors and glass in small blocks.
pub fn model_bytes() -> &'static Arc<[u8]> {
    static BYTES: OnceLock<Arc<[u8]>> = OnceLock::new();
    BYTES.get_or_init(|| {
        let options = CompileOptions { block_bytes: 8192, ..CompileOptions::default() };
        compiled(&Gears::with_tessellation(1, Tessellation::new(16).unwrap()).unwrap(), &options).into()
    })
}

pub fn model() -> MemorySource {
    MemorySource::new(Arc::clone(model_bytes())).unwrap()
}

/// The standard view of the gears.
pub fn scene() -> Scene {
    let camera = Camera::pinhole(Gears::EYE, [0.0; 3], [0.0, 0.0, 1.0], 45.0).unwrap();
    Scene::new(camera)
        .with_light(Light::point([2.0, 4.0, 4.0], [0.5; 3]))
        .with_light(Light::point([-1.0, -4.0, 2.0], [0.5; 3]))
        .with_background([0.45, 0.55, 0.68])
        .with_ambient([0.08; 3])
}

pub fn settings() -> RenderSettings {
    // Not a multiple of anything.
    RenderSettings { samples_per_pixel: 2, ..RenderSettings::new(203, 141) }
}

pub fn job() -> Job {
    Job::new(scene(), settings(), model_key(model().model()))
}

/// The picture by one machine, with one thread.
pub fn reference() -> &'static Vec<[f32; 3]> {
    static PIXELS: OnceLock<Vec<[f32; 3]>> = OnceLock::new();
    PIXELS.get_or_init(|| {
        let budget = MemoryBudget::new(Bytes::mib(256));
        let octree = LazyOctree::open(Arc::new(model()), &budget, OctreeOptions::default()).unwrap();
        let renderer = Renderer::new(&octree, &scene(), &settings(), &budget).unwrap();
        let image = renderer.render(&Threads::One, &mut |_| Control::Continue).unwrap();
        image.into_complete().unwrap().pixels().to_vec()
    })
}

pub fn quick_roles() -> RoleOptions {
    RoleOptions { heartbeat: Duration::from_millis(100), silence_max: Duration::from_secs(10) }
}

pub fn coordinator_options(workers: u32, readers: usize) -> CoordinatorOptions {
    CoordinatorOptions { roles: quick_roles(), schedule: SchedulerOptions::new(workers), readers }
}

pub fn worker_options(name: &str, lanes: u16, file: Option<Arc<dyn BlockSource>>) -> WorkerOptions {
    WorkerOptions {
        lanes,
        file,
        octree: OctreeOptions { slots_max: Some(24), ..OctreeOptions::default() },
        remote: RemoteOptions { retry_after: Duration::from_millis(300), ..RemoteOptions::default() },
        roles: quick_roles(),
        ..WorkerOptions::new(name, MemoryBudget::new(Bytes::mib(64)))
    }
}
