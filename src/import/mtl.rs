//! MTL: `tobj` understands the statements; this file guards it and salvages what it rejects.
//!
//! `tobj::load_mtl_buf` gives up a whole library for one bad statement or one byte that is not UTF-8, and panics at
//! a colour with one component. So statements are checked for shape and passed on one material at a time; a
//! statement that is rejected costs that statement, with a warning, and never the geometry.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use super::report::ImportReport;
use super::text::{shown, words};
use crate::model::MaterialRecord;

/// Longest line; longer ones are cut there.
const LINE_BYTES_MAX: u64 = 64 << 10;

/// Longest number in a statement.
const WORD_BYTES_MAX: usize = 64;

/// Reads a library and hands its materials on in order, until `add` says that it has enough. Everything that is not
/// understood becomes a warning.
///
/// # Errors
/// The file cannot be read. Materials may have been handed on before that.
pub(super) fn read(
    path: &Path,
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
            let text = text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(text).trim_ascii();
            let keyword = words(text).next().unwrap_or_default();
            let rest = text[keyword.len()..].trim_ascii();
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
                textures += 1;
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

/// The statements of one material, at most one of each kind (the last one counts).
#[derive(Default)]
struct Block {
    name: String,
    line: u64,
    statements: Vec<Statement>,
}

struct Statement {
    keyword: &'static str,
    /// The whole statement, in a shape that `tobj` takes.
    text: String,
    line: u64,
}

impl Block {
    fn named(name: &[u8], line: u64) -> Block {
        Block { name: String::from_utf8_lossy(name).into_owned(), line, statements: Vec::new() }
    }

    /// Adds a statement of a kind that is used; gives a reason if its shape is wrong.
    fn statement(&mut self, keyword: &[u8], rest: &[u8], line: u64) -> Option<String> {
        const COLORS: [&str; 4] = ["Kd", "Ks", "Ke", "Tf"];
        const NUMBERS: [&str; 5] = ["Ns", "Ni", "d", "Tr", "illum"];
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
        let (record, reasons) = record(self.name, material.unwrap_or_default());
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

/// The record of a material, and what had to be changed about it.
fn record(name: String, material: tobj::Material) -> (MaterialRecord, Vec<String>) {
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
    let emission = color("Ke", material.emissive, defaults.emission);
    let transmission = color("Tf", other("Tf").and_then(triple), defaults.transmission);
    let transparency = other("Tr").map(|text| 1.0 - text.parse().unwrap_or(f32::NAN));
    let opacity = value("d", material.dissolve.or(transparency), defaults.opacity, [0.0, 1.0]);
    let shininess = value("Ns", material.shininess, defaults.shininess, [0.0, f32::MAX]);
    // Below 1, and 0 above all, stands for "no refraction".
    let refractive_index = value("Ni", material.optical_density, 1.0, [1.0, f32::MAX]);
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
    };
    (record, reasons)
}
