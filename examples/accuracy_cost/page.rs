//! The report as one page of HTML with plots; needs no network.

use std::error::Error;
use std::fmt::Write;
use std::path::Path;

use outcrop::accuracy::Metric;
use outcrop::accuracy::sweep::Measurement;

use crate::common::log_plot::{Series, log_plot};
use crate::common::svg::escape;
use crate::study::{Knob, Report};
use crate::table;

const STYLE: &str = "\
body { font: 15px/1.45 sans-serif; max-width: 1280px; margin: 2em auto; padding: 0 1em; color: #222 }
h1 { font-size: 1.6em } h2 { margin-top: 1.8em; font-size: 1.25em; border-bottom: 1px solid #ccc }
table { border-collapse: collapse; font-size: 13px; margin: .6em 0 }
th, td { padding: .25em .6em; text-align: right; border-bottom: 1px solid #e4e4e4 }
td { white-space: nowrap } th { vertical-align: bottom }
th { border-bottom: 1px solid #888 } th:first-child, td:first-child { text-align: left }
.plots { display: grid; grid-template-columns: 1fr 1fr; gap: 1em } svg { width: 100%; height: auto }
.pictures { display: grid; grid-template-columns: repeat(3, 1fr); gap: .5em; margin-bottom: 1.4em }
.pictures img { width: 100%; image-rendering: pixelated } figure { margin: 0 } figcaption { font-size: 13px; color: #555 }
.pictures h3 { grid-column: 1 / 4; margin: .4em 0 0; font-size: 1em }
pre { background: #f5f5f5; padding: .7em; font-size: 13px; white-space: pre-wrap }";

pub fn write(path: &Path, report: &Report) -> Result<(), Box<dyn Error>> {
    std::fs::write(path, page(report))
        .map_err(|error| format!("cannot write {}: {error}", path.display()).into())
}

fn page(report: &Report) -> String {
    let mut html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>What accuracy costs</title>\n<style>\n{STYLE}\n</style>\n\
         <h1>What accuracy costs in time</h1>\n\
         <p>Model: {}, {} triangles. Pictures of {} x {} pixels, {} threads; cost is their processor time together, all blocks in the cache \
         but for the first picture of each kind. Errors are against a reference of {} samples per pixel with a cut-off of {:e} in the \
         certified tier. RMSE and max are of linear radiance; FLIP is what an eye sees that flips between both pictures, 0 to 1.</p>\n",
        escape(&report.model),
        report.triangles,
        report.size,
        report.size,
        report.threads,
        report.reference_samples,
        report.reference_cut_off,
    );
    let mut add = |text: String| {
        html.push_str(&text);
        html.push('\n');
    };
    add("<h2>All knobs together</h2>".to_string());
    add("<p>Each dot is one combination of tier, samples or adaptive threshold, and cut-off. The line joins those that no other \
         beats: less error always costs more time.</p><div class=\"plots\">"
        .to_string());
    for metric in [Metric::Rmse, Metric::Flip] {
        add(pareto_plot(report, metric));
    }
    add("</div>".to_string());
    add("<h3>Settings that no other beats in RMSE</h3>".to_string());
    add(rows(&report.front, report.size, false));
    add("<h2>Seconds to halve the error</h2>".to_string());
    let mut halvings =
        "<table><tr><th>metric<th>error<th>CPU s for it<th>CPU s for half of it<th>times".to_string();
    for (metric, steps) in table::halvings(report) {
        for step in steps {
            let [from, to] = step.seconds;
            // Writing to a String cannot fail.
            let _ = write!(
                halvings,
                "\n<tr><td>{}<td>{:.4}<td>{from:.2}<td>{to:.2}<td>{:.2}",
                metric.name(),
                step.error,
                to / from
            );
        }
    }
    add(halvings + "\n</table>");
    add("<h2>One knob at a time</h2>".to_string());
    add("<p>\"Own error\" is against the picture in which this knob alone is at its best, with the same samples: what is due to the \
         knob and to nothing else. Where it is 0 the plot has no point.</p>"
        .to_string());
    for knob in &report.knobs {
        let own = if knob.base.is_empty() {
            String::new()
        } else {
            format!("<p>Own error: against {}.</p>", escape(knob.base))
        };
        add(format!("<h3>{}</h3>{own}<div class=\"plots\">", escape(knob.name)));
        add(knob_plot(knob, Metric::Rmse));
        add(knob_plot(knob, Metric::Flip));
        add("</div>".to_string());
        add(rows(&knob.rows, report.size, !knob.base.is_empty()));
    }
    add("<h2>What must not show</h2>".to_string());
    add(
        "<p>No bit of the picture depends on any of these; the study ends with an error if one does.</p><ul>"
            .to_string(),
    );
    for line in table::neutral(report) {
        add(format!("<li>{}</li>", escape(&line)));
    }
    add("</ul>".to_string());
    add("<h2>Differences</h2>".to_string());
    for pair in &report.images {
        let [picture, difference, flip] = &pair.files;
        let [rmse, max, seen] = pair.errors;
        add(format!(
            "<div class=\"pictures\"><h3>{}</h3>\
             <figure><img src=\"{picture}\" alt=\"picture\"><figcaption>picture</figcaption></figure>\
             <figure><img src=\"{difference}\" alt=\"difference\"><figcaption>difference times {}: RMSE {rmse:.2e}, max {max:.2e}</figcaption></figure>\
             <figure><img src=\"{flip}\" alt=\"FLIP\"><figcaption>FLIP, black 0 to pale 1: mean {seen:.4}</figcaption></figure></div>",
            escape(&pair.caption),
            pair.gain
        ));
    }
    add("<h2>The reference</h2>".to_string());
    add(format!(
        "<p>{:.0} CPU seconds. {} pixels at one sample each are those of the exact tier, bit for bit. Its certificate:</p><pre>{}</pre>",
        report.reference_seconds,
        report.exact_pixels,
        escape(&report.certificate.to_string())
    ));
    add("</html>".to_string());
    html
}

fn pareto_plot(report: &Report, metric: Metric) -> String {
    let of = |word: &str| -> Vec<([f64; 2], String)> {
        report
            .combinations
            .iter()
            .filter(|row| row.value.contains(word))
            .map(|row| ([row.seconds_median(), row.error(metric)], row.value.clone()))
            .collect()
    };
    let points: Vec<[f64; 2]> =
        report.combinations.iter().map(|row| [row.seconds_median(), row.error(metric)]).collect();
    let front = outcrop::accuracy::sweep::pareto_front(&points)
        .into_iter()
        .map(|index| (points[index], short(&report.combinations[index].value)))
        .collect();
    let series = [
        Series { name: "fixed samples".to_string(), points: of("samples"), joined: false },
        Series { name: "adaptive".to_string(), points: of("adaptive"), joined: false },
        Series { name: "front".to_string(), points: front, joined: true },
    ];
    log_plot(&format!("{} against time", metric.name()), "CPU seconds", metric.name(), &series)
}

/// "certified, 16 samples, cut-off 1e-2" as "16".
fn short(value: &str) -> String {
    let sampling = value.split(", ").nth(1).unwrap_or_default();
    sampling.replace(" samples", " spp").replace("adaptive ", "< ")
}

fn knob_plot(knob: &Knob, metric: Metric) -> String {
    let points = |of: &dyn Fn(&Measurement) -> f64, labelled: bool| {
        knob.rows
            .iter()
            .map(|row| {
                let label = row.value.split(", ").next().unwrap_or_default().to_string();
                ([row.seconds_median(), of(row)], if labelled { label } else { String::new() })
            })
            .collect()
    };
    let whole = Series {
        name: "whole error".to_string(),
        points: points(&|row| row.error(metric), knob.base.is_empty()),
        joined: true,
    };
    let mut series = vec![whole];
    if !knob.base.is_empty() {
        let own = points(&|row| row.isolated[metric as usize], true);
        series.push(Series { name: "own error".to_string(), points: own, joined: true });
    }
    log_plot(&format!("{}: {}", knob.name, metric.name()), "CPU seconds", metric.name(), &series)
}

fn rows(rows: &[Measurement], size: u32, with_own: bool) -> String {
    let pixels = f64::from(size) * f64::from(size);
    let own = if with_own { "<th>own RMSE<th>own max<th>own FLIP" } else { "" };
    let mut table = format!(
        "<table><tr><th>setting<th>CPU s<th>RMSE<th>max<th>FLIP{own}<th>wrong triangles<th>leaks<th>samples per pixel<th>M rays\
         <th>box tests per ray<th>exact per M rays<th>blocks read<th>KiB read"
    );
    for row in rows {
        let [low, high] = row.seconds_range();
        let spread = if row.seconds.len() > 1 { format!(" ({low:.2} to {high:.2})") } else { String::new() };
        let errors = |errors: [f64; 3]| {
            errors.map(|x| if x == 0.0 { "<td>0".to_string() } else { format!("<td>{x:.2e}") }).concat()
        };
        let own = if with_own { errors(row.isolated) } else { String::new() };
        let rays = row.effects.rays() as f64;
        // Writing to a String cannot fail.
        let _ = write!(
            table,
            "\n<tr><td>{}<td>{:.2}{spread}{}{own}<td>{}<td>{}<td>{:.1}<td>{:.2}<td>{:.1}<td>{:.1}<td>{}<td>{:.0}",
            escape(&row.value),
            row.seconds_median(),
            errors(row.errors),
            row.wrong_triangles,
            row.leaks,
            row.effects.samples as f64 / pixels,
            rays * 1e-6,
            row.trace.box_tests as f64 / rays,
            row.trace.exact_fallbacks as f64 / (rays * 1e-6),
            row.trace.blocks_loaded,
            row.trace.bytes_read as f64 / 1024.0
        );
    }
    table + "\n</table>"
}
