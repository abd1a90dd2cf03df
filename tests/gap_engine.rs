//! The diagnosis on logs of the built-in plant, whose forms it does not share.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use retroflex::diagnosis::diagnose::diagnose;
use retroflex::diagnosis::exam::mark::mark;
use retroflex::diagnosis::exam::question::{Holds, Question, paper};
use retroflex::diagnosis::exam::sit;
use retroflex::diagnosis::observe::Observed;
use retroflex::model::effects::catalogue;

fn question(holds: Holds, names: &[&'static str], lab: bool, seed: u64) -> Question {
    Question { holds, names: names.to_vec(), lab, seed }
}

#[test]
fn a_paper_asks_every_effect_and_is_the_same_for_a_seed() {
    let asked = paper(5, 1);
    assert_eq!(asked, paper(5, 1));
    assert_ne!(asked, paper(6, 1));
    for e in catalogue() {
        for lab in [true, false] {
            assert!(asked.iter().any(|q| q.holds == Holds::Single && q.names == [e.name()] && q.lab == lab), "{} {lab}", e.name());
        }
    }
    assert!(asked.iter().filter(|q| q.holds == Holds::None).count() >= 20);
    assert!(asked.iter().all(|q| q.holds != Holds::Pair || q.names[0] != q.names[1]));
}

#[test]
fn one_cause_none_and_their_marks() {
    let asked = [
        question(Holds::Single, &["curvature"], true, 11),
        question(Holds::Single, &["hard_iron"], false, 12),
        question(Holds::None, &[], false, 13),
    ];
    let answers = sit(&asked, &catalogue(), || {}).unwrap();
    for (q, a) in asked.iter().zip(&answers) {
        let v = &a.diagnosis.verdict;
        assert_eq!(v.names, q.names, "{:?} {:?}", q.names, v);
        assert_eq!(v.kind, if q.names.is_empty() { "none" } else { "effects" });
        let shares = &a.diagnosis.location.stages;
        assert_eq!(shares.len(), 7);
        assert!((shares.iter().map(|s| s.share).sum::<f64>() - 1.0).abs() < 1e-9);
    }
    assert_eq!(answers[0].diagnosis.location.stages[0].name, "shape");
    assert!(answers[0].fresh_closed > 0.8, "{}", answers[0].fresh_closed);
    let e = &answers[0].diagnosis.effects[0];
    assert!(e.closed_ci95[0] <= e.closed && e.closed <= e.closed_ci95[1] && e.probability > 0.5);
    let sheet = mark(1, &asked, &answers);
    assert_eq!((sheet.diagnosis.single.lab.right, sheet.diagnosis.single.field.right), (1, 1));
    assert_eq!((sheet.diagnosis.alarm.field.right, sheet.diagnosis.alarm.field.of), (0, 1));
    assert_eq!(sheet.stage.lab.right, 1);
}

#[test]
fn the_same_log_gives_the_same_document() {
    let logs = question(Holds::Single, &["accel_bias"], false, 21).draw().unwrap();
    let log = Observed::new(&logs.log).unwrap();
    let text = || serde_json::to_string(&diagnose(&log, &catalogue(), &logs.lines, 1).document).unwrap();
    assert_eq!(text(), text());
}
