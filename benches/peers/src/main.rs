//! Traces the same rays, and does the same whole jobs, with outcrop, with Embree 3 and with `obvhs`.
//!
//!     cargo run --release -- rates MODEL.ply [--rays 1024] [--repetitions 7] [--without obvhs]
//!     cargo run --release -- whole MODEL.ply [--repetitions 3]
//!     cargo run --release -- leaks [--rays 100000]
//!     cargo run --release -- hard-cases
//!     cargo run --release -- accuracy MODEL.ply [--repetitions 7]
//!     cargo run --release -- alone MODEL.ply COMPILED primary|shadow|bounce [fast] [--rays 1024] [--repetitions 7]

// Without Embree nothing is traced; the rest still has to compile.
#![cfg_attr(not(embree), allow(unused))]

#[cfg(embree)]
mod accuracy;
mod alone;
#[path = "../../../tests/hard_cases/cases.rs"]
#[allow(dead_code)]
mod cases;
mod clock;
#[cfg(embree)]
mod embree;
mod engine;
#[cfg(embree)]
mod hard_cases;
#[cfg(embree)]
mod leaks;
mod mesh;
#[path = "../../../tests/support/numbers.rs"]
mod numbers;
mod obvhs_engine;
#[path = "../../../tests/geom/oracle.rs"]
mod oracle;
mod outcrop_engine;
mod parry_engine;
mod picture;
mod rates;
mod rays;
#[path = "../../../tests/hard_cases/truth.rs"]
mod truth;
#[cfg(embree)]
mod whole;

use std::path::PathBuf;
use std::process::ExitCode;

use lexopt::prelude::*;

use engine::Engine;
use mesh::Mesh;
use outcrop::octree::{OctreeOptions, Tier, TreeQuality};
use outcrop::units::Bytes;

const USAGE: &str = "\
usage: outcrop-peers rates MODEL.ply [--rays EDGE] [--repetitions N] [--without NAME]
       outcrop-peers whole MODEL.ply [--repetitions N]
       outcrop-peers leaks [--rays N]
       outcrop-peers hard-cases
       outcrop-peers accuracy MODEL.ply [--repetitions N]
       outcrop-peers alone MODEL.ply COMPILED primary|shadow|bounce [fast] [--rays EDGE] [--repetitions N]";

#[cfg(not(embree))]
const NO_EMBREE: &str = "Embree 3 was not found when this program was built, and without it there is nothing to \
    compare with. On Debian and Ubuntu: apt-get install libembree-dev; elsewhere set EMBREE_LIB_DIR to the folder \
    of libembree3.so. Then build again.";

/// What the command line says.
struct Arguments {
    command: String,
    paths: Vec<PathBuf>,
    rays: Option<usize>,
    repetitions: Option<usize>,
    without: Vec<String>,
}

fn main() -> ExitCode {
    match arguments().and_then(|arguments| run(&arguments)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn arguments() -> Result<Arguments, String> {
    let mut arguments = Arguments {
        command: String::new(),
        paths: Vec::new(),
        rays: None,
        repetitions: None,
        without: Vec::new(),
    };
    let mut parser = lexopt::Parser::from_env();
    let text = |error: lexopt::Error| format!("{error}\n{USAGE}");
    while let Some(argument) = parser.next().map_err(text)? {
        match argument {
            Long("rays") => arguments.rays = Some(parser.value().and_then(|v| v.parse()).map_err(text)?),
            Long("repetitions") => {
                arguments.repetitions = Some(parser.value().and_then(|v| v.parse()).map_err(text)?);
            }
            Long("without") => arguments.without.push(parser.value().and_then(|v| v.string()).map_err(text)?),
            Value(command) if arguments.command.is_empty() => {
                arguments.command = command.string().map_err(text)?;
            }
            Value(path) => arguments.paths.push(path.into()),
            other => return Err(text(other.unexpected())),
        }
    }
    Ok(arguments)
}

#[cfg(not(embree))]
fn run(_: &Arguments) -> Result<(), String> {
    Err(NO_EMBREE.to_string())
}

#[cfg(embree)]
fn run(arguments: &Arguments) -> Result<(), String> {
    if let ("job", [name, model, output, compiled]) = (arguments.command.as_str(), arguments.paths.as_slice())
    {
        return whole::job(&name.to_string_lossy(), model, output, compiled);
    }
    if let ("alone", [model, compiled, kind, rest @ ..]) =
        (arguments.command.as_str(), arguments.paths.as_slice())
    {
        let tier = match rest {
            [] => Tier::Certified,
            [tier] if tier.as_os_str() == "fast" => Tier::Fast,
            _ => return Err(USAGE.to_string()),
        };
        let (size, repetitions) = (arguments.rays.unwrap_or(1024), arguments.repetitions.unwrap_or(7));
        return alone::run((model, compiled), &kind.to_string_lossy(), tier, size, repetitions.max(1));
    }
    println!("Embree {}", embree::Embree::version().ok_or("Embree does not start on this machine")?);
    match (arguments.command.as_str(), arguments.paths.as_slice()) {
        ("rates", [model]) => compare_rates(arguments, model),
        ("whole", [model]) => whole::run(model, arguments.repetitions.unwrap_or(3).max(1)),
        ("leaks", []) => leaks::run(arguments.rays.unwrap_or(100_000)),
        ("hard-cases", []) => hard_cases::run(),
        ("accuracy", [model]) => accuracy::run(model, arguments.repetitions.unwrap_or(7).max(1)),
        _ => Err(USAGE.to_string()),
    }
}

#[cfg(embree)]
fn compare_rates(arguments: &Arguments, model: &std::path::Path) -> Result<(), String> {
    use embree::{Embree, Mode};

    let mut mesh = Mesh::read(model).map_err(|error| error.to_string())?;
    Embree::pad(&mut mesh);
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    let compiled = folder.path().join("model.outcrop");
    let report = build("outcrop: compile", || outcrop_engine::compile(model, &compiled, Bytes::mib(512)))?;
    println!("outcrop: {} blocks, {:.2} bytes per triangle", report.blocks, report.bytes_per_triangle);
    // Room for every block.
    let open = |tier, quality| {
        let options = OctreeOptions { tier, quality, ..OctreeOptions::default() };
        outcrop_engine::open_with(&compiled, Bytes(16 << 30), options)
    };
    let certified = open(Tier::Certified, TreeQuality::Best)?;
    let finest = open(Tier::Certified, TreeQuality::Finest)?;
    let fast = open(Tier::Fast, TreeQuality::Best)?;
    let wanted = |name: &str| !arguments.without.iter().any(|without| name.contains(without.as_str()));
    let mut engines: Vec<Box<dyn Engine + '_>> = Vec::new();
    for mode in [
        Mode::DEFAULT,
        Mode::ROBUST,
        Mode::DEFAULT.in_packets("Embree default, packets of 8"),
        Mode::COMPACT_LOW,
    ] {
        // The first is what the others are compared with.
        if engines.is_empty() || wanted(mode.name) {
            engines.push(Box::new(build(mode.name, || Embree::new(&mesh, mode))?));
        }
    }
    if wanted("obvhs") {
        engines.push(Box::new(build("obvhs", || Ok(obvhs_engine::Obvhs::new(&mesh)))?));
    }
    for (name, octree) in [
        ("outcrop certified", &certified),
        ("outcrop certified, finest trees", &finest),
        ("outcrop fast", &fast),
    ] {
        engines.push(Box::new(outcrop_engine::Outcrop::new(name, octree)?));
    }
    let settings = rates::Settings {
        size: arguments.rays.unwrap_or(1024),
        repetitions: arguments.repetitions.unwrap_or(7).max(1),
    };
    rates::run(model, &mesh, &mut engines, &settings);
    Ok(())
}

/// Builds a tracer and says what that took.
#[cfg(embree)]
fn build<E>(name: &str, make: impl FnOnce() -> Result<E, String>) -> Result<E, String> {
    let mut made = Err(String::new());
    let seconds = clock::measure(|| made = make());
    println!("{name}: built in {seconds:.2} CPU s");
    made
}
