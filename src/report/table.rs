//! Tables for the terminal.

use comfy_table::{CellAlignment, ContentArrangement, LineStyle, Row, Table, TableStyle};
use std::ops::Range;

/// Width of a table, columns; longer cells are wrapped.
const TABLE_COLUMNS: u16 = 80;

/// A rule under the head alone.
const TABLE_STYLE: TableStyle =
    TableStyle::new().header_separator(LineStyle::none().fill('─').junction('─'));

/// A table for the terminal; the columns `numbers` are aligned to the right.
pub fn table<R: Into<Row>>(
    header: &[&str],
    numbers: Range<usize>,
    rows: impl IntoIterator<Item = R>,
) -> Table {
    let mut table = Table::new();
    table.load_style(TABLE_STYLE);
    table
        .set_content_arrangement(ContentArrangement::Dynamic)
        .set_width(TABLE_COLUMNS);
    table.set_header(header.to_vec());
    for row in rows {
        table.add_row(row);
    }
    for (n, column) in table.column_iter_mut().enumerate() {
        column.set_padding((0, 2));
        if numbers.contains(&n) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table
}

/// The names of columns between bars.
pub fn columns(header: &str) -> Vec<&str> {
    header.split('|').collect()
}

/// A [`table`] whose header has the names of the columns between bars.
pub fn titled<R: Into<Row>>(
    header: &str,
    numbers: Range<usize>,
    rows: impl IntoIterator<Item = R>,
) -> Table {
    table(&columns(header), numbers, rows)
}
