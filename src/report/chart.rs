//! Line charts: axes, lines, bands, dots and a legend.
//!
//! A [`Chart`] is data; [`Chart::svg`] draws one, [`sheet`] draws several in a grid. Lines of the same colour differ by their
//! dash pattern, so that no meaning depends on colour alone.

use crate::report::svg::{End, Ink, Middle, Start, Svg, polyline};

/// Dash pattern of a line.
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

/// What a series draws, in the units of the axes.
#[derive(Debug, Clone, PartialEq)]
pub enum Mark {
    /// A polyline.
    Line(Vec<(f64, f64)>, Stroke),
    /// The area between low and high: (x, low, high).
    Band(Vec<(f64, f64, f64)>),
    /// Dots.
    Dots(Vec<(f64, f64)>),
}

/// One mark with its colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name in the legend, which leaves out a series without one.
    pub name: String,
    /// Colour.
    pub ink: Ink,
    /// Shape and points.
    pub mark: Mark,
}

impl Series {
    /// A line.
    pub fn line(name: &str, ink: Ink, stroke: Stroke, points: Vec<(f64, f64)>) -> Self {
        let (name, mark) = (name.to_owned(), Mark::Line(points, stroke));
        Self { name, ink, mark }
    }
    /// A band without a name; it belongs to the line of the same colour.
    pub fn band(ink: Ink, points: Vec<(f64, f64, f64)>) -> Self {
        let (name, mark) = (String::new(), Mark::Band(points));
        Self { name, ink, mark }
    }
    /// Dots without a name.
    pub fn dots(ink: Ink, points: Vec<(f64, f64)>) -> Self {
        let (name, mark) = (String::new(), Mark::Dots(points));
        Self { name, ink, mark }
    }
}

/// A linear axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// Quantity and unit.
    pub label: String,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Positions of the ticks and their text.
    pub ticks: Vec<(f64, String)>,
}

impl Axis {
    /// An axis from `low` to `high` with about `n` ticks at round values.
    pub fn new(label: &str, low: f64, high: f64, n: usize) -> Self {
        let high = if high > low { high } else { low + 1.0 };
        let step = round_step((high - low) / n.max(1) as f64);
        let first = (low / step - 1e-6).ceil() as i64;
        let last = (high / step + 1e-6).floor() as i64;
        let at = (first..=last.min(first + 100)).map(|k| k as f64 * step);
        Self::with_ticks(label, low, high, &at.collect::<Vec<_>>())
    }

    /// An axis with ticks at the given values.
    pub fn with_ticks(label: &str, low: f64, high: f64, at: &[f64]) -> Self {
        let steps = at.windows(2).map(|w| w[1] - w[0]);
        let digits = match steps.fold(f64::INFINITY, f64::min) {
            step if step.is_finite() && step > 0.0 => {
                (-step.log10() - 1e-9).ceil().clamp(0.0, 6.0) as usize
            }
            _ => 1,
        };
        // adding 0 turns −0 into 0
        let text = |t: f64| format!("{:.digits$}", t + 0.0).replace('-', "−");
        let (label, ticks) = (label.to_owned(), at.iter().map(|&t| (t, text(t))).collect());
        Self {
            label,
            low,
            high,
            ticks,
        }
    }

    /// An axis that extends to round values beyond all of `values`.
    pub fn around(label: &str, values: impl Iterator<Item = f64>, n: usize) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for v in values.filter(|v| v.is_finite()) {
            (low, high) = (low.min(v), high.max(v));
        }
        if low >= high {
            (low, high) = (low.min(0.0), low.max(0.0) + 1.0);
        }
        let step = round_step((high - low) / n.max(1) as f64);
        let least = (low / step - 1e-6).floor() * step;
        Self::new(label, least, (high / step + 1e-6).ceil() * step, n)
    }

    fn share(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }
}

/// The smallest of 1, 2 or 5 times a power of ten that is at least `raw`.
fn round_step(raw: f64) -> f64 {
    let power = 10f64.powf(raw.max(1e-12).log10().floor());
    let mut factors = [1.0, 2.0, 5.0].into_iter();
    let factor = factors.find(|f| f * power >= raw * (1.0 - 1e-9));
    factor.unwrap_or(10.0) * power
}

/// A chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    /// Heading inside the drawing.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// What is drawn, back to front.
    pub series: Vec<Series>,
}

/// Width of a chart, px at 96 dpi.
pub const WIDTH: f64 = 440.0;
/// Height of a chart, px.
pub const HEIGHT: f64 = 330.0;
/// Margins for the axis labels, px.
const LEFT: f64 = 58.0;
const RIGHT: f64 = 14.0;
const BOTTOM: f64 = 46.0;
/// Space above the legend and height of one of its rows, px.
const TOP: f64 = 34.0;
const LEGEND_ROW: f64 = 17.0;
/// Mean advance of a character at 11 px and width of a legend entry without its name, px.
const CHARACTER: f64 = 6.4;
const LEGEND_SAMPLE: f64 = 40.0;

impl Chart {
    /// A chart of these series.
    pub fn new(title: &str, x: Axis, y: Axis, series: Vec<Series>) -> Self {
        let title = title.to_owned();
        Self {
            title,
            x,
            y,
            series,
        }
    }

    /// The drawing as a stand-alone `<svg>` element.
    pub fn svg(&self) -> String {
        let mut out = Svg::new(WIDTH, HEIGHT, &self.title);
        self.draw(&mut out);
        out.finish()
    }

    fn draw(&self, out: &mut Svg) {
        out.heading(LEFT, &self.title);
        let top = TOP + self.legend(out) as f64 * LEGEND_ROW;
        let frame = [LEFT, top, WIDTH - LEFT - RIGHT, HEIGHT - BOTTOM - top];
        self.grid(frame, out);
        out.inset(frame, |out| {
            for series in &self.series {
                self.mark((frame[2], frame[3]), series, out);
            }
        });
    }

    /// Draws the names with samples of their lines and returns the number of rows.
    fn legend(&self, out: &mut Svg) -> usize {
        let (mut x, mut rows) = (LEFT, 0);
        for s in self.series.iter().filter(|s| !s.name.is_empty()) {
            let width = LEGEND_SAMPLE + CHARACTER * s.name.chars().count() as f64;
            if rows == 0 || x + width > WIDTH {
                (x, rows) = (LEFT, rows + 1);
            }
            let y = TOP + 3.0 + (rows - 1) as f64 * LEGEND_ROW;
            let mut style = "stroke-width=\"2.2\"".to_owned();
            if let Mark::Line(_, stroke) = &s.mark {
                style += stroke.dash();
            }
            out.line((x, y), (x + 22.0, y), s.ink, &style);
            out.text((x + 27.0, y + 4.0), Start, Ink::LABEL, &s.name);
            x += width;
        }
        rows
    }

    fn grid(&self, [left, top, width, height]: [f64; 4], out: &mut Svg) {
        let (right, bottom) = (left + width, top + height);
        for (value, text) in &self.y.ticks {
            let y = bottom - self.y.share(*value) * height;
            out.line((left, y), (right, y), Ink::PALE, "");
            out.text((left - 7.0, y + 4.0), End, Ink::FAINT, text);
        }
        for (value, text) in &self.x.ticks {
            let x = left + self.x.share(*value) * width;
            out.line((x, bottom), (x, bottom + 4.0), Ink::GREY, "");
            out.text((x, bottom + 17.0), Middle, Ink::FAINT, text);
        }
        out.line((left, bottom), (right, bottom), Ink::GREY, "");
        let (x, y) = (left + width / 2.0, top + height / 2.0);
        let style = "text-anchor=\"middle\"";
        out.styled_text(x, bottom + 36.0, Ink::LABEL, style, &self.x.label);
        let upright = format!("transform=\"translate(15 {y:.1}) rotate(-90)\" {style}");
        out.styled_text(0.0, 0.0, Ink::LABEL, &upright, &self.y.label);
    }

    fn mark(&self, size: (f64, f64), s: &Series, out: &mut Svg) {
        let at = |x: f64, y: f64| (self.x.share(x) * size.0, (1.0 - self.y.share(y)) * size.1);
        let ink = s.ink.0;
        match &s.mark {
            Mark::Line(points, stroke) => {
                let dash = stroke.dash();
                let style = format!(
                    "fill=\"none\" stroke=\"{ink}\" stroke-width=\"2\" stroke-linejoin=\"round\"{dash}"
                );
                out.path(&polyline(points.iter().map(|&(x, y)| at(x, y))), &style);
            }
            Mark::Band(points) => {
                let up = points.iter().map(|&(x, _, high)| at(x, high));
                let back = points.iter().rev().map(|&(x, low, _)| at(x, low));
                let style = format!("fill=\"{ink}\" fill-opacity=\"0.16\"");
                out.path(&(polyline(up.chain(back)) + "Z"), &style);
            }
            Mark::Dots(points) => {
                let style = format!("fill=\"{ink}\" fill-opacity=\"0.75\"");
                for &(x, y) in points.iter().filter(|p| p.0.is_finite() && p.1.is_finite()) {
                    out.circle(at(x, y), 2.4, &style);
                }
            }
        }
    }
}

/// Several charts on one drawing with a white background, `columns` to a row.
pub fn sheet(title: &str, charts: &[Chart], columns: usize) -> String {
    let columns = columns.clamp(1, charts.len().max(1));
    let width = WIDTH * columns as f64;
    let height = HEIGHT * charts.len().div_ceil(columns) as f64;
    let mut out = Svg::new(width, height, title);
    out.rect([0.0, 0.0, width, height], "#fff", 1.0);
    for (n, chart) in charts.iter().enumerate() {
        let (x, y) = (WIDTH * (n % columns) as f64, HEIGHT * (n / columns) as f64);
        out.inset([x, y, WIDTH, HEIGHT], |out| chart.draw(out));
    }
    out.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ticks_lie_on_the_axis_and_are_few(low in -1e3..1e3f64, size in 1e-3..1e4f64, n in 2usize..10) {
            let axis = Axis::new("x", low, low + size, n);
            prop_assert!(axis.ticks.len() <= n + 1 && !axis.ticks.is_empty() || n == 2);
            for (t, _) in &axis.ticks {
                prop_assert!(*t >= low - 1e-6 * size && *t <= low + size * (1.0 + 1e-6));
            }
        }

        #[test]
        fn an_axis_around_values_contains_them(values in prop::collection::vec(-1e3..1e3f64, 1..20)) {
            let axis = Axis::around("y", values.iter().copied().chain([0.0]), 5);
            prop_assert!(values.iter().all(|v| (axis.low..=axis.high).contains(v)));
        }
    }

    #[test]
    fn ticks_have_as_many_digits_as_their_step_needs() {
        let texts = |axis: Axis| axis.ticks.into_iter().map(|t| t.1).collect::<Vec<_>>();
        assert_eq!(texts(Axis::new("x", -0.5, 0.5, 4)), ["−0.5", "0.0", "0.5"]);
        assert_eq!(
            texts(Axis::new("x", 0.0, 100.0, 5)),
            ["0", "20", "40", "60", "80", "100"]
        );
    }

    fn chart() -> Chart {
        Chart {
            title: "a < b".to_owned(),
            x: Axis::new("x / mm", 0.0, 10.0, 5),
            y: Axis::new("y", -1.0, 1.0, 4),
            series: vec![
                Series::band(Ink::BLUE, vec![(0.0, -0.5, 0.5), (10.0, -0.2, 0.2)]),
                Series::line(
                    "mean",
                    Ink::BLUE,
                    Stroke::Dashed,
                    vec![(0.0, 0.0), (5.0, f64::NAN), (10.0, 1.0)],
                ),
                Series::dots(Ink::RED, vec![(5.0, 0.0)]),
            ],
        }
    }

    #[test]
    fn a_chart_is_well_formed_and_places_its_data() {
        let svg = chart().svg();
        assert!(svg.contains("a &lt; b") && !svg.contains("NaN"));
        assert_eq!(svg.matches("<svg").count(), svg.matches("</svg>").count());
        // the dot is in the middle of the frame, which is 368 px wide
        assert!(svg.contains("<circle cx=\"184.0\""), "{svg}");
    }

    #[test]
    fn a_sheet_holds_all_its_charts() {
        let svg = sheet("three", &[chart(), chart(), chart()], 2);
        assert_eq!(svg.matches("aria-label").count(), 1);
        assert_eq!(svg.matches("a &lt; b").count(), 3);
        assert!(svg.contains("width=\"880\" height=\"660\""));
    }
}
