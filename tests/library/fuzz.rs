//! No parser panics on any input. `RETROFLEX_FUZZ=1000000` sets the number of inputs per parser; the default is a short
//! run. The seeds in `tests/corpus` come from coverage-guided fuzzing of the same functions (`fuzz/`). An input that once
//! broke a parser belongs there too.

use crate::common::repo;
use crate::parsers::PARSERS;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use retroflex::primitives::units::{Seconds, Steps};
use retroflex::service::flight::cycle;
use retroflex::service::{memory, store};
use std::path::PathBuf;

/// Number of mutated inputs per parser.
fn inputs() -> u64 {
    std::env::var("RETROFLEX_FUZZ")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(4_000)
}

/// A random index below `n`, or 0 if `n` is 0.
fn below(dice: &mut StdRng, n: usize) -> usize {
    if n == 0 { 0 } else { dice.random_range(0..n) }
}

/// Text fragments that often break parsers.
const PIECES: [&str; 28] = [
    "nan",
    "-inf",
    "1e999",
    "-0",
    "99999999999999999999",
    "\"",
    "'''",
    "[",
    "]",
    "{",
    "}",
    "\n",
    "\r",
    ",",
    ",,",
    "=",
    "\0",
    "é",
    "\u{feff}",
    "true",
    "null",
    "0x",
    "1_000",
    "[[a]]",
    "\\u0000",
    "-",
    ".",
    "  ",
];

/// A seed with random changes, cuts, repetitions and parts of another seed.
fn mutate(dice: &mut StdRng, seeds: &[Vec<u8>]) -> Vec<u8> {
    let mut text = seeds[below(dice, seeds.len())].clone();
    for _ in 0..1 + below(dice, 6) {
        let at = below(dice, text.len() + 1);
        match below(dice, 8) {
            0 if !text.is_empty() => {
                let at = at.min(text.len() - 1);
                text[at] ^= 1 << below(dice, 8);
            }
            1 => text.truncate(at),
            2 => {
                text.insert(at, dice.random::<u8>());
            }
            3 => {
                let piece = PIECES[below(dice, PIECES.len())];
                text.splice(at..at, piece.bytes());
            }
            4 => {
                let to = (at + below(dice, 24)).min(text.len());
                text.drain(at..to);
            }
            5 => {
                let to = (at + below(dice, 40)).min(text.len());
                let part = text[at..to].to_vec();
                let into = below(dice, text.len() + 1);
                text.splice(into..into, part);
            }
            6 => {
                let other = &seeds[below(dice, seeds.len())];
                let from = below(dice, other.len() + 1);
                let cut = at.min(text.len());
                text.truncate(cut);
                text.extend_from_slice(&other[from..]);
            }
            _ => {
                let to = (at + 1 + below(dice, 3)).min(text.len());
                let piece = PIECES[below(dice, PIECES.len())];
                text.splice(at..to, piece.bytes());
            }
        }
    }
    text
}

/// The seeds of a parser: the corpus in the repository and `own`.
fn corpus(name: &str, own: &[&str]) -> Vec<Vec<u8>> {
    let folder: PathBuf = repo("tests/corpus").join(name);
    let mut seeds: Vec<Vec<u8>> = own.iter().map(|s| s.as_bytes().to_vec()).collect();
    for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
        seeds.push(std::fs::read(entry.path()).unwrap());
    }
    seeds
}

/// Parses every seed and then mutations. Some must be accepted and some refused, otherwise the test has no effect.
fn fuzz(name: &str, seeds: &[Vec<u8>]) {
    let (_, parse) = PARSERS.iter().find(|(n, _)| *n == name).unwrap();
    let (mut accepted, mut refused) = (0, 0);
    let mut dice = StdRng::seed_from_u64(name.len() as u64);
    let mut feed = |text: &[u8]| match std::panic::catch_unwind(|| parse(text)) {
        Ok(true) => accepted += 1,
        Ok(false) => refused += 1,
        Err(_) => {
            let saved = std::env::temp_dir().join(format!("retroflex-fuzz-{name}"));
            std::fs::write(&saved, text).unwrap();
            panic!(
                "{name} panicked; the input was saved as {}: add it to tests/corpus/{name}",
                saved.display()
            );
        }
    };
    seeds.iter().for_each(|s| feed(s));
    for _ in 0..inputs() {
        feed(&mutate(&mut dice, seeds));
    }
    eprintln!(
        "{name}: {} seeds, {accepted} accepted, {refused} refused",
        seeds.len()
    );
    assert!(
        accepted > 0 && refused > 0,
        "{name}: {accepted} accepted, {refused} refused"
    );
}

#[test]
fn toml_files_do_not_panic() {
    let small_board = "[limits]\ntravel_mm = 25.0\n[safety.on]\nlate = \"relax\"\n[service]\npriority = 5\n[plant.line]\nk_epsilon = [1.0, 2.0, 3.0]\n";
    let small_gains = "[loop]\nki_1_s = 10.0\n[fuse.align]\nwindow_s = 1.0\n";
    let paper = std::fs::read_to_string(repo("calib/paper.toml")).unwrap();
    let whole = std::fs::read_to_string(repo("boards/sim.toml")).unwrap();
    fuzz(
        "board",
        &corpus(
            "board",
            &[small_board, &whole[..whole.floor_char_boundary(1500)]],
        ),
    );
    fuzz("gains", &corpus("gains", &[small_gains]));
    fuzz("calib", &corpus("calib", &[&paper]));
}

#[test]
fn socket_lines_do_not_panic() {
    let lines = [
        r#"{"v":1,"id":7,"cmd":"bend","bend_deg":40,"dir_deg":30,"length_mm":20.5,"speed_deg_s":10}"#,
        r#"{"v":1,"id":"x","cmd":"status"}"#,
        r#"{"v":1,"id":1,"cmd":"record","action":"start","name":"a"}"#,
        r#"{"v":1,"cmd":"calibrate","action":"short"}"#,
    ];
    fuzz("socket", &corpus("socket", &lines));
}

#[test]
fn bend_logs_do_not_panic() {
    let head = "time_s,cmd_bend_deg,cmd_dir_deg,cmd_len_mm,piston1_mm,piston2_mm,piston3_mm,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2,gyr_x_rad_s,gyr_y_rad_s,gyr_z_rad_s,mag_x_ut,mag_y_ut,mag_z_ut\n";
    let rows = "0.001,0,0,20,0,0,0,0.1,0.2,9.81,0.001,0,0,20,1,-40\n0.003,10,30,20,1,-0.5,-0.5,0.1,0.2,9.8,0.001,0,0,,,\n0.005,10,30,20,2,-1,-1,0.1,,,0.001,0,0,20,1,-40\n";
    let lab = "time_s,piston1_mm,piston2_mm,piston3_mm,ref_qw,ref_qx,ref_qy,ref_qz,extra\n0,0,0,0,1,0,0,0,x\n1,1,1,1,0.9,0.1,0,0,y\n";
    fuzz(
        "bend_log",
        &corpus("bend_log", &[&(head.to_owned() + rows), lab]),
    );
}

/// A memory with every field set.
fn full_memory() -> memory::Memory {
    let restart = retroflex::control::tick::RestartState {
        steps: Steps([5, -7, 100]),
        bend_rad: [0.1, -0.2],
        play_output_mm: [0.1, 0.2, 0.3],
        k_epsilon: [2.2; 3],
        k_lambda_mm: [0.9; 3],
        lag_s: 0.03,
        delay_s: 0.01,
        dynamics_uncertainty_s: 0.02,
        caution: Default::default(),
        laws: None,
        rest: None,
    };
    let mut whole = memory::Memory {
        restart: Some(restart),
        tip: "A".to_owned(),
        armed: true,
        ..memory::Memory::default()
    };
    whole.record_fault(memory::RecordedFault {
        unix_s: 1.0,
        cause: "late".to_owned(),
        message: "é".to_owned(),
    });
    whole
}

#[test]
fn memory_slots_do_not_panic() {
    let body = serde_json::to_string(&full_memory()).unwrap();
    fuzz(
        "memory",
        &corpus("memory", &[&store::seal(3, &body), &body, ""]),
    );
}

/// After any change to a slot, only the original content passes the checksum.
#[test]
fn a_damaged_slot_never_passes_its_checksum() {
    let whole = full_memory();
    let whole_slot = store::seal(3, &serde_json::to_string(&whole).unwrap()).into_bytes();
    let mut dice = StdRng::seed_from_u64(4);
    for _ in 0..inputs() {
        if let Ok(Some((_, read))) =
            store::parse(&mutate(&mut dice, std::slice::from_ref(&whole_slot)))
        {
            assert_eq!(read, whole);
        }
    }
}

#[test]
fn flight_logs_do_not_panic() {
    let sensed = |k: i32| retroflex::motion::machine::Sensed {
        t: Seconds(f64::from(k)),
        imu: retroflex::primitives::ImuReading::Nothing,
        base_imu: None,
        counted: Steps([k; 3]),
        counted_age_s: 0.0,
        energised: true,
        inputs: retroflex::motion::lines::Inputs::default(),
        alarm: None,
        gauges: Default::default(),
        truth: None,
    };
    let target = retroflex::model::arc::Shape {
        bend: retroflex::model::bend::Bend::STRAIGHT,
        length: retroflex::primitives::units::Mm(20.0),
    };
    let order = retroflex::supervisor::cycle::order::Order::Arm;
    let one = |k: i32| cycle::Cycle {
        sensed: sensed(k),
        order: (k % 2 == 0).then_some(order),
        target,
        digests: (7, vec![1, 2, 3]),
    };
    let message = cycle::encode(9, &(0..4).map(one).collect::<Vec<_>>()).unwrap();
    fuzz("flight", &[corpus("flight", &[]), vec![message]].concat());
}
