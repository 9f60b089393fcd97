//! What the examples share: arguments, progress, ^C, and what the system says about memory.

// Each example uses its part.
#![allow(dead_code)]

/// Writes a line as the macro of that name in std does, but goes on where nobody reads any more (`render MODEL | head`): the standard one
/// panics then, and what the program was for would be lost with it.
macro_rules! println {
    ($($text:tt)*) => {{
        use std::io::Write;
        let _ = writeln!(std::io::stdout(), $($text)*);
    }};
}

/// As [`println`], without an end of line.
macro_rules! print {
    ($($text:tt)*) => {{
        use std::io::Write;
        let _ = write!(std::io::stdout(), $($text)*);
    }};
}

pub mod arguments;
pub mod gears_view;
pub mod interrupt;
pub mod log_plot;
pub mod memory_log;
pub mod place;
mod plot;
pub mod process;
pub mod progress;
pub mod svg;
