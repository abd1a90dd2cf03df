//! Horizontal bars with whiskers, one row a name.

use crate::report::svg::{Ink, WIDTH, escape};
use std::fmt::Write;

/// One bar; shares of 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Bar {
    /// Name of the row.
    pub name: String,
    /// Length, −1..=1 (below 0 is drawn as nothing).
    pub share: f64,
    /// 95 % interval, if there is one.
    pub interval: Option<[f64; 2]>,
    /// Drawn in full colour.
    pub strong: bool,
}

const LEFT: f64 = 150.0;
const ROW: f64 = 22.0;
const TOP: f64 = 34.0;

/// The drawing as a stand-alone `<svg>` element, 0 to 100 %.
#[must_use]
pub fn svg(title: &str, ink: Ink, bars: &[Bar]) -> String {
    let width = WIDTH - LEFT - 52.0;
    let height = TOP + ROW * bars.len() as f64 + 26.0;
    let x = |share: f64| LEFT + width * if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" width=\"{WIDTH}\" height=\"{height}\" role=\"img\" \
         aria-label=\"{0}\" font-family=\"system-ui, 'Segoe UI', 'DejaVu Sans', sans-serif\" font-size=\"12\">\
         <text x=\"8\" y=\"20\" font-size=\"14\" font-weight=\"600\" fill=\"#1c2026\">{0}</text>",
        escape(title)
    );
    let bottom = TOP + ROW * bars.len() as f64;
    for k in 0..=4 {
        let at = x(f64::from(k) / 4.0);
        // writing to a String cannot fail
        let _ = write!(
            out,
            "<line x1=\"{at:.1}\" y1=\"{TOP}\" x2=\"{at:.1}\" y2=\"{bottom:.1}\" stroke=\"#e3e6ea\"/>\
             <text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\" fill=\"#565d66\" font-size=\"11\">{}</text>",
            bottom + 16.0,
            k * 25
        );
    }
    for (k, b) in bars.iter().enumerate() {
        let y = TOP + ROW * k as f64;
        let _ = write!(
            out,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#1c2026\"{}>{}</text>\
             <rect x=\"{LEFT}\" y=\"{:.1}\" width=\"{:.1}\" height=\"12\" fill=\"{}\" fill-opacity=\"{}\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#3a4048\" font-size=\"11\">{:.0} %</text>",
            LEFT - 8.0,
            y + 15.0,
            if b.strong { " font-weight=\"600\"" } else { "" },
            escape(&b.name),
            y + 5.0,
            x(b.share) - LEFT,
            ink.0,
            if b.strong { "0.9" } else { "0.4" },
            WIDTH - 4.0,
            y + 15.0,
            100.0 * b.share
        );
        if let Some([low, high]) = b.interval {
            let mid = y + 11.0;
            let _ = write!(
                out,
                "<path d=\"M{0:.1} {mid:.1}H{1:.1}M{0:.1} {2:.1}v6M{1:.1} {2:.1}v6\" stroke=\"#1c2026\" stroke-width=\"1.2\" fill=\"none\"/>",
                x(low),
                x(high),
                mid - 3.0
            );
        }
    }
    out.push_str("</svg>\n");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_are_as_long_as_their_shares_and_stay_inside() {
        let bar = |share| Bar { name: "a & b".to_owned(), share, interval: Some([-0.2, 1.4]), strong: true };
        let svg = svg("shares", Ink::BLUE, &[bar(0.5), bar(-0.4), bar(f64::NAN)]);
        assert!(svg.contains("width=\"119.0\" height=\"12\"") && svg.contains("a &amp; b"), "{svg}");
        assert!(svg.contains("M150.0 45.0H388.0"), "{svg}");
        assert_eq!(svg.matches("width=\"0.0\" height=\"12\"").count(), 2);
    }
}
