//! A plot with logarithmic axes as SVG.

use super::svg::{Drawing, escape};

/// Points of one kind.
pub struct Series {
    pub name: String,
    /// Of the axes' units, each with a label or none. Points at or below zero have no place and are left out.
    pub points: Vec<([f64; 2], String)>,
    /// Whether they are joined, in their order.
    pub joined: bool,
}

const SIZE: [f64; 2] = [560.0, 360.0];
/// Left, top, right, bottom.
const MARGIN: [f64; 4] = [76.0, 34.0, 20.0, 48.0];
/// Told apart also without colour vision (Okabe and Ito).
const COLOURS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#000000"];

/// Both axes are logarithmic and hold all points.
pub fn log_plot(title: &str, x_label: &str, y_label: &str, series: &[Series]) -> String {
    let has_place = |point: &[f64; 2]| point.iter().all(|x| *x > 0.0 && x.is_finite());
    let ends = [0, 1].map(|axis| {
        let values = || {
            series
                .iter()
                .flat_map(|series| &series.points)
                .map(|(point, _)| point)
                .filter(|p| has_place(p))
                .map(|p| p[axis])
        };
        let (low, high) = values().fold((f64::INFINITY, 0.0f64), |(low, high), x| (low.min(x), high.max(x)));
        if low.is_finite() { [low.log10() - 0.08, high.log10() + 0.12] } else { [0.0, 1.0] }
    });
    // An axis of less than a third of a decade has no ticks to speak of.
    let ends = ends.map(|[low, high]| {
        let lack = (0.5 - (high - low)).max(0.0);
        [low - 0.5 * lack, high + 0.5 * lack]
    });
    let [left, top, right, bottom] = MARGIN;
    let [width, height] = [SIZE[0] - left - right, SIZE[1] - top - bottom];
    let x = |value: f64| left + width * (value.log10() - ends[0][0]) / (ends[0][1] - ends[0][0]);
    let y = |value: f64| top + height * (1.0 - (value.log10() - ends[1][0]) / (ends[1][1] - ends[1][0]));

    let mut drawing = Drawing::new(SIZE, 11);
    drawing.text([left, 18.0], "font-size=\"14\"", title);
    for tick in ticks(ends[0]) {
        let at = x(tick);
        drawing.element(format_args!("<path d=\"M{at:.1} {top}V{:.1}\" stroke=\"#e4e4e4\"/>", top + height));
        drawing.text([at, top + height + 16.0], "text-anchor=\"middle\"", &number(tick));
    }
    for tick in ticks(ends[1]) {
        let at = y(tick);
        drawing.element(format_args!("<path d=\"M{left} {at:.1}H{:.1}\" stroke=\"#e4e4e4\"/>", left + width));
        drawing.text([left - 6.0, at + 4.0], "text-anchor=\"end\"", &number(tick));
    }
    drawing.axes([left, top], [width, height], x_label, bottom - 10.0);
    drawing.element(format_args!(
        "<text transform=\"translate(14 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        top + 0.5 * height,
        escape(y_label)
    ));
    let mut taken: Vec<[f64; 2]> = Vec::new();
    for (index, series) in series.iter().enumerate() {
        let colour = COLOURS[index % COLOURS.len()];
        let points: Vec<(f64, f64, &str)> = series
            .points
            .iter()
            .filter(|(point, _)| has_place(point))
            .map(|(point, label)| (x(point[0]), y(point[1]), label.as_str()))
            .collect();
        if series.joined {
            let line: Vec<String> = points.iter().map(|(x, y, _)| format!("{x:.1},{y:.1}")).collect();
            drawing.element(format_args!(
                "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>",
                line.join(" ")
            ));
        }
        for (x, y, label) in points {
            drawing.element(format_args!(
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.5\" fill=\"{colour}\" fill-opacity=\"0.75\"><title>{}</title></circle>",
                escape(label)
            ));
            // A label is left out where another stands; the point's title still tells it.
            let is_free =
                taken.iter().all(|other| (other[0] - x).abs() > 46.0 || (other[1] - y).abs() > 12.0);
            if series.joined && !label.is_empty() && is_free {
                taken.push([x, y]);
                let (anchor, shift) = if x > left + width - 60.0 { ("end", -6.0) } else { ("start", 6.0) };
                let style = format!("text-anchor=\"{anchor}\" fill=\"{colour}\"");
                drawing.text([x + shift, y - 5.0], &style, label);
            }
        }
    }
    // The legend stands above the plot, from the right, where no point can be.
    let mut right_end = left + width;
    for (index, series) in series.iter().enumerate().rev().filter(|(_, series)| !series.name.is_empty()) {
        right_end -= 6.2 * series.name.chars().count() as f64;
        drawing.element(format_args!(
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"4\" fill=\"{}\"/>",
            right_end - 9.0,
            top - 12.0,
            COLOURS[index % COLOURS.len()]
        ));
        drawing.text([right_end, top - 8.0], "", &series.name);
        right_end -= 26.0;
    }
    drawing.finish()
}

/// 1, 2 and 5 of each decade, or powers of ten only if that would be too many.
fn ticks([low, high]: [f64; 2]) -> Vec<f64> {
    let digits: &[f64] = if high - low > 2.5 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    (low.floor() as i32..=high.ceil() as i32)
        .flat_map(|power| digits.iter().map(move |digit| digit * 10f64.powi(power)))
        .filter(|tick| (low..=high).contains(&tick.log10()))
        .collect()
}

fn number(x: f64) -> String {
    if (0.001..1e4).contains(&x) { format!("{}", (x * 1e6).round() / 1e6) } else { format!("{x:.0e}") }
}
