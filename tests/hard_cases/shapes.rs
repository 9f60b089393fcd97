//! Triangles that tests get wrong: needles, triangles of no area, rays in their plane.

use crate::cases;
use crate::everywhere::{check, expected};
use crate::truth::Truth;

#[test]
fn needles_at_grazing_incidence() {
    let case = cases::needles();
    check(&case);
    // Hits are kept: most of the rays are aimed well inside.
    let kept = expected(&case).iter().filter(|hit| hit.is_some()).count();
    assert!(10 * kept > 9 * case.rays.len(), "{kept} of {}", case.rays.len());
}

#[test]
fn zero_area_and_collinear_triangles() {
    check(&cases::without_area());
}

#[test]
fn rays_in_a_triangles_plane() {
    let case = cases::in_the_plane();
    check(&case);
    // The first of each pair of rays lies in the plane of its triangle and never meets it.
    for (index, pair) in case.rays.chunks(2).enumerate() {
        assert!(Truth::of(&pair[0], &case.triangles[index..=index]).hits.is_empty());
    }
}
