//! Tables of "Rendering complex scenes on clusters with limited precomputation" (Cadet, Zambal, Lecussan 2004), in the
//! paper's form, with today's library, beside those of the paper's figures that are known here.
//!
//!     cargo bench --bench paper -- [--table N,...] [--n WHEELS] [--size PIXELS] [--gears N] [--copies N] [--memory FILE.csv]
//!         [--largest N] [--huge] [--plot FILE.svg]
//!
//! Tables 1 to 5, `6`: the paper's two experiments with its cache, and `7`: cost against size. Small by default: `--gears 8` (Table
//! 2 up to 14 M triangles) and `--copies 9` (Tables 3 and 5 with 83.7 M) are the paper's sizes; `--largest 16` takes cost against
//! size to 112 million triangles and `--huge` to a thousand million, `--plot` draws it. `--memory` writes Figure 4, memory while
//! Table 3 renders, and a plot beside it. What is measured and what is simulated stands above each table.

mod big;
mod cache;
#[path = "../loads/drive.rs"]
mod drive;
mod efficiency;
mod gears;
mod growth;
mod memory;
#[path = "../loads/mixes.rs"]
mod mixes;
#[path = "../support/paths.rs"]
mod paths;
#[path = "../support/plain_scheduler.rs"]
mod plain_scheduler;
mod readers;
#[path = "../support/scenes.rs"]
mod scenes;

use std::error::Error;
use std::path::PathBuf;

use big::Big;
use paths::rays;

fn main() -> Result<(), Box<dyn Error>> {
    let (mut n, mut size, mut gears, mut copies) = (3, 512, 3, 2);
    let (mut tables, mut memory) = (vec![1, 2, 3, 4, 5, 6, 7], None);
    let (mut largest, mut huge, mut plot) = (2, false, None);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument}: a value is missing"));
        match argument.as_str() {
            "--bench" => {}
            // Only to see that it runs.
            "--test" => (n, size, gears, copies, largest) = (1, 64, 1, 1, 1),
            "--n" => n = value()?.parse()?,
            "--size" => size = value()?.parse()?,
            "--gears" => gears = value()?.parse()?,
            "--copies" => copies = value()?.parse()?,
            "--largest" => largest = value()?.parse()?,
            "--huge" => huge = true,
            "--plot" => plot = Some(PathBuf::from(value()?)),
            "--memory" => memory = Some(PathBuf::from(value()?)),
            "--table" => {
                tables = value()?.split(',').map(str::parse).collect::<Result<_, _>>()?;
            }
            // A filter of another benchmark's names, as `cargo bench NAME` passes it to all.
            _ => return Ok(()),
        }
    }
    // The Z curve through a picture takes a power of two.
    let side = u32::next_power_of_two(size);
    let folder = tempfile::tempdir()?;
    let wants = |table| tables.contains(&table);
    if wants(1) {
        readers::table_1(folder.path(), n.min(2), side / 4)?;
    }
    if wants(2) {
        gears::table_2(folder.path(), gears, size)?;
    }
    if wants(3) || wants(5) {
        let big = Big::compile(folder.path(), copies)?;
        if wants(3) {
            big::table_3(&big, side, memory)?;
        }
        if wants(5) {
            efficiency::table_5(&big, size)?;
        }
    }
    if wants(4) {
        println!();
        efficiency::tables_4(n, size)?;
    }
    if wants(6) {
        cache::experiments(folder.path(), n, side)?;
    }
    if wants(7) {
        growth::cost_against_size(folder.path(), largest, huge, size, plot)?;
    }
    Ok(())
}
