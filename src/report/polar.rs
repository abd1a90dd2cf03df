//! A map over the bend plane: rings of bend β, sectors of direction δ, one colour per cell.
//!
//! Colours run from pale to dark in one hue, so that greyscale print keeps their order.

use crate::report::chart::{HEIGHT, WIDTH};
use crate::report::svg::{End, Ink, Middle, Start, Svg};
use std::f64::consts::TAU;

/// Width of a ring, degrees of bend.
pub const RING_DEG: f64 = 15.0;
/// Number of sectors.
pub const SECTORS: usize = 24;

/// One cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// Ring; 0 is the innermost.
    pub ring: usize,
    /// Sector; 0 begins at δ = 0.
    pub sector: usize,
    /// Value that the colour shows.
    pub value: f64,
}

/// Centre and radius of the map, px.
const MIDDLE: (f64, f64) = (178.0, 184.0);
const RADIUS: f64 = 122.0;
/// Rings drawn even if no cell lies there: 75°, the range of the paper's experiment.
const RINGS_MIN: usize = 5;
/// Steps of the colour scale.
const SHADES: usize = 30;

/// From cream at 0 over orange to dark red at 1.
fn colour(share: f64) -> String {
    const STOPS: [[f64; 3]; 4] = [
        [253.0, 246.0, 227.0],
        [244.0, 186.0, 108.0],
        [205.0, 92.0, 46.0],
        [92.0, 22.0, 28.0],
    ];
    // `max` leaves NaN out
    let x = 3.0 * share.clamp(0.0, 1.0).max(0.0);
    let k = (x as usize).min(2);
    let [r, g, b] = std::array::from_fn(|i| {
        (STOPS[k][i] + (STOPS[k + 1][i] - STOPS[k][i]) * (x - k as f64)).round() as u8
    });
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// The drawing as a stand-alone `<svg>` element; `label` is the quantity that the colours show, with its unit, and `high` the value of
/// the darkest one.
pub fn svg(title: &str, label: &str, high: f64, cells: &[Cell]) -> String {
    let rings = cells.iter().map(|c| c.ring + 1);
    let rings = rings.fold(RINGS_MIN, usize::max);
    let step = RADIUS / rings as f64;
    let mut out = Svg::new(WIDTH, HEIGHT, title);
    out.heading(16.0, title);
    for c in cells {
        let turn = |k: usize| k as f64 * TAU / SECTORS as f64;
        let (from, to) = (turn(c.sector), turn(c.sector + 1));
        let d = sector(c.ring as f64 * step, (c.ring + 1) as f64 * step, from, to);
        let fill = colour(c.value / high.max(1e-9));
        out.path(&d, &format!("fill=\"{fill}\""));
    }
    frame(rings, step, &mut out);
    scale(label, high, &mut out);
    out.finish()
}

fn scale(label: &str, high: f64, out: &mut Svg) {
    let (x, top, height) = (352.0, 78.0, 180.0);
    let shade = height / SHADES as f64;
    for k in 0..SHADES {
        let share = 1.0 - k as f64 / (SHADES - 1) as f64;
        // the overlap hides seams between neighbours
        let frame = [x, top + k as f64 * shade, 16.0, shade + 0.4];
        out.rect(frame, &colour(share), 1.0);
    }
    for share in [0.0, 0.25, 0.5, 0.75, 1.0] {
        let y = top + (1.0 - share) * height + 4.0;
        let text = format!("{:.1}", share * high);
        out.text((x + 22.0, y), Start, Ink::FAINT, &text);
    }
    out.text((x, top - 14.0), Start, Ink::LABEL, label);
}

/// Rings with their bend angles, and the directions around them.
fn frame(rings: usize, step: f64, out: &mut Svg) {
    for k in 1..=rings {
        let width = if k == rings { 1.0 } else { 0.4 };
        let grey = Ink::GREY.0;
        let style = format!("fill=\"none\" stroke=\"{grey}\" stroke-width=\"{width}\"");
        out.circle(MIDDLE, k as f64 * step, &style);
    }
    for k in (2..=rings).step_by(2) {
        // angles stand along δ = 75°, where a white outline separates them from the cells
        let (x, y) = at(k as f64 * step, 75f64.to_radians());
        let style = "text-anchor=\"middle\" font-size=\"10\" stroke=\"#fff\" stroke-width=\"3\" paint-order=\"stroke\"";
        let text = format!("{:.0}°", k as f64 * RING_DEG);
        out.styled_text(x, y + 4.0, Ink::TEXT, style, &text);
    }
    for (deg, anchor) in [(0.0, Start), (90.0, Middle), (180.0, End), (270.0, Middle)] {
        let (x, y) = at(RADIUS + 9.0, f64::to_radians(deg));
        out.text((x, y + 4.0), anchor, Ink::FAINT, &format!("{deg:.0}°"));
    }
}

/// Point at a radius and an angle, counter-clockwise from the right as in the bend plane.
fn at(radius: f64, angle: f64) -> (f64, f64) {
    let (sin, cos) = angle.sin_cos();
    (MIDDLE.0 + radius * cos, MIDDLE.1 - radius * sin)
}

/// Path data of a cell between two radii, px, and two angles, radians.
fn sector(inner: f64, outer: f64, from: f64, to: f64) -> String {
    let ((ax, ay), (bx, by)) = (at(inner, from), at(outer, from));
    let ((cx, cy), (dx, dy)) = (at(outer, to), at(inner, to));
    format!(
        "M{ax:.1} {ay:.1}L{bx:.1} {by:.1}A{outer:.1} {outer:.1} 0 0 0 {cx:.1} {cy:.1}L{dx:.1} {dy:.1}A{inner:.1} {inner:.1} 0 0 1 {ax:.1} {ay:.1}Z"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_darken_as_the_value_grows() {
        let light = |c: &str| {
            (0..3)
                .map(|i| u32::from_str_radix(&c[1 + 2 * i..3 + 2 * i], 16).unwrap())
                .sum::<u32>()
        };
        let all: Vec<u32> = (0..=10)
            .map(|k| light(&colour(f64::from(k) / 10.0)))
            .collect();
        assert!(all.windows(2).all(|w| w[1] < w[0]), "{all:?}");
        assert_eq!(colour(f64::NAN), colour(0.0));
    }

    #[test]
    fn a_cell_lies_at_its_bend_and_direction() {
        let cell = Cell {
            ring: 4,
            sector: 0,
            value: 1.0,
        };
        let svg = svg("a < b", "°", 1.0, &[cell]);
        // δ = 0 points right, so the first sector begins at the centre plus the radius
        assert!(svg.contains("L300.0 184.0A122.0"), "{svg}");
        assert!(svg.contains("a &lt; b") && !svg.contains("NaN") && svg.ends_with("</svg>\n"));
    }
}
