//! What was found, as CSV and as tables of text.

use std::error::Error;
use std::fmt::Write;
use std::path::Path;

use outcrop::accuracy::Metric;
use outcrop::accuracy::sweep::{Halving, halving_costs, pareto_front};

use crate::study::Report;

pub fn write_csv(path: &Path, report: &Report) -> Result<(), Box<dyn Error>> {
    let mut text = "knob,value,rmse,max,flip,own_rmse,own_max,own_flip,wrong_triangles,leaks,cpu_seconds,cpu_low,cpu_high,repetitions,\
                    samples,rays,box_tests,triangle_tests,decisions,exact_fallbacks,block_visits,blocks_loaded,bytes_read,\
                    contribution_cuts,work_cuts\n"
        .to_string();
    let knobs = report.knobs.iter().flat_map(|knob| &knob.rows);
    for row in knobs.chain(&report.combinations).chain(&report.front) {
        let [a, b, c] = row.errors;
        let [d, e, f] = row.isolated;
        let [low, high] = row.seconds_range();
        let (effects, trace) = (&row.effects, &row.trace);
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{},\"{}\",{a:.6e},{b:.6e},{c:.6e},{d:.6e},{e:.6e},{f:.6e},{},{},{:.4},{low:.4},{high:.4},{},{},{},{},{},{},{},{},{},{},{},{}",
            row.knob,
            row.value,
            row.wrong_triangles,
            row.leaks,
            row.seconds_median(),
            row.seconds.len(),
            effects.samples,
            effects.rays(),
            trace.box_tests,
            trace.triangle_tests,
            trace.decisions,
            trace.exact_fallbacks,
            trace.block_visits,
            trace.blocks_loaded,
            trace.bytes_read,
            effects.contribution_cuts,
            effects.work_cuts,
        );
    }
    std::fs::write(path, text).map_err(|error| format!("cannot write {}: {error}", path.display()).into())
}

/// Tables for a terminal and for documents.
pub fn summary(report: &Report) -> String {
    let mut text = String::new();
    let pixels = f64::from(report.size) * f64::from(report.size);
    let mut line = |line: String| {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{line}");
    };
    line("Settings that no other beats, from the cheapest:\n".to_string());
    line("| settings | CPU s | RMSE | max | FLIP | samples per pixel | M rays |".to_string());
    line("|---|---|---|---|---|---|---|".to_string());
    for row in &report.front {
        let [rmse, max, flip] = row.errors;
        line(format!(
            "| {} | {:.2} | {rmse:.4} | {max:.3} | {flip:.4} | {:.1} | {:.2} |",
            row.value,
            row.seconds_median(),
            row.effects.samples as f64 / pixels,
            row.effects.rays() as f64 * 1e-6
        ));
    }
    line("\nSeconds to halve the error along them:\n".to_string());
    line("| metric | error | CPU s for it | CPU s for half of it | times |".to_string());
    line("|---|---|---|---|---|".to_string());
    for (metric, steps) in halvings(report) {
        for step in steps {
            let [from, to] = step.seconds;
            line(format!(
                "| {} | {:.4} | {from:.2} | {to:.2} | {:.2} |",
                metric.name(),
                step.error,
                to / from
            ));
        }
    }
    line(format!(
        "\nReference: {} samples per pixel, {:.0} CPU s, its own RMSE about {:.1e}. {} pixels are the exact tier's, bit for bit.",
        report.reference_samples,
        report.reference_seconds,
        report.certificate.estimate(Metric::Rmse).map_or(f64::NAN, |estimate| estimate.value),
        report.exact_pixels
    ));
    line(format!("No bit of the picture depends on: {}.", neutral(report).join("; ")));
    text
}

/// For RMSE and FLIP, what each halving costs along the front of that metric over all combinations.
pub fn halvings(report: &Report) -> Vec<(Metric, Vec<Halving>)> {
    [Metric::Rmse, Metric::Flip]
        .into_iter()
        .map(|metric| {
            let points: Vec<[f64; 2]> =
                report.combinations.iter().map(|row| [row.seconds_median(), row.error(metric)]).collect();
            let front: Vec<[f64; 2]> = pareto_front(&points).into_iter().map(|index| points[index]).collect();
            (metric, halving_costs(&front))
        })
        .collect()
}

/// What must not show, and by which values it was tried.
pub fn neutral(report: &Report) -> Vec<String> {
    let mut groups: Vec<(&str, Vec<&str>)> = Vec::new();
    for (what, value) in &report.neutral {
        match groups.last_mut().filter(|(last, _)| last == what) {
            Some((_, values)) => values.push(value),
            None => groups.push((what, vec![value])),
        }
    }
    groups.into_iter().map(|(what, values)| format!("{what} ({})", values.join(", "))).collect()
}
