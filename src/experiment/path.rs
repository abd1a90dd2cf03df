//! Files of paths.

use crate::control::{ActuatorLimits, Path};
use crate::log::error::ReadError;
use crate::log::table::{Schema, Table};
use crate::model::{Bend, Geometry, Line};

const SCHEMA: Schema<'_> = Schema {
    required: &["t_s", "bend_deg", "dir_deg"],
    known: &|name| matches!(name, "t_s" | "bend_deg" | "dir_deg" | "len_mm"),
    rows_min: 2,
};

/// A path with the table that it was read from.
#[derive(Debug, Clone, PartialEq)]
pub struct PathFile {
    /// The columns `t_s`, `bend_deg`, `dir_deg` and, if given, `len_mm`.
    pub table: Table,
    /// The path through the rows.
    pub path: Path,
}

impl PathFile {
    /// Reads a file with the columns `t_s`, `bend_deg`, `dir_deg` and, if given, `len_mm`.
    ///
    /// # Errors
    /// [`ReadError`] with file, line and column: fewer than two rows, a time that does not increase, a missing value.
    pub fn open(file: &std::path::Path, geometry: &Geometry) -> Result<Self, ReadError> {
        Self::of(Table::open(file, &SCHEMA)?, geometry)
    }

    /// Reads the text of a file, which errors call `name`.
    ///
    /// # Errors
    /// As for [`PathFile::open`].
    pub fn parse(name: &str, text: &str, geometry: &Geometry) -> Result<Self, ReadError> {
        Self::of(Table::parse(name, text.as_bytes(), &SCHEMA)?, geometry)
    }

    /// Takes a table with the columns of a path.
    ///
    /// # Errors
    /// As for [`PathFile::open`].
    pub fn of(table: Table, geometry: &Geometry) -> Result<Self, ReadError> {
        let t_s = table.clock("t_s")?.to_vec();
        let (bend, dir) = (table.complete("bend_deg")?, table.complete("dir_deg")?);
        let length = table.column("len_mm").map(|_| table.complete("len_mm"));
        let length = length.transpose()?;
        let row = |k: usize| {
            let length_mm = length.map_or(geometry.rest_length_mm, |l| l[k]);
            Bend::from_deg(bend[k], dir[k]).0.push(length_mm)
        };
        let rows: Vec<_> = (0..t_s.len()).map(row).collect();
        let path = Path::new(t_s, rows)
            .ok_or_else(|| table.refuse(0, "t_s", "", "two rows with times that increase"))?;
        Ok(Self { table, path })
    }

    /// Refuses a path with a bend that these lines cannot hold.
    ///
    /// # Errors
    /// [`ReadError`] for the first row out of reach, with the largest bend in its direction.
    pub fn within(
        &self,
        limits: &ActuatorLimits,
        geometry: &Geometry,
        lines: &[Line; 3],
    ) -> Result<(), ReadError> {
        let outside = self.path.out_of_reach(limits, geometry, lines);
        outside.map_or(Ok(()), |(k, expected)| Err(self.refuse(k, &expected)))
    }

    /// The refusal of the bend of a row.
    pub fn refuse(&self, row: usize, expected: &str) -> ReadError {
        let given = self.table.column("bend_deg").and_then(|b| b.get(row));
        let given = given.copied().unwrap_or_default().to_string();
        self.table.refuse(row, "bend_deg", &given, expected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_out_of_reach_are_refused_with_file_line_and_column() {
        let (geometry, lines) = (
            Geometry::default(),
            [Line {
                k_epsilon: 2.2,
                k_lambda_mm: 0.9,
            }; 3],
        );
        let limits = ActuatorLimits {
            travel_mm: 30.0,
            pressure_kpa_per_mm: 3.2,
            pressure_max_kpa: 41.0,
            bellow_min_mm: 14.0,
            bellow_max_mm: 29.0,
        };
        let within = |text: &str| {
            let file = PathFile::parse(
                "path.csv",
                &format!("t_s,bend_deg,dir_deg\n{text}"),
                &geometry,
            )?;
            file.within(&limits, &geometry, &lines)
        };
        assert!(within("0,30,0\n1,20,90\n").is_ok());
        let why = within("0,30,0\n1,120,0\n").unwrap_err().to_string();
        assert!(why.starts_with("path.csv, line 3, column bend_deg: `120` is not within reach: the largest bend towards 0°"), "{why}");
        assert!(
            within("0,30,0\n0,20,0\n")
                .unwrap_err()
                .to_string()
                .starts_with("path.csv, line 3, column t_s")
        );
    }
}
