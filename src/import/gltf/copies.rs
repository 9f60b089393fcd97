//! `EXT_mesh_gpu_instancing`: a node that places its mesh many times.

use glam::{DMat4, DQuat, DVec3};
use gltf::Node;

use super::accessor::Elements;
use super::bytes::Bytes;
use super::document::Opened;
use super::placement::PLACED_MAX;
use crate::error::ImportError;

/// The extension's name.
pub(super) const NAME: &str = "EXT_mesh_gpu_instancing";

/// Where a node places its mesh, in its own space; `None` for a node without the extension.
pub(super) fn copies(
    opened: &Opened,
    node: &Node<'_>,
    bytes: &mut Bytes<'_>,
) -> Result<Option<Vec<DMat4>>, ImportError> {
    let Some(extension) = node.extension_value(NAME) else { return Ok(None) };
    let name = || format!("nodes[{}].extensions.{NAME}", node.index());
    let refused = |reason: &str| opened.error(name(), reason);
    let attributes = extension.get("attributes").and_then(|part| part.as_object());
    let attributes = attributes.ok_or_else(|| refused("it has no attributes"))?;
    let (mut shifts, mut turns, mut scales) = (Vec::new(), Vec::new(), Vec::new());
    let mut copies_promised = None;
    for (attribute, index) in attributes {
        let name = || format!("{}.attributes.{attribute}", name());
        let accessor = index.as_u64().and_then(|index| opened.document.accessors().nth(index as usize));
        let accessor = accessor.ok_or_else(|| opened.error(name(), "there is no such accessor"))?;
        let copies = accessor.count() as u64;
        if *copies_promised.get_or_insert(copies) != copies {
            return Err(opened.error(name(), "its accessors are not of one length"));
        }
        // Before they are read and held.
        if copies > PLACED_MAX as u64 {
            let reason = format!("it places {copies} copies, more than {PLACED_MAX}; split the file");
            return Err(opened.error(name(), reason));
        }
        match attribute.as_str() {
            "TRANSLATION" => read(opened, &accessor, name(), bytes, &mut shifts)?,
            "ROTATION" => read(opened, &accessor, name(), bytes, &mut turns)?,
            "SCALE" => read(opened, &accessor, name(), bytes, &mut scales)?,
            // Of the application.
            attribute if attribute.starts_with('_') => {}
            _ => return Err(opened.error(name(), "there is no such attribute")),
        }
    }
    // Of them as many were in the file: no count alone chooses an allocation.
    let count = shifts.len().max(turns.len()).max(scales.len());
    if count == 0 && copies_promised != Some(0) {
        return Err(refused("it has neither TRANSLATION nor ROTATION nor SCALE"));
    }
    let vector = |list: &[[f32; 3]], index: usize, default: DVec3| {
        list.get(index).map_or(default, |v| DVec3::from_array(v.map(f64::from)))
    };
    let matrix = |index: usize| {
        let turn = turns.get(index).map_or(DQuat::IDENTITY, |turn: &[f32; 4]| {
            let turn = DQuat::from_array(turn.map(f64::from));
            // As of nodes: files round, and a zero quaternion turns nothing.
            if turn.length_squared() > 0.0 { turn.normalize() } else { DQuat::IDENTITY }
        });
        let (scale, shift) = (vector(&scales, index, DVec3::ONE), vector(&shifts, index, DVec3::ZERO));
        DMat4::from_scale_rotation_translation(scale, turn, shift)
    };
    let copies: Vec<DMat4> = (0..count).map(matrix).collect();
    match copies.iter().all(DMat4::is_finite) {
        true => Ok(Some(copies)),
        false => Err(refused("a number is not finite")),
    }
}

fn read<const N: usize>(
    opened: &Opened,
    accessor: &gltf::Accessor<'_>,
    name: String,
    bytes: &mut Bytes<'_>,
    into: &mut Vec<[f32; N]>,
) -> Result<(), ImportError> {
    let mut elements = Elements::of_copies(opened, accessor, name, N)?;
    let mut vectors = Vec::new();
    while elements.next_vectors(bytes, &mut vectors)?.is_some() {
        into.extend_from_slice(&vectors);
    }
    Ok(())
}
