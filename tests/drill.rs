//! Every fault in flight is survived as promised; of those of the process, the quick ones.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{repo, twin};
use retroflex::config::gains::Gains;
use retroflex::config::source;
use retroflex::drill::bench::Make;
use retroflex::drill::run::{Allowance, fly};
use retroflex::drill::{list, soak};

fn make() -> Make {
    Make { board: twin(), calibration: source::read(&repo("calib/paper.toml")).unwrap(), gains: Gains::default() }
}

#[test]
fn every_fault_in_flight_is_survived() {
    let make = make();
    let allowance = Allowance::new(&make).unwrap();
    let rows: Vec<_> = list::specs().iter().map(|s| fly(&make, s, &allowance).unwrap()).collect();
    let bad: Vec<String> = rows.iter().filter(|r| !r.ok).map(|r| format!("{}: {}", r.fault, r.why)).collect();
    println!("{bad:#?}");
    assert!(bad.is_empty(), "{bad:#?}");
    assert!(rows.len() >= 33);
    // a turn of the base is called that, and no line is blamed for it
    let base = rows.iter().find(|r| r.fault == "base_turned").unwrap();
    assert!(base.message.contains("base"), "{}", base.message);
}

#[test]
fn a_fault_that_nothing_notices_is_a_failed_row() {
    // the judge is no rubber stamp: a strike that does nothing is not noticed
    let make = make();
    let allowance = Allowance::new(&make).unwrap();
    let mut specs = list::specs();
    let spec = specs.iter_mut().find(|s| s.name == "burst").unwrap();
    spec.strike = list::Strike::Stall(0.0);
    let row = fly(&make, spec, &allowance).unwrap();
    assert!(!row.ok && row.why.contains("not noticed"), "{}", row.why);
}

#[test]
fn a_short_soak_stays_within_its_guards() {
    let soak = soak::run(&make(), 0.3, 3, &mut |_| ()).unwrap();
    // other tests of this process take memory, too: that it stays flat is for the command to say
    let why: Vec<_> = soak.why.iter().filter(|w| !w.starts_with("memory")).collect();
    assert!(why.is_empty(), "{why:?}");
    assert!(soak.poses > 100 && soak.faults > 10, "{soak:?}");
}
