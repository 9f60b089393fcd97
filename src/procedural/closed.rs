//! Is a surface closed?

use std::collections::HashMap;

/// How many directed edges are not met by exactly one edge in the opposite direction: 0 for surfaces that are closed,
/// oriented and manifold along every edge. Edges are compared by vertex index. Memory grows with the triangles.
pub fn open_edges(triangles: &[[u32; 3]]) -> usize {
    let mut edges: HashMap<[u32; 2], u32> = HashMap::new();
    for &[a, b, c] in triangles {
        for edge in [[a, b], [b, c], [c, a]] {
            *edges.entry(edge).or_default() += 1;
        }
    }
    edges.iter().filter(|&(&[a, b], &count)| count != 1 || edges.get(&[b, a]) != Some(&1)).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holes_flips_and_doubles_are_counted() {
        let tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        assert_eq!(open_edges(&tetrahedron), 0);
        assert_eq!(open_edges(&tetrahedron[1..]), 3);
        let mut flipped = tetrahedron;
        flipped[0].reverse();
        // Each of its edges now runs twice in one direction and never in the other.
        assert_eq!(open_edges(&flipped), 3);
        let doubled = [tetrahedron[0], tetrahedron[1], tetrahedron[2], tetrahedron[3], tetrahedron[3]];
        assert_eq!(open_edges(&doubled), 6);
    }
}
