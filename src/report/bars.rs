//! Horizontal bars with whiskers, one row for each name.

use crate::report::chart::WIDTH;
use crate::report::svg::{End, Ink, Middle, Svg};

/// One bar.
#[derive(Debug, Clone, PartialEq)]
pub struct Bar {
    /// Name of the row.
    pub name: String,
    /// Length as a fraction of the axis; values outside 0 to 1 are drawn at the nearer end.
    pub share: f64,
    /// 95 % confidence interval, as fractions.
    pub interval: Option<[f64; 2]>,
    /// Draws the bar in full colour and its name in bold.
    pub strong: bool,
}

const LEFT: f64 = 150.0;
const RIGHT: f64 = 52.0;
const ROW: f64 = 22.0;
const TOP: f64 = 34.0;

/// The drawing as a stand-alone `<svg>` element with an axis from 0 to 100 %.
pub fn svg(title: &str, ink: Ink, bars: &[Bar]) -> String {
    let bottom = TOP + ROW * bars.len() as f64;
    // `max` leaves NaN out
    let x = |share: f64| LEFT + (WIDTH - LEFT - RIGHT) * share.clamp(0.0, 1.0).max(0.0);
    let mut out = Svg::new(WIDTH, bottom + 26.0, title);
    out.heading(8.0, title);
    for percent in [0, 25, 50, 75, 100] {
        let at = x(f64::from(percent) / 100.0);
        out.line((at, TOP), (at, bottom), Ink::PALE, "");
        let text = percent.to_string();
        out.text((at, bottom + 16.0), Middle, Ink::FAINT, &text);
    }
    for (k, b) in bars.iter().enumerate() {
        let y = TOP + ROW * k as f64;
        let (opacity, weight) = if b.strong { (0.9, 600) } else { (0.4, 400) };
        let style = format!("text-anchor=\"end\" font-weight=\"{weight}\"");
        out.styled_text(LEFT - 8.0, y + 15.0, Ink::TEXT, &style, &b.name);
        out.rect([LEFT, y + 5.0, x(b.share) - LEFT, 12.0], ink.0, opacity);
        let text = format!("{:.0} %", 100.0 * b.share);
        out.text((WIDTH - 4.0, y + 15.0), End, Ink::LABEL, &text);
        if let Some([low, high]) = b.interval.map(|i| i.map(x)) {
            let (middle, style) = (y + 11.0, "stroke-width=\"1.2\"");
            out.line((low, middle), (high, middle), Ink::TEXT, style);
            for end in [low, high] {
                let (from, to) = ((end, middle - 3.0), (end, middle + 3.0));
                out.line(from, to, Ink::TEXT, style);
            }
        }
    }
    out.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_are_as_long_as_their_shares_and_stay_on_the_axis() {
        let bar = |share| Bar {
            name: "a & b".to_owned(),
            share,
            interval: Some([-0.2, 1.4]),
            strong: true,
        };
        let svg = svg("shares", Ink::BLUE, &[bar(0.5), bar(-0.4), bar(f64::NAN)]);
        assert!(
            svg.contains("width=\"119.0\" height=\"12.0\"") && svg.contains("a &amp; b"),
            "{svg}"
        );
        assert!(
            svg.contains("x1=\"150.0\" y1=\"45.0\" x2=\"388.0\""),
            "{svg}"
        );
        assert_eq!(svg.matches("width=\"0.0\" height=\"12.0\"").count(), 2);
    }
}
