//! Attributes on their way to a sink: values in batches, and which of them the corners of waiting triangles have.

use super::feed::BATCH_COUNT;
use super::sink::{CornerIndices, MeshSink, NO_INDEX};
use crate::error::CompileError;

/// The attributes of a face's corner: texture coordinate and normal, each an index from 0 or [`NO_INDEX`].
pub(super) type Reference = [u32; 2];

/// How corners name their attributes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Naming {
    /// Each corner by itself, as in OBJ.
    ByCorner,
    /// By their vertex, as in PLY: whether it has texture coordinates, and normals.
    ByVertex { uvs: bool, normals: bool },
}

/// See the module's text. Empty, and without memory, as long as no attribute comes.
#[derive(Debug)]
pub(super) struct AttributeFeed {
    /// Whether the sink takes any.
    pub(super) is_wanted: bool,
    naming: Naming,
    uvs: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    /// How many came in all.
    pub(super) uv_count: u64,
    pub(super) normal_count: u64,
    /// One beside each of the first triangles of the batch; those behind have none.
    triangle_uvs: Vec<[u32; 3]>,
    triangle_normals: Vec<[u32; 3]>,
    /// One more than the greatest index that a corner named.
    pub(super) named: [u64; 2],
}

impl AttributeFeed {
    pub(super) fn new(is_wanted: bool) -> AttributeFeed {
        AttributeFeed {
            is_wanted,
            naming: Naming::ByCorner,
            uvs: Vec::new(),
            normals: Vec::new(),
            uv_count: 0,
            normal_count: 0,
            triangle_uvs: Vec::new(),
            triangle_normals: Vec::new(),
            named: [0; 2],
        }
    }

    /// From now on vertex `i` has texture coordinate `i` and normal `i`.
    pub(super) fn name_by_vertex(&mut self, uvs: bool, normals: bool) {
        self.naming = Naming::ByVertex { uvs, normals };
    }

    pub(super) fn uv(&mut self, uv: [f32; 2], sink: &mut dyn MeshSink) -> Result<(), CompileError> {
        self.uv_count += 1;
        self.uvs.push(uv);
        if self.uvs.len() == BATCH_COUNT { self.send_values(sink) } else { Ok(()) }
    }

    pub(super) fn normal(&mut self, normal: [f32; 3], sink: &mut dyn MeshSink) -> Result<(), CompileError> {
        self.normal_count += 1;
        self.normals.push(normal);
        if self.normals.len() == BATCH_COUNT { self.send_values(sink) } else { Ok(()) }
    }

    /// The corners of the triangle that is number `index` of the batch.
    #[inline]
    pub(super) fn triangle(&mut self, index: usize, references: [Reference; 3]) {
        for (kind, list) in [&mut self.triangle_uvs, &mut self.triangle_normals].into_iter().enumerate() {
            let corners = references.map(|reference| reference[kind]);
            if corners.contains(&NO_INDEX) {
                continue;
            }
            let [a, b, c] = corners;
            self.named[kind] = self.named[kind].max(u64::from(a.max(b).max(c)) + 1);
            list.resize(index, [NO_INDEX; 3]);
            list.push(corners);
        }
    }

    pub(super) fn send_values(&mut self, sink: &mut dyn MeshSink) -> Result<(), CompileError> {
        if !self.uvs.is_empty() {
            sink.texture_coordinates(&self.uvs)?;
            self.uvs.clear();
        }
        if !self.normals.is_empty() {
            sink.normals(&self.normals)?;
            self.normals.clear();
        }
        Ok(())
    }

    /// What the corners of `triangles`, the whole batch, have; `None` if that is nothing.
    pub(super) fn corners<'a>(&'a mut self, triangles: &'a [[u32; 3]]) -> Option<CornerIndices<'a>> {
        if let Naming::ByVertex { uvs, normals } = self.naming {
            let corners =
                CornerIndices { uvs: uvs.then_some(triangles), normals: normals.then_some(triangles) };
            return (uvs || normals).then_some(corners);
        }
        for list in [&mut self.triangle_uvs, &mut self.triangle_normals] {
            if !list.is_empty() {
                list.resize(triangles.len(), [NO_INDEX; 3]);
            }
        }
        let list = |list: &'a Vec<[u32; 3]>| (!list.is_empty()).then_some(list.as_slice());
        let corners = CornerIndices { uvs: list(&self.triangle_uvs), normals: list(&self.triangle_normals) };
        (corners.uvs.is_some() || corners.normals.is_some()).then_some(corners)
    }

    /// The batch was sent.
    pub(super) fn clear_corners(&mut self) {
        self.triangle_uvs.clear();
        self.triangle_normals.clear();
    }
}
