//! Boxes inside a block's box, in one byte per side.

use super::directory::SUB_BOX_COUNT;
use crate::geom::Aabb;

/// Up to eight boxes on a grid of 256^3 cells over a block's box: `min x, y, z, max x, y, z`, each the number of a
/// cell, both ends included. A box with min > max is unused; used boxes come first.
///
/// Sides are rounded outward: a decoded box holds the box that was encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SubBoxes(pub [[u8; 6]; SUB_BOX_COUNT]);

impl SubBoxes {
    const UNUSED: [u8; 6] = [1, 1, 1, 0, 0, 0];

    /// Where cell border `border` (0 to 256) of one axis lies. The ends are exact, so the whole grid is `min ..= max`.
    fn border(min: f64, max: f64, border: u32) -> f64 {
        match border {
            0 => min,
            256 => max,
            // Half the extent cannot overflow; monotone in `border` except for rounding, which `quantize` allows for.
            _ => (min + (0.5 * max - 0.5 * min) * (f64::from(border) / 128.0)).clamp(min, max),
        }
    }

    /// Encodes boxes that lie inside `bounds` (parts outside are cut off). Empty boxes are left out; those beyond the
    /// eighth are merged into the eighth.
    pub fn quantize(bounds: &Aabb, boxes: &[Aabb]) -> SubBoxes {
        let mut merged = [Aabb::EMPTY; SUB_BOX_COUNT];
        for (index, part) in boxes.iter().filter(|part| !part.is_empty()).enumerate() {
            merged[index.min(SUB_BOX_COUNT - 1)].merge(part);
        }
        SubBoxes(
            merged.map(|part| if part.is_empty() { Self::UNUSED } else { Self::quantize_one(bounds, &part) }),
        )
    }

    fn quantize_one(bounds: &Aabb, part: &Aabb) -> [u8; 6] {
        let mut cells = [0; 6];
        for axis in 0..3 {
            let (min, max) = (bounds.min[axis], bounds.max[axis]);
            let scale = 256.0 / (max - min);
            // A guess, corrected below with the very numbers that the decoder will see; `as` saturates and takes NaN
            // (a flat box) to 0.
            let cell = |x: f64| (((x - min) * scale) as u32).min(255);
            let mut low = cell(part.min[axis]);
            while low > 0 && Self::border(min, max, low) > part.min[axis] {
                low -= 1;
            }
            let mut high = cell(part.max[axis]).max(low);
            while high < 255 && Self::border(min, max, high + 1) < part.max[axis] {
                high += 1;
            }
            cells[axis] = low as u8;
            cells[axis + 3] = high as u8;
        }
        cells
    }

    /// The used boxes, each holding what it was made from.
    pub fn decode(self, bounds: &Aabb) -> impl Iterator<Item = Aabb> + use<> {
        let bounds = *bounds;
        let used = self.0.into_iter().filter(|cells| (0..3).all(|axis| cells[axis] <= cells[axis + 3]));
        used.map(move |cells| {
            let side = |axis: usize, border: u32| Self::border(bounds.min[axis], bounds.max[axis], border);
            Aabb {
                min: [0, 1, 2].map(|axis| side(axis, u32::from(cells[axis]))),
                max: [0, 1, 2].map(|axis| side(axis, u32::from(cells[axis + 3]) + 1)),
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn boxes_in(bounds: Aabb, parts: &[[f64; 6]]) -> Vec<Aabb> {
        let at = |axis: usize, t: f64| {
            (bounds.min[axis] + t * (bounds.max[axis] - bounds.min[axis]))
                .clamp(bounds.min[axis], bounds.max[axis])
        };
        let part = |t: &[f64; 6]| Aabb {
            min: [0, 1, 2].map(|axis| at(axis, t[axis].min(t[axis + 3]))),
            max: [0, 1, 2].map(|axis| at(axis, t[axis].max(t[axis + 3]))),
        };
        parts.iter().map(part).collect()
    }

    proptest! {
        #[test]
        fn decoded_boxes_hold_what_was_encoded(
            min in prop::array::uniform3(-1e9..1e9f64),
            extent in prop::array::uniform3(prop_oneof![Just(0.0), 1e-12..1e-3f64, 1.0..1e9f64]),
            parts in prop::collection::vec(prop::array::uniform6(0.0..=1.0f64), 0..12),
        ) {
            let bounds = Aabb { min, max: [0, 1, 2].map(|axis| min[axis] + extent[axis]) };
            let boxes = boxes_in(bounds, &parts);
            let decoded: Vec<Aabb> = SubBoxes::quantize(&bounds, &boxes).decode(&bounds).collect();
            prop_assert_eq!(decoded.len(), boxes.len().min(SUB_BOX_COUNT));
            for (index, part) in boxes.iter().enumerate() {
                prop_assert!(decoded[index.min(SUB_BOX_COUNT - 1)].contains(part));
                prop_assert!(bounds.contains(&decoded[index.min(SUB_BOX_COUNT - 1)]));
            }
        }
    }

    #[test]
    fn a_box_is_widened_by_less_than_two_cells_on_each_side() {
        let bounds = Aabb { min: [0.0; 3], max: [256.0; 3] };
        let part = Aabb { min: [10.5, 0.0, 256.0], max: [10.75, 256.0, 256.0] };
        let decoded: Vec<Aabb> = SubBoxes::quantize(&bounds, &[Aabb::EMPTY, part]).decode(&bounds).collect();
        assert_eq!(decoded, [Aabb { min: [10.0, 0.0, 255.0], max: [11.0, 256.0, 256.0] }]);
    }
}
