//! `log export`: the samples of a flight log with what the loop made of them, as a bend log or a Parquet table.

use crate::cli::{ResultFile, flight, output};
use crate::log::columns::{self, Column};
use crate::service::flight::cycle::Cycle;
use crate::service::flight::read::Entry;
use crate::service::flight::scene::timestamp;
use crate::service::flight::start::Event;
use crate::service::{record, status};
use mcap::Message;
use miette::{IntoDiagnostic, Result};
use serde_json::{Map, Value, json};
use std::collections::VecDeque;
use std::path::PathBuf;

/// Arguments of `log export`.
#[derive(Debug, clap::Args)]
pub struct ExportArgs {
    /// Flight log.
    file: PathBuf,
    /// Bend log to write; `-` is standard output.
    #[arg(long, required_unless_present = "parquet")]
    csv: Option<ResultFile>,
    /// Parquet file to write, with the same columns; a missing value is null. Its metadata hold the units and the start time.
    #[arg(long)]
    parquet: Option<ResultFile>,
}

/// Columns beside those of a bend log, and where the status holds their values; the last column is the mode.
const OF_LOOP: [(&str, &str); 15] = [
    ("setpoint_bend_deg", "/setpoint/bend_deg"),
    ("setpoint_dir_deg", "/setpoint/dir_deg"),
    ("setpoint_len_mm", "/length_mm"),
    ("estimate_bend_deg", "/estimate/bend_deg"),
    ("estimate_dir_deg", "/estimate/dir_deg"),
    ("estimate_sigma_deg", "/sigma_deg"),
    ("belief_bend_deg", "/belief/bend_deg"),
    ("belief_dir_deg", "/belief/dir_deg"),
    ("belief_sigma_deg", "/belief_sigma_deg"),
    ("k_epsilon1", "/k_epsilon/0"),
    ("k_epsilon2", "/k_epsilon/1"),
    ("k_epsilon3", "/k_epsilon/2"),
    ("k_lambda1_mm", "/k_lambda_mm/0"),
    ("k_lambda2_mm", "/k_lambda_mm/1"),
    ("k_lambda3_mm", "/k_lambda_mm/2"),
];
/// Ends of the names of columns with their units.
const UNITS: [(&str, &str); 8] = [
    ("_rad_s", "rad/s"),
    ("_m_s2", "m/s²"),
    ("_deg", "°"),
    ("_mm", "mm"),
    ("_ut", "µT"),
    ("_kpa", "kPa"),
    ("temp_c", "°C"),
    ("time_s", "s"),
];
/// Rounding of the times of a log, ns.
const ROUNDING_NS: u64 = 1000;

/// The rows of a log.
#[derive(Default)]
struct Rows {
    step_mm: f64,
    program: String,
    /// Time of the first row's zero, ns since 1970.
    start_ns: u64,
    samples: record::Rows,
    numbers: Vec<Vec<f64>>,
    modes: Vec<String>,
    /// The status, and what the channels show of it later, with the times, ns since 1970.
    status: Value,
    later: VecDeque<(u64, Map<String, Value>)>,
}

impl Rows {
    fn take(&mut self, message: &Message<'_>) -> Result<(), String> {
        match Entry::of(message)? {
            Entry::Event(event) => {
                if let Event::Start(header) = *event {
                    (self.step_mm, self.program) = (header.machine.step_mm, header.program);
                }
            }
            Entry::Shown(Value::Object(fields)) => self.later.push_back((message.log_time, fields)),
            Entry::Shown(_) => {}
            Entry::Cycles(_, cycles) => {
                let last_s = cycles.last().map_or(0.0, |cycle| cycle.sensed.t.0);
                for cycle in &cycles {
                    let before_ns = ((last_s - cycle.sensed.t.0) * 1e9) as u64;
                    self.add(cycle, message.log_time.saturating_sub(before_ns));
                }
            }
        }
        Ok(())
    }

    fn add(&mut self, cycle: &Cycle, unix_ns: u64) {
        let due = |next: &mut (u64, _)| next.0 <= unix_ns + ROUNDING_NS;
        while let Some((_, fields)) = self.later.pop_front_if(due) {
            match &mut self.status {
                Value::Object(status) => status.extend(fields),
                none => *none = Value::Object(fields),
            }
        }
        let Some(mut row) = self.samples.add(&cycle.sensed, &cycle.target, self.step_mm) else {
            return;
        };
        if self.numbers.is_empty() {
            self.start_ns = unix_ns.saturating_sub((row[0] * 1e9) as u64);
        }
        // single precision keeps the four digits
        let value = |place| self.status.pointer(place).and_then(Value::as_f64);
        row.extend(OF_LOOP.map(|(_, place)| value(place).map_or(f64::NAN, status::round)));
        self.numbers.push(row);
        let mode = self.status["mode"].as_str().unwrap_or_default();
        self.modes.push(mode.to_owned());
    }

    fn csv(&self) -> Vec<u8> {
        let mut log = [&names().join(","), ",mode"].concat().into_bytes();
        for (row, mode) in self.numbers.iter().zip(&self.modes) {
            log.push(b'\n');
            record::write_values(&mut log, row);
            log.extend([",", mode].concat().bytes());
        }
        log.push(b'\n');
        log
    }

    /// The table, with the units of its columns and the time of its zero.
    fn parquet(&self) -> Result<Vec<u8>> {
        let unit = |name: &&str| {
            let (_, unit) = UNITS.iter().find(|(end, _)| name.ends_with(end))?;
            Some(((*name).to_owned(), json!(unit)))
        };
        let units: Map<String, Value> = names().iter().filter_map(unit).collect();
        let start = timestamp(self.start_ns);
        let metadata = [
            ("start_time", start.as_str().unwrap_or_default().to_owned()),
            ("units", json!(units).to_string()),
            ("program", format!("retroflex {}", self.program)),
        ];
        let numbers = |k: usize| Column::Numbers(self.numbers.iter().map(|row| row[k]).collect());
        let mut table: Vec<(&str, Column)> = Vec::new();
        table.extend((0..).zip(names()).map(|(k, name)| (name, numbers(k))));
        table.push(("mode", Column::Texts(self.modes.clone())));
        columns::write(&table, &metadata).into_diagnostic()
    }
}

/// Names of the columns of numbers.
fn names() -> Vec<&'static str> {
    let samples = record::HEADER.trim_end().split(',');
    samples.chain(OF_LOOP.map(|column| column.0)).collect()
}

/// Runs the command.
///
/// # Errors
/// A report that names the file.
pub fn export(args: &ExportArgs) -> Result<bool> {
    let (path, mut rows) = (flight::flight_of(&args.file)?, Rows::default());
    let ending = flight::read(&path, &mut |_, message| rows.take(message))?;
    output::write_some(&args.csv, || Ok(rows.csv()))?;
    output::write_some(&args.parquet, || rows.parquet())?;
    eprintln!("{:.3} s; {ending}", rows.samples.last_s);
    Ok(ending.damage.is_empty())
}
