//! Which material a face has: by an index into a library, or by a colour.

use std::collections::HashMap;
use std::ops::Range;

use super::header::{Element, Kind, Scalar};
use crate::error::ImportError;
use crate::import::feed::Feed;
use crate::import::library::Materials;
use crate::model::MaterialRecord;
use crate::units::MaterialId;

/// Distinct face colours that become materials; later ones take the nearest of them.
const PALETTE_MAX: usize = 1024;

/// How the faces of an element tell their material.
#[derive(Clone, Debug)]
pub(super) struct Look {
    /// The properties that tell it, in the order in which `resolve` takes their values, with their types.
    properties: Vec<(usize, Scalar)>,
    kind: LookKind,
}

#[derive(Clone, Debug)]
enum LookKind {
    /// `material_index`.
    Index,
    /// `red`, `green`, `blue`.
    Color(HashMap<[u8; 3], MaterialId>),
}

impl Look {
    /// What the properties of the element say; `None` if all its faces have one material.
    pub(super) fn of(element: &Element, materials: &Materials<'_>, feed: &mut Feed<'_>) -> Option<Look> {
        let find = |names: &[&str]| -> Option<(usize, Scalar)> {
            let index = element.properties.iter().position(|p| names.contains(&p.name.as_str()))?;
            match element.properties[index].kind {
                Kind::Scalar(scalar) => Some((index, scalar)),
                Kind::List { .. } => None,
            }
        };
        if let Some(index) = find(&["material_index", "material"]) {
            if !materials.ids().is_empty() {
                return Some(Look { properties: vec![index], kind: LookKind::Index });
            }
            let text =
                "faces name materials, but no library is named by a line `comment mtllib NAME` or an option";
            feed.report.warn(materials.model(), None, text);
        }
        let red = find(&["red", "diffuse_red"])?;
        let green = find(&["green", "diffuse_green"])?;
        let blue = find(&["blue", "diffuse_blue"])?;
        // A library that the caller named goes before colours.
        materials
            .ids()
            .is_empty()
            .then(|| Look { properties: vec![red, green, blue], kind: LookKind::Color(HashMap::new()) })
    }

    /// Which value a property gives.
    pub(super) fn index_of(&self, property: usize) -> Option<usize> {
        self.properties.iter().position(|(index, _)| *index == property)
    }

    /// Where the properties stand in a record whose index list has three corners, if they stand together.
    pub(super) fn bytes_in(&self, offsets: &[usize]) -> Option<Range<usize>> {
        let mut end = offsets[self.properties[0].0];
        let start = end;
        for (property, scalar) in &self.properties {
            if offsets[*property] != end {
                return None;
            }
            end += scalar.bytes();
        }
        Some(start..end)
    }

    /// The material of a face, from the bytes of `bytes_in`, little-endian.
    pub(super) fn resolve_bytes(
        &mut self,
        mut bytes: &[u8],
        materials: &Materials<'_>,
        feed: &mut Feed<'_>,
    ) -> Result<Option<MaterialId>, ImportError> {
        let mut values = [0.0; 3];
        for (value, (_, scalar)) in values.iter_mut().zip(&self.properties) {
            let (here, rest) = bytes.split_at(scalar.bytes());
            *value = scalar.little_endian(here);
            bytes = rest;
        }
        self.resolve(values, materials, feed)
    }

    /// The material of a face, from the values of its properties.
    pub(super) fn resolve(
        &mut self,
        values: [f64; 3],
        materials: &Materials<'_>,
        feed: &mut Feed<'_>,
    ) -> Result<Option<MaterialId>, ImportError> {
        let palette = match &mut self.kind {
            LookKind::Color(palette) => palette,
            LookKind::Index => {
                let index = values[0];
                let count = materials.ids().len();
                if index >= 0.0 && index < count as f64 {
                    return Ok(Some(materials.ids()[index as usize]));
                }
                // -1 is a common way to say "none".
                if index != -1.0 {
                    let text = format!("faces name materials outside of the {count} known");
                    feed.report.warn_once(materials.model(), None, text);
                }
                return Ok(None);
            }
        };
        let mut color = [0; 3];
        for (channel, (value, (_, scalar))) in values.iter().zip(&self.properties).enumerate() {
            let full = match scalar {
                Scalar::F32 | Scalar::F64 => 1.0,
                Scalar::I8 | Scalar::U8 => 255.0,
                _ => 65535.0,
            };
            // The cast saturates, and makes 0 of NaN.
            color[channel] = (value / full * 255.0).round() as u8;
        }
        if let Some(id) = palette.get(&color) {
            return Ok(Some(*id));
        }
        if palette.len() < PALETTE_MAX {
            let id = feed.add_material(MaterialRecord {
                name: format!("color #{:02x}{:02x}{:02x}", color[0], color[1], color[2]),
                diffuse: color.map(linear),
                ..MaterialRecord::default()
            })?;
            palette.insert(color, id);
            return Ok(Some(id));
        }
        let text = format!("more than {PALETTE_MAX} face colours; further ones take the nearest of them");
        feed.report.warn_once(materials.model(), None, text);
        // The order of a hash map must not show: equal distances go by id.
        let distance = |other: &[u8; 3]| -> u32 {
            std::iter::zip(*other, color).map(|(a, b)| u32::from(a.abs_diff(b)).pow(2)).sum()
        };
        Ok(palette.iter().map(|(other, id)| (distance(other), *id)).min().map(|(_, id)| id))
    }
}

/// Linear intensity of an sRGB value (IEC 61966-2-1): colours in PLY files are display colours.
fn linear(value: u8) -> f32 {
    let value = f64::from(value) / 255.0;
    let linear = if value <= 0.04045 { value / 12.92 } else { libm::pow((value + 0.055) / 1.055, 2.4) };
    linear as f32
}
