//! One slot of the memory on the disk: `magic version sequence length crc\n`, JSON, padding up to a fixed size.

use crate::service::disk;
use crate::service::memory::{Memory, MemoryError};
use std::fs::OpenOptions;
use std::io::{self, Read};
use std::path::Path;

/// Version of the format.
const VERSION: u32 = 1;
/// First word of a slot.
const MAGIC: &str = "retroflex-memory";
/// Largest sequence number: more writes than a disk survives.
const SEQUENCE_MAX: u64 = 1 << 53;
/// Size of a slot, bytes.
pub const SIZE: usize = 32 * 1024;

/// The slot of a write.
///
/// # Errors
/// [`MemoryError::NotFinite`], [`MemoryError::TooLarge`].
pub fn compose(sequence: u64, memory: &Memory) -> Result<Vec<u8>, MemoryError> {
    let body = serde_json::to_string(memory).map_err(|_| MemoryError::NotFinite)?;
    if serde_json::from_str::<Memory>(&body).ok().as_ref() != Some(memory) {
        return Err(MemoryError::NotFinite);
    }
    let mut slot = seal(sequence, &body).into_bytes();
    if slot.len() > SIZE {
        return Err(MemoryError::TooLarge(slot.len()));
    }
    slot.resize(SIZE, b' ');
    Ok(slot)
}

/// Puts the header before a body, as [`parse`] expects it.
pub fn seal(sequence: u64, body: &str) -> String {
    let head = format!("{MAGIC} {VERSION} {sequence} {} ", body.len());
    format!("{head}{:08x}\n{body}", checksum(&head, body))
}

fn checksum(head: &str, body: &str) -> u32 {
    let mut crc = flate2::Crc::new();
    crc.update(head.as_bytes());
    crc.update(body.as_bytes());
    crc.sum()
}

/// Sequence number and content of a slot; `None` if there is no such file.
///
/// # Errors
/// What is wrong with it, as the end of a sentence.
pub fn read(path: &Path) -> Result<Option<(u64, Memory)>, String> {
    let mut text = Vec::new();
    let opened = disk::open(OpenOptions::new().read(true), path);
    match opened.and_then(|f| f.take(SIZE as u64 + 1).read_to_end(&mut text)) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(e.to_string()),
        Ok(SIZE) => {}
        Ok(size) => return Err(format!("has {size} bytes or more instead of {SIZE}")),
    }
    parse(&text)?.map_or_else(|| Err("is empty".to_owned()), |slot| Ok(Some(slot)))
}

/// Parses a slot; `Ok(None)` for one that was never written.
///
/// # Errors
/// What is wrong with it, as the end of a sentence.
pub fn parse(text: &[u8]) -> Result<Option<(u64, Memory)>, String> {
    let text = std::str::from_utf8(text).map_err(|_| "is not UTF-8 text".to_owned())?;
    if text.trim().is_empty() {
        return Ok(None);
    }
    let (header, body) = text.split_once('\n').ok_or("has no header line")?;
    let fields: Vec<&str> = header.split(' ').collect();
    let &[magic, version, sequence, length, crc] = fields.as_slice() else {
        return Err("has a damaged header".to_owned());
    };
    if magic != MAGIC {
        return Err("is not a memory of retroflex".to_owned());
    }
    if version.parse() != Ok(VERSION) {
        return Err(format!(
            "has version {version}; this program reads version {VERSION}"
        ));
    }
    let length: usize = length.parse().map_err(|_| "has a damaged header")?;
    let body = body.get(..length).ok_or("is truncated")?;
    let head = &header[..header.len() - crc.len()];
    if u32::from_str_radix(crc, 16) != Ok(checksum(head, body)) {
        return Err("does not match its checksum".to_owned());
    }
    let sequence = sequence.parse().ok().filter(|n| *n < SEQUENCE_MAX);
    let sequence = sequence.ok_or("has a damaged header")?;
    let memory: Memory =
        serde_json::from_str(body).map_err(|e| format!("is not understood: {e}"))?;
    if !memory.is_possible() {
        return Err("has a value that no machine has".to_owned());
    }
    Ok(Some((sequence, memory)))
}

/// Memories for the tests of the room.
#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::control::tick::RestartState;
    use crate::service::memory::LearnedGains;

    pub(in crate::service) fn memory(n: i32) -> Memory {
        let restart = RestartState {
            steps: crate::primitives::units::Steps([n, -n, 7]),
            bend_rad: [0.1, 1.0 / 3.0],
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
        Memory {
            tip: "A".to_owned(),
            restart: Some(restart),
            ..Memory::default()
        }
    }

    #[test]
    fn every_torn_write_fails_its_checksum() {
        let (old, new) = (
            compose(1, &memory(1)).unwrap(),
            compose(3, &memory(-9)).unwrap(),
        );
        for cut in 1..old.len().min(600) {
            let torn: Vec<u8> = new[..cut].iter().chain(&old[cut..]).copied().collect();
            match parse(&torn) {
                Err(_) => {}
                Ok(read) => assert!(torn == old || torn == new, "cut {cut}: {read:?}"),
            }
        }
    }

    /// Every number of a memory in turn, with a checksum that is right.
    #[test]
    fn a_number_that_no_machine_has_is_refused() {
        let mut whole = memory(1);
        whole.restart.as_mut().unwrap().rest = Some(crate::control::tick::RestartRest {
            acc_m_s2: [0.1, 0.2, 9.7],
            mag_ut: Some([20.0, 1.0, -40.0]),
            gyro_bias_rad_s: [0.01, 0.0, -0.01],
        });
        whole.accepted = Some(LearnedGains {
            k_epsilon: [2.2; 3],
            k_lambda_mm: [0.9; 3],
            lag_s: 0.1,
            delay_s: 0.02,
            tip: "A".to_owned(),
            unix_s: 1.7e9,
            source: "test".to_owned(),
        });
        whole.proposed = whole.accepted.clone();
        let good = serde_json::to_value(&whole).unwrap();
        let read = |body: &serde_json::Value| parse(seal(3, &body.to_string()).as_bytes());
        assert!(read(&good).unwrap().is_some());
        let (mut paths, mut open) = (Vec::new(), vec![String::new()]);
        while let Some(path) = open.pop() {
            match good.pointer(&path).unwrap() {
                serde_json::Value::Object(map) => {
                    open.extend(map.keys().map(|key| format!("{path}/{key}")));
                }
                serde_json::Value::Array(all) => {
                    open.extend((0..all.len()).map(|k| format!("{path}/{k}")));
                }
                serde_json::Value::Number(_) if !path.ends_with("unix_s") => paths.push(path),
                _ => (),
            }
        }
        assert!(paths.len() > 30, "{paths:?}");
        for path in paths {
            for value in [1e300, -1e300, 1e13, -1e13] {
                let mut bad = good.clone();
                *bad.pointer_mut(&path).unwrap() = value.into();
                assert!(read(&bad).is_err(), "{path} = {value}");
            }
        }
        let late = seal(u64::MAX, &good.to_string());
        assert!(parse(late.as_bytes()).is_err());
    }

    #[test]
    fn a_state_that_is_not_finite_is_not_written() {
        let mut bad = memory(1);
        bad.restart.as_mut().unwrap().lag_s = f64::NAN;
        assert!(matches!(compose(1, &bad), Err(MemoryError::NotFinite)));
    }
}
