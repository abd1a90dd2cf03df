//! What reads text or bytes from outside, as functions that answer whether the input was taken. Whatever is put in,
//! they do not panic; what must hold of an accepted input is asserted here. Driven by `tests/fuzz.rs` and by `fuzz/`.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use retroflex::config::board::Board;
use retroflex::config::calib::Calibration;
use retroflex::config::gains::Gains;
use retroflex::config::source;
use retroflex::log::bend_log;
use retroflex::service::memory;
use retroflex::service::{protocol, tape};

/// A parser behind its name.
pub type Parser = (&'static str, fn(&[u8]) -> bool);

/// All of them.
pub const PARSERS: [Parser; 7] =
    [("board", board), ("gains", gains), ("calib", calib), ("socket", socket), ("bend_log", bend_log), ("memory", memory), ("tape", tape)];

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A refusal is one message that names the file.
fn toml<T: serde::de::DeserializeOwned + retroflex::primitives::parameters::Check>(bytes: &[u8]) -> bool {
    match source::parse::<T>("fuzzed.toml", &text(bytes)) {
        Ok(_) => true,
        Err(why) => {
            assert!(why.to_string().contains("fuzzed.toml"), "{why}");
            false
        }
    }
}

/// A board file.
pub fn board(bytes: &[u8]) -> bool {
    toml::<Board>(bytes)
}

/// A gains file.
pub fn gains(bytes: &[u8]) -> bool {
    toml::<Gains>(bytes)
}

/// A calibration file.
pub fn calib(bytes: &[u8]) -> bool {
    toml::<Calibration>(bytes)
}

/// A line of the socket: its answer is one line.
pub fn socket(bytes: &[u8]) -> bool {
    let Ok(line) = std::str::from_utf8(bytes) else { return false };
    let (id, request) = protocol::parse(line);
    let answer = request.map(|r| serde_json::json!(r.name()));
    let said = protocol::answer_line(&id, &answer);
    assert!(said.ends_with('\n') && said.matches('\n').count() == 1, "an answer is one line");
    answer.is_ok()
}

/// A bend log.
pub fn bend_log(bytes: &[u8]) -> bool {
    bend_log::parse("fuzzed.csv", bytes).is_ok()
}

/// A slot of the service's memory: as it is, and as the body of one whose checksum is right.
pub fn memory(bytes: &[u8]) -> bool {
    let read = |slot: &[u8]| match memory::parse(slot) {
        Ok(_) => true,
        Err(why) => {
            assert!(!why.is_empty());
            false
        }
    };
    let body = std::str::from_utf8(bytes).is_ok_and(|body| read(memory::sealed(1, body).as_bytes()));
    read(bytes) || body
}

/// A tape.
pub fn tape(bytes: &[u8]) -> bool {
    let mut reader = tape::Reader::new(bytes);
    while reader.turn().is_some() {}
    reader.is_done()
}
