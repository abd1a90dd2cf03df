//! The modes: the drawing in ARCHITECTURE.md and the table of the code are the same, and there is no
//! other way from mode to mode.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::repo;
use retroflex::supervisor::mode::{Event, Mode, Modes, TABLE};
use std::collections::BTreeSet;

type Arrow = (String, String, String);

/// The arrows of the state diagram.
fn drawn() -> BTreeSet<Arrow> {
    let text = std::fs::read_to_string(repo("ARCHITECTURE.md")).unwrap();
    let diagram = text.split("```mermaid").nth(1).unwrap().split("```").next().unwrap();
    let arrows = diagram.lines().filter(|l| l.contains("-->") && !l.contains("[*]"));
    arrows
        .map(|l| {
            let (from, rest) = l.split_once("-->").unwrap();
            let (to, event) = rest.split_once(':').unwrap();
            (from.trim().to_lowercase(), event.trim().to_owned(), to.trim().to_lowercase())
        })
        .collect()
}

/// The arrows that the code goes, found by trying every event in every mode.
fn gone() -> BTreeSet<Arrow> {
    let mut all = BTreeSet::new();
    for mode in Mode::ALL {
        for event in Event::ALL {
            let Some(mut modes) = reach(mode) else { panic!("{mode} is not to be reached") };
            let led = modes.leads(event);
            let taken = modes.take(event);
            assert_eq!(taken, led.is_some());
            assert_eq!(modes.now(), led.unwrap_or(mode), "what is refused changes nothing");
            if taken {
                all.insert((mode.name().to_owned(), event.name().to_owned(), modes.now().name().to_owned()));
            }
        }
    }
    all
}

/// Modes that have come to a mode by events alone.
fn reach(goal: Mode) -> Option<Modes> {
    let mut seen = vec![Modes::default()];
    let mut next = 0;
    while next < seen.len() {
        let from = seen[next];
        if from.now() == goal {
            return Some(from);
        }
        for event in Event::ALL {
            let mut to = from;
            if to.take(event) && seen.iter().all(|s| s.now() != to.now()) {
                seen.push(to);
            }
        }
        next += 1;
    }
    None
}

#[test]
fn the_drawing_and_the_code_agree() {
    let (drawn, gone) = (drawn(), gone());
    assert!(gone.len() > 25);
    assert_eq!(drawn.difference(&gone).collect::<Vec<_>>(), Vec::<&Arrow>::new(), "drawn, but not in the code");
    assert_eq!(gone.difference(&drawn).collect::<Vec<_>>(), Vec::<&Arrow>::new(), "in the code, but not drawn");
}

#[test]
fn no_event_leads_two_ways_and_every_row_is_used() {
    let pairs: BTreeSet<_> = TABLE.iter().map(|(from, on, _)| (from.name(), on.name())).collect();
    assert_eq!(pairs.len(), TABLE.len());
    assert_eq!(gone().len(), TABLE.len());
}

#[test]
fn every_mode_in_which_something_can_go_wrong_can_fault_and_every_fault_can_be_left() {
    for mode in Mode::ALL {
        let modes = reach(mode).unwrap();
        let can_trip = modes.leads(Event::Trip) == Some(Mode::Faulted);
        assert_eq!(can_trip, !matches!(mode, Mode::Boot | Mode::Faulted), "{mode}");
    }
    let faulted = reach(Mode::Faulted).unwrap();
    for way_out in [Event::Reset, Event::ResetUnaligned, Event::Relax] {
        assert!(faulted.leads(way_out).is_some());
    }
    // nothing but a command arms, and only from rest
    let armed: Vec<_> = TABLE.iter().filter(|(from, _, to)| !from.moves() && to.moves()).collect();
    assert_eq!(armed, [&(Mode::Disarmed, Event::Arm, Mode::Holding), &(Mode::Relaxing, Event::Stop, Mode::Holding)]);
}
