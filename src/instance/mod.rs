//! Instances: a model that stands in many places is held once.
//!
//! [`Instances`] is a tree over the boxes of instances, above the octrees of their models: blocks are loaded, cached and forgotten
//! per model, however often it is placed. Moving instances ([`Instances::place`]) makes the upper tree anew and touches no block.
//!
//! An [`InstanceTracer`] moves a ray into the space of each model whose instance it may meet. That rounds; so nothing is decided
//! there: the octree is walked with the rounding taken into every box and every reject test, and what is left is decided on the
//! vertices of the instance in the world, each the model's vertex under one map in one order of operations
//! ([`Affine::point`](crate::geom::Affine::point)). So hits are those of a model in which every instance is written out (I2, I3):
//! no leak at edges inside an instance, and none between instances whose vertices fall on the same numbers. `docs/numerics.md` has
//! the bounds.
//!
//! Triangles are numbered by instance, then by their number in the model ([`InstanceTriangle`]): ties go to the first instance.

#[cfg(feature = "gltf")]
mod gltf;
mod goal;
mod instances;
mod moved_ray;
mod placed;
mod tracer;
mod tree;
mod walk;

#[cfg(feature = "gltf")]
pub use gltf::GltfInstances;
pub use instances::{Instance, InstanceTriangle, Instances};
pub use tracer::InstanceTracer;
