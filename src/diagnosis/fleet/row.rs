//! One row per diagnosed log.

use crate::diagnosis::tip::{Diagnosed, SavedGains};
use crate::log::columns::Column;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};

/// Names of the gains in [`FleetRow::numbers`]: k_ε and k_λ of the channels, and the lag of the pistons.
pub const GAINS: [&str; 7] = [
    "k_epsilon_1",
    "k_epsilon_2",
    "k_epsilon_3",
    "k_lambda_1_mm",
    "k_lambda_2_mm",
    "k_lambda_3_mm",
    "lag_s",
];

/// What is kept of the diagnosis of a log. A text that does not apply is empty.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FleetRow {
    /// Path of the log below its folder.
    pub log: String,
    /// Hash of the log.
    pub content: String,
    /// Hash of what else decides the row: version of the program, board, calibration, seed.
    pub settings: String,
    /// Unit that the log is of.
    pub unit: String,
    /// Lot of the unit.
    pub lot: String,
    /// Day of the log, `YYYY-MM-DD`.
    pub date: String,
    /// Why the log cannot be diagnosed.
    pub refused: String,
    /// Kind of the verdict.
    pub verdict: String,
    /// Effects that the verdict names, with `+` between them.
    pub names: String,
    /// Gap, degrees; probability of each effect, `p_NAME`, and of an unknown one; gains. What is absent is unknown.
    #[serde(flatten)]
    pub numbers: BTreeMap<String, f64>,
}

impl FleetRow {
    /// Takes over the result of another row of the same log.
    pub fn take_result(&mut self, other: &Self) {
        self.numbers.clone_from(&other.numbers);
        self.refused.clone_from(&other.refused);
        self.verdict.clone_from(&other.verdict);
        self.names.clone_from(&other.names);
    }

    /// Fills in the result of a diagnosis.
    pub fn tell(&mut self, done: &Diagnosed) {
        let document = &done.document;
        self.verdict = document.verdict.kind.name().to_owned();
        self.names = document.verdict.names.join("+");
        let gap = &document.gap;
        let chosen = SavedGains::new(&done.chosen.theta);
        let gains = chosen.k_epsilon.into_iter().chain(chosen.k_lambda_mm);
        let gains = gains.chain([chosen.lag_s]);
        let named = [
            ("as_configured_deg", gap.as_configured_deg),
            ("recalibrated_deg", gap.recalibrated_deg),
            ("explained_deg", gap.explained_deg),
            ("noise_floor_deg", gap.noise_floor_deg),
            ("p_unknown", document.unknown.probability),
        ];
        let effects = document.effects.iter();
        let effects = effects.map(|e| (format!("p_{}", e.name), e.probability));
        let named = named.into_iter().chain(GAINS.into_iter().zip(gains));
        let named = named.map(|(name, value)| (name.to_owned(), value));
        let numbers = named.chain(effects);
        self.numbers = numbers.filter(|(_, value)| value.is_finite()).collect();
    }
}

/// Rows as the columns of a table, texts first.
pub fn table(rows: &[FleetRow]) -> Vec<(String, Column)> {
    let object = |row| serde_json::to_value(row).unwrap_or_default();
    let objects: Vec<Value> = rows.iter().map(object).collect();
    let cells = objects.iter().filter_map(Value::as_object).flatten();
    let names = cells.map(|(name, value)| (value.is_number(), name));
    let names: BTreeSet<(bool, &String)> = names.collect();
    let text = |cell: &Value| cell.as_str().unwrap_or_default().to_owned();
    let column = |(number, name): (bool, &String)| {
        let cells = objects.iter().map(|object| &object[name.as_str()]);
        let column = if number {
            Column::Numbers(cells.map(|c| c.as_f64().unwrap_or(f64::NAN)).collect())
        } else {
            Column::Texts(cells.map(text).collect())
        };
        (name.clone(), column)
    };
    names.into_iter().map(column).collect()
}

/// Rows of a table.
///
/// # Errors
/// A column that is missing or has the wrong type.
pub fn rows(table: &[(String, Column)]) -> Result<Vec<FleetRow>, serde_json::Error> {
    let length = |column: &Column| match column {
        Column::Numbers(all) => all.len(),
        Column::Texts(all) => all.len(),
    };
    let cell = |column: &Column, k: usize| match column {
        Column::Numbers(all) => all[k].is_finite().then(|| all[k].into()),
        Column::Texts(all) => Some(all[k].as_str().into()),
    };
    let row = |k| {
        let named = |(name, column): &(String, _)| Some((name.clone(), cell(column, k)?));
        let cells: Map<String, Value> = table.iter().filter_map(named).collect();
        serde_json::from_value(Value::Object(cells))
    };
    let rows = table.iter().map(|(_, column)| length(column)).min();
    (0..rows.unwrap_or(0)).map(row).collect()
}
