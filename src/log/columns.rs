//! A table of numbers as a Parquet file.

use parquet::basic::{Compression, ZstdLevel};
use parquet::data_type::DoubleType;
use parquet::errors::Result;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use std::sync::Arc;

/// Rows of a row group: what a reader takes at once.
const GROUP: usize = 1 << 16;

/// The file of a table with the columns of the header line of a CSV file. What is not a number is null.
///
/// # Errors
/// Those of the crate `parquet`.
pub fn parquet<const N: usize>(header: &str, rows: &[[f64; N]]) -> Result<Vec<u8>> {
    let fields = header.trim_end().replace(',', "; optional double ");
    let schema = parse_message_type(&format!("message log {{ optional double {fields}; }}"))?;
    let zstd = Compression::ZSTD(ZstdLevel::default());
    let properties = Arc::new(WriterProperties::builder().set_compression(zstd).build());
    let mut writer = SerializedFileWriter::new(Vec::new(), Arc::new(schema), properties)?;
    for rows in rows.chunks(GROUP) {
        let mut group = writer.next_row_group()?;
        for k in 0..N {
            let Some(mut column) = group.next_column()? else { break };
            let mut values: Vec<f64> = rows.iter().map(|row| row[k]).collect();
            let present: Vec<i16> = values.iter().map(|x| x.is_finite().into()).collect();
            values.retain(|x| x.is_finite());
            column.typed::<DoubleType>().write_batch(&values, Some(&present), None)?;
            column.close()?;
        }
        group.close()?;
    }
    writer.into_inner()
}
