//! The ways by which light leaves a hit, and what each brings of what the path carries: every effect adds or changes its own, and
//! the path follows those that are worth it.

use glam::DVec3;

use super::detail::normals::on_side;
use super::mirror::reflect;
use super::paths::Point;
use super::stage::Shader;

/// How a ray came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Transmission,
    Reflection,
    Bounce,
}

/// How a direction came about.
#[derive(Clone, Copy, Debug)]
pub(super) enum Course {
    /// As the ray came.
    Straight,
    /// By the law of reflection or refraction.
    Lawful,
    /// By luck, with this density over solid angle.
    Sampled(f64),
}

/// One of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Way {
    pub kind: Kind,
    /// What a ray along it carries is this times what the path carries.
    pub weight: DVec3,
    /// Unit. None: that of a smooth mirror, for reflection, which is worked out if it is followed; for others nothing goes this
    /// way, and what is forced goes on any.
    pub direction: Option<DVec3>,
    pub course: Course,
}

/// All of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ways {
    pub transmission: Way,
    pub reflection: Way,
    pub bounce: Way,
}

impl Ways {
    /// What a smooth surface does to a ray along `direction` (unit) that bends none: part of it is mirrored, part goes straight through.
    pub fn new(shader: &Shader, direction: DVec3) -> Ways {
        Ways {
            transmission: Way {
                kind: Kind::Transmission,
                weight: DVec3::splat(shader.transmission),
                direction: Some(direction),
                course: Course::Straight,
            },
            reflection: Way {
                kind: Kind::Reflection,
                weight: shader.mirror,
                direction: None,
                course: Course::Lawful,
            },
            bounce: Way {
                kind: Kind::Bounce,
                weight: DVec3::ZERO,
                direction: None,
                course: Course::Sampled(0.0),
            },
        }
    }

    /// Where the normal that light falls on disagrees with that of the triangle, `geometric`: rays still go to the side that they
    /// are meant for.
    pub fn keep_sides(&mut self, point: &Point, geometric: DVec3) {
        let onward = &mut self.transmission.direction;
        *onward = onward.map(|onward| on_side(onward, -geometric));
        let away = self.reflection.direction.unwrap_or_else(|| reflect(-point.view, point.normal));
        self.reflection.direction = Some(on_side(away, geometric));
    }
}
