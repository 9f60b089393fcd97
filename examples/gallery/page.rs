//! The page about the pictures.

use std::fmt::Write as _;

use outcrop::render::{PathEnd, RenderReport, RenderSettings};
use outcrop::scene::Effect;

use crate::scenes::Entry;

/// One measured run.
#[derive(Clone, Copy, Default)]
pub struct Run {
    pub rays_per_sample: f64,
    pub seconds: f64,
}

/// What an effect costs in its scene.
pub struct Costs {
    pub effect: Effect,
    pub without: Run,
    pub planned: Run,
    pub forced: Run,
}

#[derive(Default)]
pub struct Page {
    pictures: String,
    rows: String,
}

impl Page {
    pub fn add(
        &mut self,
        entry: &Entry,
        file: &str,
        report: &RenderReport,
        settings: &RenderSettings,
        costs: Option<Costs>,
    ) {
        let text = &mut self.pictures;
        // Writing to a String cannot fail.
        let end = match settings.path_end {
            PathEnd::Cut => format!("cut below {}", settings.contribution_bound),
            PathEnd::Roulette => format!("roulette below {}", settings.contribution_bound),
        };
        let _ = writeln!(text, "## {}\n\n![{}]({file})\n", entry.title, entry.title);
        let _ = writeln!(
            text,
            "{} triangles, {} x {} pixels, {} samples each, faint paths {end}.\n\n```text",
            entry.mesh.triangle_count(),
            report.width,
            report.height,
            report.samples_per_pixel
        );
        for decision in report.plan.decisions().iter().filter(|decision| decision.needed) {
            let _ = writeln!(text, "{}: {}", decision.effect.name(), decision.reason);
        }
        let left_out: Vec<_> =
            report.plan.decisions().iter().filter(|d| !d.needed).map(|d| d.effect.name()).collect();
        let _ = writeln!(text, "not needed: {}\n", left_out.join(", "));
        let samples = report.effects.samples as f64;
        for (name, count) in report.effects.fields().into_iter().skip(1).filter(|(_, count)| *count > 0) {
            let _ = writeln!(text, "{name:<20} {:>9.3} per sample", count as f64 / samples);
        }
        let _ = writeln!(text, "```\n");
        if let Some(costs) = costs {
            let (base, planned, forced) = (costs.without, costs.planned, costs.forced);
            let _ = writeln!(
                self.rows,
                "| {} | [{}]({file}) | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} |",
                costs.effect.name(),
                entry.name,
                base.rays_per_sample,
                planned.rays_per_sample,
                forced.rays_per_sample,
                planned.seconds / base.seconds,
                forced.seconds / planned.seconds
            );
        }
    }

    /// What there is about the pictures.
    pub fn part(&self) -> &str {
        &self.pictures
    }

    /// Where what follows the pictures is written.
    pub fn more(&mut self) -> &mut String {
        &mut self.pictures
    }

    pub fn text(&self) -> String {
        let mut text = String::from(
            "# Gallery\n\n\
             Made by `cargo run --release --example gallery`, pictures, plans and figures alike. Each scene is built in code in\n\
             [`examples/gallery/scenes.rs`](../../examples/gallery/scenes.rs), [`surfaces.rs`](../../examples/gallery/surfaces.rs) and\n\
             [`instances.rs`](../../examples/gallery/instances.rs).\n\n",
        );
        if !self.rows.is_empty() {
            text.push_str(
                "## What each effect costs\n\n\
                 In its own scene, at 64 x 48 pixels and 4 samples: rays per sample without the effect, with it, and with every\n\
                 effect forced, that is traced and multiplied by zero; CPU time with the effect over without it, and with everything\n\
                 forced over the plan's. The best of three interleaved runs on one thread. The picture with everything forced is the\n\
                 same to the bit, or the example fails. Rays are exact. The runs take a tenth of a second or a few, so\n\
                 time ratios near 1 are no better than a quarter either way.\n\n\
                 | effect | scene | rays without | rays with | rays forced | time with / without | time forced / with |\n\
                 |---|---|---|---|---|---|---|\n",
            );
            text.push_str(&self.rows);
            text.push('\n');
        }
        text.push_str(&self.pictures);
        while text.ends_with("\n\n") {
            text.pop();
        }
        text
    }
}
