//! What a cluster costs on this machine: `transports` measures the latency and bandwidth of each transport beside the disk's;
//! `pair` compares two real workers with two independent processes.

#[macro_use]
#[path = "../common/mod.rs"]
mod common;

mod pair;
mod transports;

use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;

use common::arguments::{self, Arguments};

const HELP: &str = "\
cluster_cost: what a cluster costs on this machine

    cluster_cost transports [--quick]       a table of latency and bandwidth by message size; every answer is checked. Built with
                                            --features mpi it starts itself by mpirun for the rows of MPI
    cluster_cost pair [OPTIONS]             two workers beside two processes that render half of the picture each; all pixels are compared
        --model FILE                        a compiled model (gears, made here)
        --size WxH                          512x512; one number for a square
        --spp N                             samples per pixel (4)
        --rounds N                          both ways in turn, so often (3)
";

fn main() -> ExitCode {
    arguments::run(run)
}

/// The command line.
pub struct Options {
    pub is_quick: bool,
    pub model: Option<PathBuf>,
    pub size: [u32; 2],
    pub samples_per_pixel: u32,
    pub rounds: u32,
    /// For processes that this one starts: the part to play, and the coordinator.
    pub part: Option<String>,
    pub connect: Option<String>,
}

fn run(mut arguments: Arguments) -> Result<ExitCode, Box<dyn Error>> {
    let mut options = Options {
        is_quick: false,
        model: None,
        size: [512; 2],
        samples_per_pixel: 4,
        rounds: 3,
        part: None,
        connect: None,
    };
    let mut what = None;
    while let Some(name) = arguments.option_or_model(&mut what)? {
        match name.as_str() {
            "-h" | "--help" => {
                print!("{HELP}");
                return Ok(ExitCode::SUCCESS);
            }
            "--quick" => options.is_quick = true,
            "--model" => options.model = Some(arguments.path()?),
            "--size" => options.size = arguments.size()?,
            "--spp" => options.samples_per_pixel = arguments.value()?,
            "--rounds" => options.rounds = arguments.value()?,
            "--part" => options.part = Some(arguments.text()?),
            "--connect" => options.connect = Some(arguments.text()?),
            _ => return Err(arguments.unknown()),
        }
    }
    match what.as_deref().and_then(|what| what.to_str()) {
        Some("transports") => transports::run(&options)?,
        Some("pair") => pair::run(&options)?,
        _ => return Err("say what: transports or pair; --help tells more".into()),
    }
    Ok(ExitCode::SUCCESS)
}
