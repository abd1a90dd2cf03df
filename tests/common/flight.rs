//! Flights of the simulated machine that are written as flight logs.

use super::{repo, twin};
use retroflex::config::calib::Calibration;
use retroflex::config::gains::Gains;
use retroflex::config::{show, source};
use retroflex::drill::bench::Bench;
use retroflex::service::flight::file::FlightFile;
use retroflex::service::flight::start::{Event, Logged, hash};
use retroflex::service::start::{RunConfig, Start};
use retroflex::service::store::Belief;
use retroflex::supervisor::cycle::order::Order;
use std::path::Path;
use std::sync::Arc;

/// Flies for a time, s, and logs it; `script` receives the number of each cycle and gives the order for it. Returns the cycles and
/// the bytes of the log. Equal arguments give equal files.
pub fn fly(
    path: &Path,
    gains: Gains,
    duration_s: f64,
    mut script: impl FnMut(u64, &mut Bench) -> Option<Order>,
) -> (u64, u64) {
    let calibration: Calibration = source::read(&repo("calib/paper.toml")).unwrap();
    let board = twin();
    let config = super::bench(&board, &calibration, &gains);
    let mut bench = config.bench(3, 5).unwrap();
    let texts = vec![
        show::compact(&board),
        show::compact(&gains),
        show::compact(&calibration),
    ];
    let supervisor = config.supervisor;
    let start = Start {
        config: supervisor.clone(),
        restart: None,
        belief: Belief::Certain,
        unverified: false,
    };
    let service = board.service.clone();
    let config_hash = hash(texts.iter().map(String::as_str));
    let run = RunConfig {
        supervisor,
        service,
        board,
        gains: None,
        calibration,
        calib: None,
        feedforward: None,
        tip: String::new(),
        config_hash,
        texts,
    };
    let mut events = vec![Arc::new(Event::Start(start.header(&run, "bench")))];
    let mut file = FlightFile::create(path, 0).unwrap();
    let cycles = (duration_s / bench.period_s) as u64;
    for number in 0..cycles {
        let order = script(number, &mut bench);
        let output = bench.turn(order).unwrap();
        file.write(&Logged {
            number,
            events: std::mem::take(&mut events),
            output,
        })
        .unwrap();
        if number % 500 == 499 {
            file.flush(false).unwrap();
        }
    }
    file.finish().unwrap();
    (cycles, std::fs::metadata(path).unwrap().len())
}
