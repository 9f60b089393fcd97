//! OBJ: polygonal geometry and materials.
//!
//! Read are `v`, `f` (every form), `usemtl` and `mtllib`, and `vt` and `vn` if the sink takes attributes; `g`, `o`, `s` and everything
//! else is passed over. Text may have any encoding. Lines end with LF, CRLF or CR, and `\` before the line end joins a line with
//! the next (but not in comments).

mod ahead;
mod chunk;
mod fast;
mod parser;
mod statement;

use std::io::Read;
use std::path::Path;

use self::parser::Parser;
use super::file::Reopen;
use super::meter::Meter;
use super::report::{ImportOptions, ImportReport};
use super::sink::MeshSink;
use super::window::Window;
use crate::error::ImportError;

/// Reads an OBJ file from `reader` into `sink`; `name` stands in messages, and material libraries are looked for
/// beside it.
///
/// # Errors
/// [`ImportError::Line`] for a `v` or `f` that cannot be read, for lines of more than 1 MiB (comments excepted), and
/// for a face that names a vertex further down: [`super::import_file`] reads files with those, in two passes.
/// [`ImportError::Io`], [`ImportError::Sink`].
pub fn read_obj(
    reader: impl Read,
    name: &Path,
    options: &ImportOptions,
    sink: &mut dyn MeshSink,
) -> Result<ImportReport, ImportError> {
    read(Box::new(reader), Meter::default(), name, options, None, sink)
}

/// [`read_obj`] with progress, and with a second pass where one is needed.
pub(super) fn read(
    reader: Box<dyn Read + '_>,
    meter: Meter,
    name: &Path,
    options: &ImportOptions,
    reopen: Option<Reopen<'_>>,
    sink: &mut dyn MeshSink,
) -> Result<ImportReport, ImportError> {
    let mut parser = Parser::new(name, options, sink)?;
    let mut window = Window::new(reader, name, meter);
    let postponed = parser.run(&mut window, reopen.is_some(), options.pool.as_ref())?;
    let (Some(postponed), Some(reopen)) = (postponed, reopen) else {
        return parser.finish(&window);
    };
    // A face names a vertex further down. The vertices have all come by now; take the faces from there on, without other threads: the
    // sink may have them at work.
    drop(window);
    let (reader, meter) = reopen()?;
    let mut window = Window::new(reader, name, meter);
    parser.run_postponed(&mut window, postponed)?;
    parser.finish(&window)
}
