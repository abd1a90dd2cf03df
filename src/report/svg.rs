//! Writes SVG elements. Every drawing of the program goes through [`Svg`].
//!
//! `kuva` 0.6 and `plotters` 0.3 were considered. `kuva` omits `viewBox`, so its drawings do not scale in a page, and it writes
//! `NaN` into paths; `plotters` splits dashed lines into segments. Neither draws a map of polar cells or writes an
//! accessible label. Both need more adapter code than the elements below.

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
pub(crate) use Anchor::{End, Middle, Start};

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
        self.0 += "</svg>\n";
        self.0
    }

    /// Draws into the rectangle `[x, y, width, height]`, with the origin at its corner, and clips at its edges.
    pub(crate) fn inset(&mut self, frame: [f64; 4], draw: impl FnOnce(&mut Self)) {
        let [x, y, width, height] = frame;
        self.0 += &format!(
            r#"<svg x="{x:.1}" y="{y:.1}" width="{width:.1}" height="{height:.1}" overflow="hidden">"#
        );
        draw(self);
        self.0 += "</svg>";
    }

    pub(crate) fn heading(&mut self, x: f64, text: &str) {
        let style = "font-size=\"14\" font-weight=\"600\"";
        self.styled_text(x, 20.0, Ink::TEXT, style, text);
    }

    pub(crate) fn text(&mut self, at: (f64, f64), anchor: Anchor, ink: Ink, text: &str) {
        let anchor = match anchor {
            Start => "start",
            Middle => "middle",
            End => "end",
        };
        let style = format!("font-size=\"11\" text-anchor=\"{anchor}\"");
        self.styled_text(at.0, at.1, ink, &style, text);
    }

    /// Text with any further attributes.
    pub(crate) fn styled_text(&mut self, x: f64, y: f64, ink: Ink, style: &str, text: &str) {
        let (fill, text) = (ink.0, escape(text));
        self.0 += &format!(r#"<text x="{x:.1}" y="{y:.1}" fill="{fill}" {style}>{text}</text>"#);
    }

    /// A straight line; `style` holds further attributes.
    pub(crate) fn line(&mut self, from: (f64, f64), to: (f64, f64), ink: Ink, style: &str) {
        let ((x1, y1), (x2, y2), ink) = (from, to, ink.0);
        self.0 += &format!(
            r#"<line x1="{x1:.1}" y1="{y1:.1}" x2="{x2:.1}" y2="{y2:.1}" stroke="{ink}" {style}/>"#
        );
    }

    /// A filled rectangle `[x, y, width, height]`.
    pub(crate) fn rect(&mut self, frame: [f64; 4], fill: &str, opacity: f64) {
        let [x, y, width, height] = frame;
        self.0 += &format!(
            r#"<rect x="{x:.1}" y="{y:.1}" width="{width:.1}" height="{height:.1}" fill="{fill}" fill-opacity="{opacity}"/>"#
        );
    }

    pub(crate) fn circle(&mut self, centre: (f64, f64), radius: f64, style: &str) {
        let (x, y) = centre;
        self.0 += &format!(r#"<circle cx="{x:.1}" cy="{y:.1}" r="{radius:.1}" {style}/>"#);
    }

    /// A path with the data `d`; `style` holds all other attributes.
    pub(crate) fn path(&mut self, d: &str, style: &str) {
        self.0 += &format!(r#"<path d="{d}" {style}/>"#);
    }
}

/// Path data through the finite points; a point that is not finite interrupts the line.
pub(crate) fn polyline(points: impl Iterator<Item = (f64, f64)>) -> String {
    let (mut d, mut pen_down) = (String::new(), false);
    for (x, y) in points {
        let is_there = x.is_finite() && y.is_finite();
        if is_there {
            let step = if pen_down { 'L' } else { 'M' };
            d += &format!("{step}{x:.1} {y:.1}");
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
