//! Renders small scenes in code, one for each effect and some with several, and writes a page about what each costs.

#[macro_use]
#[path = "../common/mod.rs"]
mod common;

mod city;
mod costs;
mod instances;
mod mesh;
mod page;
mod scenes;
mod surfaces;

use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use common::arguments::{self, Arguments};
use instances::Making;
use outcrop::octree::OctreeOptions;
use outcrop::render::{Control, Film, PathEnd, RenderSettings, Renderer, Threads};
use outcrop::units::Bytes;
use outcrop::{LazyOctree, MemoryBudget};
use page::Page;
use scenes::Entry;

const HELP: &str = "\
gallery: renders one small scene per effect, and says what each effect costs

    cargo run --release --example gallery -- [OPTION]...

    -o, --output FOLDER   where pictures and README.md go (docs/gallery)
    --only NAME           one picture; its part of the page goes to standard output
    --size WxH            of the pictures (240x180)
    --quick               tiny pictures and no measurement: shows that everything works
    --threads N           for the pictures (2); costs are measured on one
";

struct Options {
    output: PathBuf,
    only: Option<String>,
    size: [u32; 2],
    quick: bool,
    threads: usize,
}

impl Options {
    /// Whether costs are measured.
    fn measures(&self) -> bool {
        !self.quick && self.only.is_none()
    }
}

fn main() -> ExitCode {
    arguments::run(run)
}

fn run(mut arguments: Arguments) -> Result<ExitCode, Box<dyn Error>> {
    let mut options = Options {
        output: PathBuf::from("docs/gallery"),
        only: None,
        size: [240, 180],
        quick: false,
        threads: 2,
    };
    while let Some(name) = arguments.option()? {
        match name.as_str() {
            "-o" | "--output" => options.output = arguments.path()?,
            "--only" => options.only = Some(arguments.text()?),
            "--size" => options.size = arguments.size()?,
            "--quick" => options.quick = true,
            "--threads" => options.threads = arguments.value()?,
            "-h" | "--help" => {
                print!("{HELP}");
                return Ok(ExitCode::SUCCESS);
            }
            _ => return Err(arguments.unknown()),
        }
    }
    if options.threads == 0 {
        return Err("--threads 0: at least one is needed".into());
    }
    let budget = MemoryBudget::new(Bytes::mib(256));
    let entries = scenes::all(&budget, options.quick)?;
    let pictures: [(&str, Picture); 2] =
        [("instances", instances::forest), ("moving-instances", instances::moving)];
    if let Some(only) = &options.only {
        let names = entries.iter().map(|entry| entry.name).chain(pictures.map(|(name, _)| name));
        refuse_unknown(only, &names.collect::<Vec<_>>())?;
    }
    std::fs::create_dir_all(&options.output)
        .map_err(|error| format!("cannot make the folder {}: {error}", options.output.display()))?;
    let mut page = Page::default();
    for entry in entries {
        if options.only.as_ref().is_some_and(|only| only != entry.name) {
            continue;
        }
        make(&options, entry, &budget, &mut page)?;
    }
    if options.measures() {
        for costs in costs::forced(&budget)? {
            println!("forced {}: {:.2} of the time", costs.what, costs.time[1]);
            page.add_forced(&costs);
        }
    }
    let making = Making {
        folder: &options.output,
        size: if options.quick { [32, 24] } else { options.size },
        quick: options.quick,
        threads: options.threads,
        budget: &budget,
    };
    for (name, picture) in pictures {
        if options.only.as_ref().is_none_or(|only| only == name) {
            picture(&making, page.more())?;
        }
    }
    match options.only {
        None => std::fs::write(options.output.join("README.md"), page.text())?,
        Some(_) => print!("{}", page.part()),
    }
    Ok(ExitCode::SUCCESS)
}

/// Refuses the name of a picture that there is not.
fn refuse_unknown(only: &str, names: &[&str]) -> Result<(), String> {
    match names.contains(&only) {
        true => Ok(()),
        false => Err(format!("--only {only}: there is no such picture; there are {}", names.join(", "))),
    }
}

/// Makes pictures that are not of one mesh, and writes about them.
type Picture = fn(&Making<'_>, &mut String) -> Result<(), Box<dyn Error>>;

fn make(
    options: &Options,
    entry: Entry,
    budget: &MemoryBudget,
    page: &mut Page,
) -> Result<(), Box<dyn Error>> {
    let source = Arc::new(entry.mesh.compile()?);
    let octree_options =
        OctreeOptions { tracers_max: options.threads as u32, slots_max: Some(512), ..Default::default() };
    let octree = LazyOctree::open(source, budget, octree_options)?;
    let [width, height] = if options.quick { [32, 24] } else { options.size };
    let settings = RenderSettings {
        samples_per_pixel: if options.quick { 2 } else { entry.samples_per_pixel },
        path_end: PathEnd::Roulette,
        contribution_bound: 0.05,
        ..RenderSettings::new(width, height)
    };
    // Scenes without luck keep their exact cut.
    let settings = if is_lucky(&octree, &entry, &settings, budget)? {
        settings
    } else {
        RenderSettings { path_end: PathEnd::Cut, contribution_bound: 1e-3, ..settings }
    };
    let settings = RenderSettings {
        detail_bytes: entry.detail_bytes.map_or(settings.detail_bytes, |bytes| bytes.0),
        ..settings
    };
    let renderer = Renderer::new(&octree, &entry.scene, &settings, budget)?;
    let image = renderer.render(&Threads::Count(options.threads), &mut |_| Control::Continue)?;
    let plan = &image.report.plan;
    if let Some(effect) = entry.excluded.iter().find(|effect| plan.has(**effect)) {
        return Err(format!("{}: {} is in the plan, and may not be", entry.name, effect.name()).into());
    }
    let tiles = match (entry.detail_bytes, renderer.texture_stats()) {
        (Some(_), Some(stats)) => {
            let loads = stats.misses;
            tiles(&octree, &entry, &settings, loads, &image.film, budget)?
        }
        _ => String::new(),
    };
    let file = format!("{}.png", entry.name);
    image.film.write(options.output.join(&file))?;
    println!(
        "{}: {} rays in {:.1} s",
        options.output.join(&file).display(),
        image.report.effects.rays(),
        image.report.wall_seconds
    );
    page.add(&entry, &file, &image.report, &settings, &tiles);
    if options.measures() {
        for effect in entry.effects {
            let costs = costs::added(&entry, &settings, *effect, budget)?;
            println!("{}: {:.2} of the time without it", costs.what, costs.time[1]);
            page.add_cost(entry.name, &file, &costs);
        }
    }
    Ok(())
}

/// Makes the picture again with room for all tiles of its images, and says how many they are and how often they were loaded.
fn tiles(
    octree: &LazyOctree,
    entry: &Entry,
    settings: &RenderSettings,
    loads: u64,
    film: &Film,
    budget: &MemoryBudget,
) -> Result<String, Box<dyn Error>> {
    let roomy = RenderSettings { detail_bytes: RenderSettings::new(1, 1).detail_bytes, ..*settings };
    let renderer = Renderer::new(octree, &entry.scene, &roomy, budget)?;
    let image = renderer.render(&Threads::One, &mut |_| Control::Continue)?;
    if image.film.pixels() != film.pixels() {
        return Err(format!("{}: the memory of textures shows", entry.name).into());
    }
    let touched = renderer.texture_stats().map_or(0, |stats| stats.misses);
    let mib = |tiles: u64| (tiles * 16) as f64 / 1024.0;
    let all = entry.scene.textures().map_or(0, |textures| u64::from(textures.tile_count()));
    Ok(format!(
        "{all} tiles are {:.0} MiB, of which the picture looks at {touched}, {:.1} MiB. With {:.1} MiB for attributes and tiles together it loads tiles \
         {loads} times.",
        mib(all),
        mib(touched),
        settings.detail_bytes as f64 / (1u64 << 20) as f64
    ))
}

/// Whether the scene calls for an effect that draws random numbers.
fn is_lucky(
    octree: &LazyOctree,
    entry: &Entry,
    settings: &RenderSettings,
    budget: &MemoryBudget,
) -> Result<bool, Box<dyn Error>> {
    Ok(Renderer::new(octree, &entry.scene, settings, budget)?.plan().has_sampled_effects())
}
