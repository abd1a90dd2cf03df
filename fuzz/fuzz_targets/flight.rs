//! Coverage-guided fuzzing of the `flight` parser; run as `fuzz/run` says.
#![no_main]

#[path = "../../tests/parsers/mod.rs"]
mod parsers;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    parsers::flight(data);
});
