//! Tables as Parquet files.

use parquet::basic::{Compression, Type, ZstdLevel};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType};
use parquet::errors::Result;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::record::Field;
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::ColumnDescPtr;
use std::fs::File;
use std::sync::Arc;

/// Rows of a row group: what a reader takes at once.
const GROUP: usize = 1 << 16;

/// A column of a table.
#[derive(Debug, Clone, PartialEq)]
pub enum Column {
    /// Numbers; what is not finite is null.
    Numbers(Vec<f64>),
    /// Texts.
    Texts(Vec<String>),
}

/// The file of a table whose columns have these names and equal lengths, with metadata by name.
///
/// # Errors
/// Those of the crate `parquet`.
pub fn write<N: AsRef<str>>(table: &[(N, Column)], metadata: &[(&str, String)]) -> Result<Vec<u8>> {
    let field = |(name, column): &(N, Column)| match column {
        Column::Numbers(_) => format!("optional double {};", name.as_ref()),
        Column::Texts(_) => format!("required binary {} (STRING);", name.as_ref()),
    };
    let fields: String = table.iter().map(field).collect();
    let schema = parse_message_type(&format!("message log {{ {fields} }}"))?;
    let zstd = Compression::ZSTD(ZstdLevel::default());
    let entry = |(name, value): &(&str, String)| KeyValue::new((*name).to_owned(), value.clone());
    let properties = WriterProperties::builder()
        .set_compression(zstd)
        .set_key_value_metadata(Some(metadata.iter().map(entry).collect()));
    let properties = Arc::new(properties.build());
    let mut writer = SerializedFileWriter::new(Vec::new(), Arc::new(schema), properties)?;
    let rows = table.first().map_or(0, |(_, column)| match column {
        Column::Numbers(all) => all.len(),
        Column::Texts(all) => all.len(),
    });
    for from in (0..rows).step_by(GROUP) {
        let part = from..rows.min(from + GROUP);
        let mut group = writer.next_row_group()?;
        for (_, column) in table {
            let Some(mut writer) = group.next_column()? else {
                break;
            };
            match column {
                Column::Numbers(all) => {
                    let mut values = all[part.clone()].to_vec();
                    let present: Vec<i16> = values.iter().map(|x| x.is_finite().into()).collect();
                    values.retain(|x| x.is_finite());
                    let writer = writer.typed::<DoubleType>();
                    writer.write_batch(&values, Some(&present), None)?;
                }
                Column::Texts(all) => {
                    let values = all[part.clone()].iter().map(|text| text.as_str().into());
                    let values: Vec<ByteArray> = values.collect();
                    let writer = writer.typed::<ByteArrayType>();
                    writer.write_batch(&values, None, None)?;
                }
            }
            writer.close()?;
        }
        group.close()?;
    }
    writer.into_inner()
}

/// Reads the table of a file. A null text is empty.
///
/// # Errors
/// Those of the crate `parquet`.
pub fn read(file: File) -> Result<Vec<(String, Column)>> {
    let reader = SerializedFileReader::new(file)?;
    let column = |of: &ColumnDescPtr| match of.physical_type() {
        Type::BYTE_ARRAY => (of.name().to_owned(), Column::Texts(Vec::new())),
        _ => (of.name().to_owned(), Column::Numbers(Vec::new())),
    };
    let columns = reader.metadata().file_metadata().schema_descr().columns();
    let mut table: Vec<(String, Column)> = columns.iter().map(column).collect();
    for row in reader.get_row_iter(None)? {
        for ((_, column), (_, field)) in table.iter_mut().zip(row?.get_column_iter()) {
            match (column, field) {
                (Column::Texts(all), Field::Str(text)) => all.push(text.clone()),
                (Column::Texts(all), _) => all.push(String::new()),
                (Column::Numbers(all), Field::Double(value)) => all.push(*value),
                (Column::Numbers(all), _) => all.push(f64::NAN),
            }
        }
    }
    Ok(table)
}
