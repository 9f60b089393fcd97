//! An instance made ready: its inverse, its box, and how far rounding can go.

use super::instances::Instance;
use crate::block::attributes::CornerAttributes;
use crate::geom::{Aabb, Affine, Motion, gamma};

/// More than the roundings of the few operations that a bound is computed with.
pub(super) const SLACK: f64 = 1.0 + 1e-9;

/// Largest coordinate that an instance may reach, with room to the `2^252` of exact decisions.
const COORDINATE_MAX: f64 = f64::from_bits((1023 + 250) << 52);

/// How far the computed inverse times the matrix may be from the identity: then it has six digits at least.
const RESIDUAL_MAX: f64 = 1.0 / (1u64 << 20) as f64;

/// See the module's text.
#[derive(Clone, Debug)]
pub(crate) struct Placed {
    /// Number of its model.
    pub model: u32,
    /// From the model to the world.
    pub map: Affine,
    /// Whether it is mirrored, so that its triangles are turned around to keep their outer side outside.
    pub is_mirrored: bool,
    /// Of the matrix, nearly.
    pub inverse: [[f64; 3]; 3],
    /// Where the model's origin stands.
    pub shift: [f64; 3],
    /// Holds all its vertices in the world.
    pub bounds: Aabb,
    /// Largest magnitude of the model's coordinates.
    pub reach: [f64; 3],
    /// How far a point of a triangle and the ray that meets it in the world may be apart in the model, whatever the ray.
    pub error: [f64; 3],
}

impl Placed {
    /// Makes an instance of a model with these bounds ready; gives why it cannot be.
    pub fn new(instance: &Instance, model: &Aabb) -> Result<Placed, &'static str> {
        let map = instance.map;
        map.validate()?;
        let matrix = map.matrix();
        let inverse = inverse(&matrix).ok_or("its map is flat: it has no inverse")?;
        let reach = if model.is_empty() {
            [0.0; 3]
        } else {
            [0, 1, 2].map(|axis| model.min[axis].abs().max(model.max[axis].abs()))
        };
        // Written so that NaN fails.
        if !map.permanent(reach).iter().all(|x| *x <= COORDINATE_MAX) {
            return Err("it reaches beyond 2^250");
        }
        let residual = residual(&inverse, &matrix);
        if !residual.iter().all(|row| row.iter().sum::<f64>() <= RESIDUAL_MAX) {
            return Err("its map is nearly flat: it has no inverse of any use");
        }
        // docs/numerics.md, "Instances".
        let vertex_error = map.point_error(reach);
        let error = [0, 1, 2].map(|axis| {
            let of_vertices: f64 = (0..3).map(|k| inverse[axis][k].abs() * vertex_error[k]).sum();
            let of_inverse: f64 = (0..3).map(|k| residual[axis][k] * reach[k]).sum();
            (of_vertices + of_inverse) * SLACK + f64::MIN_POSITIVE
        });
        let mut bounds = Aabb::EMPTY;
        if !model.is_empty() {
            for (axis, [a, b, c, shift]) in map.rows().into_iter().enumerate() {
                let (mut low, mut high) = (shift, shift);
                for (factor, k) in [(a, 0), (b, 1), (c, 2)] {
                    let (x, y) = (factor * model.min[k], factor * model.max[k]);
                    low += x.min(y);
                    high += x.max(y);
                }
                // The sums round like those of vertices.
                let pad = 2.0 * vertex_error[axis];
                (bounds.min[axis], bounds.max[axis]) = ((low - pad).next_down(), (high + pad).next_up());
            }
        }
        let is_mirrored = map.orientation() < 0.0;
        Ok(Placed {
            model: instance.model,
            map,
            is_mirrored,
            inverse,
            shift: map.shift(),
            bounds,
            reach,
            error,
        })
    }

    /// A box around all vertices of an instance of a model with these bounds on their way; gives why there is none.
    pub fn bounds_on_way(instance: &Instance, motion: &Motion, model: &Aabb) -> Result<Aabb, &'static str> {
        let parts = motion.part_count();
        let mut bounds = Aabb::EMPTY;
        let (mut largest, mut radius) = ([0.0f64; 3], 0.0f64);
        for part in 0..=parts {
            let time = f64::from(part) / f64::from(parts);
            let map = if part == parts { *motion.end() } else { motion.at(time) };
            for map in [map, motion.at(time)] {
                let there = Placed::new(&Instance { map, ..*instance }, model)?;
                bounds.merge(&there.bounds);
                let permanent = there.map.permanent(there.reach);
                let turned = there.map.with_shift([0.0; 3]).permanent(there.reach);
                (0..3).for_each(|axis| largest[axis] = largest[axis].max(permanent[axis]));
                radius = radius.max(turned.iter().sum());
            }
        }
        // Numbers of maps in between are off by two roundings of the numbers at the ends; where it turns by those of a rotation and
        // of its product with the first map, of which each row adds up to no more than the radius.
        let stray = motion.stray(radius * SLACK);
        let turned = if stray > 0.0 { radius } else { 0.0 };
        for (axis, largest) in largest.into_iter().enumerate() {
            let pad = stray + gamma(32) * (2.0 * largest + 3.0 * turned);
            bounds.min[axis] -= pad;
            bounds.max[axis] += pad;
        }
        Ok(bounds)
    }

    /// The corners of a triangle in the world, turned around if the instance is mirrored.
    #[inline(always)]
    pub fn vertices(&self, [a, b, c]: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
        let [a, b, c] = [self.map.point(*a), self.map.point(*b), self.map.point(*c)];
        if self.is_mirrored { [a, c, b] } else { [a, b, c] }
    }

    /// The attributes of a triangle's corners, turned with it.
    pub fn attributes(&self, attributes: CornerAttributes) -> CornerAttributes {
        let CornerAttributes { mut uvs, mut normals } = attributes;
        if self.is_mirrored {
            // As the corners themselves.
            uvs.iter_mut().for_each(|uvs| uvs.swap(1, 2));
            normals.iter_mut().for_each(|normals| normals.swap(1, 2));
        }
        CornerAttributes { uvs, normals: normals.map(|normals| normals.map(|normal| self.normal(normal))) }
    }

    /// The unit normal that a normal of the model becomes; zero if it was.
    fn normal(&self, normal: [f64; 3]) -> [f64; 3] {
        let [a, b, c] = self.inverse;
        let turned = [0, 1, 2].map(|axis| a[axis] * normal[0] + b[axis] * normal[1] + c[axis] * normal[2]);
        let largest = turned.iter().fold(0.0f64, |largest, x| largest.max(x.abs()));
        if largest == 0.0 || !largest.is_finite() {
            return [0.0; 3];
        }
        let scaled = turned.map(|x| x / largest);
        let length = (scaled[0] * scaled[0] + scaled[1] * scaled[1] + scaled[2] * scaled[2]).sqrt();
        scaled.map(|x| x / length)
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The inverse, by cofactors, of rows scaled by powers of two so that nothing leaves the range of f64.
fn inverse(matrix: &[[f64; 3]; 3]) -> Option<[[f64; 3]; 3]> {
    let mut scaled = *matrix;
    let mut powers = [1.0; 3];
    for (row, power) in scaled.iter_mut().zip(&mut powers) {
        let largest = row.iter().fold(0.0f64, |largest, x| largest.max(x.abs()));
        if largest < f64::MIN_POSITIVE {
            return None;
        }
        let exponent = ((largest.to_bits() >> 52) as i64 - 1023).clamp(-1000, 1000);
        *power = f64::from_bits(((1023 - exponent) as u64) << 52);
        row.iter_mut().for_each(|x| *x *= *power);
    }
    let [a, b, c] = scaled;
    let columns = [cross(b, c), cross(c, a), cross(a, b)];
    let determinant = a[0] * columns[0][0] + a[1] * columns[0][1] + a[2] * columns[0][2];
    let inverse = [0, 1, 2].map(|axis| [0, 1, 2].map(|k| columns[k][axis] / determinant * powers[k]));
    inverse.iter().flatten().all(|x| x.is_finite()).then_some(inverse)
}

/// Bounds on the magnitudes of the identity less `inverse` times `matrix`.
fn residual(inverse: &[[f64; 3]; 3], matrix: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|row| {
        [0, 1, 2].map(|column| {
            let products = [0, 1, 2].map(|k| inverse[row][k] * matrix[k][column]);
            let one = if row == column { 1.0 } else { 0.0 };
            let difference: f64 = products.iter().sum::<f64>() - one;
            let permanent = products.iter().fold(one, |sum, product| sum + product.abs());
            (difference.abs() + gamma(6) * permanent) * SLACK
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverses_are_inverses_or_are_refused() {
        let shear = [[1.0, 0.5, 0.0], [0.0, 2.0, 0.25], [0.0, 0.0, -4.0]];
        let good = [
            (shear, true),
            ([[1e-100, 0.0, 0.0], [0.0, 1e100, 0.0], [0.0, 0.0, 1.0]], false),
            ([[0.0, 0.0, 3.0], [1e-9, 0.0, 0.0], [0.0, 7.0, 0.0]], false),
        ];
        for (matrix, is_mirrored) in good {
            let inverse = inverse(&matrix).unwrap();
            assert!(residual(&inverse, &matrix).iter().flatten().all(|x| *x < 1e-14), "{matrix:?}");
            let map = Affine::from_rows(matrix.map(|[a, b, c]| [a, b, c, 0.0]));
            assert_eq!(map.orientation() < 0.0, is_mirrored);
        }
        assert!(inverse(&[[1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [0.0, 0.0, 1.0]]).is_none());
        assert!(inverse(&[[0.0; 3]; 3]).is_none());
        let nearly = [[1.0, 1.0, 0.0], [1.0, 1.0 + 1e-15, 0.0], [0.0, 0.0, 1.0]];
        let found = inverse(&nearly).unwrap();
        assert!(residual(&found, &nearly).iter().any(|row| row.iter().sum::<f64>() > RESIDUAL_MAX));
    }
}
