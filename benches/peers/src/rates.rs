//! Same rays, all tracers, one thread: rates, ratios, and whether they agree.

use std::path::Path;

use crate::clock::{measure, median};
use crate::engine::{Engine, Found};
use crate::mesh::Mesh;
use crate::rays::{Rays, bounce, primary, shadow, trace_closest, trace_occluded};

/// What to compare and how often.
pub struct Settings {
    /// Edge length of the image.
    pub size: usize,
    pub repetitions: usize,
}

/// The three kinds of rays, by the names under which they are reported.
const KINDS: [&str; 3] = ["primary", "shadow", "bounce"];

/// Everything that one tracer answered.
struct Answers {
    primary: Vec<Found>,
    shadow: Vec<bool>,
    bounce: Vec<Found>,
}

/// Traces, times, compares and prints. The first of `engines` is the one that ratios and agreement refer to; its hits
/// also give the shadow and bounce rays.
pub fn run(model: &Path, mesh: &Mesh, engines: &mut [Box<dyn Engine + '_>], settings: &Settings) {
    let (primary_rays, _) = primary(settings.size);
    let first_hits = trace_closest(engines[0].as_mut(), &primary_rays);
    let sets = [
        ("primary", &primary_rays),
        ("shadow", &shadow(mesh, &primary_rays, &first_hits)),
        ("bounce", &bounce(mesh, &primary_rays, &first_hits)),
    ];
    let file = model.file_name().unwrap_or_default().to_string_lossy();
    println!(
        "{file}: {} triangles; {} x {} pixels; {} primary, {} shadow, {} bounce rays; median of {} \
         interleaved repetitions, CPU time of one thread",
        mesh.triangles.len(),
        settings.size,
        settings.size,
        sets[0].1.len(),
        sets[1].1.len(),
        sets[2].1.len(),
        settings.repetitions
    );

    // The first pass loads what is to be loaded and answers the question whether all agree.
    let mut counters: Vec<Vec<String>> = Vec::new();
    let answers: Vec<Answers> = engines
        .iter_mut()
        .map(|engine| {
            engine.take_counters();
            let mut taken = Vec::new();
            let primary = trace_closest(engine.as_mut(), sets[0].1);
            taken.extend(engine.take_counters());
            let shadow = trace_occluded(engine.as_mut(), sets[1].1);
            taken.extend(engine.take_counters());
            let bounce = trace_closest(engine.as_mut(), sets[2].1);
            taken.extend(engine.take_counters());
            counters.push(taken);
            Answers { primary, shadow, bounce }
        })
        .collect();

    // seconds[engine][kind][repetition]
    let mut seconds = vec![[const { Vec::new() }; 3]; engines.len()];
    for repetition in 0..settings.repetitions {
        for (kind, (_, rays)) in sets.iter().enumerate() {
            for place in 0..engines.len() {
                // Not always the same one first.
                let index = (place + repetition) % engines.len();
                let engine = engines[index].as_mut();
                let (mut found, mut blocked) = (vec![Found::NONE; rays.len()], vec![false; rays.len()]);
                seconds[index][kind].push(measure(|| once(engine, rays, kind, &mut found, &mut blocked)));
                // Answers must not depend on the repetition: a check on the tracer, and a use of what was computed.
                match kind {
                    0 => assert!(found == answers[index].primary, "{}", engine.name()),
                    1 => assert!(blocked == answers[index].shadow, "{}", engine.name()),
                    _ => assert!(found == answers[index].bounce, "{}", engine.name()),
                }
            }
        }
    }

    println!("\n| M rays/s (ratio to the first) | {} |", KINDS.join(" | "));
    println!("|---|---|---|---|");
    for (index, engine) in engines.iter().enumerate() {
        print!("| {} |", engine.name());
        for (kind, (_, rays)) in sets.iter().enumerate() {
            let own = &seconds[index][kind];
            let rate = rays.len() as f64 / median(own.iter().copied()) / 1e6;
            // Of times in the same repetition, so that a slow moment of the machine hits both.
            let ratio = median(own.iter().zip(&seconds[0][kind]).map(|(own, first)| first / own));
            print!(" {rate:.2} ({ratio:.2}) |");
        }
        println!();
    }

    println!(
        "\n| rays that differ from the first | primary: hit or miss, t, id only | shadow | bounce: hit or miss, t, id only |"
    );
    println!("|---|---|---|---|");
    for (engine, own) in engines.iter().zip(&answers) {
        let shadow = own.shadow.iter().zip(&answers[0].shadow).filter(|(a, b)| a != b).count();
        println!(
            "| {} | {} | {shadow} | {} |",
            engine.name(),
            differences(&own.primary, &answers[0].primary),
            differences(&own.bounce, &answers[0].bounce)
        );
    }
    for (engine, taken) in engines.iter().zip(&counters) {
        for (kind, text) in KINDS.iter().zip(taken) {
            println!("\n{} {kind}: {text}", engine.name());
        }
    }
}

fn once(engine: &mut dyn Engine, rays: &Rays, kind: usize, found: &mut [Found], blocked: &mut [bool]) {
    for range in rays.calls() {
        if kind == 1 {
            engine.occluded(rays, range.clone(), &mut blocked[range]);
        } else {
            engine.closest(rays, range.clone(), &mut found[range]);
        }
    }
}

/// How many answers differ, by how: one hits and the other misses; distances differ by more than f32 tracers err;
/// only the triangle differs (a shared edge, or surfaces that lie in each other).
fn differences(own: &[Found], first: &[Found]) -> String {
    let (mut hit, mut distance, mut triangle) = (0, 0, 0);
    for (own, first) in own.iter().zip(first) {
        if own.is_hit() != first.is_hit() {
            hit += 1;
        } else if own.is_hit() && (own.t - first.t).abs() > 1e-4 * first.t.abs().max(1e-2) {
            distance += 1;
        } else if own.triangle != first.triangle {
            triangle += 1;
        }
    }
    format!("{hit}, {distance}, {triangle}")
}
