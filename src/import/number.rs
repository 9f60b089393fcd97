//! Decimal text to the nearest f64.

/// Reads a whole token as a number: the nearest f64 (ties to even). Takes every form that model files have
/// (`1.`, `.5`, `+1`, `1e-5`, `nan`, `inf`); `None` for anything else.
pub(super) fn parse(token: &[u8]) -> Option<f64> {
    fast_float2::parse(token).ok()
}
