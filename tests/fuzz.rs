//! Whatever is put into a parser, it answers and does not panic. `RETROFLEX_FUZZ=1000000` sets how many
//! inputs each parser gets; without it a short run. The seeds in `tests/corpus` were found by coverage-guided
//! fuzzing of the same functions (`fuzz/`); what once broke a parser belongs there too.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;
mod parsers;

use common::repo;
use parsers::PARSERS;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use retroflex::primitives::units::{Seconds, Steps};
use retroflex::service::memory;
use retroflex::service::tape;
use std::path::PathBuf;

/// How many inputs a parser gets.
fn times() -> u64 {
    std::env::var("RETROFLEX_FUZZ").ok().and_then(|n| n.parse().ok()).unwrap_or(4_000)
}

/// An index below `n`; 0 when there is none.
fn below(dice: &mut StdRng, n: usize) -> usize {
    if n == 0 { 0 } else { dice.random_range(0..n) }
}

/// Pieces that parsers trip over.
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

/// A seed with some of it changed, cut, doubled or crossed with another.
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

/// The corpus of a parser: what is kept in the repository, and seeds of our own.
fn corpus(name: &str, own: &[&str]) -> Vec<Vec<u8>> {
    let folder: PathBuf = repo("tests/corpus").join(name);
    let mut seeds: Vec<Vec<u8>> = own.iter().map(|s| s.as_bytes().to_vec()).collect();
    for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
        seeds.push(std::fs::read(entry.path()).unwrap());
    }
    seeds
}

/// Every seed as it is, then mutations; how many were taken and refused. Both must occur, or nothing was tried.
fn beset(name: &str, seeds: &[Vec<u8>]) {
    let (_, parse) = PARSERS.iter().find(|(n, _)| *n == name).unwrap();
    let (mut taken, mut refused) = (0, 0);
    let mut dice = StdRng::seed_from_u64(name.len() as u64);
    let mut feed = |text: &[u8]| match std::panic::catch_unwind(|| parse(text)) {
        Ok(true) => taken += 1,
        Ok(false) => refused += 1,
        Err(_) => {
            let kept = std::env::temp_dir().join(format!("retroflex-fuzz-{name}"));
            std::fs::write(&kept, text).unwrap();
            panic!("{name} panicked; the input is kept as {}: put it into tests/corpus/{name}", kept.display());
        }
    };
    seeds.iter().for_each(|s| feed(s));
    for _ in 0..times() {
        feed(&mutate(&mut dice, seeds));
    }
    eprintln!("{name}: {} seeds, {taken} taken, {refused} refused", seeds.len());
    assert!(taken > 0 && refused > 0, "{name}: {taken} taken, {refused} refused");
}

#[test]
fn toml_files() {
    let small_board =
        "[limits]\ntravel_mm = 25.0\n[safety.on]\nlate = \"relax\"\n[service]\npriority = 5\n[plant.line]\nk_epsilon = [1.0, 2.0, 3.0]\n";
    let small_gains = "[loop]\ntau_c_s = 0.2\n[fuse.align]\nwindow_s = 1.0\n";
    let paper = std::fs::read_to_string(repo("calib/paper.toml")).unwrap();
    let whole = std::fs::read_to_string(repo("boards/sim.toml")).unwrap();
    beset("board", &corpus("board", &[small_board, &whole[..whole.floor_char_boundary(1500)]]));
    beset("gains", &corpus("gains", &[small_gains]));
    beset("calib", &corpus("calib", &[&paper]));
}

#[test]
fn socket_lines() {
    let lines = [
        r#"{"v":1,"id":7,"cmd":"bend","bend_deg":40,"dir_deg":30,"length_mm":20.5,"speed_deg_s":10}"#,
        r#"{"v":1,"id":"x","cmd":"status"}"#,
        r#"{"v":1,"id":1,"cmd":"record","action":"start","name":"a"}"#,
        r#"{"v":1,"cmd":"calibrate","action":"short"}"#,
    ];
    beset("socket", &corpus("socket", &lines));
}

#[test]
fn bend_logs() {
    let head = "time_s,cmd_bend_deg,cmd_dir_deg,cmd_len_mm,piston1_mm,piston2_mm,piston3_mm,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2,gyr_x_rad_s,gyr_y_rad_s,gyr_z_rad_s,mag_x_ut,mag_y_ut,mag_z_ut\n";
    let rows = "0.001,0,0,20,0,0,0,0.1,0.2,9.81,0.001,0,0,20,1,-40\n0.003,10,30,20,1,-0.5,-0.5,0.1,0.2,9.8,0.001,0,0,,,\n0.005,10,30,20,2,-1,-1,0.1,,,0.001,0,0,20,1,-40\n";
    let lab = "time_s,piston1_mm,piston2_mm,piston3_mm,ref_qw,ref_qx,ref_qy,ref_qz,extra\n0,0,0,0,1,0,0,0,x\n1,1,1,1,0.9,0.1,0,0,y\n";
    beset("bend_log", &corpus("bend_log", &[&(head.to_owned() + rows), lab]));
}

/// A memory with something in every field.
fn remembered() -> memory::Memory {
    let kept = retroflex::control::tick::RestartState {
        steps: Steps([5, -7, 100]),
        bend_rad: [0.1, -0.2],
        play_output_mm: [0.1, 0.2, 0.3],
        k_epsilon: [2.2; 3],
        k_lambda_mm: [0.9; 3],
        lag_s: 0.03,
        delay_s: 0.01,
        rest: None,
    };
    let mut whole = memory::Memory { kept: Some(kept), tip: "A".to_owned(), armed: true, ..memory::Memory::default() };
    whole.fault(memory::RecordedFault { unix_s: 1.0, cause: "late".to_owned(), words: "é".to_owned() });
    whole
}

#[test]
fn persisted_state() {
    let body = serde_json::to_string(&remembered()).unwrap();
    beset("memory", &corpus("memory", &[&memory::sealed(3, &body), &body, ""]));
}

/// Whatever happens to a slot, nothing but what was written passes its checksum.
#[test]
fn a_damaged_slot_is_never_believed() {
    let whole = remembered();
    let slot = memory::sealed(3, &serde_json::to_string(&whole).unwrap()).into_bytes();
    let mut dice = StdRng::seed_from_u64(4);
    for _ in 0..times() {
        if let Ok(Some((_, read))) = memory::parse(&mutate(&mut dice, std::slice::from_ref(&slot))) {
            assert_eq!(read, whole);
        }
    }
}

#[test]
fn tapes() {
    let mut seed = Vec::new();
    let order = retroflex::supervisor::cycle::order::Order::Arm;
    for k in 0..4 {
        let sensed = retroflex::supervisor::machine::Sensed {
            t: Seconds(f64::from(k)),
            imu: retroflex::estimation::fusion::health::ImuReading::Nothing,
            base_imu: None,
            counted: Steps([k; 3]),
            energised: true,
            inputs: retroflex::motion::lines::Inputs::default(),
            alarm: None,
            truth: None,
        };
        tape::write(&mut seed, &tape::Record { sensed, order: (k % 2 == 0).then_some(order), digest: 7 });
    }
    let mut seeds = corpus("tape", &[]);
    seeds.push(seed);
    beset("tape", &seeds);
}
