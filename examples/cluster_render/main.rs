//! Makes one picture with many processes: coordinator, workers and readers over TCP, on this machine or on many.

#[path = "../common/mod.rs"]
mod common;
mod crew;
mod nodes;
mod options;
mod timeline;

use std::error::Error;
use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use common::arguments::{self, Arguments};
use options::Options;
use outcrop::transport::SharedKey;

fn main() -> ExitCode {
    arguments::run(run)
}

fn run(arguments: Arguments) -> Result<ExitCode, Box<dyn Error>> {
    let Some(options) = Options::parse(arguments)? else {
        print!("{}", options::HELP);
        return Ok(ExitCode::SUCCESS);
    };
    if let Some(path) = &options.new_key {
        write_key(path).map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        return Ok(ExitCode::SUCCESS);
    }
    nodes::run(&options)
}

/// A new key in a file that only its owner may read. Never over an existing file.
fn write_key(path: &Path) -> Result<(), Box<dyn Error>> {
    let mut open = OpenOptions::new();
    open.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut open, 0o600);
    writeln!(open.open(path)?, "{}", SharedKey::generate()?.to_hex())?;
    Ok(())
}
