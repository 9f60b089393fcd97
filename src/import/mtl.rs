//! MTL: `tobj` understands the statements; this file guards it and salvages what it rejects.
//!
//! `tobj::load_mtl_buf` gives up a whole library for one bad statement or one byte that is not UTF-8, and panics at
//! a colour with one component. So statements are checked for shape and passed on one material at a time; a
//! statement that is rejected costs that statement, with a warning, and never the geometry.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use super::library::candidates;
use super::report::ImportReport;
use super::text::{self, shown, trimmed, words};
use crate::model::{ImageMap, MaterialImages, MaterialRecord};

/// Longest line; longer ones are cut there.
const LINE_BYTES_MAX: u64 = 64 << 10;

/// Longest number in a statement.
const WORD_BYTES_MAX: usize = 64;

/// Reads a library and hands its materials on in order, until `add` says that it has enough. Everything that is not
/// understood becomes a warning.
///
/// # Errors
/// The file cannot be read. Materials may have been handed on before that.
///
/// `images` is the folder from which paths of images are to start, or `None` if images are not wanted.
pub(super) fn read(
    path: &Path,
    images: Option<&Path>,
    report: &mut ImportReport,
    add: &mut dyn FnMut(MaterialRecord) -> bool,
) -> io::Result<()> {
    let mut reader = BufReader::with_capacity(LINE_BYTES_MAX as usize, File::open(path)?);
    let mut block = Block::default();
    let mut textures = 0_u64;
    let mut line = 0;
    let mut bytes = Vec::new();
    loop {
        bytes.clear();
        if (&mut reader).take(LINE_BYTES_MAX).read_until(b'\n', &mut bytes)? == 0 {
            break;
        }
        let bytes = bytes.strip_suffix(b"\n").unwrap_or(&bytes);
        let bytes = bytes.strip_suffix(b"\r").unwrap_or(bytes);
        // A lone CR ends lines in files that have no LF.
        for text in bytes.split(|byte| *byte == b'\r') {
            line += 1;
            let text = trimmed(text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(text));
            let keyword = words(text).next().unwrap_or_default();
            let rest = trimmed(&text[keyword.len()..]);
            if keyword == b"newmtl" {
                let finished = std::mem::replace(&mut block, Block::named(rest, line));
                if let Some(material) = finished.finish(path, report)
                    && !add(material)
                {
                    return Ok(());
                }
                if rest.is_empty() {
                    report.warn(path, Some(line), "a material without a name; it is left out");
                }
            } else if is_texture(keyword) {
                match (images, block.image_place(keyword)) {
                    (Some(folder), Some(place)) => match image_map(path, folder, rest) {
                        Ok(map) => *place = Some(map),
                        Err(reason) => report.warn(path, Some(line), reason),
                    },
                    _ => textures += 1,
                }
            } else if let Some(reason) = block.statement(keyword, rest, line) {
                report.warn(path, Some(line), reason);
            }
        }
    }
    if textures > 0 {
        report.warn(path, None, format!("{textures} texture statements are left out"));
    }
    if let Some(material) = block.finish(path, report) {
        add(material);
    }
    Ok(())
}

/// Whether a statement names an image.
fn is_texture(keyword: &[u8]) -> bool {
    keyword.starts_with(b"map_") || matches!(keyword, b"bump" | b"disp" | b"decal" | b"refl" | b"norm")
}

/// The picture that a statement of the library at `path` names, with its options.
fn image_map(path: &Path, folder: &Path, rest: &[u8]) -> Result<ImageMap, String> {
    let mut map = ImageMap::new("");
    let mut left = rest;
    // Options come first; the name is all that follows, blanks included.
    while let Some(option) = words(left).next().filter(|word| word.starts_with(b"-")) {
        left = trimmed(&left[option.len()..]);
        let mut take = |most: usize, is_number: bool| {
            let mut taken = Vec::new();
            while taken.len() < most
                && let Some(word) = words(left).next()
                && (!is_number || std::str::from_utf8(word).is_ok_and(|text| text.parse::<f32>().is_ok()))
            {
                taken.push(String::from_utf8_lossy(word).into_owned());
                left = trimmed(&left[word.len()..]);
            }
            taken
        };
        let number = |text: Option<&String>, default: f32| {
            text.and_then(|text| text.parse().ok()).filter(|x: &f32| x.is_finite()).unwrap_or(default)
        };
        match option {
            b"-s" | b"-o" | b"-t" => {
                let numbers = take(3, true);
                let (place, default) = match option {
                    b"-s" => (&mut map.scale, 1.0),
                    b"-o" => (&mut map.offset, 0.0),
                    // Turbulence is not used.
                    _ => continue,
                };
                *place = [0, 1].map(|axis| number(numbers.get(axis), default));
            }
            b"-bm" => map.strength = number(take(1, true).first(), 1.0),
            b"-clamp" => map.clamp = take(1, false).first().is_some_and(|word| word == "on"),
            b"-mm" => _ = take(2, true),
            _ => _ = take(1, false),
        }
    }
    let name = trimmed(left);
    if name.is_empty() {
        return Err("a texture statement without an image; it is left out".to_owned());
    }
    let found = candidates(path, name).into_iter().find(|path| path.is_file());
    let found = found.ok_or_else(|| format!("the image `{}` is not there; it is left out", shown(name)))?;
    let relative = found.strip_prefix(folder).unwrap_or(&found);
    map.path = relative.to_str().ok_or("the path of an image is not Unicode; it is left out")?.to_owned();
    Ok(map)
}

const NO_IMAGES: MaterialImages = MaterialImages {
    diffuse: None,
    specular: None,
    opacity: None,
    bump: None,
    normal: None,
    emission: None,
    roughness: None,
    metalness: None,
};

/// The statements of one material, at most one of each kind (the last one counts).
#[derive(Default)]
struct Block {
    name: String,
    line: u64,
    statements: Vec<Statement>,
    images: Option<Box<MaterialImages>>,
}

struct Statement {
    keyword: &'static str,
    /// The whole statement, in a shape that `tobj` takes.
    text: String,
    line: u64,
}

impl Block {
    fn named(name: &[u8], line: u64) -> Block {
        Block { name: text::name(name), line, ..Block::default() }
    }

    /// Where a picture goes; none if pictures of its kind are not used.
    fn image_place(&mut self, keyword: &[u8]) -> Option<&mut Option<ImageMap>> {
        let images = self.images.get_or_insert_default();
        match keyword {
            b"map_Kd" => Some(&mut images.diffuse),
            b"map_Ks" => Some(&mut images.specular),
            b"map_d" => Some(&mut images.opacity),
            b"map_Bump" | b"map_bump" | b"bump" => Some(&mut images.bump),
            b"norm" | b"map_norm" | b"map_Norm" => Some(&mut images.normal),
            b"map_Ke" => Some(&mut images.emission),
            b"map_Pr" => Some(&mut images.roughness),
            b"map_Pm" => Some(&mut images.metalness),
            _ => None,
        }
    }

    /// Adds a statement of a kind that is used; gives a reason if its shape is wrong.
    fn statement(&mut self, keyword: &[u8], rest: &[u8], line: u64) -> Option<String> {
        const COLORS: [&str; 4] = ["Kd", "Ks", "Ke", "Tf"];
        const NUMBERS: [&str; 7] = ["Ns", "Ni", "d", "Tr", "Pr", "Pm", "illum"];
        let known = |names: &[&'static str]| names.iter().find(|name| name.as_bytes() == keyword).copied();
        let mut arguments = words(rest).filter(|word| *word != b"-halo");
        if arguments.clone().any(|word| word.len() > WORD_BYTES_MAX) {
            return Some(format!("`{}` is too long", shown(keyword)));
        }
        let (keyword, values) = if let Some(keyword) = known(&COLORS) {
            match (arguments.next(), arguments.next(), arguments.next()) {
                // Green and blue default to red.
                (Some(red), None, _) => (keyword, vec![red; 3]),
                (Some(red), Some(green), Some(blue)) => (keyword, vec![red, green, blue]),
                _ => return Some(format!("`{keyword}` needs one or three numbers; it is left out")),
            }
        } else if let Some(keyword) = known(&NUMBERS) {
            match arguments.next() {
                Some(value) => (keyword, vec![value]),
                None => return Some(format!("`{keyword}` without a number; it is left out")),
            }
        } else {
            return None;
        };
        let mut text = keyword.to_owned();
        for value in values {
            text.push(' ');
            text.push_str(&String::from_utf8_lossy(value));
        }
        self.statements.retain(|statement| statement.keyword != keyword);
        self.statements.push(Statement { keyword, text, line });
        None
    }

    /// The material that the statements make; `None` for what stands before the first `newmtl`.
    fn finish(mut self, path: &Path, report: &mut ImportReport) -> Option<MaterialRecord> {
        if self.name.is_empty() {
            return None;
        }
        let material = parse(&self.statements).or_else(|| {
            self.statements.retain(|statement| {
                let good = parse(std::slice::from_ref(statement)).is_some();
                if !good {
                    let text = format!("`{}` is not understood; it is left out", statement.text);
                    report.warn(path, Some(statement.line), text);
                }
                good
            });
            parse(&self.statements)
        });
        let images = self.images.filter(|images| images.all().next().is_some());
        let (mut record, reasons) =
            record(self.name, material.unwrap_or_default(), images.as_deref().unwrap_or(&NO_IMAGES));
        record.images = images.map(|mut images| {
            // A picture times nothing is not looked at.
            images.emission = images.emission.filter(|_| record.emission != [0.0; 3]);
            images.roughness = images.roughness.filter(|_| record.roughness > 0.0);
            images.metalness = images.metalness.filter(|_| record.metalness > 0.0);
            images
        });
        record.images = record.images.filter(|images| images.all().next().is_some());
        for reason in reasons {
            report.warn(path, Some(self.line), reason);
        }
        Some(record)
    }
}

/// What `tobj` makes of the statements, or nothing if it rejects one.
fn parse(statements: &[Statement]) -> Option<tobj::Material> {
    let mut text = "newmtl material\n".to_owned();
    for statement in statements {
        text.push_str(&statement.text);
        text.push('\n');
    }
    tobj::load_mtl_buf(&mut text.as_bytes()).ok()?.0.pop()
}

/// The record of a material with these pictures, and what had to be changed about it. A picture of what no statement says stands
/// alone, times 1: also where a model has no texture coordinates to find it by, and the number is all there is.
fn record(name: String, material: tobj::Material, images: &MaterialImages) -> (MaterialRecord, Vec<String>) {
    let mut reasons = Vec::new();
    let mut value = |keyword: &str, given: Option<f32>, default: f32, range: [f32; 2]| match given {
        None => default,
        Some(given) if given.is_finite() => given.clamp(range[0], range[1]),
        Some(given) => {
            reasons.push(format!("`{keyword}` is {given}; {default} is taken"));
            default
        }
    };
    let defaults = MaterialRecord::default();
    let mut color = |keyword: &str, given: Option<[f32; 3]>, default: [f32; 3]| {
        std::array::from_fn(|channel| {
            value(keyword, given.map(|given| given[channel]), default[channel], [0.0, f32::MAX])
        })
    };
    let other = |keyword: &str| material.unknown_param.get(keyword);
    let triple = |text: &String| -> Option<[f32; 3]> {
        let mut numbers = text.split_whitespace().map(|word| word.parse().unwrap_or(f32::NAN));
        Some([numbers.next()?, numbers.next()?, numbers.next()?])
    };
    let diffuse = color("Kd", material.diffuse, defaults.diffuse);
    let specular = color("Ks", material.specular, defaults.specular);
    let or_picture = |default: f32, picture: &Option<ImageMap>| if picture.is_some() { 1.0 } else { default };
    let emission = defaults.emission.map(|channel| or_picture(channel, &images.emission));
    let emission = color("Ke", material.emissive, emission);
    let transmission = color("Tf", other("Tf").and_then(triple), defaults.transmission);
    let transparency = other("Tr").map(|text| 1.0 - text.parse().unwrap_or(f32::NAN));
    let opacity = value("d", material.dissolve.or(transparency), defaults.opacity, [0.0, 1.0]);
    let shininess = value("Ns", material.shininess, defaults.shininess, [0.0, f32::MAX]);
    // Below 1, and 0 above all, stands for "no refraction".
    let refractive_index = value("Ni", material.optical_density, 1.0, [1.0, f32::MAX]);
    // Of the extension for physically based materials; perceptual, as in glTF.
    let mut share = |keyword: &str, default: f32| {
        let given = other(keyword).map(|text| text.parse().unwrap_or(f32::NAN));
        value(keyword, given, default, [0.0, 1.0])
    };
    let roughness = share("Pr", or_picture(defaults.roughness, &images.roughness));
    let metalness = share("Pm", or_picture(defaults.metalness, &images.metalness));
    // 3 to 9 reflect; 10 only casts shadows.
    let mirror = matches!(material.illumination_model, Some(3..=9));
    let record = MaterialRecord {
        name,
        diffuse,
        specular,
        shininess,
        emission,
        opacity,
        transmission,
        refractive_index,
        mirror,
        roughness,
        metalness,
        exponent_by_roughness: false,
        images: None,
    };
    (record, reasons)
}
