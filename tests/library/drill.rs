//! Every fault in flight is survived as claimed. The faults of the process run with `retroflex drill`.

use crate::common::paper_bench;
use retroflex::drill::run::{Allowance, fly};
use retroflex::drill::spec::Injection;
use retroflex::drill::{list, soak};

#[test]
fn every_fault_in_flight_is_survived() {
    let config = paper_bench();
    let allowance = Allowance::new(&config).unwrap();
    let rows: Vec<_> = list::specs()
        .iter()
        .map(|s| fly(&config, s, &allowance).unwrap())
        .collect();
    for r in rows.iter().filter(|r| r.fault.starts_with("base_imu")) {
        println!(
            "{}: {:?} s, {:.1} then {:.1} deg, {} {}",
            r.fault, r.detected_s, r.error_deg_during, r.error_deg_after, r.state, r.why
        );
    }
    let failed: Vec<String> = rows
        .iter()
        .filter(|r| !r.ok)
        .map(|r| format!("{}: {}", r.fault, r.why))
        .collect();
    assert!(failed.is_empty(), "{failed:#?}");
    assert!(rows.len() >= 40, "only {} faults", rows.len());
    assert!(rows.iter().all(|r| r.requires.contains("detected within")));
    // a turn of the base at a held pose is not attributed to a line
    let base = rows.iter().find(|r| r.fault == "base_turned").unwrap();
    assert!(base.message.contains("base"), "{}", base.message);
}

#[test]
fn a_fault_without_detection_fails_its_row() {
    let config = paper_bench();
    let allowance = Allowance::new(&config).unwrap();
    let mut spec = list::specs()
        .into_iter()
        .find(|s| s.name == "burst")
        .unwrap();
    spec.injection = Injection::Stall(0.0);
    let row = fly(&config, &spec, &allowance).unwrap();
    assert!(!row.ok && row.why.contains("not detected"), "{}", row.why);
}

#[test]
fn a_short_soak_meets_its_requirements() {
    let soak = soak::run(&paper_bench(), 0.3, 3, &mut |_| ()).unwrap();
    // other tests in this process also allocate memory, so that its growth is assessed only by the command
    let why: Vec<_> = soak
        .why
        .iter()
        .filter(|w| !w.starts_with("memory"))
        .collect();
    assert!(why.is_empty(), "{why:?}");
    assert!(soak.poses > 100 && soak.faults > 10, "{soak:?}");
}
