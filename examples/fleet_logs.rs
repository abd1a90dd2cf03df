//! Simulates the logs of a fleet in four lots, three of which have an effect of their own:
//! `cargo run --release --example fleet_logs -- FOLDER [LOGS [SEED]]`.
//!
//! One unit in 25 of every lot has an effect at random. In lot B, one in four leaks. In lot C, the cable of one in four is
//! stiff. In lot D, lines become slower over the year: none in January, every second one in December.
#![allow(
    clippy::expect_used,
    reason = "a tool that may stop at the first error"
)]

use flate2::Compression;
use flate2::write::GzEncoder;
use rand::rngs::StdRng;
use rand::{Rng, RngExt, SeedableRng};
use rayon::prelude::*;
use retroflex::experiment::exam::{Content, Question};
use retroflex::log::bend_log::BendLog;
use retroflex::service::record::{HEADER, write_values};
use retroflex::simulation::plant::effect_names;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let folder = PathBuf::from(
        args.first()
            .expect("usage: fleet_logs FOLDER [LOGS [SEED]]"),
    );
    let number = |k: usize, usual: u64| {
        args.get(k)
            .map_or(usual, |text| text.parse().expect("a whole number"))
    };
    let (logs, seed) = (number(1, 1000), number(2, 1));
    eprintln!("seed {seed}");
    let mut rng = StdRng::seed_from_u64(seed);
    let names: Vec<&'static str> = effect_names()
        .filter(|e| e.in_catalogue)
        .map(|e| e.name)
        .collect();
    let (mut units, mut truth) = ("log,unit,lot,date\n".to_owned(), "log,names\n".to_owned());
    let mut asked = Vec::new();
    for n in 0..logs {
        let (lot, month) = (
            ["A", "B", "C", "D"][n as usize % 4],
            rng.random_range(1..=12),
        );
        let mut effects = Vec::new();
        if rng.random_bool(0.04) {
            effects.push(names[rng.random_range(0..names.len())]);
        }
        let own = match lot {
            "B" => ("leak", 0.25),
            "C" => ("cable_stiffness", 0.25),
            "D" => ("line_lag", f64::from(month - 1) / 22.0),
            _ => ("leak", 0.0),
        };
        if rng.random_bool(own.1) && !effects.contains(&own.0) {
            effects.push(own.0);
        }
        let log = format!("{lot}/{n:05}.csv.gz");
        // writing to a `String` cannot fail
        let _ = writeln!(
            units,
            "{log},{n:05},{lot},2026-{month:02}-{:02}",
            rng.random_range(1..=28)
        );
        let _ = writeln!(truth, "{log},{}", effects.join("+"));
        asked.push((
            folder.join(log),
            Question {
                content: Content::Single,
                names: effects,
                lab: false,
                seed: rng.next_u64(),
            },
        ));
    }
    for lot in ["A", "B", "C", "D"] {
        fs::create_dir_all(folder.join(lot)).expect("the folder can be created");
    }
    fs::write(folder.join("units.table"), units).expect("the folder can be written to");
    fs::write(folder.join("truth.table"), truth).expect("the folder can be written to");
    asked.par_iter().for_each(|(path, question)| {
        write(path, &question.draw().expect("the plants can run").log)
    });
}

fn write(path: &Path, log: &BendLog) {
    let mut text = HEADER.as_bytes().to_vec();
    let imu = log.imu.as_ref().expect("every question has an IMU");
    for k in 0..log.t_s.len() {
        let vectors = [
            log.command[k],
            log.piston_mm[k],
            imu.acc[k],
            imu.gyr[k],
            imu.mag[k],
        ];
        let mut row = vec![f64::NAN; HEADER.split(',').count()];
        row[0] = log.t_s[k];
        row[1..16].copy_from_slice(vectors.map(<[f64; 3]>::from).as_flattened());
        // as many digits as the sensors have
        row.iter_mut().for_each(|x| *x = (*x * 1e6).round() / 1e6);
        write_values(&mut text, &row);
        text.push(b'\n');
    }
    let mut file = GzEncoder::new(
        File::create(path).expect("the folder can be written to"),
        Compression::fast(),
    );
    file.write_all(&text)
        .and_then(|()| file.finish().map(drop))
        .expect("the disk has space");
}
