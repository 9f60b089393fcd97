//! Hard cases of ray tracing, by name. Each has a construction in code, an expected result from exact integers
//! (`tests/geom/oracle.rs`), and a line in `docs/numerics.md` that says what fails there and why it holds here;
//! [`index`] fails if one of the three is missing.

#[path = "../support/compiling.rs"]
mod compiling;
#[path = "../geom/oracle.rs"]
mod oracle;
#[path = "../geom/samples.rs"]
#[allow(dead_code)]
mod samples;
#[path = "../support/mod.rs"]
mod support;
use support::numbers;

mod cases;
mod everywhere;
mod truth;

mod axes;
mod bounds;
mod boxes;
mod index;
mod input;
mod leaks;
mod light;
mod scales;
mod shading;
mod shapes;
mod surfaces;
mod tiers;
mod ties;
