//! No ray passes through a closed surface.

use crate::cases::{self, Case};
use crate::everywhere::check;
use crate::truth::Truth;

/// Checks the case, and that it is what it says: every ray meets something.
fn check_closed(case: &Case) {
    let opening = case.rays.iter().find(|ray| Truth::of(ray, &case.triangles).hits.is_empty());
    assert_eq!(opening, None, "{}: the model is not closed", case.name);
    check(case);
}

#[test]
fn leaks_at_vertices() {
    for translation in cases::TRANSLATIONS {
        check_closed(&cases::closed_sphere("leaks_at_vertices", translation, false));
    }
}

#[test]
fn leaks_at_edges() {
    for translation in cases::TRANSLATIONS {
        let mut case = cases::closed_sphere("leaks_at_edges", translation, true);
        case.rays.truncate(1500);
        check_closed(&case);
    }
}

#[test]
fn leaks_of_hulls() {
    check_closed(&cases::closed_hulls());
}

#[test]
fn leaks_of_a_grid() {
    check_closed(&cases::grid_from_above());
}

#[test]
fn seams_across_block_borders() {
    for bits in 10..=24 {
        let mut case = cases::sphere_on_lattice(bits);
        // A different part for each; the first vertices of each sphere are those of the icosahedron.
        let skip = 150 * (bits - 10) as usize;
        case.rays = case.rays.iter().copied().cycle().skip(skip).take(400).collect();
        check_closed(&case);
    }
}
