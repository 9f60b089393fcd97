//! Writes the procedural gears at any size, so that big model files can be made without downloads.

#[macro_use]
mod common;

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use common::arguments::{self, Arguments};
use outcrop::procedural::export::{write_obj, write_ply};
use outcrop::procedural::{Gears, Shape, Tessellation};

const HELP: &str = "\
gears: writes n x n x n meshing wheels above a mirror as a model file

    cargo run --release --example gears -- --n 8 -o gears8.ply

    --n N               wheels per edge (1): 27,552 triangles for 1, 1,757,280 for 4, 14,057,568 for 8
    --tessellation T    triangles per coarse one (48): a square or three times a square
    --materials         PLY only: materials in a .mtl beside it and an index per face
    -o, --output FILE   .ply (binary) or .obj (with .mtl beside it); gearsN.ply if not given
";

fn main() -> ExitCode {
    arguments::run(gears)
}

fn gears(mut arguments: Arguments) -> Result<ExitCode, Box<dyn Error>> {
    let (mut n, mut tessellation, mut materials, mut output) = (1, Tessellation::STANDARD, false, None);
    while let Some(name) = arguments.option()? {
        match name.as_str() {
            "--n" => n = arguments.value()?,
            "--tessellation" => tessellation = Tessellation::new(arguments.value()?)?,
            "--materials" => materials = true,
            "-o" | "--output" => output = Some(arguments.path()?),
            "-h" | "--help" => {
                print!("{HELP}");
                return Ok(ExitCode::SUCCESS);
            }
            _ => return Err(arguments.unknown()),
        }
    }
    let shape = Gears::with_tessellation(n, tessellation)?;
    let output = output.unwrap_or_else(|| PathBuf::from(format!("gears{n}.ply")));
    let start = Instant::now();
    write(&shape, &output, materials)?;
    println!(
        "{}: {} triangles, {} vertices, {} bytes in {:.1} s",
        output.display(),
        shape.triangle_count(),
        shape.vertex_count(),
        std::fs::metadata(&output)?.len(),
        start.elapsed().as_secs_f64()
    );
    Ok(ExitCode::SUCCESS)
}

fn write(shape: &Gears, output: &Path, materials: bool) -> Result<(), Box<dyn Error>> {
    match output.extension().and_then(|extension| extension.to_str()) {
        Some("ply") => write_ply(shape, output, materials)?,
        Some("obj") => write_obj(shape, output)?,
        _ => return Err(format!("{}: write to a .ply or .obj file", output.display()).into()),
    }
    Ok(())
}
