//! Measures every knob that trades error for time on one model, and writes what it finds as CSV, as a page and as pictures.

#[macro_use]
#[path = "../common/mod.rs"]
mod common;

mod images;
mod model;
mod page;
mod study;
mod table;

use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;

use common::arguments::{self, Arguments};
use common::interrupt::Interrupt;
use common::progress::Meter;

const HELP: &str = "\
accuracy_cost: what accuracy costs in time

    cargo run --release --example accuracy_cost -- [MODEL] [OPTION]...

Without MODEL: gears above a mirror, a stack of glass, and a sphere 100,000 units away. MODEL is an OBJ, PLY or STL file. Each knob
is turned alone and then together with others, and every picture is held against a reference. Into the folder go accuracy.csv,
index.html with plots (needs no network) and pictures of the differences.

    --out FOLDER        where the report goes (report)
    --size N            pixels per side (256)
    --reference N       samples per pixel of the reference (1024)
    --reference-cut-off C   contribution bound of the reference (1e-9)
    --repetitions N     times each picture is made (3; combinations once)
    --threads N         threads, up to 8 (2); cost is their processor time together
    --quick             all small: shows that it works, not what it costs
";

/// What the command line asks for.
pub struct Options {
    pub model: Option<PathBuf>,
    pub out: PathBuf,
    pub size: u32,
    pub reference_samples: u32,
    pub reference_cut_off: f64,
    pub repetitions: u32,
    pub threads: usize,
    pub quick: bool,
}

fn main() -> ExitCode {
    arguments::run(accuracy_cost)
}

fn accuracy_cost(mut arguments: Arguments) -> Result<ExitCode, Box<dyn Error>> {
    let mut options = Options {
        model: None,
        out: PathBuf::from("report"),
        size: 256,
        reference_samples: 1024,
        reference_cut_off: 1e-9,
        repetitions: 3,
        threads: 2,
        quick: false,
    };
    while let Some(name) = arguments.option_or_model(&mut options.model)? {
        match name.as_str() {
            "--out" => options.out = arguments.path()?,
            "--size" => options.size = arguments.value()?,
            "--reference" => options.reference_samples = arguments.value()?,
            "--reference-cut-off" => options.reference_cut_off = arguments.value()?,
            "--repetitions" => options.repetitions = arguments.value()?,
            "--threads" => options.threads = arguments.value()?,
            "--quick" => {
                options.quick = true;
                (options.size, options.reference_samples, options.repetitions) = (48, 64, 1);
            }
            "-h" | "--help" => {
                print!("{HELP}");
                return Ok(ExitCode::SUCCESS);
            }
            _ => return Err(arguments.unknown()),
        }
    }
    if !(1..=model::TRACERS_MAX as usize).contains(&options.threads) {
        return Err(
            format!("--threads: between 1 and {}, not {}", model::TRACERS_MAX, options.threads).into()
        );
    }
    if options.repetitions == 0 {
        return Err("--repetitions 0: at least one is needed".into());
    }
    std::fs::create_dir_all(&options.out)
        .map_err(|error| format!("cannot make {}: {error}", options.out.display()))?;
    let interrupt = Interrupt::install()?;
    let mut meter = Meter::new();
    let report = study::run(&options, &interrupt, &mut meter);
    meter.finish();
    if interrupt.is_requested() {
        return Ok(ExitCode::from(Interrupt::EXIT_CODE));
    }
    let report = report?;
    table::write_csv(&options.out.join("accuracy.csv"), &report)?;
    page::write(&options.out.join("index.html"), &report)?;
    print!("{}", table::summary(&report));
    println!("report: {}", options.out.join("index.html").display());
    Ok(ExitCode::SUCCESS)
}
