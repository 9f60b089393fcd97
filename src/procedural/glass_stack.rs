//! Transparent plates, one behind the other.

use super::{CUBOID_FACES, Shape, cuboid_corners};
use crate::error::CompileError;
use crate::import::{MeshSink, VertexBatch};
use crate::model::MaterialRecord;
use crate::units::MaterialId;

/// `plates` closed glass boxes, -1 ..= 1 in x and y, stacked along z above an opaque ground at z = 0, in f32.
///
/// Plate `k` fills z from 1 + `k` to 1.5 + `k`, in units of `spacing`. A ray along z passes 2 x `plates` surfaces before the
/// ground. 12 triangles and 8 vertices per plate, then 2 and 4 for the ground. Materials: 0 glass, 1 the ground.
#[derive(Clone, Copy, Debug)]
pub struct GlassStack {
    plates: u32,
    spacing: f32,
    glass: [f32; 2],
}

impl GlassStack {
    /// Plates of the given `opacity` (0 ..= 1) and `refractive_index` (1 for light that passes straight).
    ///
    /// # Errors
    /// [`CompileError::Limit`] for more than 1,048,576 plates.
    pub fn new(
        plates: u32,
        spacing: f32,
        opacity: f32,
        refractive_index: f32,
    ) -> Result<GlassStack, CompileError> {
        if plates > 1 << 20 {
            return Err(CompileError::Limit { reason: format!("{plates} plates are too many") });
        }
        Ok(GlassStack { plates, spacing, glass: [opacity, refractive_index] })
    }
}

impl Shape for GlassStack {
    fn vertex_count(&self) -> u64 {
        8 * u64::from(self.plates) + 4
    }

    fn triangle_count(&self) -> u64 {
        12 * u64::from(self.plates) + 2
    }

    fn emit(&self, sink: &mut dyn MeshSink) -> Result<(), CompileError> {
        let [opacity, refractive_index] = self.glass;
        sink.material(MaterialRecord {
            name: "glass".to_string(),
            diffuse: [0.2, 0.3, 0.3],
            opacity,
            refractive_index,
            ..MaterialRecord::default()
        })?;
        sink.material(MaterialRecord { name: "ground".to_string(), ..MaterialRecord::default() })?;
        let corners = |low: f32, high: f32| cuboid_corners([-1.0, -1.0, low], [1.0, 1.0, high]);
        for plate in 0..self.plates {
            let (low, high) = ((1.0 + plate as f32) * self.spacing, (1.5 + plate as f32) * self.spacing);
            sink.vertices(VertexBatch::Float32(&corners(low, high)))?;
            sink.triangles(&CUBOID_FACES.map(|face| face.map(|corner| 8 * plate + corner)), MaterialId(0))?;
        }
        sink.vertices(VertexBatch::Float32(&corners(0.0, 0.0)[..4]))?;
        sink.triangles(&[[0, 1, 3], [0, 3, 2]].map(|face| face.map(|k| 8 * self.plates + k)), MaterialId(1))?;
        sink.vertices_complete()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::MeshBuffer;
    use crate::procedural::open_edges;

    #[test]
    fn plates_are_closed_and_ordered() {
        let stack = GlassStack::new(5, 0.25, 0.1, 1.5).unwrap();
        let mut mesh = MeshBuffer::new();
        stack.emit(&mut mesh).unwrap();
        assert_eq!(mesh.vertices.len() as u64, stack.vertex_count());
        assert_eq!(mesh.triangles.len() as u64, stack.triangle_count());
        assert_eq!(open_edges(&mesh.triangles[0..60]), 0);
        assert_eq!(open_edges(&mesh.triangles[60..62]), 4);
        let volume: f64 = (0..60)
            .map(|triangle| {
                let [a, b, c] = mesh.corners(triangle);
                let n = super::super::random::cross(b, c);
                (a[0] * n[0] + a[1] * n[1] + a[2] * n[2]) / 6.0
            })
            .sum();
        assert!((volume - 5.0 * 4.0 * 0.125).abs() < 1e-12, "{volume}");
        assert_eq!(mesh.triangle_materials.iter().filter(|material| material.0 == 1).count(), 2);
        assert!(GlassStack::new(u32::MAX, 1.0, 0.5, 1.0).is_err());
    }
}
