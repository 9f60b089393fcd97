//! The elements `face` and `tristrips`.

use std::ops::Range;

use super::header::{Element, Encoding, Kind, Scalar};
use super::look::Look;
use super::values::Values;
use crate::error::ImportError;
use crate::import::feed::{BATCH_COUNT, Feed};
use crate::import::library::Materials;
use crate::import::polygon::CORNERS_MAX;

/// Where the indices of a face stand in its record.
#[derive(Clone, Copy, Debug)]
struct IndexList {
    /// Which property it is.
    property: usize,
    count: Scalar,
    item: Scalar,
}

/// Finds the list of vertex indices.
fn index_list(element: &Element) -> Result<IndexList, String> {
    for (property, candidate) in element.properties.iter().enumerate() {
        if matches!(candidate.name.as_str(), "vertex_indices" | "vertex_index") {
            let Kind::List { count, item } = candidate.kind else {
                return Err(format!("the property `{}` is not a list", candidate.name));
            };
            return Ok(IndexList { property, count, item });
        }
    }
    Err(format!("the element `{}` has no list `vertex_indices` or `vertex_index`", element.name))
}

/// Reads the faces, cuts those with more than three corners, and sends the triangles on.
pub(super) fn read(
    values: &mut Values<'_, '_>,
    element: &Element,
    materials: &Materials<'_>,
    feed: &mut Feed<'_>,
) -> Result<(), ImportError> {
    if element.count == 0 {
        return Ok(());
    }
    let list = index_list(element).map_err(|reason| values.error(reason))?;
    // For each corner of a face, as MeshLab writes them.
    if element.properties.iter().any(|property| property.name == "texcoord") {
        let ignored = &mut feed.report.ignored.texture_coordinates;
        *ignored = ignored.saturating_add(element.count);
    }
    let mut look = Look::of(element, materials, feed);
    if look.is_none() {
        let material = materials.only(feed);
        feed.set_material(material)?;
    }
    let layout = TriangleLayout::of(values.encoding(), element, list, look.as_ref());
    let mut corners = Vec::new();
    let mut left = element.count;
    while left > 0 {
        if let Some(layout) = &layout {
            left -= layout.read(values, left, look.as_mut(), materials, feed)?;
            if left == 0 {
                break;
            }
        }
        let mut look_values = [0.0; 3];
        for (index, property) in element.properties.iter().enumerate() {
            let look_index = look.as_ref().and_then(|look| look.index_of(index));
            if index == list.property {
                read_corners(values, list, feed.vertex_count(), &mut corners)?;
            } else if let (Some(look_index), Kind::Scalar(scalar)) = (look_index, property.kind) {
                look_values[look_index] = values.float(scalar)?;
            } else {
                values.skip_property(property.kind)?;
            }
        }
        if let Some(look) = &mut look {
            let material = look.resolve(look_values, materials, feed)?;
            feed.set_material(material)?;
        }
        feed.face(&corners)?;
        feed.progress(values.window.progress())?;
        left -= 1;
    }
    Ok(())
}

/// Reads the list of a face's vertices into `corners`.
fn read_corners(
    values: &mut Values<'_, '_>,
    list: IndexList,
    vertex_count: u64,
    corners: &mut Vec<u32>,
) -> Result<(), ImportError> {
    let count = values.count(list.count)?;
    if count > CORNERS_MAX as u64 {
        return Err(values.error(format!("a face with {count} corners; at most {CORNERS_MAX} are supported")));
    }
    corners.clear();
    for _ in 0..count {
        let index = values.integer(list.item)?;
        corners.push(vertex(values, index, vertex_count)?);
    }
    Ok(())
}

/// Checks the index of a vertex that was just read.
fn vertex(values: &Values<'_, '_>, index: i64, vertex_count: u64) -> Result<u32, ImportError> {
    match u32::try_from(index) {
        Ok(vertex) if u64::from(vertex) < vertex_count => Ok(vertex),
        _ => Err(values.error(format!(
            "a face names vertex {index} of {vertex_count} (just before this place; counted from 0)"
        ))),
    }
}

/// Reads triangle strips: every index makes a triangle with the two before it, turned round every other time; -1
/// starts anew.
pub(super) fn read_strips(
    values: &mut Values<'_, '_>,
    element: &Element,
    materials: &Materials<'_>,
    feed: &mut Feed<'_>,
) -> Result<(), ImportError> {
    if element.count == 0 {
        return Ok(());
    }
    let list = index_list(element).map_err(|reason| values.error(reason))?;
    let material = materials.only(feed);
    feed.set_material(material)?;
    let vertex_count = feed.vertex_count();
    for _ in 0..element.count {
        for (index, property) in element.properties.iter().enumerate() {
            if index != list.property {
                values.skip_property(property.kind)?;
                continue;
            }
            let mut last = [0; 2];
            let mut length = 0_u64;
            for _ in 0..values.count(list.count)? {
                let index = values.integer(list.item)?;
                // -1 in an unsigned list is the type's largest value.
                if index == -1 || (index == 0xFFFF_FFFF && list.item == Scalar::U32) {
                    length = 0;
                    continue;
                }
                let vertex = vertex(values, index, vertex_count)?;
                if length >= 2 {
                    let [a, b] = if length.is_multiple_of(2) { last } else { [last[1], last[0]] };
                    // Repeated vertices stitch strips together; they are no faces.
                    if a != b && b != vertex && vertex != a {
                        feed.triangle([a, b, vertex])?;
                    }
                }
                last = [last[1], vertex];
                length += 1;
                feed.progress(values.window.progress())?;
            }
        }
    }
    Ok(())
}

/// Binary little-endian records with one list, of one-byte counts and four-byte indices: while the counts are 3,
/// records have one size and are read in bulk.
struct TriangleLayout {
    /// Bytes before the list.
    before: usize,
    /// Bytes of a whole record with three corners.
    stride: usize,
    /// Whether indices are signed.
    signed: bool,
    /// The bytes of a record that tell its material, if they matter.
    look: Option<Range<usize>>,
}

/// Records taken at once; few enough that an odd record costs little.
const RUN_COUNT: usize = 4096;

impl TriangleLayout {
    fn of(
        encoding: Encoding,
        element: &Element,
        list: IndexList,
        look: Option<&Look>,
    ) -> Option<TriangleLayout> {
        let lists = element.properties.iter().filter(|property| matches!(property.kind, Kind::List { .. }));
        let fits = encoding == Encoding::LittleEndian
            && lists.count() == 1
            && list.count.bytes() == 1
            && matches!(list.item, Scalar::I32 | Scalar::U32);
        if !fits {
            return None;
        }
        let mut stride = 0;
        let mut offsets = Vec::new();
        for property in &element.properties {
            offsets.push(stride);
            stride += match property.kind {
                Kind::Scalar(scalar) => scalar.bytes(),
                Kind::List { .. } => 13,
            };
        }
        let look = match look {
            Some(look) => Some(look.bytes_in(&offsets)?),
            None => None,
        };
        Some(TriangleLayout {
            before: offsets[list.property],
            stride,
            signed: list.item == Scalar::I32,
            look,
        })
    }

    /// Reads triangles until a record is odd (not a triangle, or naming no vertex) or cut off by the end of the
    /// stream, or `count` are read; returns how many. The caller reads the odd one the slow way, which also words
    /// the error.
    fn read(
        &self,
        values: &mut Values<'_, '_>,
        count: u64,
        mut look: Option<&mut Look>,
        materials: &Materials<'_>,
        feed: &mut Feed<'_>,
    ) -> Result<u64, ImportError> {
        let signed_limit = if self.signed { 1 << 31 } else { u64::MAX };
        let limit = feed.vertex_count().min(signed_limit);
        let mut done = 0;
        while done < count {
            if values.window.data().len() < self.stride {
                values.window.refill()?;
                feed.progress(values.window.progress())?;
                if values.window.data().len() < self.stride {
                    break;
                }
            }
            let data = values.window.data();
            let left = usize::try_from(count - done).unwrap_or(usize::MAX);
            let mut most = (data.len() / self.stride).min(RUN_COUNT).min(left);
            if let (Some(look), Some(range)) = (&mut look, &self.look) {
                let mut records = data[..most * self.stride].chunks_exact(self.stride);
                let bytes = &data[range.clone()];
                most = records.position(|record| record[range.clone()] != *bytes).unwrap_or(most);
                let material = look.resolve_bytes(bytes, materials, feed)?;
                feed.set_material(material)?;
            }
            let batch = feed.triangles_with_room()?;
            let take = most.min(BATCH_COUNT - batch.len());
            let records = &data[..take * self.stride];
            let taken = if self.stride == 13 {
                take_triangles(records.as_chunks::<13>().0.iter(), limit, batch)
            } else {
                let lists = records.chunks_exact(self.stride).map(|record| {
                    // The record has `before` bytes, 13 of the list, and what comes after it.
                    record[self.before..].first_chunk::<13>().expect("a record holds its list")
                });
                take_triangles(lists, limit, batch)
            };
            values.window.consume(taken * self.stride);
            done += taken as u64;
            if taken < take {
                break;
            }
        }
        Ok(done)
    }
}

/// Appends the triangles of `lists` up to the first that is odd; returns how many.
fn take_triangles<'r>(
    lists: impl ExactSizeIterator<Item = &'r [u8; 13]> + Clone,
    limit: u64,
    batch: &mut Vec<[u32; 3]>,
) -> usize {
    let start = batch.len();
    batch.resize(start + lists.len(), [0; 3]);
    let (mut odd, mut bits) = (0, 0);
    for (into, list) in batch[start..].iter_mut().zip(lists.clone()) {
        let corners = corners(list);
        odd |= list[0] ^ 3;
        // No index is above the bits of all together.
        bits |= corners[0] | corners[1] | corners[2];
        *into = corners;
    }
    if odd == 0 && u64::from(bits) < limit {
        return batch.len() - start;
    }
    // Only a run with an odd record comes here, or one near the last vertices.
    let good = lists
        .take_while(|list| list[0] == 3 && corners(list).iter().all(|corner| u64::from(*corner) < limit))
        .count();
    batch.truncate(start + good);
    good
}

/// The three indices of a list.
#[inline]
fn corners(list: &[u8; 13]) -> [u32; 3] {
    std::array::from_fn(|corner| {
        let at = 1 + corner * 4;
        u32::from_le_bytes([list[at], list[at + 1], list[at + 2], list[at + 3]])
    })
}
