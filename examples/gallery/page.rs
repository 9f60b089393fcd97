//! The page about the pictures.

use std::fmt::Write as _;

use outcrop::render::{PathEnd, RenderReport, RenderSettings};

use crate::costs::Comparison;
use crate::scenes::Entry;

#[derive(Default)]
pub struct Page {
    pictures: String,
    added: String,
    forced: String,
}

/// The plan of a picture, and its counters per sample.
pub fn plan(report: &RenderReport) -> String {
    let mut text = String::from("```text\n");
    // Writing to a String cannot fail.
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
    let _ = writeln!(
        text,
        "{:<20} {:>9} of {}, loaded {} times",
        "blocks touched", report.blocks_touched, report.blocks_total, report.trace.blocks_loaded
    );
    text.push_str("```\n\n");
    text
}

impl Page {
    /// A picture; `more` is what there is to say about its images.
    pub fn add(
        &mut self,
        entry: &Entry,
        file: &str,
        report: &RenderReport,
        settings: &RenderSettings,
        more: &str,
    ) {
        let text = &mut self.pictures;
        let end = match settings.path_end {
            PathEnd::Cut => format!("cut below {}", settings.contribution_bound),
            PathEnd::Roulette => format!("roulette below {}", settings.contribution_bound),
        };
        let _ = writeln!(text, "## {}\n\n![{}]({file})\n", entry.title, entry.title);
        let _ = writeln!(
            text,
            "{} triangles, {} x {} pixels, {} samples each, faint paths {end}.\n",
            entry.mesh.triangle_count(),
            report.width,
            report.height,
            report.samples_per_pixel
        );
        for note in [entry.note, more].into_iter().filter(|note| !note.is_empty()) {
            let _ = writeln!(text, "{note}\n");
        }
        text.push_str(&plan(report));
    }

    /// What an effect adds to its own scene, which is in `file`.
    pub fn add_cost(&mut self, name: &str, file: &str, costs: &Comparison) {
        let _ = writeln!(self.added, "| {} | [{name}]({file}) |{}", costs.what, cells(costs));
    }

    /// What it costs to force an effect.
    pub fn add_forced(&mut self, costs: &Comparison) {
        let _ = writeln!(self.forced, "| {} |{}", costs.what, cells(costs));
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
             [`scenes.rs`](../../examples/gallery/scenes.rs), [`surfaces.rs`](../../examples/gallery/surfaces.rs),\n\
             [`city.rs`](../../examples/gallery/city.rs) and [`instances.rs`](../../examples/gallery/instances.rs) of `examples/gallery`.\n\n",
        );
        if !self.added.is_empty() {
            text.push_str(
                "## What each effect adds to its own scene\n\n\
                 Without the effect and with it, at 96 x 72 pixels and 4 samples, in blocks of 4 KiB. Counts are exact, and per pixel but for blocks, which are distinct ones that rays\n\
                 entered; lookups are of attributes and in pictures. Time is CPU time with the effect over that without it: the median of seven pairs of runs of a tenth of a second or more on one thread\n\
                 with everything in memory, and the least and the greatest of them.\n\n",
            );
            head(&mut text, "| effect | scene |", "|---|---|");
            text.push_str(&self.added);
            text.push('\n');
        }
        if !self.forced.is_empty() {
            text.push_str(
                "## What it saves to leave an effect out\n\n\
                 The same, where an effect is forced that the scene does not call for: simulated, and multiplied by zero. The scene is [bricks](bricks.png), matt and in direct light; direct light and\n\
                 shadows, which that does call for, are forced on the same bricks in ambient light, by a black lamp that shines along none of the sides of the bricks. The picture is the same to the bit, or the example fails. Antialiasing has\n\
                 no work that could be multiplied by zero. Effects that go on from a surface are forced for one ray at each hit, so in scenes of their own they cost more than here.\n\n",
            );
            head(&mut text, "| forced |", "|---|");
            text.push_str(&self.forced);
            text.push('\n');
        }
        text.push_str(&self.pictures);
        while text.ends_with("\n\n") {
            text.pop();
        }
        text
    }
}

fn head(text: &mut String, names: &str, rule: &str) {
    let _ = writeln!(
        text,
        "{names} rays | box tests | triangle tests | blocks | lookups | random numbers | time |\n{rule}---|---|---|---|---|---|---|"
    );
}

fn cells(costs: &Comparison) -> String {
    let (less, more) = (&costs.without, &costs.with);
    let pair = |less: f64, more: f64, digits: usize| {
        let [less, more] = [less, more].map(|count| format!("{count:.digits$}"));
        if less == more { format!(" {less} |") } else { format!(" {less} to {more} |") }
    };
    let [least, median, greatest] = costs.time;
    [
        pair(less.rays, more.rays, 2),
        pair(less.box_tests, more.box_tests, 0),
        pair(less.triangle_tests, more.triangle_tests, 0),
        pair(less.blocks as f64, more.blocks as f64, 0),
        pair(less.lookups, more.lookups, 2),
        pair(less.random_numbers, more.random_numbers, 2),
        format!(" **{median:.2}** ({least:.2} to {greatest:.2}) |"),
    ]
    .concat()
}
