//! Logs of healthy sensors on machines with any effect: none has wrong axes, units or wiring.
//!
//! Units of the built-in plant and of the plant in C, with each effect that they know alone; no log was looked at when the bars were chosen.

use crate::plant_in_c::{Case, Cold, arguments, calibration, compiled, variable};
use rayon::prelude::*;
use retroflex::diagnosis::plausibility::check;
use retroflex::experiment::exam::{Content, questions, record};
use retroflex::model::Geometry;
use retroflex::model::effects::by_catalogue;
use retroflex::simulation::link::Link;
use retroflex::simulation::plant::effect_names;
use std::process::Command;

#[test]
fn no_log_of_the_built_in_plant_is_refused() {
    let names = by_catalogue(effect_names().map(|e| e.name));
    let seed = variable("RETROFLEX_SEED", 7100);
    let asked = questions(seed, 1, &names);
    let alone = asked.into_iter().filter(|q| {
        !q.lab
            && matches!(
                q.content,
                Content::None | Content::Single | Content::Outside
            )
    });
    let alone: Vec<_> = alone.collect();
    let refused = alone.par_iter().filter_map(|q| {
        let logs = q.draw().unwrap();
        let finding = check(&logs.log, &Geometry::default(), &logs.lines).err();
        finding.map(|why| format!("{:?} {}: {why}", q.names, q.seed))
    });
    let refused: Vec<_> = refused.collect();
    println!("{} of {} refused, seed {seed}", refused.len(), alone.len());
    assert!(refused.is_empty(), "{}", refused.join("\n"));
}

#[test]
fn no_log_of_the_plant_in_c_is_refused() {
    let Some(folder) = compiled() else { return };
    let plant = folder.path().join("plant");
    let listed = Command::new(&plant).arg("--list").output().unwrap();
    let listed = String::from_utf8(listed.stdout).unwrap().leak();
    let effects = listed
        .lines()
        .filter_map(|line| line.split_whitespace().next());
    let first = variable("RETROFLEX_SEED", 131);
    let cases: Vec<Case> = effects
        .flat_map(|effect| (first..first + 2).map(move |seed| (effect, seed)))
        .map(|(effect, seed)| Case {
            effect,
            value: None,
            seed,
            cold: Cold::Own,
        })
        .collect();
    let refused = cases.par_iter().filter_map(|case| {
        let lines = calibration(&plant, case).lines();
        let machine = |_| Link::start(plant.to_str().unwrap(), &arguments(case));
        let log = record::record(machine, &lines, case.seed, false).unwrap();
        let finding = check(&log, &Geometry::default(), &lines).err();
        finding.map(|why| format!("{case:?}: {why}"))
    });
    let refused: Vec<_> = refused.collect();
    println!(
        "{} of {} refused, units {first} and the next",
        refused.len(),
        cases.len()
    );
    assert!(refused.is_empty(), "{}", refused.join("\n"));
}
