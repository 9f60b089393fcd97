//! Who rendered when, as SVG: one row for each lane.

use std::fmt::Write;

use outcrop::cluster::{LaneInfo, Span, map_colour};

const LEFT: f64 = 150.0;
const WIDTH: f64 = 720.0;
const ROW: f64 = 22.0;

pub fn timeline_svg(lanes: &[LaneInfo], spans: &[Span]) -> String {
    let end = spans.iter().map(|span| span.end.as_secs_f64()).fold(0.001, f64::max);
    let x = |seconds: f64| LEFT + WIDTH * seconds / end;
    let height = 60.0 + ROW * lanes.len() as f64;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {height}\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"{LEFT}\" y=\"18\" font-size=\"15\">Who rendered when</text>\n",
        LEFT + WIDTH + 20.0
    );
    let mut names: Vec<&str> = Vec::new();
    for (row, lane) in lanes.iter().enumerate() {
        let index = names.iter().position(|name| *name == &*lane.worker).unwrap_or_else(|| {
            names.push(&lane.worker);
            names.len() - 1
        });
        // As in the map.
        let [r, g, b] = map_colour(index).map(|channel| (255.0 * channel.sqrt()).round() as u8);
        let y = 30.0 + ROW * row as f64;
        let name = lane.worker.replace('&', "&amp;").replace('<', "&lt;");
        let name =
            if lanes.iter().any(|other| other.lane > 0) { format!("{name}.{}", lane.lane) } else { name };
        // Writing to a String cannot fail.
        let _ =
            writeln!(svg, "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{name}</text>", LEFT - 8.0, y + 14.0);
        for span in spans.iter().filter(|span| span.lane as usize == row) {
            let (start, end) = (x(span.start.as_secs_f64()), x(span.end.as_secs_f64()));
            let _ = writeln!(
                svg,
                "<rect x=\"{start:.2}\" y=\"{y:.1}\" width=\"{:.2}\" height=\"{}\" fill=\"rgb({r},{g},{b})\" stroke=\"white\" stroke-width=\"0.3\"/>",
                (end - start).max(0.1),
                ROW - 4.0
            );
        }
    }
    let base = 34.0 + ROW * lanes.len() as f64;
    for tick in 0..=6 {
        let seconds = end * f64::from(tick) / 6.0;
        let _ = writeln!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{seconds:.2} s</text>",
            x(seconds),
            base + 14.0
        );
    }
    svg + "</svg>\n"
}
