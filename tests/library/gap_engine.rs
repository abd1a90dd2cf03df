//! The diagnosis on logs of the built-in plant, whose laws differ in form from the catalogue's.

use crate::plant_in_c::{Case, Cold, arguments, calibration, compiled};
use retroflex::diagnosis::tip::observed::Observed;
use retroflex::diagnosis::tip::{Diagnosis, ParamValue, Rig, SavedModel, TipProblem, check};
use retroflex::diagnosis::verdict::VerdictKind;
use retroflex::diagnosis::{Judgement, Problem, diagnose, search, statements};
use retroflex::experiment::exam::record;
use retroflex::experiment::exam::run::run;
use retroflex::experiment::exam::{Content, Question, questions, score};
use retroflex::log::bend_log::BendLog;
use retroflex::model::effects::{by_catalogue, catalogue};
use retroflex::simulation::link::Link;
use retroflex::simulation::plant::effect_names;
use std::collections::BTreeSet;

fn question(content: Content, names: &[&'static str], lab: bool, seed: u64) -> Question {
    Question {
        content,
        names: names.to_vec(),
        lab,
        seed,
    }
}

#[test]
fn an_exam_asks_about_every_effect_and_is_reproducible() {
    let names = by_catalogue(effect_names().map(|e| e.name));
    let asked = questions(5, 1, &names);
    assert_eq!(asked, questions(5, 1, &names));
    assert_ne!(asked, questions(6, 1, &names));
    for e in catalogue() {
        for lab in [true, false] {
            assert!(
                asked
                    .iter()
                    .any(|q| q.content == Content::Single && q.names == [e.name()] && q.lab == lab),
                "{} {lab}",
                e.name()
            );
        }
    }
    assert!(asked.iter().filter(|q| q.content == Content::None).count() >= 20);
    assert!(
        asked
            .iter()
            .all(|q| q.content != Content::Pair || q.names[0] != q.names[1])
    );
}

/// Every feature has a weight, and every weight a feature.
#[test]
fn the_weights_are_those_of_the_features() {
    let logs = question(Content::Single, &["leak"], true, 14)
        .draw()
        .unwrap();
    let log = Observed::new(&logs.log, &Rig::default()).unwrap();
    let problem = TipProblem::new(&log, catalogue(), &logs.lines, 1);
    let said = statements(&problem, &search(&problem));
    let names = said.iter().flat_map(|s| &s.features).map(|(name, _)| name);
    let forms = catalogue().iter().map(|e| format!("form_{}", e.name()));
    let known: BTreeSet<String> = names.cloned().chain(forms).collect();
    let weights: BTreeSet<String> = TipProblem::head().weight.keys().cloned().collect();
    assert_eq!(known, weights);
}

#[test]
fn a_single_effect_and_none_are_recognised_and_scored() {
    let asked = [
        question(Content::Single, &["curvature"], true, 11),
        question(Content::Single, &["hard_iron"], false, 12),
        question(Content::None, &[], false, 13),
    ];
    let answers = run(&asked, Question::draw, || {}).unwrap();
    for (q, a) in asked.iter().zip(&answers) {
        let v = &a.diagnosis.verdict;
        assert_eq!(v.names, q.names, "{:?} {:?}", q.names, v);
        assert_eq!(
            v.kind,
            if q.names.is_empty() {
                VerdictKind::None
            } else {
                VerdictKind::Effects
            }
        );
        let shares = &a.diagnosis.location.stages;
        assert_eq!(shares.len(), 7);
        let sum: f64 = shares.iter().map(|s| s.share).sum();
        let whole = if q.names.is_empty() { 0.0 } else { 1.0 };
        assert!((sum - whole).abs() < 1e-9, "{:?}: {sum}", q.names);
    }
    assert_eq!(answers[0].diagnosis.location.stages[0].name, "shape");
    assert!(answers[0].fresh_closed > 0.8, "{}", answers[0].fresh_closed);
    let e = &answers[0].diagnosis.effects[0];
    assert!(e.closed_ci95[0] <= e.closed && e.closed <= e.closed_ci95[1] && e.probability > 0.5);
    let score = score(1, &asked, &answers);
    assert_eq!(
        (
            score.diagnosis.single.lab.right,
            score.diagnosis.single.field.right
        ),
        (1, 1)
    );
    assert_eq!(
        (
            score.diagnosis.alarm.field.right,
            score.diagnosis.alarm.field.of
        ),
        (0, 1)
    );
    assert_eq!(score.stage.lab.right, 1);
}

#[test]
fn several_logs_of_a_unit_are_diagnosed_together() {
    let leak = question(Content::Single, &["leak"], false, 31)
        .draw()
        .unwrap();
    let observed = |log| Observed::new(log, &Rig::default()).unwrap();
    let [first, second] = [&leak.log, &leak.fresh].map(observed);
    let mut both = first.clone();
    both.append(second.clone());
    assert_eq!(both.bins.len(), first.bins.len() + second.bins.len());
    let of = |log: &Observed| diagnose(&TipProblem::new(log, catalogue(), &leak.lines, 1)).document;
    let [one, two, all] = [&first, &second, &both].map(of);
    assert_eq!(all.verdict.names, ["leak"]);
    assert_eq!((one.logs.len(), all.logs.len()), (1, 2));
    for (alone, part) in [&one, &two].iter().zip(&all.logs) {
        let [a, b] = [alone.gap.recalibrated_deg, part.recalibrated_deg];
        assert!(
            (a / b - 1.0).abs() < 0.25,
            "each log keeps its own gap: {a} alone, {b} together"
        );
        assert!(part.explained_deg < 0.5 * part.recalibrated_deg, "{part:?}");
    }
    // more evidence makes a narrower interval
    let width = |d: &Diagnosis| d.effects[0].params[0].ci95[1] - d.effects[0].params[0].ci95[0];
    assert!(
        width(&all) < width(&one).min(width(&two)),
        "{} {} {}",
        width(&one),
        width(&two),
        width(&all)
    );
}

#[test]
fn an_event_of_one_log_stays_in_that_log() {
    let lost = question(Content::Single, &["missed_steps"], true, 32)
        .draw()
        .unwrap();
    // the same seed draws the same unit
    let healthy = question(Content::None, &[], true, 32).draw().unwrap();
    let observed = |log| Observed::new(log, &Rig::default()).unwrap();
    let mut both = observed(&healthy.log);
    let later_s = both.duration_s();
    both.append(observed(&lost.log));
    let d = diagnose(&TipProblem::new(&both, catalogue(), &lost.lines, 1)).document;
    assert_eq!(d.verdict.names, ["missed_steps"], "{:?}", d.logs);
    let events = d.effects[0].params.chunks_exact(4);
    let lost_mm = |e: &[ParamValue]| e[1..].iter().map(|p| p.value.abs()).fold(0.0, f64::max);
    assert!(
        events
            .filter(|e| lost_mm(e) > 0.3)
            .all(|e| e[0].value > later_s),
        "{:?}",
        d.effects[0].params
    );
}

/// Both move periodically, the first the base and the second the tip.
#[test]
fn a_sway_of_the_base_is_named_and_a_breath_of_the_tip_is_not_taken_for_one() {
    let Some(folder) = compiled() else { return };
    let plant = folder.path().join("plant");
    let first: u64 = std::env::var("RETROFLEX_SEED").map_or(41, |s| s.parse().unwrap());
    println!("RETROFLEX_SEED={first}");
    for (effect, lab, seed) in [
        ("base_motion.sway", false, first),
        ("base_motion.sway", true, first + 1),
        ("respiration", false, first + 2),
    ] {
        let case = Case {
            effect,
            value: None,
            seed,
            cold: Cold::Own,
        };
        let lines = calibration(&plant, &case).lines();
        let machine = |_| Link::start(plant.to_str().unwrap(), &arguments(&case));
        let log = record::record(machine, &lines, seed, lab).unwrap();
        let observed = Observed::new(&log, &Rig::default()).unwrap();
        let found = diagnose(&TipProblem::new(&observed, catalogue(), &lines, seed)).document;
        let sways = found.verdict.names.contains(&"base_motion");
        assert_eq!(
            sways,
            effect == "base_motion.sway",
            "{effect} {seed}: {:?}",
            found.verdict
        );
    }
}

/// A saved model on a fresh log of its unit, of the mended unit, and of others.
#[test]
fn a_check_tells_this_machine_from_another_and_from_a_mended_one() {
    let mut harmful = 0;
    for (effect, lab, seed) in [
        ("leak", false, 31),
        ("curvature", true, 45),
        ("creep", false, 52),
    ] {
        let drawn = |content, names: &[&'static str], seed| {
            question(content, names, lab, seed).draw().unwrap()
        };
        let observed = |log: &BendLog| Observed::new(log, &Rig::default()).unwrap();
        let sick = drawn(Content::Single, &[effect], seed);
        let log = observed(&sick.log);
        let done = diagnose(&TipProblem::new(&log, catalogue(), &sick.lines, 1));
        let model = SavedModel::new("log", &done);
        let judged = |log: &BendLog| check(&model, &observed(log));
        let same = judged(&sick.fresh);
        assert_eq!(same.judgement, Judgement::ThisMachine, "{effect} {same:?}");
        // the same seed draws the same unit
        let mended = judged(&drawn(Content::None, &[], seed).fresh);
        assert_ne!(
            mended.judgement,
            Judgement::ThisMachine,
            "{effect} {mended:?}"
        );
        harmful += usize::from(mended.judgement == Judgement::WorseThanNothing);
        let others =
            (1..=4).map(|k| judged(&drawn(Content::Single, &[effect], seed + 1000 * k).log));
        let told = others
            .filter(|c| c.judgement != Judgement::ThisMachine)
            .count();
        assert!(told >= 3, "{effect}: {told} of 4 other units are told");
    }
    // gains that went with the effect may not fit the mended machine either
    assert!(harmful >= 1, "{harmful} of 3 mended machines");
}

#[test]
fn equal_logs_give_equal_documents() {
    let logs = question(Content::Single, &["accel_bias"], false, 21)
        .draw()
        .unwrap();
    let log = Observed::new(&logs.log, &Rig::default()).unwrap();
    let text = || {
        serde_json::to_string(
            &diagnose(&TipProblem::new(&log, catalogue(), &logs.lines, 1)).document,
        )
        .unwrap()
    };
    assert_eq!(text(), text());
}

/// Training machines are made of deformed laws of the catalogue; the exam asks about the built-in plant, whose laws are others.
#[test]
fn training_and_exam_share_no_law() {
    let folder = format!("{}/examples/gap_train", env!("CARGO_MANIFEST_DIR"));
    let files: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|file| file.unwrap().path())
        .collect();
    assert!(files.len() > 3, "{files:?}");
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(
            !text.contains("simulation::plant") && !text.contains("simulation::sim"),
            "{} uses the built-in plant",
            file.display()
        );
    }
}
