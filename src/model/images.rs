//! Pictures that materials name, as the compiled file holds them: in a table of their own, so that a file without any is as before.

use std::ops::Range;

use super::MaterialRecord;
use super::directory::Fields;
use crate::error::ModelError;

/// A picture on a surface, in the terms of MTL.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageMap {
    /// The image file; a relative path starts from the model's folder. An image that is a part of a file has its place behind the
    /// file's name: see [`ImageMap::inside`] and [`ImageMap::base64_inside`].
    pub path: String,
    /// Texture coordinates are multiplied by this (`-s`),
    pub scale: [f32; 2],
    /// and then this is added (`-o`).
    pub offset: [f32; 2],
    /// How high the bumps are (`-bm`): from black to white over one texel is a slope of as much.
    pub strength: f32,
    /// Whether the picture's border stands for what is beyond it (`-clamp on`), not the picture again.
    pub clamp: bool,
}

impl ImageMap {
    /// The whole picture once from 0 to 1, and again beyond that.
    pub fn new(path: impl Into<String>) -> ImageMap {
        ImageMap { path: path.into(), scale: [1.0; 2], offset: [0.0; 2], strength: 1.0, clamp: false }
    }

    /// [`ImageMap::new`] for an image that is a part of a file, as in `.glb` files: the bytes `place` of it. In
    /// [`ImageMap::path`] that is `FILE#bytes=START+LENGTH`.
    pub fn inside(file: &str, place: Range<u64>) -> ImageMap {
        let length = place.end.saturating_sub(place.start);
        ImageMap::new(format!("{file}{PLACE}{}+{length}", place.start))
    }

    /// [`ImageMap::new`] for an image whose bytes stand as base64 text in a JSON string of a file, as in `.gltf` files: the bytes
    /// `place` of it, without the quotes. In [`ImageMap::path`] that is `FILE#base64=START+LENGTH`; behind that may come the place
    /// inside what the text says, as of [`ImageMap::inside`].
    pub fn base64_inside(file: &str, place: Range<u64>) -> ImageMap {
        let length = place.end.saturating_sub(place.start);
        ImageMap::new(format!("{file}{TEXT_PLACE}{}+{length}", place.start))
    }

    /// The file of a path, and where in it the image is, if it is only a part. If the file is itself a text in a file, see
    /// [`ImageMap::text_of`].
    pub fn file_of(path: &str) -> (&str, Option<Range<u64>>) {
        split_place(path, PLACE)
    }

    /// The file of a path that [`ImageMap::file_of`] gave, and where in it the base64 text is that stands for it, if one does.
    pub fn text_of(path: &str) -> (&str, Option<Range<u64>>) {
        split_place(path, TEXT_PLACE)
    }
}

fn split_place<'p>(path: &'p str, mark: &str) -> (&'p str, Option<Range<u64>>) {
    let place = path.rsplit_once(mark).and_then(|(file, place)| {
        let (start, length) = place.split_once('+')?;
        let start: u64 = start.parse().ok()?;
        Some((file, start..start.checked_add(length.parse().ok()?)?))
    });
    place.map_or((path, None), |(file, place)| (file, Some(place)))
}

/// Between a file and the place of an image in it.
const PLACE: &str = "#bytes=";

/// Between a file and the place of a base64 text in it.
const TEXT_PLACE: &str = "#base64=";

/// The pictures of a material.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MaterialImages {
    /// Colours that the diffuse reflectance is multiplied by (`map_Kd`). Where its alpha is below one half the surface is not there.
    pub diffuse: Option<ImageMap>,
    /// Colours that the specular reflectance is multiplied by (`map_Ks`).
    pub specular: Option<ImageMap>,
    /// Where this is below one half the surface is not there (`map_d`): its alpha if it has any, else its red.
    pub opacity: Option<ImageMap>,
    /// Heights above the surface (`map_Bump`, `bump`).
    pub bump: Option<ImageMap>,
    /// Normals in the frame of the texture coordinates: red along u, green along v, blue away from the surface (`norm`).
    pub normal: Option<ImageMap>,
    /// Colours that the emitted radiance is multiplied by (`map_Ke`).
    pub emission: Option<ImageMap>,
    /// Numbers that the roughness is multiplied by: the green of it (`map_Pr`; glTF has roughness and metalness in one image).
    pub roughness: Option<ImageMap>,
    /// Numbers that the metalness is multiplied by: the blue of it (`map_Pm`).
    pub metalness: Option<ImageMap>,
}

impl MaterialImages {
    /// Each picture, and whether it holds colours (and so is in sRGB).
    pub fn all(&self) -> impl Iterator<Item = (&ImageMap, bool)> {
        let MaterialImages { diffuse, specular, opacity, bump, normal, emission, roughness, metalness } =
            self;
        let colors = [diffuse, specular, emission].into_iter().flatten().map(|map| (map, true));
        let numbers = [opacity, bump, normal, roughness, metalness].into_iter().flatten();
        colors.chain(numbers.map(|map| (map, false)))
    }

    /// By kind.
    fn places(&self) -> [&Option<ImageMap>; 8] {
        let MaterialImages { diffuse, specular, opacity, bump, normal, emission, roughness, metalness } =
            self;
        [diffuse, specular, opacity, bump, normal, emission, roughness, metalness]
    }

    fn places_mut(&mut self) -> [&mut Option<ImageMap>; 8] {
        let MaterialImages { diffuse, specular, opacity, bump, normal, emission, roughness, metalness } =
            self;
        [diffuse, specular, opacity, bump, normal, emission, roughness, metalness]
    }
}

/// Longest path.
const PATH_BYTES_MAX: usize = 1 << 12;

/// The shortest entry.
const ENTRY_BYTES: usize = 28;

/// The table of all pictures; empty if there are none.
pub(super) fn table_bytes(materials: &[MaterialRecord]) -> Result<Vec<u8>, ModelError> {
    let mut out = Vec::new();
    for (material, record) in materials.iter().enumerate() {
        let Some(images) = &record.images else { continue };
        for (kind, map) in images.places().into_iter().enumerate() {
            let Some(map) = map else { continue };
            let numbers = [map.scale[0], map.scale[1], map.offset[0], map.offset[1], map.strength];
            if numbers.iter().any(|number| !number.is_finite()) {
                return Err(ModelError::Limit { reason: "a number of a texture is not finite" });
            }
            if map.path.len() > PATH_BYTES_MAX {
                return Err(ModelError::Limit { reason: "the path of an image is longer than 4 KiB" });
            }
            // There are at most 65,536 materials.
            out.extend_from_slice(&(material as u16).to_le_bytes());
            out.push(kind as u8);
            out.push(u8::from(map.clamp));
            out.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
            out.extend_from_slice(&(map.path.len() as u32).to_le_bytes());
            out.extend_from_slice(map.path.as_bytes());
        }
    }
    Ok(out)
}

/// Reads a whole table whose first byte is at `offset` of the file into the materials.
pub(super) fn parse_table(
    bytes: &[u8],
    offset: u64,
    materials: &mut [MaterialRecord],
) -> Result<(), ModelError> {
    let (mut rest, mut last) = (bytes, None);
    while !rest.is_empty() {
        let at = offset + (bytes.len() - rest.len()) as u64;
        rest = parse(rest, &mut last, materials).map_err(|reason| ModelError::Damaged {
            part: "table of images",
            offset: at,
            reason,
        })?;
    }
    Ok(())
}

fn parse<'b>(
    bytes: &'b [u8],
    last: &mut Option<(u16, u8)>,
    materials: &mut [MaterialRecord],
) -> Result<&'b [u8], &'static str> {
    const ENDS: &str = "it ends inside an image";
    let (head, rest) = bytes.split_first_chunk::<ENTRY_BYTES>().ok_or(ENDS)?;
    let mut fields = Fields(head);
    let material = fields.u16();
    let [kind, clamp] = fields.take();
    let [su, sv, ou, ov, strength] = [(); 5].map(|()| fields.f32());
    let length = fields.u32() as usize;
    if clamp > 1 || [su, sv, ou, ov, strength].iter().any(|number| !number.is_finite()) {
        return Err("a number of an image is wrong");
    }
    if length > PATH_BYTES_MAX {
        return Err("the path of an image is too long");
    }
    // So that there is one form, and no picture comes twice.
    if last.is_some_and(|last| last >= (material, kind)) {
        return Err("images are not in the order of the materials");
    }
    *last = Some((material, kind));
    let (path, rest) = rest.split_at_checked(length).ok_or(ENDS)?;
    let path = str::from_utf8(path).map_err(|_| "the path of an image is not UTF-8")?.to_owned();
    let record =
        materials.get_mut(usize::from(material)).ok_or("an image is of a material that is not there")?;
    let places = record.images.get_or_insert_default().places_mut();
    let place = places.into_iter().nth(usize::from(kind)).ok_or("an image is of an unknown kind")?;
    *place = Some(ImageMap { path, scale: [su, sv], offset: [ou, ov], strength, clamp: clamp == 1 });
    Ok(rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn materials() -> Vec<MaterialRecord> {
        let map =
            |path: &str| Some(ImageMap { scale: [2.0, -1.0], offset: [0.5, 0.0], ..ImageMap::new(path) });
        let first =
            MaterialImages { diffuse: map("a.png"), normal: map("folder/n.png"), ..Default::default() };
        let clamped = ImageMap { clamp: true, strength: 0.25, ..ImageMap::new("ä") };
        let third = MaterialImages {
            bump: Some(clamped),
            opacity: map(""),
            specular: map("s"),
            ..Default::default()
        };
        let last = MaterialImages {
            emission: map("e"),
            roughness: map("pm.png"),
            metalness: map("pm.png"),
            ..Default::default()
        };
        let with = |images: MaterialImages| MaterialRecord {
            images: Some(Box::new(images)),
            ..MaterialRecord::default()
        };
        vec![with(first), MaterialRecord::default(), with(third), with(last)]
    }

    fn read(bytes: &[u8]) -> Result<Vec<MaterialRecord>, ModelError> {
        let mut found = vec![MaterialRecord::default(); 4];
        parse_table(bytes, 1000, &mut found).map(|()| found)
    }

    #[test]
    fn places_in_files_are_part_of_paths() {
        let map = ImageMap::inside("a b.glb", 12..40);
        assert_eq!(map.path, "a b.glb#bytes=12+28");
        assert_eq!(ImageMap::file_of(&map.path), ("a b.glb", Some(12..40)));
        let inner = ImageMap::inside(&map.path, 0..u64::MAX);
        assert_eq!(ImageMap::file_of(&inner.path), (&*map.path, Some(0..u64::MAX)));
        for path in [
            "a.png",
            "",
            "#bytes=",
            "a#bytes=1",
            "a#bytes=1+",
            "a#bytes=+1",
            "a#bytes=-1+2",
            "a#bytes=1+x",
            "a#bytes=1+18446744073709551615",
        ] {
            assert_eq!(ImageMap::file_of(path), (path, None));
        }
        let text = ImageMap::base64_inside("a.gltf", 5..25);
        assert_eq!(text.path, "a.gltf#base64=5+20");
        let part = ImageMap::inside(&text.path, 3..7).path;
        assert_eq!(ImageMap::file_of(&part), (&*text.path, Some(3..7)));
        assert_eq!(ImageMap::text_of(&text.path), ("a.gltf", Some(5..25)));
        assert_eq!(ImageMap::text_of("a.gltf#base64=5"), ("a.gltf#base64=5", None));
    }

    #[test]
    fn images_come_back() {
        let bytes = table_bytes(&materials()).unwrap();
        assert_eq!(read(&bytes).unwrap(), materials());
        assert!(table_bytes(&[MaterialRecord::default()]).unwrap().is_empty());
        let mut bad = materials();
        if let Some(map) = bad[0].images.as_mut().and_then(|images| images.diffuse.as_mut()) {
            map.strength = f32::NAN;
        }
        assert!(table_bytes(&bad).is_err());
    }

    #[test]
    fn damaged_tables_are_refused_or_sound() {
        let bytes = table_bytes(&materials()).unwrap();
        let mut whole = 0;
        for length in 1..bytes.len() {
            whole += u32::from(read(&bytes[..length]).is_ok());
        }
        // Only where an image ends: the header says where the table ends.
        assert_eq!(whole, 7);
        let (mut refused, mut sound) = (0, 0);
        for at in 0..8 * bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at / 8] ^= 1 << (at % 8);
            match read(&damaged) {
                Err(ModelError::Damaged { offset, .. }) => {
                    assert!((1000..1000 + bytes.len() as u64).contains(&offset));
                    refused += 1;
                }
                Err(other) => panic!("{other}"),
                Ok(found) => {
                    // What was read can be written.
                    table_bytes(&found).unwrap();
                    sound += 1;
                }
            }
        }
        assert!(refused > 50 && sound > 50, "{refused} {sound}");
    }
}
