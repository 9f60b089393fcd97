//! The compiled forms of the path loop: which effects it can have at all (I6).
//!
//! The loop is written once, generic over one of these sets. What a set leaves out is not there in its code: no test, no
//! state beside the rays. Combinations that are not here run in [`Sampled`] and are gated at run time.
//! Which one a batch of samples takes is decided by what its camera rays have hit (`Stage::loop_of_hits`).

/// Effects that a compiled path loop knows.
pub(super) trait EffectsOfLoop {
    /// Rays go on from hits: reflection, transmission.
    const SECONDARY: bool;
    /// Everything else: lights with extent, rough surfaces, interreflection, nested media, luck.
    const SAMPLED: bool;
    /// What hits look like depends on attributes of their triangle's corners.
    const DETAILED: bool = false;
}

/// Direct light and shadows on matt surfaces: a picture of bricks costs what a brick renderer costs.
pub(super) struct Matt;

impl EffectsOfLoop for Matt {
    const SECONDARY: bool = false;
    const SAMPLED: bool = false;
}

/// Smooth mirrors and glass as well.
pub(super) struct Whitted;

impl EffectsOfLoop for Whitted {
    const SECONDARY: bool = true;
    const SAMPLED: bool = false;
}

/// Everything.
pub(super) struct Sampled;

impl EffectsOfLoop for Sampled {
    const SECONDARY: bool = true;
    const SAMPLED: bool = true;
}

/// Everything, on surfaces with attributes.
pub(super) struct Detailed;

impl EffectsOfLoop for Detailed {
    const SECONDARY: bool = true;
    const SAMPLED: bool = true;
    const DETAILED: bool = true;
}
