//! A simulator beside a log: the JSON file, and the answer in words.

use crate::diagnosis::tip::fit::CLAIM_DEG;
use crate::diagnosis::tip::observed::{Depends, Observed};
use crate::diagnosis::tip::{Diagnosis, goes_with};
use crate::experiment::compare::{Compared, Fitted};
use crate::report::gap::words;
use crate::report::table::table;
use serde::Serialize;

/// The JSON file.
#[derive(Serialize)]
pub struct Document {
    schema: u32,
    plant: PlantEntry,
    nominal_deg: f64,
    diagnosed_deg: f64,
    noise_floor_deg: f64,
    goes_with: Vec<Depends>,
    params: Vec<Fitted>,
}

#[derive(Serialize)]
struct PlantEntry {
    name: String,
    rmse_deg: f64,
    kinds: Vec<KindEntry>,
}

#[derive(Serialize)]
struct KindEntry {
    name: &'static str,
    rmse_deg: f64,
    nominal_deg: f64,
    diagnosed_deg: f64,
}

/// The result; `name` is the simulator's.
pub fn document(
    log: &Observed,
    name: String,
    compared: Compared,
    diagnosis: &Diagnosis,
) -> Document {
    let kinds = log.quantities().map(|q| {
        let known = diagnosis.location.kinds.iter().find(|k| k.name == q.name());
        KindEntry {
            name: q.name(),
            rmse_deg: compared.held_out.rmse_deg[q],
            nominal_deg: known.map_or(0.0, |k| k.rmse_deg),
            diagnosed_deg: known.map_or(0.0, |k| k.explained_deg),
        }
    });
    Document {
        schema: 1,
        plant: PlantEntry {
            name,
            rmse_deg: log.rms_deg(compared.held_out.energy()),
            kinds: kinds.collect(),
        },
        nominal_deg: diagnosis.gap.recalibrated_deg,
        diagnosed_deg: diagnosis.gap.explained_deg,
        noise_floor_deg: diagnosis.gap.noise_floor_deg,
        goes_with: goes_with(log, &compared.held_out),
        params: compared.params,
    }
}

/// The answer, and whether it is better than no simulator.
pub fn said(d: &Document) -> (String, bool) {
    let (left, floor) = (d.plant.rmse_deg, d.noise_floor_deg);
    let within = |k: &KindEntry| k.rmse_deg - k.diagnosed_deg < CLAIM_DEG;
    let fits = left - floor < CLAIM_DEG && d.plant.kinds.iter().all(within);
    let sentence = match (fits, left < d.nominal_deg) {
        (true, _) => "The simulator fits the log",
        (_, true) => "The simulator is nearer to the log than the nominal model, but not all of it",
        _ => "The simulator does not fit the log, the nominal model is nearer",
    };
    let mut text = format!(
        "{sentence}: it leaves {left:.2}°, the nominal model {:.2}°, the diagnosed one {:.2}°; noise alone is {floor:.2}°.\n",
        d.nominal_deg, d.diagnosed_deg
    );
    for p in &d.params {
        let [low, high] = p.ci95;
        let nothing = ": it changes nothing here; is its name right?";
        let told = if p.untold { nothing } else { "" };
        let (name, value) = (&p.name, p.value);
        text += &format!("{name} = {value:.4}, 95 %: {low:.4} to {high:.4}{told}\n");
    }
    if !fits {
        text.extend(d.goes_with.iter().map(|d| words::goes_with(d) + "\n"));
    }
    let row = |k: &KindEntry| {
        let unit = words::unit_of(k.name);
        let [a, b, c] =
            [k.rmse_deg, k.nominal_deg, k.diagnosed_deg].map(|x| format!("{x:.2}{unit}"));
        [k.name.to_owned(), a, b, c]
    };
    let header = "left-out RMSE|simulator|nominal|diagnosed";
    let table = table(header, 1..4, d.plant.kinds.iter().map(row));
    (format!("{text}{table}\n"), fits || left < d.nominal_deg)
}
