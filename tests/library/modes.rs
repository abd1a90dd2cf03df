//! The modes: ARCHITECTURE.md and the code contain the same transitions.

use crate::common::repo;
use retroflex::supervisor::mode::{Event, Mode, TABLE};
use std::collections::BTreeSet;

type Transition = (String, String, String);

/// Transitions of the state diagram in ARCHITECTURE.md.
fn documented() -> BTreeSet<Transition> {
    let text = std::fs::read_to_string(repo("ARCHITECTURE.md")).unwrap();
    let diagram = text
        .split("```mermaid")
        .nth(1)
        .unwrap()
        .split("```")
        .next()
        .unwrap();
    let lines = diagram
        .lines()
        .filter(|l| l.contains("-->") && !l.contains("[*]"));
    lines
        .map(|l| {
            let (from, rest) = l.split_once("-->").unwrap();
            let (to, event) = rest.split_once(':').unwrap();
            (
                from.trim().to_lowercase(),
                event.trim().to_owned(),
                to.trim().to_lowercase(),
            )
        })
        .collect()
}

/// Transitions of the code, found by trying every event in every mode.
fn implemented() -> BTreeSet<Transition> {
    let pairs = Mode::ALL
        .into_iter()
        .flat_map(|mode| Event::ALL.map(move |event| (mode, event)));
    pairs
        .filter_map(|(mode, event)| {
            Some((
                mode.name().into(),
                event.name().into(),
                mode.after(event)?.name().into(),
            ))
        })
        .collect()
}

/// Modes that events alone lead to, starting from `boot`.
fn reachable() -> BTreeSet<&'static str> {
    let mut seen = BTreeSet::from([Mode::Boot.name()]);
    for _ in Mode::ALL {
        let next = TABLE
            .iter()
            .filter(|(_, from, _)| from.iter().any(|mode| seen.contains(mode.name())))
            .map(|(_, _, to)| to.name());
        seen.extend(next.collect::<Vec<_>>());
    }
    seen
}

#[test]
fn the_state_diagram_and_the_code_agree() {
    let (documented, implemented) = (documented(), implemented());
    let only_documented: Vec<_> = documented.difference(&implemented).collect();
    let only_implemented: Vec<_> = implemented.difference(&documented).collect();
    assert!(
        only_documented.is_empty(),
        "only in the diagram: {only_documented:?}"
    );
    assert!(
        only_implemented.is_empty(),
        "only in the code: {only_implemented:?}"
    );
}

#[test]
fn transitions_are_unique_and_every_mode_is_reachable() {
    let events: BTreeSet<_> = TABLE.iter().map(|(on, ..)| on.name()).collect();
    assert_eq!(
        (events.len(), TABLE.len()),
        (Event::ALL.len(), Event::ALL.len())
    );
    for (on, from, _) in TABLE {
        let modes: BTreeSet<_> = from.iter().map(|mode| mode.name()).collect();
        assert_eq!(modes.len(), from.len(), "{on}");
    }
    assert_eq!(reachable().len(), Mode::ALL.len());
}

#[test]
fn every_mode_but_boot_can_fault_and_every_fault_can_be_left() {
    for mode in Mode::ALL {
        let can_trip = mode.after(Event::Trip) == Some(Mode::Faulted);
        assert_eq!(
            can_trip,
            !matches!(mode, Mode::Boot | Mode::Faulted),
            "{mode}"
        );
    }
    for way_out in [Event::Reset, Event::ResetUnaligned, Event::Relax] {
        assert!(Mode::Faulted.after(way_out).is_some());
    }
    // motion begins only with `arm`, or where `stop` ends a return to rest
    let armed: Vec<_> = TABLE
        .iter()
        .filter(|(_, _, to)| to.moves())
        .flat_map(|(on, from, to)| from.iter().map(|from| (*from, *on, *to)))
        .filter(|(from, _, _)| !from.moves())
        .collect();
    assert_eq!(
        armed,
        [
            (Mode::Disarmed, Event::Arm, Mode::Holding),
            (Mode::Relaxing, Event::Stop, Mode::Holding)
        ]
    );
}
