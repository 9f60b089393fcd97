//! A drawing as SVG, element by element: what plots are made of.

use std::fmt::{Arguments, Write};

pub struct Drawing {
    svg: String,
}

impl Drawing {
    /// White, of that width and height.
    pub fn new([width, height]: [f64; 2], font_size: u32) -> Drawing {
        Drawing {
            svg: format!(
                "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"{font_size}\">\n\
                 <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
            ),
        }
    }

    /// An element as it stands; texts in it must be escaped.
    pub fn element(&mut self, text: Arguments<'_>) {
        // Writing to a String cannot fail.
        let _ = writeln!(self.svg, "{text}");
    }

    /// A text of any characters. `attributes` are as in SVG, or nothing.
    pub fn text(&mut self, [x, y]: [f64; 2], attributes: &str, text: &str) {
        let space = if attributes.is_empty() { "" } else { " " };
        self.element(format_args!(
            "<text x=\"{x:.1}\" y=\"{y:.1}\"{space}{attributes}>{}</text>",
            escape(text)
        ));
    }

    /// The two axes of a plot, and the label of the lower one, so far below it.
    pub fn axes(&mut self, [left, top]: [f64; 2], [width, height]: [f64; 2], x_label: &str, below: f64) {
        self.element(format_args!(
            "<path d=\"M{left} {top}V{:.1}H{:.1}\" fill=\"none\" stroke=\"black\"/>",
            top + height,
            left + width
        ));
        self.text([left + 0.5 * width, top + height + below], "text-anchor=\"middle\"", x_label);
    }

    pub fn finish(self) -> String {
        self.svg + "</svg>\n"
    }
}

/// For texts and for attributes.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
