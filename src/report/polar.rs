//! A map over the bend plane: rings of bend β, sectors of direction δ, one colour a cell.
//!
//! Colours run from pale to dark in one hue, so that a grey print keeps the order.

use crate::report::svg::{HEIGHT, WIDTH, escape};
use std::f64::consts::TAU;
use std::fmt::Write;

/// Width of a ring, degrees of bend.
pub const RING_DEG: f64 = 15.0;
/// Sectors around the circle.
pub const SECTORS: usize = 24;

/// One cell: ring from the middle, sector from δ = 0, value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// Ring, 0 in the middle.
    pub ring: usize,
    /// Sector, 0 begins at δ = 0.
    pub sector: usize,
    /// What the colour stands for.
    pub value: f64,
}

/// A polar map.
#[derive(Debug, Clone, PartialEq)]
pub struct Polar {
    /// Heading inside the drawing.
    pub title: String,
    /// What the colours mean, with the unit.
    pub label: String,
    /// Value of the darkest colour.
    pub high: f64,
    /// The cells there is something to say of.
    pub cells: Vec<Cell>,
}

/// Middle of the map and its radius, px.
const MIDDLE: (f64, f64) = (178.0, 184.0);
const RADIUS: f64 = 122.0;

/// Pale at 0, dark at 1: from cream over orange to a dark brown red.
fn colour(share: f64) -> String {
    const STOPS: [[f64; 3]; 4] = [[253.0, 246.0, 227.0], [244.0, 186.0, 108.0], [205.0, 92.0, 46.0], [92.0, 22.0, 28.0]];
    let x = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 } * 3.0;
    let (k, part) = ((x as usize).min(2), x - (x as usize).min(2) as f64);
    let c: Vec<String> = (0..3).map(|i| format!("{:02x}", (STOPS[k][i] + (STOPS[k + 1][i] - STOPS[k][i]) * part).round() as u8)).collect();
    format!("#{}", c.concat())
}

impl Polar {
    /// The drawing as a stand-alone `<svg>` element.
    #[must_use]
    pub fn svg(&self) -> String {
        let rings = self.cells.iter().map(|c| c.ring + 1).max().unwrap_or(1).max(5);
        let step = RADIUS / rings as f64;
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" role=\"img\" \
             aria-label=\"{0}\" font-family=\"system-ui, 'Segoe UI', 'DejaVu Sans', sans-serif\" font-size=\"12\">\
             <text x=\"16\" y=\"20\" font-size=\"14\" font-weight=\"600\" fill=\"#1c2026\">{0}</text>",
            escape(&self.title)
        );
        for c in &self.cells {
            let (inner, outer) = (c.ring as f64 * step, (c.ring + 1) as f64 * step);
            let turn = |k: usize| k as f64 * TAU / SECTORS as f64;
            let _ = write!(
                out,
                "<path d=\"{}\" fill=\"{}\"/>",
                sector(inner, outer, turn(c.sector), turn(c.sector + 1)),
                colour(c.value / self.high.max(1e-9))
            );
        }
        self.frame(rings, step, &mut out);
        self.scale(&mut out);
        out.push_str("</svg>\n");
        out
    }

    fn frame(&self, rings: usize, step: f64, out: &mut String) {
        let (cx, cy) = MIDDLE;
        for k in 1..=rings {
            let _ = write!(
                out,
                "<circle cx=\"{cx}\" cy=\"{cy}\" r=\"{:.1}\" fill=\"none\" stroke=\"#8a8f98\" stroke-width=\"{}\"/>",
                k as f64 * step,
                if k == rings { 1.0 } else { 0.4 }
            );
        }
        for k in (2..=rings).step_by(2) {
            // β is written along δ = 75°, on a ground of its own
            let (x, y) = at(k as f64 * step, 75f64.to_radians());
            let _ = write!(
                out,
                "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\" font-size=\"10\" fill=\"#1c2026\" stroke=\"#fff\" stroke-width=\"3\" paint-order=\"stroke\">{:.0}°</text>",
                y + 4.0,
                k as f64 * RING_DEG
            );
        }
        for (deg, anchor) in [(0.0, "start"), (90.0, "middle"), (180.0, "end"), (270.0, "middle")] {
            let (x, y) = at(RADIUS + 9.0, f64::to_radians(deg));
            let _ = write!(
                out,
                "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\" fill=\"#565d66\" font-size=\"11\">{deg:.0}°</text>",
                y + 4.0
            );
        }
    }

    fn scale(&self, out: &mut String) {
        let (x, top, height) = (352.0, 78.0, 180.0);
        for k in 0..30 {
            let share = 1.0 - f64::from(k) / 29.0;
            let _ = write!(
                out,
                "<rect x=\"{x}\" y=\"{:.1}\" width=\"16\" height=\"{:.1}\" fill=\"{}\"/>",
                top + f64::from(k) * height / 30.0,
                height / 30.0 + 0.4,
                colour(share)
            );
        }
        for k in 0..=4 {
            let share = f64::from(k) / 4.0;
            let _ = write!(
                out,
                "<text x=\"{}\" y=\"{:.1}\" fill=\"#565d66\" font-size=\"11\">{:.1}</text>",
                x + 22.0,
                top + (1.0 - share) * height + 4.0,
                share * self.high
            );
        }
        let _ = write!(out, "<text x=\"{x}\" y=\"{}\" fill=\"#3a4048\">{}</text>", top - 14.0, escape(&self.label));
    }
}

/// Point at a radius and an angle, counter-clockwise from the right as in the bend plane.
fn at(radius: f64, angle: f64) -> (f64, f64) {
    (MIDDLE.0 + radius * angle.cos(), MIDDLE.1 - radius * angle.sin())
}

fn sector(inner: f64, outer: f64, from: f64, to: f64) -> String {
    let [(ax, ay), (bx, by), (cx, cy), (dx, dy)] = [at(inner, from), at(outer, from), at(outer, to), at(inner, to)];
    format!(
        "M{ax:.1} {ay:.1}L{bx:.1} {by:.1}A{outer:.1} {outer:.1} 0 0 0 {cx:.1} {cy:.1}L{dx:.1} {dy:.1}A{inner:.1} {inner:.1} 0 0 1 {ax:.1} {ay:.1}Z"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_darken_with_the_value() {
        let light = |c: &str| (0..3).map(|i| u32::from_str_radix(&c[1 + 2 * i..3 + 2 * i], 16).unwrap()).sum::<u32>();
        let all: Vec<u32> = (0..=10).map(|k| light(&colour(f64::from(k) / 10.0))).collect();
        assert!(all.windows(2).all(|w| w[1] < w[0]), "{all:?}");
        assert_eq!(colour(f64::NAN), colour(0.0));
    }

    #[test]
    fn a_cell_lies_where_its_bend_and_direction_are() {
        let cells = vec![Cell { ring: 4, sector: 0, value: 1.0 }];
        let svg = Polar { title: "a < b".to_owned(), label: "°".to_owned(), high: 1.0, cells }.svg();
        // δ = 0 is to the right: the outer corner of the first sector is the middle plus the radius
        assert!(svg.contains("L300.0 184.0A122.0"), "{svg}");
        assert!(svg.contains("a &lt; b") && !svg.contains("NaN") && svg.ends_with("</svg>\n"));
    }
}
