//! Materials as MTL text.

use std::fmt::Write;

use crate::model::MaterialRecord;

/// The MTL statements of `materials`. Numbers are the shortest decimals that give the same f32.
pub(super) fn mtl_text(materials: &[MaterialRecord]) -> String {
    let mut text = String::new();
    for material in materials {
        let rgb = |[r, g, b]: [f32; 3]| format!("{r} {g} {b}");
        let mut line = |key: &str, value: String| {
            writeln!(text, "{key} {value}").expect("a String takes any text");
        };
        line("newmtl", material.name.clone());
        line("Kd", rgb(material.diffuse));
        line("Ks", rgb(material.specular));
        line("Ns", material.shininess.to_string());
        if material.emission != [0.0; 3] {
            line("Ke", rgb(material.emission));
        }
        line("d", material.opacity.to_string());
        if material.transmission != [1.0; 3] {
            line("Tf", rgb(material.transmission));
        }
        line("Ni", material.refractive_index.to_string());
        if material.roughness != 0.0 {
            line("Pr", material.roughness.to_string());
        }
        if material.metalness != 0.0 {
            line("Pm", material.metalness.to_string());
        }
        line("illum", if material.mirror { "3" } else { "2" }.to_string());
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roughness_and_metalness_are_said_where_there_are_any() {
        let rough = MaterialRecord { roughness: 0.375, ..MaterialRecord::default() };
        let text = |record| mtl_text(&[record]);
        assert_eq!(text(rough).replace("Pr 0.375\n", ""), text(MaterialRecord::default()));
        let metal = MaterialRecord { metalness: 0.25, ..MaterialRecord::default() };
        assert_eq!(text(metal).replace("Pm 0.25\n", ""), text(MaterialRecord::default()));
        assert!(!text(MaterialRecord::default()).contains("\nP"));
    }
}
