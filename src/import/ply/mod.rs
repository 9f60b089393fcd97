//! PLY: text and binary of both endians, any order and type of properties.
//!
//! Positions of f32 and narrower go to the sink as they are; wider ones, and text, as f64. Faces are taken from
//! the lists `vertex_indices` or `vertex_index` of the element `face`, and from the element `tristrips` (-1
//! starts a new strip). Every other element and property is passed over and counted.

mod faces;
mod header;
mod look;
mod values;
mod vertices;

use std::io::Read;
use std::path::Path;

use self::header::{Element, Header};
use self::values::Values;
use super::feed::Feed;
use super::file::Reopen;
use super::library::Materials;
use super::meter::Meter;
use super::report::{ImportOptions, ImportReport};
use super::sink::MeshSink;
use super::window::Window;
use crate::error::ImportError;

/// Reads a PLY file from `reader` into `sink`; `name` stands in messages, and material libraries are looked for
/// beside it.
///
/// # Errors
/// [`ImportError::Line`] (header, text files) or [`ImportError::Byte`] (binary files) for what cannot be read, and for
/// files whose faces come before their vertices: [`super::import_file`] reads those, in two passes.
/// [`ImportError::Io`], [`ImportError::Sink`].
pub fn read_ply(
    reader: impl Read,
    name: &Path,
    options: &ImportOptions,
    sink: &mut dyn MeshSink,
) -> Result<ImportReport, ImportError> {
    read(Box::new(reader), Meter::default(), name, options, None, sink)
}

/// [`read_ply`] with progress, and with a second pass where one is needed.
pub(super) fn read(
    reader: Box<dyn Read + '_>,
    meter: Meter,
    name: &Path,
    options: &ImportOptions,
    reopen: Option<Reopen<'_>>,
    sink: &mut dyn MeshSink,
) -> Result<ImportReport, ImportError> {
    let mut window = Window::new(reader, name, meter);
    let header = header::read(&mut window)?;
    let mut feed = Feed::new(sink);
    let mut materials = Materials::new(name, options, &mut feed)?;
    if let Some((line, text)) = &header.stray {
        feed.report.warn(name, Some(*line), format!("`{text}` is not a header line; it is left out"));
    }
    if let Some(library) = &header.material_library {
        materials.load_named(library, None, &mut feed)?;
    }

    let vertex_at = header.elements.iter().position(|element| element.name == "vertex");
    let Some(vertex_at) = vertex_at else {
        return Err(window.line_error(header.lines, "the header has no element `vertex`"));
    };
    if header.elements.iter().filter(|element| element.name == "vertex").count() > 1 {
        return Err(window.line_error(header.lines, "the header has several elements `vertex`"));
    }
    if header.elements[..vertex_at].iter().all(|element| !has_faces(element)) {
        body(&mut window, &header, &materials, &mut feed, Pass::Whole)?;
        return feed.finish(window.progress());
    }
    let Some(reopen) = reopen else {
        return Err(window.line_error(
            header.lines,
            "faces come before vertices; import it as a file (not from a stream), so that it can be read twice",
        ));
    };
    body(&mut window, &header, &materials, &mut feed, Pass::Vertices)?;
    drop(window);
    let (reader, meter) = reopen()?;
    let mut window = Window::new(reader, name, meter);
    let header = header::read(&mut window)?;
    body(&mut window, &header, &materials, &mut feed, Pass::Faces)?;
    feed.finish(window.progress())
}

/// Whether an element holds faces.
fn has_faces(element: &Element) -> bool {
    matches!(element.name.as_str(), "face" | "tristrips")
}

/// What is taken on this way through the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pass {
    Whole,
    Vertices,
    Faces,
}

/// Reads the records after the header.
fn body(
    window: &mut Window<'_>,
    header: &Header,
    materials: &Materials<'_>,
    feed: &mut Feed<'_>,
    pass: Pass,
) -> Result<(), ImportError> {
    let mut values = Values::new(window, header.encoding, header.lines + 1);
    for element in &header.elements {
        if element.name == "vertex" {
            if pass == Pass::Faces {
                skip(&mut values, element, feed)?;
            } else {
                vertices::read(&mut values, element, feed)?;
                feed.vertices_complete()?;
            }
        } else if !has_faces(element) {
            if pass != Pass::Faces {
                let ignored = &mut feed.report.ignored;
                let count = match element.name.as_str() {
                    "edge" => &mut ignored.lines_and_points,
                    _ => &mut ignored.unknown,
                };
                // Records without properties take no bytes, so the header may promise any number of them.
                *count = count.saturating_add(element.count);
            }
            skip(&mut values, element, feed)?;
        } else if pass == Pass::Vertices {
            skip(&mut values, element, feed)?;
        } else if element.name == "face" {
            faces::read(&mut values, element, materials, feed)?;
        } else {
            faces::read_strips(&mut values, element, materials, feed)?;
        }
        // Nothing after the last element that matters is worth reading.
        if pass == Pass::Vertices && element.name == "vertex" {
            break;
        }
    }
    Ok(())
}

/// Passes over an element.
fn skip(values: &mut Values<'_, '_>, element: &Element, feed: &mut Feed<'_>) -> Result<(), ImportError> {
    if let (Some(bytes), true) = (element.fixed_bytes(), values.encoding() != header::Encoding::Ascii) {
        let total = element.count.checked_mul(bytes as u64);
        return match total {
            Some(total) if values.window.skip(total)? => Ok(()),
            _ => Err(values.error("the file ends here, but its header promises more records")),
        };
    }
    if element.properties.is_empty() {
        return Ok(());
    }
    for _ in 0..element.count {
        for property in &element.properties {
            values.skip_property(property.kind)?;
        }
        feed.progress(values.window.progress())?;
    }
    Ok(())
}
