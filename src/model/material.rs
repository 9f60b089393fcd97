//! Materials as the compiled file holds them.

use super::MaterialImages;
use super::directory::Fields;
use super::header::MATERIAL_BYTES_MIN;
use crate::error::ModelError;

/// A material in the terms of MTL (and of the 2004 paper). Colours are linear RGB.
#[derive(Clone, Debug, PartialEq)]
pub struct MaterialRecord {
    /// Name in the source; empty for the default material.
    pub name: String,
    /// Diffuse reflectance (`Kd`).
    pub diffuse: [f32; 3],
    /// Specular reflectance (`Ks`): highlight, and mirror where `mirror` is set.
    pub specular: [f32; 3],
    /// Phong exponent (`Ns`).
    pub shininess: f32,
    /// Emitted radiance (`Ke`).
    pub emission: [f32; 3],
    /// 1 for opaque (`d`); below 1 the rest is transmitted.
    pub opacity: f32,
    /// Colour of transmitted light per unit length inside (`Tf`): Beer-Lambert; white for none.
    pub transmission: [f32; 3],
    /// Refractive index (`Ni`); values below 1 or 0 in the source mean 1: light passes straight.
    pub refractive_index: f32,
    /// Whether `specular` reflects the scene like a mirror (`illum` 3 and up).
    pub mirror: bool,
    /// How rough mirror and glass are (`Pr`, glTF's roughness): 0 for smooth, up to 1. See
    /// [`Finish::roughness`](crate::scene::Finish::roughness), which overrides it. What neither mirrors nor refracts has no use for
    /// it.
    pub roughness: f32,
    /// The share of the surface that is metal (`Pm`, glTF's metalness), 0 to 1. Metal mirrors the scene with reflectance `diffuse`,
    /// as rough as `roughness` says, and lets nothing through where the rest refracts; all other terms are those of the rest.
    pub metalness: f32,
    /// Whether the Phong exponent follows from the roughness ([`MaterialRecord::exponent_of`]), as in glTF. `shininess` is that of
    /// `roughness` then; where a picture says how rough the surface is, the exponent goes along.
    pub exponent_by_roughness: bool,
    /// Pictures on the surface, if there are any.
    pub images: Option<Box<MaterialImages>>,
}

impl Default for MaterialRecord {
    /// Opaque mid-grey, as used where the source names no material.
    fn default() -> MaterialRecord {
        MaterialRecord {
            name: String::new(),
            diffuse: [0.7; 3],
            specular: [0.0; 3],
            shininess: 1.0,
            emission: [0.0; 3],
            opacity: 1.0,
            transmission: [1.0; 3],
            refractive_index: 1.0,
            mirror: false,
            roughness: 0.0,
            metalness: 0.0,
            exponent_by_roughness: false,
            images: None,
        }
    }
}

/// Longest name that a table holds.
const NAME_BYTES_MAX: usize = 1 << 16;

/// Flags of an entry.
const MIRROR: u32 = 1;
const EXPONENT_BY_ROUGHNESS: u32 = 2;

impl MaterialRecord {
    /// The Phong exponent of a highlight that is as wide as that of a surface of such roughness (0 to 1): `2 / r^4 - 2`, from 1 to
    /// a million, beyond which it is as good as a mirror's.
    pub fn exponent_of(roughness: f32) -> f32 {
        let squared = roughness * roughness;
        (2.0 / (squared * squared) - 2.0).clamp(1.0, 1e6)
    }

    fn numbers(&self) -> [f32; 17] {
        let (d, s, e, t) = (self.diffuse, self.specular, self.emission, self.transmission);
        [
            d[0],
            d[1],
            d[2],
            s[0],
            s[1],
            s[2],
            e[0],
            e[1],
            e[2],
            t[0],
            t[1],
            t[2],
            self.shininess,
            self.opacity,
            self.refractive_index,
            self.roughness,
            self.metalness,
        ]
    }

    /// What a table refuses about the numbers, if anything.
    fn check(&self) -> Result<(), &'static str> {
        if self.numbers().iter().any(|number| !number.is_finite()) {
            return Err("a number of a material is not finite");
        }
        let is_share = |number: f32| (0.0..=1.0).contains(&number);
        match (is_share(self.roughness), is_share(self.metalness)) {
            (true, true) => Ok(()),
            (false, _) => Err("the roughness of a material is not between 0 and 1"),
            (true, false) => Err("the metalness of a material is not between 0 and 1"),
        }
    }

    /// Appends the material to a table.
    pub(super) fn put(&self, out: &mut Vec<u8>) -> Result<(), ModelError> {
        if self.name.len() > NAME_BYTES_MAX {
            return Err(ModelError::Limit { reason: "the name of a material is longer than 64 KiB" });
        }
        self.check().map_err(|reason| ModelError::Limit { reason })?;
        out.extend(self.numbers().iter().flat_map(|number| number.to_le_bytes()));
        let flag = |is_set: bool, flag: u32| if is_set { flag } else { 0 };
        let flags = flag(self.mirror, MIRROR) | flag(self.exponent_by_roughness, EXPONENT_BY_ROUGHNESS);
        out.extend_from_slice(&flags.to_le_bytes());
        out.extend_from_slice(&(self.name.len() as u32).to_le_bytes());
        out.extend_from_slice(self.name.as_bytes());
        Ok(())
    }
}

/// The table of `materials`, or of the default material if there are none, and how many it has.
pub(crate) fn table_bytes(materials: &[MaterialRecord]) -> Result<(Vec<u8>, u32), ModelError> {
    let default = [MaterialRecord::default()];
    let materials = if materials.is_empty() { &default } else { materials };
    let count = u32::try_from(materials.len()).ok().filter(|count| *count <= 1 << 16);
    let count = count.ok_or(ModelError::Limit { reason: "a file holds at most 65,536 materials" })?;
    let mut out = Vec::new();
    for material in materials {
        material.put(&mut out)?;
    }
    Ok((out, count))
}

/// Parses a whole table of `count` materials whose first byte is at `offset` of the file.
pub(super) fn parse_table(bytes: &[u8], count: u32, offset: u64) -> Result<Vec<MaterialRecord>, ModelError> {
    let mut rest = bytes;
    let mut materials = Vec::new();
    for _ in 0..count {
        let at = offset + (bytes.len() - rest.len()) as u64;
        let (material, after) = parse(rest).map_err(|reason| ModelError::Damaged {
            part: "material table",
            offset: at,
            reason,
        })?;
        materials.push(material);
        rest = after;
    }
    if rest.is_empty() {
        Ok(materials)
    } else {
        let at = offset + (bytes.len() - rest.len()) as u64;
        Err(ModelError::Damaged {
            part: "material table",
            offset: at,
            reason: "bytes follow the last material",
        })
    }
}

fn parse(bytes: &[u8]) -> Result<(MaterialRecord, &[u8]), &'static str> {
    const ENDS: &str = "it ends inside a material";
    let (head, rest) = bytes.split_first_chunk::<{ MATERIAL_BYTES_MIN as usize }>().ok_or(ENDS)?;
    let mut fields = Fields(head);
    let mut color = || [(); 3].map(|()| fields.f32());
    let (diffuse, specular, emission, transmission) = (color(), color(), color(), color());
    let [shininess, opacity, refractive_index, roughness, metalness] = [(); 5].map(|()| fields.f32());
    let flags = fields.u32();
    if flags & !(MIRROR | EXPONENT_BY_ROUGHNESS) != 0 {
        return Err("a flag of a material is unknown");
    }
    let name_bytes = fields.u32() as usize;
    if name_bytes > NAME_BYTES_MAX {
        return Err("the name of a material is too long");
    }
    let (name, rest) = rest.split_at_checked(name_bytes).ok_or(ENDS)?;
    let name = str::from_utf8(name).map_err(|_| "the name of a material is not UTF-8")?;
    let material = MaterialRecord {
        name: name.to_owned(),
        diffuse,
        specular,
        shininess,
        emission,
        opacity,
        transmission,
        refractive_index,
        mirror: flags & MIRROR != 0,
        roughness,
        metalness,
        exponent_by_roughness: flags & EXPONENT_BY_ROUGHNESS != 0,
        images: None,
    };
    material.check()?;
    Ok((material, rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn materials() -> Vec<MaterialRecord> {
        let brass = MaterialRecord {
            name: "brass".into(),
            specular: [0.9, 0.7, 0.3],
            mirror: true,
            roughness: 0.375,
            ..MaterialRecord::default()
        };
        let frosted = MaterialRecord {
            name: "Milchgläser".into(),
            opacity: 0.0,
            refractive_index: 1.5,
            roughness: 1.0,
            ..brass.clone()
        };
        let rusty =
            MaterialRecord { metalness: 0.625, exponent_by_roughness: true, mirror: false, ..brass.clone() };
        vec![brass, MaterialRecord::default(), frosted, rusty]
    }

    #[test]
    fn materials_come_back() {
        let (bytes, count) = table_bytes(&materials()).unwrap();
        assert_eq!(bytes.len(), 4 * MATERIAL_BYTES_MIN as usize + 2 * "brass".len() + "Milchgläser".len());
        assert_eq!(parse_table(&bytes, count, 0).unwrap(), materials());
    }

    #[test]
    fn roughness_and_metalness_are_between_0_and_1() {
        for number in [-0.1, 1.1, f32::NAN, f32::INFINITY] {
            let rough = MaterialRecord { roughness: number, ..MaterialRecord::default() };
            let metal = MaterialRecord { metalness: number, ..MaterialRecord::default() };
            for (bad, at) in [(rough, 60), (metal, 64)] {
                assert!(matches!(table_bytes(&[bad]), Err(ModelError::Limit { .. })), "{number}");
                let (mut bytes, _) = table_bytes(&[MaterialRecord::default()]).unwrap();
                bytes[at..at + 4].copy_from_slice(&number.to_le_bytes());
                assert!(matches!(parse_table(&bytes, 1, 0), Err(ModelError::Damaged { offset: 0, .. })));
            }
        }
    }

    #[test]
    fn exponents_are_those_of_the_roughness_and_of_a_mirror_at_most() {
        let found = [0.0, 0.01, 0.5, 0.75, 1.0].map(MaterialRecord::exponent_of);
        assert_eq!(found, [1e6, 1e6, 30.0, 2.0 / 0.316_406_25 - 2.0, 1.0]);
    }

    #[test]
    fn damaged_tables_are_refused_or_sound() {
        let (bytes, count) = table_bytes(&materials()).unwrap();
        let is_refused = |bytes: &[u8]| match parse_table(bytes, count, 1000) {
            Err(ModelError::Damaged { offset, .. }) => {
                assert!((1000..=1000 + bytes.len() as u64).contains(&offset));
                true
            }
            Err(other) => panic!("{other}"),
            Ok(found) => {
                // What was read can be written.
                table_bytes(&found).unwrap();
                false
            }
        };
        for length in 0..bytes.len() {
            assert!(is_refused(&bytes[..length]), "cut to {length}");
        }
        assert!(is_refused(&[&bytes[..], &[0]].concat()));
        let (mut refused, mut sound) = (0, 0);
        for at in 0..8 * bytes.len() {
            let mut changed = bytes.clone();
            changed[at / 8] ^= 1 << (at % 8);
            if is_refused(&changed) { refused += 1 } else { sound += 1 }
        }
        assert!(refused > 100 && sound > 100, "{refused} {sound}");
    }
}
