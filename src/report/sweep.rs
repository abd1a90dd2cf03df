//! The envelope as a drawing: a row for each condition and a cell for each value, which shows the closed loop against the
//! best open loop and where it fails.

use crate::experiment::sweep::{GOOD_DEG, SweepRow};
use crate::report::svg::{End, Ink, Middle, Start, Svg};

const LEFT: f64 = 200.0;
const TOP: f64 = 52.0;
const CELL: (f64, f64) = (112.0, 40.0);

/// The drawing.
pub fn svg(rows: &[SweepRow]) -> String {
    let groups: Vec<&[SweepRow]> = rows.chunk_by(|a, b| a.condition == b.condition).collect();
    let columns = groups.iter().map(|g| g.len()).max().unwrap_or(0).max(3);
    let width = LEFT + CELL.0 * columns as f64 + 10.0;
    let height = TOP + CELL.1 * groups.len() as f64 + 10.0;
    let mut out = Svg::new(width, height, "The closed loop over conditions");
    out.rect([0.0, 0.0, width, height], "#fff", 1.0);
    let title = "Closed loop over conditions: bend RMSE, in brackets that of the best open loop";
    out.heading(12.0, title);
    let green =
        "green: closed is no worse than max(0.3°, open) and a held state moves by at most 0.5°";
    out.text((12.0, 40.0), Start, Ink::FAINT, green);
    for (n, group) in groups.iter().enumerate() {
        let y = TOP + CELL.1 * n as f64;
        out.text((LEFT - 10.0, y + 24.0), End, Ink::TEXT, group[0].condition);
        for (k, row) in group.iter().enumerate() {
            cell(&mut out, LEFT + CELL.0 * k as f64, y, row);
        }
    }
    out.finish()
}

fn cell(out: &mut Svg, x: f64, y: f64, row: &SweepRow) {
    let (ink, opacity) = if row.ok {
        (Ink::GREEN, 0.16)
    } else {
        (Ink::RED, 0.35)
    };
    out.rect([x, y, CELL.0 - 4.0, CELL.1 - 4.0], ink.0, opacity);
    let middle = x + CELL.0 / 2.0 - 2.0;
    let failure = if row.ok {
        String::new()
    } else if row.closed_deg > row.open_deg.max(GOOD_DEG) {
        ": worse".to_owned()
    } else {
        format!(": moves {:.1}°", row.hunting_deg.max(row.cold_deg))
    };
    let value = format!("{}{failure}", row.value);
    out.text((middle, y + 15.0), Middle, Ink::FAINT, &value);
    let style = "font-size=\"11\" font-weight=\"600\" text-anchor=\"middle\"";
    let text = format!("{:.2}° ({:.1}°)", row.closed_deg, row.open_deg);
    out.styled_text(middle, y + 30.0, Ink::TEXT, style, &text);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_is_a_cell_and_a_failure_is_named() {
        let row = |condition, value, closed_deg, hunting_deg, ok| SweepRow {
            condition,
            value,
            open_deg: 7.0,
            closed_deg,
            p95_deg: 0.3,
            hunting_deg,
            cold_deg: 0.0,
            ok,
        };
        let rows = [
            row("a_s", 0.1, 0.2, 0.1, true),
            row("a_s", 0.2, 0.2, 0.83, false),
            row("b < c", 1.0, 8.0, 0.1, false),
        ];
        let svg = svg(&rows);
        assert_eq!(
            (
                svg.matches("0.20° (7.0°)").count(),
                svg.matches("8.00° (7.0°)").count()
            ),
            (2, 1)
        );
        assert!(
            svg.contains(">0.1<") && svg.contains("0.2: moves 0.8°") && svg.contains("1: worse"),
            "{svg}"
        );
        assert!(svg.contains("b &lt; c") && svg.matches(">a_s<").count() == 1);
    }
}
