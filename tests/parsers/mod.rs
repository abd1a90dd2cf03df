//! The parsers of external input, as functions that return whether the input was accepted. They must not panic on any
//! input; properties of accepted input are asserted here. Used by `tests/library/fuzz.rs` and by `fuzz/`.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use retroflex::config::board::Board;
use retroflex::config::calib::Calibration;
use retroflex::config::gains::Gains;
use retroflex::config::source;
use retroflex::log::bend_log;
use retroflex::service::flight::{cycle, read};
use retroflex::service::{protocol, store};

/// A parser and its name.
pub type Parser = (&'static str, fn(&[u8]) -> bool);

/// All parsers.
pub const PARSERS: [Parser; 7] = [
    ("board", board),
    ("gains", gains),
    ("calib", calib),
    ("socket", socket),
    ("bend_log", bend_log),
    ("memory", memory),
    ("flight", flight),
];

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Parses TOML. A refusal names the file.
fn toml<T: serde::de::DeserializeOwned + retroflex::primitives::parameters::Check>(
    bytes: &[u8],
) -> bool {
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

/// A line of the socket. The reply must be one line.
pub fn socket(bytes: &[u8]) -> bool {
    let Ok(line) = std::str::from_utf8(bytes) else {
        return false;
    };
    let (id, request) = protocol::parse(line);
    let reply = request.map(|r| serde_json::json!(r.name()));
    let text = protocol::reply_line(&id, &reply);
    assert!(
        text.ends_with('\n') && text.matches('\n').count() == 1,
        "the reply is not one line: {text}"
    );
    reply.is_ok()
}

/// A bend log.
pub fn bend_log(bytes: &[u8]) -> bool {
    bend_log::parse("fuzzed.csv", bytes).is_ok()
}

/// A slot of the memory: the input itself, and the input as the body of a slot with a valid checksum.
pub fn memory(bytes: &[u8]) -> bool {
    let read = |slot: &[u8]| match store::parse(slot) {
        Ok(_) => true,
        Err(why) => {
            assert!(!why.is_empty(), "a refusal without a reason");
            false
        }
    };
    let body = std::str::from_utf8(bytes).is_ok_and(|body| read(store::seal(1, body).as_bytes()));
    read(bytes) || body
}

/// A flight log: the input as a file, and as a message with cycles, of which most have no file around them.
pub fn flight(bytes: &[u8]) -> bool {
    let file = read::parse(std::io::Cursor::new(bytes), &mut |message| {
        read::Entry::of(&message).map(|_| ())
    });
    assert!(
        file.as_ref().is_err_and(|why| !why.is_empty()) || file.is_ok(),
        "a refusal without a reason"
    );
    cycle::decode(bytes).is_ok() || file.is_ok()
}
