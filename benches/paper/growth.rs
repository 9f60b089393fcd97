//! Cost against size: the gears from 27 thousand triangles on, in the same memory.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use log_plot::{Series, log_plot};
use outcrop::MemoryBudget;
use outcrop::compile::{CompileOptions, Control, PrecisionChoice, compile_shape};
use outcrop::procedural::{Gears, Shape};
use outcrop::source::{BlockSource, DiskSource, PageCache};
use outcrop::units::Bytes;

use crate::gears::picture;
use crate::memory;
// What the plot draws with.
use crate::memory::svg;

#[path = "../../examples/common/log_plot.rs"]
mod log_plot;

/// Of the library, for compile and render of all sizes but the greatest.
const BUDGET: Bytes = Bytes::mib(160);
/// Of the greatest, whose directory alone takes more.
const BUDGET_HUGE: Bytes = Bytes::mib(900);

/// One size of the study.
struct Row {
    triangles: u64,
    compile_seconds: f64,
    picture_seconds: f64,
    peak_mib: Option<f64>,
}

/// Sizes 1, 2, 4 ... up to `largest`; `huge` adds a thousand million triangles. Writes the plot to `plot`, if there is one.
pub fn cost_against_size(
    folder: &Path,
    largest: u32,
    huge: bool,
    size: u32,
    plot: Option<PathBuf>,
) -> Result<(), Box<dyn Error>> {
    println!(
        "\nCost against size (measured): gears made in code, compiled and rendered with {size} x {size} pixels, five lights, shadows,"
    );
    println!(
        "reflection and refraction; one thread, processor time, budget {BUDGET} ({BUDGET_HUGE} for the thousand million), page cache bypassed."
    );
    println!("Peak: VmHWM of the process, compile and picture together.\n");
    println!(
        "| gears | triangles | compile CPU s | us per triangle | picture CPU s | blocks | touched | loaded | peak MiB |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let doubled = std::iter::successors(Some(1u32), |n| n.checked_mul(2)).take_while(|n| *n <= largest);
    let mut rows = Vec::new();
    for n in doubled.chain(huge.then_some(34)) {
        rows.push(one_size(folder, n, size)?);
    }
    if let Some(path) = plot {
        std::fs::write(&path, drawing(&rows))?;
    }
    Ok(())
}

fn one_size(folder: &Path, n: u32, size: u32) -> Result<Row, Box<dyn Error>> {
    let gears = Gears::new(n)?;
    let compiled = folder.join("grown.outcrop");
    memory::forget_peak();
    let budget = MemoryBudget::new(if n > 16 { BUDGET_HUGE } else { BUDGET });
    let start = cpu_seconds();
    // Their coordinates are f32: looking whether they are would take a second pass.
    let options = CompileOptions { precision: PrecisionChoice::Float32, ..CompileOptions::default() };
    compile_shape(&gears, &compiled, &options, &budget, &mut |_| Control::Continue)?;
    let compile_seconds = cpu_seconds() - start;

    let start = cpu_seconds();
    let source = Arc::new(DiskSource::open_with(&compiled, PageCache::Bypass)?);
    let blocks = source.model().blocks.len();
    let image = picture(source, &budget, Bytes::mib(48), size)?;
    let picture_seconds = cpu_seconds() - start;
    let pixels = image.film.pixels();
    let lit = pixels.iter().filter(|colour| colour.iter().any(|x| *x > 0.0)).count();
    assert!(lit > pixels.len() / 2, "the gears fill most of the picture");

    let row =
        Row { triangles: gears.triangle_count(), compile_seconds, picture_seconds, peak_mib: memory::peak() };
    println!(
        "| {n} | {} | {compile_seconds:.2} | {:.3} | {picture_seconds:.2} | {blocks} | {} | {} | {} |",
        row.triangles,
        compile_seconds * 1e6 / row.triangles as f64,
        image.report.blocks_touched,
        image.report.trace.blocks_loaded,
        row.peak_mib.map_or("-".to_string(), |peak| format!("{peak:.0}")),
    );
    Ok(row)
}

/// Processor time of this process so far; 0 where the system has no such clock.
fn cpu_seconds() -> f64 {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
    }
    #[cfg(not(unix))]
    0.0
}

/// Time and memory against triangles, in one plot.
fn drawing(rows: &[Row]) -> String {
    let series = |name: &str, value: &dyn Fn(&Row) -> Option<f64>| Series {
        name: name.to_string(),
        points: rows
            .iter()
            .filter_map(|row| value(row).map(|value| ([row.triangles as f64, value], String::new())))
            .collect(),
        joined: true,
    };
    let all = [
        series("compile, CPU s", &|row| Some(row.compile_seconds)),
        series("picture, CPU s", &|row| Some(row.picture_seconds)),
        series("peak, MiB", &|row| row.peak_mib),
    ];
    log_plot("Cost against size", "triangles", "CPU seconds; MiB", &all)
}
