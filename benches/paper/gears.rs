//! Table 2: gears of growing size, whole jobs.

use std::error::Error;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

use outcrop::compile::{CompileOptions, Control, Threads, compile_file};
use outcrop::octree::OctreeOptions;
use outcrop::procedural::export::write_ply;
use outcrop::procedural::{Gears, Shape};
use outcrop::render::{RenderSettings, RenderedImage, Renderer};
use outcrop::scene::{Camera, Light, Scene};
use outcrop::source::DiskSource;
use outcrop::units::Bytes;
use outcrop::{LazyOctree, MemoryBudget};

use crate::memory;

/// Of the library, for compile and render.
const BUDGET: Bytes = Bytes::mib(64);

pub fn table_2(folder: &Path, largest: u32, size: u32) -> Result<(), Box<dyn Error>> {
    println!(
        "\nTable 2 (measured): gears, {size} x {size} pixels, five lights, shadows, reflection and refraction; one thread, budget {BUDGET}."
    );
    println!(
        "Parse: from a PLY file to the compiled file. Trace: the picture, from an empty cache. Peak: VmHWM of the process."
    );
    println!("The paper's figures for this table are not known here.\n");
    let pov = Command::new("povray").arg("--version").output().is_ok();
    if !pov {
        println!("(POV-Ray is not installed: no column for it.)\n");
    }
    println!(
        "| gears | triangles | parse s | trace s | full s | peak MiB |{}",
        if pov { " POV-Ray full s |" } else { "" }
    );
    println!("|---|---|---|---|---|---|{}", if pov { "---|" } else { "" });
    for n in 1..=largest {
        let gears = Gears::new(n)?;
        let (model, compiled) = (folder.join("gears.ply"), folder.join("gears.outcrop"));
        write_ply(&gears, &model, true)?;
        memory::forget_peak();
        let start = Instant::now();
        let budget = MemoryBudget::new(BUDGET);
        compile_file(&model, &compiled, &CompileOptions::default(), &budget, &mut |_| Control::Continue)?;
        let parse = start.elapsed().as_secs_f64();
        let source = Arc::new(DiskSource::open(&compiled)?);
        picture(source, &budget, Bytes::mib(24), size)?;
        let full = start.elapsed().as_secs_f64();
        let peak = memory::peak().map_or("-".to_string(), |peak| format!("{peak:.0}"));
        print!(
            "| {n} | {} | {parse:.2} | {:.2} | {full:.2} | {peak} |",
            gears.triangle_count(),
            full - parse
        );
        println!("{}", if pov { format!(" {} |", pov_ray(folder, &gears, size)?) } else { String::new() });
    }
    Ok(())
}

/// The standard view, on one thread from an empty cache: film and tables take up to `aside` of the budget, slots the rest.
pub fn picture(
    source: Arc<DiskSource>,
    budget: &MemoryBudget,
    aside: Bytes,
    size: u32,
) -> Result<RenderedImage, Box<dyn Error>> {
    let camera = Camera::pinhole(Gears::EYE, [0.0; 3], [0.0, 0.0, 1.0], 45.0)?;
    let scene = Scene::new(camera)
        .with_background([0.078, 0.361, 0.753])
        .with_lights(Gears::LAMPS.map(|position| Light::point(position, [0.35; 3])));
    let settings = RenderSettings::new(size, size);
    // Film and tables before the slots, which take the rest.
    let aside = budget.reserve(aside, "film")?;
    let octree = LazyOctree::open(source, budget, OctreeOptions::default())?;
    drop(aside);
    let renderer = Renderer::new(&octree, &scene, &settings, budget)?;
    Ok(renderer.render(&Threads::One, &mut |_| Control::Continue)?)
}

/// Seconds of POV-Ray's whole job on the same triangles, grey and lit by the same lamps.
fn pov_ray(folder: &Path, gears: &Gears, size: u32) -> Result<String, Box<dyn Error>> {
    use std::io::Write;
    let mut mesh = outcrop::import::MeshBuffer::new();
    gears.emit(&mut mesh)?;
    let path = folder.join("gears.pov");
    let mut file = std::io::BufWriter::new(std::fs::File::create(&path)?);
    let vector = |[x, y, z]: [f64; 3]| format!("<{x},{y},{z}>");
    writeln!(file, "#version 3.7; global_settings {{ assumed_gamma 1 }}")?;
    writeln!(file, "camera {{ location {} sky z up z right -x look_at 0 angle 45 }}", vector(Gears::EYE))?;
    for lamp in Gears::LAMPS {
        writeln!(file, "light_source {{ {} rgb 0.35 }}", vector(lamp))?;
    }
    writeln!(file, "mesh {{")?;
    for triangle in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(triangle).map(vector);
        writeln!(file, "triangle {{ {a},{b},{c} }}")?;
    }
    writeln!(file, "pigment {{ rgb 0.7 }} }}")?;
    drop(file);
    let start = Instant::now();
    let done = Command::new("povray")
        .arg(format!("+I{}", path.display()))
        .arg(format!("+O{}", folder.join("pov.png").display()))
        .args([format!("+W{size}"), format!("+H{size}"), "-D".to_string(), "+WT1".to_string()])
        .output()?;
    Ok(if done.status.success() {
        format!("{:.2}", start.elapsed().as_secs_f64())
    } else {
        "failed".to_string()
    })
}
