//! Tables for the terminal.

use comfy_table::{CellAlignment, ContentArrangement, LineStyle, Row, Table, TableStyle};
use std::ops::Range;

/// Width of a table, columns; longer cells are wrapped.
const TABLE_COLUMNS: u16 = 80;

/// A rule under the head alone.
const TABLE_STYLE: TableStyle =
    TableStyle::new().header_separator(LineStyle::none().fill('─').junction('─'));

/// A table for the terminal, whose header has the names of the columns between bars; the columns `numbers` are aligned to the right.
pub fn table<R: Into<Row>>(
    header: &str,
    numbers: Range<usize>,
    rows: impl IntoIterator<Item = R>,
) -> Table {
    let mut table = Table::new();
    table.load_style(TABLE_STYLE);
    table
        .set_content_arrangement(ContentArrangement::Dynamic)
        .set_width(TABLE_COLUMNS)
        .set_header(header.split('|'))
        .add_rows(rows);
    for (n, column) in table.column_iter_mut().enumerate() {
        column.set_padding((0, 2));
        if numbers.contains(&n) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table
}
