//! The wiring of a board as a drawing: the header of the computer, and the devices with a line for each wire.

use crate::report::svg::{End, Ink, Middle, Start, Svg};
use std::collections::BTreeSet;

/// A device with its terminals, from top to bottom.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Device {
    /// What is written above it, for example `driver of bellow 1`.
    pub name: String,
    /// Name of a terminal, and what it is wired to.
    pub terminals: Vec<(String, Wire)>,
}

/// The other end of a wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    /// A GPIO line.
    Line(u32),
    /// A pin of the header by its position, for supply and ground.
    Position(usize),
}

/// What the pins of a 40-pin header of a Raspberry Pi are, from pin 1: a supply, ground, or a GPIO line.
const HEADER: [&str; 40] = [
    "3.3 V", "5 V", "2", "5 V", "3", "ground", "4", "14", "ground", "15", "17", "18", "27",
    "ground", "22", "23", "3.3 V", "24", "10", "ground", "9", "25", "11", "8", "ground", "7", "0",
    "1", "5", "ground", "6", "12", "13", "ground", "19", "16", "26", "20", "ground", "21",
];
/// Colours of the devices.
const INKS: [Ink; 6] = [
    Ink::BLUE,
    Ink::RED,
    Ink::GREEN,
    Ink::PURPLE,
    Ink::ORANGE,
    Ink::GREY,
];
/// Distances of rows and of the two columns of the header, px.
const ROW: f64 = 22.0;
const TOP: f64 = 64.0;
const LEFT: f64 = 150.0;
const DEVICE: f64 = 430.0;

/// Draws devices at a header of a Raspberry Pi (`raspberry`) or, for another computer, at the lines that they use.
pub fn draw(title: &str, raspberry: bool, devices: &[Device]) -> String {
    let wires = || devices.iter().flat_map(|d| d.terminals.iter().map(|t| t.1));
    let lines = wires().filter_map(|w| match w {
        Wire::Line(n) => Some(n),
        Wire::Position(_) => None,
    });
    let lines: Vec<u32> = lines.collect::<BTreeSet<_>>().into_iter().collect();
    let rows: usize = devices.iter().map(|d| d.terminals.len() + 2).sum();
    let rows = rows.max(if raspberry { 20 } else { lines.len() });
    let height = TOP + ROW * rows as f64;
    let mut svg = Svg::new(640.0, height, title);
    svg.rect([0.0, 0.0, 640.0, height], "#ffffff", 1.0);
    svg.heading(16.0, title);
    let at = |i: usize| (LEFT + ROW * (i % 2) as f64, TOP + ROW * (i / 2) as f64);
    let place = |wire: Wire| {
        let index = match wire {
            Wire::Position(position) => Some(position - 1),
            Wire::Line(n) if raspberry => HEADER.iter().position(|name| *name == n.to_string()),
            Wire::Line(n) => lines.iter().position(|line| *line == n).map(|i| 2 * i + 1),
        };
        index.map(at)
    };
    let (x, text) = if raspberry {
        (LEFT + ROW / 2.0, "header, pin 1 at the top left")
    } else {
        (LEFT, "lines of the GPIO chip")
    };
    svg.text((x, TOP - 22.0), Middle, Ink::LABEL, text);
    for (i, name) in HEADER.iter().enumerate().filter(|_| raspberry) {
        let used = wires().any(|w| place(w) == Some(at(i)));
        let is_line = name.parse::<u32>().is_ok();
        let kind = if is_line { "GPIO " } else { "" };
        let name = format!("{kind}{name} ({})", i + 1);
        pin(&mut svg, at(i), i % 2 == 0, &name, used);
    }
    for (i, line) in lines.iter().enumerate().filter(|_| !raspberry) {
        pin(&mut svg, at(2 * i + 1), true, &format!("line {line}"), true);
    }
    let mut y = TOP;
    for (device, ink) in devices.iter().zip(INKS.iter().cycle()) {
        let height = ROW * (device.terminals.len() + 1) as f64 + 6.0;
        svg.rect([DEVICE, y - 14.0, 180.0, height], ink.0, 0.08);
        svg.text((DEVICE + 8.0, y + 4.0), Start, Ink::TEXT, &device.name);
        for (name, wire) in &device.terminals {
            y += ROW;
            svg.text((DEVICE + 16.0, y + 4.0), Start, Ink::LABEL, name);
            if let Some(at) = place(*wire) {
                wire_to(&mut svg, at, y, *ink);
            }
        }
        y += 2.0 * ROW;
    }
    svg.finish()
}

/// A wire from a pin to the terminal of a device at the height `y`.
fn wire_to(svg: &mut Svg, (px, py): (f64, f64), y: f64, ink: Ink) {
    // between two rows of pins and names, those of the left column lower
    let clear = py + if px > LEFT { 0.4 * ROW } else { 0.6 * ROW };
    let [beside, end, away, near] = [px + 11.0, LEFT + 110.0, LEFT + 190.0, DEVICE - 90.0];
    let bend = format!(
        "M{px:.0} {py:.0}L{beside:.0} {clear:.0}H{end:.0}C{away:.0} {clear:.0} {near:.0} {y:.0} {DEVICE:.0} {y:.0}"
    );
    let style = format!("fill=\"none\" stroke=\"{}\" stroke-width=\"1.6\"", ink.0);
    svg.path(&bend, &style);
}

/// A pin with its name on the left or the right; an unused one is pale.
fn pin(svg: &mut Svg, at: (f64, f64), left: bool, name: &str, used: bool) {
    let ink = if used { Ink::TEXT } else { Ink::GREY };
    svg.circle(at, 5.0, &format!("fill=\"{}\"", ink.0));
    let (by, anchor) = if left { (-10.0, End) } else { (10.0, Start) };
    svg.text((at.0 + by, at.1 + 4.0), anchor, ink, name);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_wire_ends_at_its_pin() {
        let driver = Device {
            name: "driver".to_owned(),
            terminals: vec![
                ("STEP".to_owned(), Wire::Line(17)),
                ("GND".to_owned(), Wire::Position(39)),
            ],
        };
        let drawn = draw("board", true, std::slice::from_ref(&driver));
        // GPIO 17 is pin 11: the left column, the sixth row; pin 39 is the last of that column
        assert!(
            drawn.contains("M150 174L") && drawn.contains("M150 482L"),
            "{drawn}"
        );
        assert_eq!(drawn.matches("<path").count(), 2);
        assert!(draw("board", false, &[driver]).contains("line 17"));
    }
}
