//! A line plot as SVG, small enough to read.

use super::svg::Drawing;

/// One line of a plot.
pub struct Line {
    /// Its label.
    pub name: String,
    /// Points in the units of the axes, from left to right.
    pub points: Vec<[f64; 2]>,
}

const SIZE: [f64; 2] = [720.0, 360.0];
/// Left, top, right, bottom.
const MARGIN: [f64; 4] = [64.0, 36.0, 170.0, 44.0];
/// Told apart also without colour vision (Okabe and Ito).
const COLOURS: [&str; 5] = ["#000000", "#0072b2", "#d55e00", "#009e73", "#cc79a7"];

/// Both axes start at 0.
pub fn plot_svg(title: &str, x_label: &str, y_label: &str, lines: &[Line]) -> String {
    let end = |axis: usize| {
        let largest = lines.iter().flat_map(|line| &line.points).map(|point| point[axis]).fold(0.0, f64::max);
        if largest > 0.0 { largest } else { 1.0 }
    };
    let steps = [0, 1].map(|axis| round_step(end(axis) / 6.0));
    // The time axis ends with the data, the other one at a round number.
    let ends = [end(0), (end(1) / steps[1]).ceil() * steps[1]];
    let [left, top, right, bottom] = MARGIN;
    let [width, height] = [SIZE[0] - left - right, SIZE[1] - top - bottom];
    let x = |value: f64| left + width * value / ends[0];
    let y = |value: f64| top + height * (1.0 - value / ends[1]);

    let mut drawing = Drawing::new(SIZE, 12);
    drawing.text([left, 20.0], "font-size=\"15\"", title);
    for tick in ticks(steps[1], ends[1]) {
        let (x1, x2, at) = (left, left + width, y(tick));
        drawing.element(format_args!("<path d=\"M{x1:.1} {at:.1}H{x2:.1}\" stroke=\"#dddddd\"/>"));
        drawing.text([x1 - 6.0, at + 4.0], "text-anchor=\"end\"", &tick.to_string());
    }
    for tick in ticks(steps[0], ends[0]) {
        let (at, base) = (x(tick), top + height);
        drawing.element(format_args!("<path d=\"M{at:.1} {base:.1}v5\" stroke=\"black\"/>"));
        drawing.text([at, base + 18.0], "text-anchor=\"middle\"", &tick.to_string());
    }
    drawing.axes([left, top], [width, height], x_label, bottom - 8.0);
    drawing.text([8.0, top - 4.0], "", y_label);
    for (index, line) in lines.iter().enumerate() {
        let colour = COLOURS[index % COLOURS.len()];
        let points: Vec<String> =
            line.points.iter().map(|point| format!("{:.1},{:.1}", x(point[0]), y(point[1]))).collect();
        drawing.element(format_args!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>",
            points.join(" ")
        ));
        let at = [left + width + 12.0, top + 12.0 + 20.0 * index as f64];
        drawing.element(format_args!(
            "<path d=\"M{:.1} {:.1}h16\" stroke=\"{colour}\" stroke-width=\"2\"/>",
            at[0],
            at[1] - 4.0
        ));
        drawing.text([at[0] + 22.0, at[1]], "", &line.name);
    }
    drawing.finish()
}

/// The least of 1, 2, 5, 10 ... (and their tenths) that is at least `step`.
fn round_step(step: f64) -> f64 {
    let power = 10f64.powf(step.log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .map(|digit| digit * power)
        .into_iter()
        .find(|&round| round >= step)
        .unwrap_or(10.0 * power)
}

fn ticks(step: f64, end: f64) -> impl Iterator<Item = f64> {
    // Rounded, so that 3 x 0.1 prints as 0.3.
    (0..=(end / step + 1e-9) as u32).map(move |count| (f64::from(count) * step * 1e9).round() / 1e9)
}
