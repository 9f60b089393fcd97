//! Cameras and lights of a glTF file.

use std::path::Path;

use ::gltf::camera::Projection as GltfProjection;
use ::gltf::khr_lights_punctual::Kind;
use glam::{DMat4, DVec3};

use super::{Camera, Falloff, Light, Projection};
use crate::error::{ImportError, RenderError};
use crate::import::gltf::{Opened, visit};

/// Cameras and lights of a scene, in the order of its nodes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GltfView {
    /// Perspective and orthographic ones. A picture has the shape that is asked for: what a file says of it is not used.
    pub cameras: Vec<Camera>,
    /// Those of `KHR_lights_punctual`. Irradiance over pi, in the file's unit, so that a surface with diffuse
    /// reflectance `Kd` shows `Kd` times it as radiance; point and spot lights weaken with the square of the distance.
    pub lights: Vec<Light>,
}

/// Size of lights that have none in the file, which bounds what can be received from them: 1 cm, as glTF is in metres.
const RADIUS: f64 = 0.01;

impl GltfView {
    /// Reads what the default scene of a file, or its first one, says about view and light; buffers are not looked at.
    ///
    /// # Errors
    /// As for [`import_file`](crate::import::import_file), and [`ImportError::Element`] for a camera or a light that makes no sense.
    pub fn read(path: impl AsRef<Path>) -> Result<GltfView, ImportError> {
        let opened = Opened::new(path.as_ref())?;
        let mut view = GltfView::default();
        visit(&opened, |node, matrix| {
            let refused =
                |error: RenderError| opened.error(format!("nodes[{}]", node.index()), error.to_string());
            if let Some(camera) = node.camera() {
                view.cameras.push(camera_at(camera.projection(), matrix).map_err(refused)?);
            }
            if let Some(light) = node.light() {
                let intensity = light.color().map(|part| part * light.intensity() / std::f32::consts::PI);
                let light = light_at(light.kind(), intensity, matrix);
                light.validate().map_err(refused)?;
                view.lights.push(light);
            }
            Ok(())
        })?;
        Ok(view)
    }
}

/// Where a node is, and where it looks.
fn pose(matrix: DMat4) -> (DVec3, DVec3) {
    (matrix.transform_point3(DVec3::ZERO), matrix.transform_vector3(DVec3::NEG_Z))
}

fn camera_at(projection: GltfProjection<'_>, matrix: DMat4) -> Result<Camera, RenderError> {
    let (eye, forward) = pose(matrix);
    let up = matrix.transform_vector3(DVec3::Y);
    let projection = match projection {
        GltfProjection::Perspective(part) => {
            Projection::Pinhole { fov_degrees: f64::from(part.yfov()).to_degrees() }
        }
        GltfProjection::Orthographic(part) => {
            Projection::Orthographic { height: 2.0 * f64::from(part.ymag()) }
        }
    };
    // Far from the origin a short step would be lost, as would be one that a small scale of the node has shortened. (Without a
    // direction it goes nowhere, which the camera refuses.)
    let length = forward.abs().max_element();
    let step = if length > 0.0 { forward / length } else { forward };
    let look_at = eye + step * (1.0 + eye.abs().max_element());
    Camera::new(eye.to_array(), look_at.to_array(), up.to_array(), projection)
}

fn light_at(kind: Kind, intensity: [f32; 3], matrix: DMat4) -> Light {
    let (position, direction) = pose(matrix);
    let (position, direction) = (position.to_array(), direction.to_array());
    let falloff = Falloff::InverseSquare { radius: RADIUS };
    match kind {
        Kind::Directional => Light::Directional { direction, intensity },
        Kind::Point => Light::Point { position, intensity, falloff },
        Kind::Spot { inner_cone_angle, outer_cone_angle } => {
            let degrees = |angle: f32| f64::from(angle).to_degrees().min(90.0);
            let (inner_degrees, outer_degrees) = (degrees(inner_cone_angle), degrees(outer_cone_angle));
            Light::Spot { position, direction, intensity, falloff, inner_degrees, outer_degrees }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_place_cameras_and_lights() {
        let document = r#"{
            "asset": { "version": "2.0" }, "scenes": [{ "nodes": [0, 2] }],
            "extensionsUsed": ["KHR_lights_punctual"],
            "nodes": [
                { "translation": [0, 0, 5], "camera": 0, "children": [1] },
                { "translation": [1, 0, 0], "extensions": { "KHR_lights_punctual": { "light": 0 } } },
                { "rotation": [-0.7071067811865476, 0, 0, 0.7071067811865476], "camera": 1,
                  "extensions": { "KHR_lights_punctual": { "light": 1 } } }
            ],
            "cameras": [
                { "type": "perspective", "perspective": { "yfov": 0.5, "znear": 0.1 } },
                { "type": "orthographic", "orthographic": { "xmag": 1, "ymag": 3, "zfar": 10, "znear": 0.1 } }
            ],
            "extensions": { "KHR_lights_punctual": { "lights": [
                { "type": "point", "intensity": 31.41592653589793, "color": [1, 0.5, 0] },
                { "type": "spot", "spot": { "innerConeAngle": 0.25, "outerConeAngle": 0.5 } }
            ] } }
        }"#;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.gltf");
        std::fs::write(&path, document).unwrap();
        let view = GltfView::read(&path).unwrap();
        let [perspective, orthographic] = view.cameras.as_slice() else { panic!("{view:?}") };
        assert_eq!(perspective.eye(), [0.0, 0.0, 5.0]);
        assert_eq!(perspective.frame(), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]);
        assert_eq!(perspective.projection(), Projection::Pinhole { fov_degrees: 0.5f64.to_degrees() });
        assert_eq!(orthographic.projection(), Projection::Orthographic { height: 6.0 });
        // A quarter turn backwards about x: it looks down, and what is up in its picture is -z.
        let [_, up, forward] = orthographic.frame().map(DVec3::from_array);
        assert!((forward - DVec3::NEG_Y).length() < 1e-6 && (up - DVec3::NEG_Z).length() < 1e-6);
        let [Light::Point { position, intensity, .. }, Light::Spot { direction, outer_degrees, .. }] =
            view.lights[..]
        else {
            panic!("{view:?}")
        };
        assert_eq!(position, [1.0, 0.0, 5.0]);
        assert!(
            (intensity[0] - 10.0).abs() < 1e-4 && (intensity[1] - 5.0).abs() < 1e-4 && intensity[2] == 0.0
        );
        assert!(direction[1] < -0.999 && (outer_degrees - 0.5f64.to_degrees()).abs() < 1e-5);
        // A small node far away looks the same way.
        let far = document.replace("[0, 0, 5], ", "[0, 1e9, 0], \"scale\": [1e-12, 1e-12, 1e-12], ");
        std::fs::write(&path, far).unwrap();
        let [_, _, forward] = GltfView::read(&path).unwrap().cameras[0].frame().map(DVec3::from_array);
        assert!((forward - DVec3::NEG_Z).length() < 1e-15, "{forward}");
        std::fs::write(&path, document.replace("\"yfov\": 0.5", "\"yfov\": 4.0")).unwrap();
        assert!(
            matches!(GltfView::read(&path), Err(ImportError::Element { element, .. }) if element == "nodes[0]")
        );
    }
}
