//! Queries: closest hit, any hit, all hits and crossings in order, for streams of rays.
//!
//! A [`Tracer`] belongs to one thread and holds all the memory that queries need; nothing is allocated while rays are
//! traced. Rays of one call are traced in the order given, and no result depends on that order.
//!
//! A tracer waits for every block that is missing. A [`RayPool`] puts the ray aside instead and goes on with others, so
//! that one load serves all rays that need it; it answers in any order. A [`BlockLoader`] loads for it while it traces.
//!
//! # Example
//! How much of a ball lies on a line, and which points of it see each other:
//! ```
//! use std::ops::ControlFlow;
//! use std::sync::Arc;
//!
//! use outcrop::compile::{CompileOptions, Compiler, Control};
//! use outcrop::geom::{Ray, Sense, SightEnd, line_of_sight};
//! use outcrop::octree::OctreeOptions;
//! use outcrop::procedural::{Icosphere, Shape};
//! use outcrop::source::DiskSource;
//! use outcrop::trace::Occlusion;
//! use outcrop::units::Bytes;
//! use outcrop::{LazyOctree, MemoryBudget};
//!
//! let directory = tempfile::tempdir()?;
//! let path = directory.path().join("ball.outcrop");
//! let budget = MemoryBudget::new(Bytes::mib(64));
//! let mut progress = |_| Control::Continue;
//! let mut compiler = Compiler::new(&path, CompileOptions::default(), &budget, &mut progress)?;
//! Icosphere::new(1.0, [0.0; 3], 5)?.emit(&mut compiler)?;
//! compiler.finish()?;
//! let octree = LazyOctree::open(Arc::new(DiskSource::open(&path)?), &budget, OctreeOptions::default())?;
//! let mut tracer = octree.tracer()?;
//!
//! let ray = Ray::new([-5.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
//! let (mut inside, mut found) = (0.0, Vec::new());
//! tracer.crossings(&[ray], |_, crossing| {
//!     inside += if crossing.sense == Sense::Exit { crossing.hit.t } else { -crossing.hit.t };
//!     found.push(crossing.hit);
//!     ControlFlow::Continue(())
//! })?;
//! assert_eq!(found.len(), 2);
//! assert!((inside - 2.0).abs() < 0.01);
//!
//! let [near, far] = [found[0], found[1]].map(|hit| SightEnd::from(&hit));
//! let eye = SightEnd::Free([-5.0, 3.0, 0.0]);
//! let pairs = [(eye, near), (near, eye), (eye, far), (near, far)];
//! let rays: Vec<Ray> = pairs.iter().filter_map(|(from, to)| line_of_sight(from, to)).collect();
//! let mut occlusions = vec![Occlusion::Clear; rays.len()];
//! tracer.occluded(&rays, None, &mut occlusions)?;
//! assert_eq!(occlusions[..3], [Occlusion::Clear, Occlusion::Clear, Occlusion::Blocked]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod all;
mod any;
mod closest;
mod crossings;
mod exact;
mod hit;
mod in_flight;
mod keep;
mod load;
mod loader;
mod policy;
mod pool;
mod requests;
#[cfg(test)]
mod small_model;
mod stack;
mod suspended;
mod together;
mod tracer;
mod unvisited;
mod way;

pub(crate) use closest::lanes_in_use;
pub use crossings::Crossing;
pub use hit::{Hit, MaterialSet, Occlusion};
pub use load::LoadStats;
pub use loader::{BlockLoader, LoaderOptions};
pub use pool::{PoolOptions, RayPool};
pub use requests::{Answers, AnyRequest, ClosestRequest, OnMissing};
pub use tracer::Tracer;
