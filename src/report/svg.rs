//! Small charts as inline SVG: axes, lines, bands, dots, a legend. No scripts, no fonts of its own.
//!
//! A [`Chart`] is data; [`Chart::svg`] draws it, [`sheet`] draws several on one drawing. Colours come
//! from one palette that stays apart for colour-blind readers and in grey print (Okabe & Ito 2008);
//! lines of one colour differ by dash, so that no meaning hangs on colour alone.

use std::fmt::Write;

/// A colour of the palette.
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
    /// What stands behind: ideal lines, limits.
    pub const GREY: Self = Self("#8a8f98");
}

/// How a line is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stroke {
    /// Unbroken.
    Solid,
    /// Dashed.
    Dashed,
    /// Dotted.
    Dotted,
}

impl Stroke {
    fn dash(self) -> &'static str {
        match self {
            Self::Solid => "",
            Self::Dashed => " stroke-dasharray=\"6 4\"",
            Self::Dotted => " stroke-dasharray=\"1.5 3.5\"",
        }
    }
}

/// What is drawn, in the axes' units.
#[derive(Debug, Clone, PartialEq)]
pub enum Mark {
    /// A polyline.
    Line(Vec<(f64, f64)>, Stroke),
    /// The area between low and high at each x.
    Band(Vec<(f64, f64, f64)>),
    /// Dots.
    Dots(Vec<(f64, f64)>),
}

/// One mark with its colour and, if it is to stand in the legend, its name.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name in the legend; `None` leaves it out.
    pub name: Option<String>,
    /// Colour.
    pub ink: Ink,
    /// Shape.
    pub mark: Mark,
}

impl Series {
    /// A line with a name.
    #[must_use]
    pub fn line(name: &str, ink: Ink, stroke: Stroke, points: Vec<(f64, f64)>) -> Self {
        Self { name: Some(name.to_owned()), ink, mark: Mark::Line(points, stroke) }
    }
    /// A band, without a name: it belongs to the line of its colour.
    #[must_use]
    pub fn band(ink: Ink, points: Vec<(f64, f64, f64)>) -> Self {
        Self { name: None, ink, mark: Mark::Band(points) }
    }
    /// Dots, without a name.
    #[must_use]
    pub fn dots(ink: Ink, points: Vec<(f64, f64)>) -> Self {
        Self { name: None, ink, mark: Mark::Dots(points) }
    }
}

/// One axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// Quantity and unit.
    pub label: String,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Where a tick stands.
    pub ticks: Vec<f64>,
}

impl Axis {
    /// An axis from `low` to `high` with about `n` round ticks.
    #[must_use]
    pub fn new(label: &str, low: f64, high: f64, n: usize) -> Self {
        let high = if high > low { high } else { low + 1.0 };
        Self { label: label.to_owned(), low, high, ticks: round_ticks(low, high, n) }
    }
    /// An axis that reaches round numbers beyond all of `values` (and `always`).
    #[must_use]
    pub fn around(label: &str, values: impl IntoIterator<Item = f64>, always: &[f64], n: usize) -> Self {
        let finite = values.into_iter().chain(always.iter().copied()).filter(|v| v.is_finite());
        let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = if low < high { (low, high) } else { (low.min(0.0), low.max(0.0) + 1.0) };
        let step = round_step((high - low) / n.max(1) as f64);
        Self::new(label, (low / step - 1e-6).floor() * step, (high / step + 1e-6).ceil() * step, n)
    }
    fn share(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }
    fn digits(&self) -> usize {
        let step = self.ticks.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
        if step.is_finite() && step > 0.0 { (-step.log10() - 1e-9).ceil().clamp(0.0, 6.0) as usize } else { 1 }
    }
}

/// 1, 2 or 5 times a power of ten, at least `raw`.
fn round_step(raw: f64) -> f64 {
    let power = 10f64.powf(raw.max(1e-12).log10().floor());
    let factor = [1.0, 2.0, 5.0, 10.0].into_iter().find(|f| f * power >= raw * (1.0 - 1e-9)).unwrap_or(10.0);
    factor * power
}

fn round_ticks(low: f64, high: f64, n: usize) -> Vec<f64> {
    let step = round_step((high - low) / n.max(1) as f64);
    let first = (low / step - 1e-6).ceil() as i64;
    let last = (high / step + 1e-6).floor() as i64;
    (first..=last.min(first + 100)).map(|k| k as f64 * step).collect()
}

/// A chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    /// Heading inside the drawing.
    pub title: String,
    /// Across.
    pub x: Axis,
    /// Up.
    pub y: Axis,
    /// What is drawn, first at the back.
    pub series: Vec<Series>,
}

/// Size of a chart's drawing, px at 96 dpi.
pub const WIDTH: f64 = 440.0;
/// Height of a chart's drawing, px.
pub const HEIGHT: f64 = 330.0;
const LEFT: f64 = 58.0;
const RIGHT: f64 = 14.0;
const BOTTOM: f64 = 46.0;
const LEGEND_ROW: f64 = 17.0;

impl Chart {
    /// The drawing as a stand-alone `<svg>` element.
    #[must_use]
    pub fn svg(&self) -> String {
        let mut out = String::new();
        // writing to a String cannot fail; its Result is the trait's, not this use's
        let _ = write!(
            out,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" role=\"img\" \
             aria-label=\"{}\" font-family=\"system-ui, 'Segoe UI', 'DejaVu Sans', sans-serif\" font-size=\"12\">",
            escape(&self.title)
        );
        self.draw(&mut out);
        out.push_str("</svg>\n");
        out
    }

    fn draw(&self, out: &mut String) {
        let (legend, rows) = self.legend();
        let frame = Frame {
            left: LEFT,
            top: 34.0 + rows as f64 * LEGEND_ROW,
            width: WIDTH - LEFT - RIGHT,
            height: HEIGHT - BOTTOM - 34.0 - rows as f64 * LEGEND_ROW,
        };
        let _ =
            write!(out, "<text x=\"{LEFT}\" y=\"20\" font-size=\"14\" font-weight=\"600\" fill=\"#1c2026\">{}</text>", escape(&self.title));
        out.push_str(&legend);
        self.grid(&frame, out);
        // what lies outside the axes is cut at the frame, by a nested drawing with its own edges
        let _ = write!(
            out,
            "<svg x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" overflow=\"hidden\">",
            frame.left, frame.top, frame.width, frame.height
        );
        for s in &self.series {
            self.mark(&frame, s, out);
        }
        out.push_str("</svg>");
    }

    /// Names with a sample of their line, wrapped; the markup and the number of rows.
    fn legend(&self) -> (String, usize) {
        let (mut out, mut x, mut row) = (String::new(), LEFT, 0);
        let mut any = false;
        for s in &self.series {
            let Some(name) = &s.name else { continue };
            let width = 40.0 + 6.4 * name.chars().count() as f64;
            if any && x + width > WIDTH {
                (x, row) = (LEFT, row + 1);
            }
            any = true;
            let y = 37.0 + row as f64 * LEGEND_ROW;
            let dash = if let Mark::Line(_, stroke) = s.mark { stroke.dash() } else { "" };
            let _ = write!(
                out,
                "<line x1=\"{x:.1}\" y1=\"{y:.1}\" x2=\"{:.1}\" y2=\"{y:.1}\" stroke=\"{}\" stroke-width=\"2.2\"{dash}/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" fill=\"#3a4048\" font-size=\"11.5\">{}</text>",
                x + 22.0,
                s.ink.0,
                x + 27.0,
                y + 4.0,
                escape(name)
            );
            x += width;
        }
        (out, if any { row + 1 } else { 0 })
    }

    fn grid(&self, f: &Frame, out: &mut String) {
        let (right, bottom) = (f.left + f.width, f.top + f.height);
        for &t in &self.y.ticks {
            let y = bottom - self.y.share(t) * f.height;
            let _ = write!(
                out,
                "<line x1=\"{:.1}\" y1=\"{y:.1}\" x2=\"{right:.1}\" y2=\"{y:.1}\" stroke=\"#e3e6ea\"/>\
                 <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#565d66\" font-size=\"11\">{}</text>",
                f.left,
                f.left - 7.0,
                y + 4.0,
                number(t, self.y.digits())
            );
        }
        for &t in &self.x.ticks {
            let x = f.left + self.x.share(t) * f.width;
            let _ = write!(
                out,
                "<line x1=\"{x:.1}\" y1=\"{bottom:.1}\" x2=\"{x:.1}\" y2=\"{:.1}\" stroke=\"#8a8f98\"/>\
                 <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\" fill=\"#565d66\" font-size=\"11\">{}</text>",
                bottom + 4.0,
                bottom + 17.0,
                number(t, self.x.digits())
            );
        }
        let _ = write!(
            out,
            "<line x1=\"{:.1}\" y1=\"{bottom:.1}\" x2=\"{right:.1}\" y2=\"{bottom:.1}\" stroke=\"#8a8f98\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\" fill=\"#3a4048\">{}</text>\
             <text transform=\"translate(15 {:.1}) rotate(-90)\" text-anchor=\"middle\" fill=\"#3a4048\">{}</text>",
            f.left,
            f.left + f.width / 2.0,
            bottom + 36.0,
            escape(&self.x.label),
            f.top + f.height / 2.0,
            escape(&self.y.label)
        );
    }

    fn mark(&self, f: &Frame, s: &Series, out: &mut String) {
        let at = |x: f64, y: f64| (self.x.share(x) * f.width, (1.0 - self.y.share(y)) * f.height);
        let ink = s.ink.0;
        match &s.mark {
            Mark::Line(points, stroke) => {
                let d = path(points.iter().map(|&(x, y)| at(x, y)));
                let _ = write!(
                    out,
                    "<path d=\"{d}\" fill=\"none\" stroke=\"{ink}\" stroke-width=\"2\" stroke-linejoin=\"round\"{}/>",
                    stroke.dash()
                );
            }
            Mark::Band(points) => {
                let up = points.iter().map(|&(x, _, high)| at(x, high));
                let back = points.iter().rev().map(|&(x, low, _)| at(x, low));
                let _ = write!(out, "<path d=\"{}Z\" fill=\"{ink}\" fill-opacity=\"0.16\"/>", path(up.chain(back)));
            }
            Mark::Dots(points) => {
                for &(x, y) in points.iter().filter(|p| p.0.is_finite() && p.1.is_finite()) {
                    let (x, y) = at(x, y);
                    let _ = write!(out, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.4\" fill=\"{ink}\" fill-opacity=\"0.75\"/>");
                }
            }
        }
    }
}

/// Where the data go.
struct Frame {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
}

/// Several charts on one stand-alone drawing with a white ground, `columns` in a row.
#[must_use]
pub fn sheet(charts: &[Chart], columns: usize) -> String {
    let columns = columns.clamp(1, charts.len().max(1));
    let (width, height) = (WIDTH * columns as f64, HEIGHT * charts.len().div_ceil(columns) as f64);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
         font-family=\"system-ui, 'Segoe UI', 'DejaVu Sans', sans-serif\" font-size=\"12\"><rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>"
    );
    for (n, chart) in charts.iter().enumerate() {
        let (x, y) = (WIDTH * (n % columns) as f64, HEIGHT * (n / columns) as f64);
        let _ = write!(out, "<g transform=\"translate({x} {y})\">");
        chart.draw(&mut out);
        out.push_str("</g>\n");
    }
    out.push_str("</svg>\n");
    out
}

/// `M x y L x y …` of the finite points; a gap where one is not.
fn path(points: impl Iterator<Item = (f64, f64)>) -> String {
    let (mut d, mut pen_down) = (String::new(), false);
    for (x, y) in points {
        if x.is_finite() && y.is_finite() {
            let _ = write!(d, "{}{x:.1} {y:.1}", if pen_down { 'L' } else { 'M' });
            pen_down = true;
        } else {
            pen_down = false;
        }
    }
    d
}

fn number(value: f64, digits: usize) -> String {
    // −0 is 0
    let text = format!("{:.digits$}", if value == 0.0 { 0.0 } else { value });
    text.replace('-', "−")
}

/// Text that may stand in markup and in attributes.
#[must_use]
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ticks_are_round_inside_and_not_too_many(low in -1e3..1e3f64, size in 1e-3..1e4f64, n in 2usize..10) {
            let axis = Axis::new("x", low, low + size, n);
            prop_assert!(axis.ticks.len() <= n + 1 && !axis.ticks.is_empty() || n == 2);
            for t in &axis.ticks {
                prop_assert!(*t >= low - 1e-6 * size && *t <= low + size * (1.0 + 1e-6));
            }
        }

        #[test]
        fn an_axis_around_values_holds_them(values in prop::collection::vec(-1e3..1e3f64, 1..20)) {
            let axis = Axis::around("y", values.iter().copied(), &[0.0], 5);
            prop_assert!(values.iter().all(|v| (axis.low..=axis.high).contains(v)));
        }
    }

    fn chart() -> Chart {
        Chart {
            title: "a < b".to_owned(),
            x: Axis::new("x / mm", 0.0, 10.0, 5),
            y: Axis::new("y", -1.0, 1.0, 4),
            series: vec![
                Series::band(Ink::BLUE, vec![(0.0, -0.5, 0.5), (10.0, -0.2, 0.2)]),
                Series::line("mean", Ink::BLUE, Stroke::Dashed, vec![(0.0, 0.0), (5.0, f64::NAN), (10.0, 1.0)]),
                Series::dots(Ink::RED, vec![(5.0, 0.0)]),
            ],
        }
    }

    #[test]
    fn draws_well_formed_markup_with_data_where_they_belong() {
        let svg = chart().svg();
        assert!(svg.contains("a &lt; b") && !svg.contains("NaN"));
        assert_eq!(svg.matches("<svg").count(), svg.matches("</svg>").count());
        // the dot is in the middle of the frame: x 184.0 of 368, y half of its height
        assert!(svg.contains("<circle cx=\"184.0\""), "{svg}");
    }

    #[test]
    fn a_sheet_holds_all_its_charts() {
        let svg = sheet(&[chart(), chart(), chart()], 2);
        assert_eq!(svg.matches("translate(").count() - svg.matches("translate(15").count(), 3);
        assert!(svg.contains("width=\"880\" height=\"660\""));
    }
}
