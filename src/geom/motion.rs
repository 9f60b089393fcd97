//! The way of a map from one place to another: where an instance is while the shutter is open.

use glam::{DMat3, DVec3};

use super::affine::Affine;

/// The maps between two, a pure function of both and of the time (I2).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Motion {
    start: Affine,
    end: Affine,
    turn: Option<Turn>,
}

/// What a rigid body does beside moving.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Turn {
    /// Nearly unit.
    axis: [f64; 3],
    radians: f64,
}

impl Motion {
    /// Bodies that turn further, the shorter way, have no axis that is well known.
    const RADIANS_MAX: f64 = 170.0 / 180.0 * std::f64::consts::PI;

    /// How far the numbers of a rotation may be from one.
    const RIGID: f64 = 1e-9;

    /// From `start` to `end`. If all that is between them is that a body turns and moves, then what the origin goes to moves on a
    /// straight line, and the body turns evenly about it, the shorter way, by 170 degrees at most (M. Pharr, W. Jakob and G.
    /// Humphreys, "Physically Based Rendering", section 2.9, "Animating Transformations"). In all other cases every point moves on
    /// a straight line.
    pub fn new(start: &Affine, end: &Affine) -> Motion {
        Motion { start: *start, end: *end, turn: Turn::between(start, end) }
    }

    /// The map at `time`, from 0 to 1. At 0 it is the first, to the bit; at 1 the second, up to rounding where it turns.
    pub fn at(&self, time: f64) -> Affine {
        let straight = self.start.straight_to(&self.end, time);
        let Some(Turn { axis, radians }) = self.turn else { return straight };
        let (sin, cos) = (libm::sin(radians * time), libm::cos(radians * time));
        self.start.then(&Affine::rotation_of(axis, sin, cos)).with_shift(straight.shift())
    }

    /// Where it ends.
    pub fn end(&self) -> &Affine {
        &self.end
    }

    /// Whether no map on the way is flat, nor nearly so.
    pub fn stays_upright(&self) -> bool {
        self.turn.is_some() || self.start.stays_upright(&self.end)
    }

    /// Into how many equal parts the way is to be cut so that a point of one strays little from the straight line between the ends
    /// of its part.
    pub fn part_count(&self) -> u32 {
        const PART_RADIANS: f64 = 0.125;
        // At most 24.
        self.turn.map_or(1, |turn| (turn.radians / PART_RADIANS).ceil().max(1.0) as u32)
    }

    /// Twice as far as any point strays from the straight line between the ends of its part of the way, rounding apart, if it is at
    /// most `radius` from the origin when all is turned about it: for a curve whose second derivative is at most `radius radians^2`
    /// it is an eighth of that in a unit of time.
    pub fn stray(&self, radius: f64) -> f64 {
        self.turn.map_or(0.0, |turn| {
            let part = turn.radians / f64::from(self.part_count());
            radius * part * part / 4.0
        })
    }
}

impl Affine {
    /// The map between this one and `end`, at `time` from 0 to 1. Where one becomes the other by moving and turning alone (by 170
    /// degrees at most, the shorter way), the body does that evenly, about what the origin goes to, and keeps its shape; otherwise
    /// every point moves on a straight line. The same on every machine (I2).
    #[must_use]
    pub fn between(&self, end: &Affine, time: f64) -> Affine {
        Motion::new(self, end).at(time)
    }
}

impl Turn {
    fn between(start: &Affine, end: &Affine) -> Option<Turn> {
        let matrix = |map: &Affine| DMat3::from_cols_array_2d(&map.matrix()).transpose();
        let (from, to) = (matrix(start), matrix(end));
        if from == to {
            return None;
        }
        let turn = to * from.inverse();
        let residual = turn.transpose() * turn - DMat3::IDENTITY;
        let largest = residual.to_cols_array().iter().fold(0.0, |largest: f64, x| largest.max(x.abs()));
        // Written so that NaN fails.
        if !(turn.is_finite() && largest <= Motion::RIGID && turn.determinant() > 0.0) {
            return None;
        }
        let [x, y, z] = [turn.x_axis, turn.y_axis, turn.z_axis];
        // The sine times the axis, and the cosine.
        let (along, cos) = (0.5 * DVec3::new(y.z - z.y, z.x - x.z, x.y - y.x), 0.5 * (x.x + y.y + z.z - 1.0));
        let sin = along.length();
        let radians = libm::atan2(sin, cos);
        let is_turn = sin > Motion::RIGID && radians <= Motion::RADIANS_MAX;
        is_turn.then(|| Turn { axis: (along / sin).to_array(), radians })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotation(degrees: f64) -> Affine {
        Affine::rotation([1.0, -2.0, 3.0], degrees)
    }

    fn assert_near(found: &Affine, expected: &Affine) {
        for (found, expected) in found.rows().iter().flatten().zip(expected.rows().iter().flatten()) {
            assert!((found - expected).abs() < 1e-13, "{found} {expected}");
        }
    }

    #[test]
    fn bodies_that_turn_keep_their_shape() {
        // Any shape: mirrored and sheared before it turns.
        let shape = Affine::from_rows([[2.0, 0.5, 0.0, 1.0], [0.0, -1.0, 0.0, 2.0], [0.0, 0.25, 3.0, -1.0]]);
        for degrees in [0.001, -40.0, 90.0, 130.0, 169.0] {
            let shift = Affine::translation([5.0, -1.0, 0.5]);
            let (start, end) = (shape, shape.then(&rotation(degrees)).then(&shift));
            let motion = Motion::new(&start, &end);
            assert_eq!(motion.at(0.0), start);
            assert_near(&motion.at(1.0), &end);
            for time in [0.25, 0.5, 0.9] {
                let at = motion.at(time);
                let turned = shape.then(&rotation(degrees * time));
                let expected = [0, 1, 2].map(|axis| {
                    let [a, b, c, _] = turned.rows()[axis];
                    let (from, to) = (start.rows()[axis][3], end.rows()[axis][3]);
                    [a, b, c, from + (to - from) * time]
                });
                assert_near(&at, &Affine::from_rows(expected));
            }
            assert!(motion.stays_upright());
        }
    }

    #[test]
    fn what_only_moves_or_changes_its_shape_moves_on_straight_lines() {
        let start = rotation(20.0);
        let (moved, grown) = (Affine::translation([1.0, 2.0, 3.0]), Affine::scale([1.0, 1.5, 1.0]));
        for end in [start.then(&moved), start.then(&grown), rotation(30.0).then(&grown), rotation(-155.0)] {
            let motion = Motion::new(&start, &end);
            assert_eq!(motion.turn, None);
            assert_eq!((motion.part_count(), motion.stray(7.0)), (1, 0.0));
            assert_eq!(motion.at(0.375), start.straight_to(&end, 0.375));
        }
        // The other way around is too far, and not to be done on straight lines either.
        assert!(!Motion::new(&start, &rotation(-155.0)).stays_upright());
        assert!(!Motion::new(&start, &start.then(&Affine::scale([1.0, 1.0, -1.0]))).stays_upright());
    }

    #[test]
    fn points_stray_from_the_straight_lines_of_parts_as_little_as_promised() {
        let (start, end) = (Affine::translation([0.1, 0.2, 0.3]), rotation(100.0));
        let motion = Motion::new(&start, &end);
        let (parts, point) = (motion.part_count(), [0.0, 2.0, 0.0]);
        assert!(parts > 10 && parts < 20);
        let (mut largest, bound) = (0.0f64, motion.stray(2.0));
        for step in 0..=1000 {
            let time = f64::from(step) / 1000.0;
            let part = (time * f64::from(parts)).floor().min(f64::from(parts - 1));
            let ends = [part, part + 1.0].map(|end| motion.at(end / f64::from(parts)).point(point));
            let (share, at) = (time * f64::from(parts) - part, motion.at(time).point(point));
            for axis in 0..3 {
                let line = ends[0][axis] + (ends[1][axis] - ends[0][axis]) * share;
                largest = largest.max((at[axis] - line).abs());
            }
        }
        assert!(largest <= bound && largest > 0.1 * bound, "{largest} {bound}");
    }
}
