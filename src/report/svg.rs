//! Writes SVG elements. Every drawing of the program goes through [`Svg`].
//!
//! `kuva` 0.6 and `plotters` 0.3 were considered. `kuva` omits `viewBox`, so its drawings do not scale in a page, and it writes
//! `NaN` into paths; `plotters` splits dashed lines into segments. Neither draws a map of polar cells or writes an
//! accessible label. Both need more adapter code than the elements below.

use std::fmt::{Display, Write};

const FONT: &str =
    "font-family=\"system-ui, 'Segoe UI', 'DejaVu Sans', sans-serif\" font-size=\"12\"";

/// A colour.
///
/// The palette (Okabe and Ito 2008, darkened for lines on white) remains distinguishable for colour-blind readers and in
/// greyscale print.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ink(pub &'static str);

impl Ink {
    /// Vermilion.
    pub const RED: Self = Self("#c8501e");
    /// Blue.
    pub const BLUE: Self = Self("#0a66a8");
    /// Bluish green.
    pub const GREEN: Self = Self("#00805c");
    /// Reddish purple.
    pub const PURPLE: Self = Self("#a3527f");
    /// Orange.
    pub const ORANGE: Self = Self("#c88700");
    /// Axes, limits and ideal lines.
    pub const GREY: Self = Self("#8a8f98");
    /// Grid lines.
    pub(crate) const PALE: Self = Self("#e3e6ea");
    /// Numbers on axes.
    pub(crate) const FAINT: Self = Self("#565d66");
    /// Labels and legends.
    pub(crate) const LABEL: Self = Self("#3a4048");
    /// Headings and names.
    pub(crate) const TEXT: Self = Self("#1c2026");
}

/// Which point of a text its coordinates name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

/// An SVG document under construction; all lengths in px at 96 dpi.
#[derive(Debug, Clone)]
pub struct Svg(String);

impl Svg {
    /// An empty drawing. Screen readers announce `title`.
    pub fn new(width: f64, height: f64, title: &str) -> Self {
        Self(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
             role=\"img\" aria-label=\"{}\" {FONT}>",
            escape(title)
        ))
    }

    /// The finished document.
    pub fn finish(mut self) -> String {
        self.0.push_str("</svg>\n");
        self.0
    }

    /// Draws into the rectangle `[x, y, width, height]`, with the origin at its corner, and clips at its edges.
    pub(crate) fn inset(&mut self, frame: [f64; 4], draw: impl FnOnce(&mut Self)) {
        self.open("svg", &["x", "y", "width", "height"], &frame);
        self.0.push_str(" overflow=\"hidden\">");
        draw(self);
        self.0.push_str("</svg>");
    }

    pub(crate) fn heading(&mut self, x: f64, text: &str) {
        let style = "font-size=\"14\" font-weight=\"600\"";
        self.styled_text(x, 20.0, Ink::TEXT, style, text);
    }

    pub(crate) fn text(&mut self, at: (f64, f64), anchor: Anchor, ink: Ink, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let style = format!("font-size=\"11\" text-anchor=\"{anchor}\"");
        self.styled_text(at.0, at.1, ink, &style, text);
    }

    /// Text with any further attributes.
    pub(crate) fn styled_text(&mut self, x: f64, y: f64, ink: Ink, style: &str, text: &str) {
        self.open("text", &["x", "y"], &[x, y]);
        let (fill, text) = (ink.0, escape(text));
        self.push(format_args!(" fill=\"{fill}\" {style}>{text}</text>"));
    }

    /// A straight line; `style` holds further attributes.
    pub(crate) fn line(&mut self, from: (f64, f64), to: (f64, f64), ink: Ink, style: &str) {
        let ends = [from.0, from.1, to.0, to.1];
        self.open("line", &["x1", "y1", "x2", "y2"], &ends);
        self.push(format_args!(" stroke=\"{}\" {style}/>", ink.0));
    }

    /// A filled rectangle `[x, y, width, height]`.
    pub(crate) fn rect(&mut self, frame: [f64; 4], fill: &str, opacity: f64) {
        self.open("rect", &["x", "y", "width", "height"], &frame);
        let style = format!("fill=\"{fill}\" fill-opacity=\"{opacity}\"");
        self.push(format_args!(" {style}/>"));
    }

    pub(crate) fn circle(&mut self, centre: (f64, f64), radius: f64, style: &str) {
        self.open("circle", &["cx", "cy", "r"], &[centre.0, centre.1, radius]);
        self.push(format_args!(" {style}/>"));
    }

    /// A path with the data `d`; `style` holds all other attributes.
    pub(crate) fn path(&mut self, d: &str, style: &str) {
        self.push(format_args!("<path d=\"{d}\" {style}/>"));
    }

    fn open(&mut self, name: &str, keys: &[&str], values: &[f64]) {
        self.push(format_args!("<{name}"));
        for (key, value) in keys.iter().zip(values) {
            self.push(format_args!(" {key}=\"{value:.1}\""));
        }
    }

    fn push(&mut self, markup: impl Display) {
        // writing to a `String` cannot fail
        let _ = write!(self.0, "{markup}");
    }
}

/// Path data through the finite points; a point that is not finite interrupts the line.
pub(crate) fn polyline(points: impl Iterator<Item = (f64, f64)>) -> String {
    let (mut d, mut pen_down) = (String::new(), false);
    for (x, y) in points {
        let is_there = x.is_finite() && y.is_finite();
        if is_there {
            let _ = write!(d, "{}{x:.1} {y:.1}", if pen_down { 'L' } else { 'M' });
        }
        pen_down = is_there;
    }
    d
}

/// Escapes text for use in markup and in attributes.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
