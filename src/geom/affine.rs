//! Affine maps: where an instance of a model stands.

use serde::{Deserialize, Serialize};

/// A map `x -> M x + c` of space onto itself: moved, turned, scaled, sheared.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Affine {
    /// Per axis of the result: three numbers of `M`, then one of `c`.
    rows: [[f64; 4]; 3],
}

/// Every result of [`Affine::point`] is a multiple of this: then it is a vertex that hits can be decided on exactly.
const COORDINATE_UNIT: f64 = f64::from_bits((1023 - 252) << 52);

impl Affine {
    /// Leaves everything where it is.
    pub const IDENTITY: Affine =
        Affine { rows: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]] };

    /// The map whose rows are these: per axis of the result, three numbers of the matrix and the shift.
    pub fn from_rows(rows: [[f64; 4]; 3]) -> Affine {
        Affine { rows }
    }

    /// Shifts by `offset`.
    pub fn translation(offset: [f64; 3]) -> Affine {
        let mut map = Affine::IDENTITY;
        for (row, offset) in map.rows.iter_mut().zip(offset) {
            row[3] = offset;
        }
        map
    }

    /// Multiplies each axis by a factor, about the origin.
    pub fn scale(factors: [f64; 3]) -> Affine {
        let mut map = Affine::IDENTITY;
        for (axis, factor) in factors.into_iter().enumerate() {
            map.rows[axis][axis] = factor;
        }
        map
    }

    /// Turns about the line through the origin along `axis` (of any length but zero), counter-clockwise for who looks against it.
    /// Multiples of a right angle about a coordinate axis are exact. The same on every machine (I2).
    pub fn rotation(axis: [f64; 3], degrees: f64) -> Affine {
        let length = (axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]).sqrt();
        let [x, y, z] = axis.map(|component| component / length);
        let (sin, cos) = match degrees.rem_euclid(360.0) {
            0.0 => (0.0, 1.0),
            90.0 => (1.0, 0.0),
            180.0 => (0.0, -1.0),
            270.0 => (-1.0, 0.0),
            degrees => (libm::sin(degrees.to_radians()), libm::cos(degrees.to_radians())),
        };
        Affine::rotation_of([x, y, z], sin, cos)
    }

    /// [`Affine::rotation`] about a unit axis by the angle with this sine and cosine.
    pub(super) fn rotation_of([x, y, z]: [f64; 3], sin: f64, cos: f64) -> Affine {
        let rest = 1.0 - cos;
        Affine {
            rows: [
                [cos + x * x * rest, x * y * rest - z * sin, x * z * rest + y * sin, 0.0],
                [y * x * rest + z * sin, cos + y * y * rest, y * z * rest - x * sin, 0.0],
                [z * x * rest - y * sin, z * y * rest + x * sin, cos + z * z * rest, 0.0],
            ],
        }
    }

    /// This map, and `next` after it.
    #[must_use]
    pub fn then(&self, next: &Affine) -> Affine {
        let rows = next.rows.map(|[a, b, c, shift]| {
            let mut row = [0, 1, 2, 3].map(|column| {
                (a * self.rows[0][column] + b * self.rows[1][column]) + c * self.rows[2][column]
            });
            row[3] += shift;
            row
        });
        Affine { rows }
    }

    /// Why nothing can be placed by the map, if nothing can.
    ///
    /// # Errors
    /// A reason if a number is not finite, or the map is flat as far as f64 can tell.
    pub fn validate(&self) -> Result<(), &'static str> {
        if !self.rows.iter().flatten().all(|x| x.is_finite()) {
            return Err("a number of its map is not finite");
        }
        // NaN, of a row of zeros, fails.
        let is_flat = self.orientation() == 0.0 || self.orientation().is_nan();
        if is_flat { Err("its map is flat: it has no inverse") } else { Ok(()) }
    }

    /// A number with the sign of the matrix' determinant: below 0 if the map mirrors.
    pub(crate) fn orientation(&self) -> f64 {
        // Magnitudes do not matter, but products must not vanish.
        let [a, b, c] = self.matrix().map(|row| {
            let largest = row.iter().fold(0.0f64, |largest, x| largest.max(x.abs()));
            row.map(|x| x / largest)
        });
        a[0] * (b[1] * c[2] - b[2] * c[1])
            + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    }

    /// The map between this one and `end`, at `time` from 0 to 1: every point moves on a straight line from where this map takes it
    /// to where `end` does.
    pub(super) fn straight_to(&self, end: &Affine, time: f64) -> Affine {
        let mut map = *self;
        for (row, end) in map.rows.iter_mut().zip(end.rows) {
            for (number, end) in row.iter_mut().zip(end) {
                *number += (end - *number) * time;
            }
        }
        map
    }

    /// Whether no map on the straight way between this one and `end` is flat, nor nearly so.
    pub(super) fn stays_upright(&self, end: &Affine) -> bool {
        // The determinant is a cubic polynomial in time, and lies between the least and the greatest of its Bernstein coefficients: the
        // mean determinants of matrices of which so many rows are the end's.
        let (from, to) = (self.matrix(), end.matrix());
        let mixed = |ends: u32| {
            let choices = (0..8u32).filter(|choice| choice.count_ones() == ends);
            let determinants = choices.map(|choice| {
                let row = |axis: usize| if choice >> axis & 1 == 1 { to[axis] } else { from[axis] };
                let [a, b, c] = [row(0), row(1), row(2)];
                a[0] * (b[1] * c[2] - b[2] * c[1])
                    + a[1] * (b[2] * c[0] - b[0] * c[2])
                    + a[2] * (b[0] * c[1] - b[1] * c[0])
            });
            let all: Vec<f64> = determinants.collect();
            all.iter().sum::<f64>() / all.len() as f64
        };
        const LEAST_SHARE: f64 = 1.0 / 64.0;
        let coefficients = [0, 1, 2, 3].map(mixed);
        let largest = coefficients.iter().fold(0.0f64, |largest, x| largest.max(x.abs()));
        let sign = coefficients[0].signum();
        // Written so that NaN fails.
        largest > 0.0 && coefficients.iter().all(|x| x * sign >= LEAST_SHARE * largest)
    }

    /// Per axis of the result: three numbers of the matrix, and the shift.
    pub fn rows(&self) -> [[f64; 4]; 3] {
        self.rows
    }

    /// Where a point goes: `((m0 x + m1 y) + m2 z) + c` per axis, rounded after each operation, and to a multiple of `2^-252`. A
    /// pure function of map and point (I2): this is where the vertices of an instance are.
    #[inline(always)]
    pub fn point(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [first, second, third] = self.rows;
        let along = |[a, b, c, shift]: [f64; 4]| snap(((a * x + b * y) + c * z) + shift);
        [along(first), along(second), along(third)]
    }

    /// More than what each operation of [`Affine::point`] can lose, for points with coordinates up to `reach` in magnitude: per axis.
    pub(crate) fn point_error(&self, reach: [f64; 3]) -> [f64; 3] {
        self.permanent(reach).map(|permanent| super::gamma(5) * permanent + COORDINATE_UNIT)
    }

    /// Per axis: the sum of the magnitudes that [`Affine::point`] adds up.
    pub(crate) fn permanent(&self, reach: [f64; 3]) -> [f64; 3] {
        self.rows.map(|[a, b, c, shift]| {
            a.abs() * reach[0] + b.abs() * reach[1] + c.abs() * reach[2] + shift.abs()
        })
    }

    /// The matrix.
    pub(crate) fn matrix(&self) -> [[f64; 3]; 3] {
        self.rows.map(|[a, b, c, _]| [a, b, c])
    }

    /// This map, but for where the origin goes.
    pub(crate) fn with_shift(mut self, shift: [f64; 3]) -> Affine {
        self.rows.iter_mut().zip(shift).for_each(|(row, shift)| row[3] = shift);
        self
    }

    /// Where the origin goes.
    pub(crate) fn shift(&self) -> [f64; 3] {
        self.rows.map(|row| row[3])
    }
}

/// `x` as a multiple of [`COORDINATE_UNIT`]; unchanged from `2^-200` up, and where it is no number.
#[inline(always)]
fn snap(x: f64) -> f64 {
    const SHIFT: f64 = 1.5 * (1u64 << 52) as f64 * COORDINATE_UNIT;
    if x.abs() < COORDINATE_UNIT * (1u64 << 52) as f64 { (x + SHIFT) - SHIFT } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_do_what_they_say() {
        let point = [1.0, 2.0, 3.0];
        assert_eq!(Affine::IDENTITY.point(point), point);
        assert_eq!(Affine::translation([10.0, 0.0, -1.0]).point(point), [11.0, 2.0, 2.0]);
        assert_eq!(Affine::scale([2.0, -1.0, 0.5]).point(point), [2.0, -2.0, 1.5]);
        // X goes to Y, Y to -X.
        assert_eq!(Affine::rotation([0.0, 0.0, 7.0], 90.0).point(point), [-2.0, 1.0, 3.0]);
        assert_eq!(Affine::rotation([0.0, 0.0, 7.0], -270.0).point(point), [-2.0, 1.0, 3.0]);
        assert_eq!(Affine::rotation([0.0, 1.0, 0.0], 180.0).point(point), [-1.0, 2.0, -3.0]);
        let third = Affine::rotation([1.0, 1.0, 1.0], 120.0).point(point);
        assert!((0..3).all(|axis| (third[axis] - point[(axis + 2) % 3]).abs() < 1e-14), "{third:?}");
        let both = Affine::scale([2.0; 3]).then(&Affine::translation([1.0, 0.0, 0.0]));
        assert_eq!(both.point(point), [3.0, 4.0, 6.0]);
        let turned = both.then(&Affine::rotation([0.0, 0.0, 1.0], 90.0));
        assert_eq!(turned.point(point), [-4.0, 3.0, 6.0]);
    }

    #[test]
    fn maps_between_two_are_on_the_way() {
        let (from, to) =
            (Affine::IDENTITY, Affine::rotation([0.0, 0.0, 1.0], 80.0).then(&Affine::translation([4.0; 3])));
        assert_eq!((from.between(&to, 0.0), from.between(&from, 0.3)), (from, from));
        let point = [1.0, 2.0, 3.0];
        // What turns does so about the origin, which is half way.
        let half = Affine::rotation([0.0, 0.0, 1.0], 40.0).then(&Affine::translation([2.0; 3])).point(point);
        let found = from.between(&to, 0.5).point(point);
        assert!((0..3).all(|axis| (found[axis] - half[axis]).abs() < 1e-14), "{found:?} {half:?}");
        let (start, end, middle) =
            (from.point(point), to.point(point), from.straight_to(&to, 0.5).point(point));
        for axis in 0..3 {
            assert!((middle[axis] - 0.5 * (start[axis] + end[axis])).abs() < 1e-15);
        }
        assert!(from.stays_upright(&to));
        for bad in [
            Affine::rotation([0.0, 0.0, 1.0], 180.0),
            Affine::rotation([1.0, 2.0, 1.0], 130.0),
            Affine::scale([1.0, -1.0, 1.0]),
            Affine::scale([0.0; 3]),
            Affine::scale([f64::NAN; 3]),
        ] {
            assert!(!from.stays_upright(&bad), "{bad:?}");
        }
    }

    #[test]
    fn points_stay_in_the_domain_of_exact_decisions() {
        // What cancels leaves bits far below 2^-252.
        let tiny = f64::from_bits((1023 - 230) << 52);
        let map = Affine::from_rows([[1.0 / 3.0, 0.0, 0.0, 0.0]; 3]);
        for component in map.point([tiny, 0.0, 0.0]) {
            let units = component / COORDINATE_UNIT;
            assert_eq!(units, units.trunc());
            assert!((component - tiny / 3.0).abs() <= COORDINATE_UNIT);
        }
        assert_eq!(snap(1.0 + f64::EPSILON), 1.0 + f64::EPSILON);
        assert!(snap(f64::NAN).is_nan() && snap(f64::NEG_INFINITY) == f64::NEG_INFINITY);
    }
}
