//! Procedural models that examples, tests and benches share.
