//! What the service remembers over `kill -9`, power loss and a full disk.
//!
//! Two slots of fixed size, written in turn: `magic version seq length crc\n`, JSON, padding. A write
//! goes to the older slot in place and is forced to the disk before anybody relies on it; a torn one
//! fails its checksum and the other slot, one write older, is still whole. In place, because a disk that
//! is full takes no new file but lets what is there be written over.
//!
//! Written ahead: drivers are armed only after the slot that says so is on the disk. So whatever a slot
//! says of pistons at rest is true, and what it says of armed ones is as old as it says.
//!
//! A slot that is damaged is set aside under another name and reported; it is never read as truth.

use crate::control::tick::RestartState;
use serde::{Deserialize, Serialize};
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Version of the format.
const VERSION: u32 = 1;
/// First word of a slot.
const MAGIC: &str = "retroflex-memory";
/// Size of a slot, bytes.
const SLOT: usize = 32 * 1024;
/// Faults that are remembered.
pub const FAULTS_MAX: usize = 64;

/// Everything that is remembered.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Memory {
    /// Identity of the disposable tip; empty if none was given.
    pub tip: String,
    /// Drivers may have moved the pistons since this was written.
    pub armed: bool,
    /// Where pistons and tip were, and what was learnt.
    pub kept: Option<RestartState>,
    /// A calibration that was accepted, in use.
    pub accepted: Option<LearnedGains>,
    /// A calibration that waits for acceptance.
    pub proposed: Option<LearnedGains>,
    /// What went wrong, oldest first.
    pub faults: Vec<RecordedFault>,
    /// Hash of the configuration that was in use.
    pub config_hash: String,
}

/// Transmission gains with their origin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnedGains {
    /// Extension gains.
    pub k_epsilon: [f64; 3],
    /// Backlash half-widths, mm.
    pub k_lambda_mm: [f64; 3],
    /// Lag, s.
    pub lag_s: f64,
    /// Dead time, s.
    pub delay_s: f64,
    /// Tip they were found on.
    pub tip: String,
    /// When, seconds since 1970.
    pub unix_s: f64,
    /// How.
    pub source: String,
}

/// One entry of the fault history.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedFault {
    /// When, seconds since 1970.
    pub unix_s: f64,
    /// What tripped.
    pub cause: String,
    /// In words.
    pub words: String,
}

impl Memory {
    /// Adds a fault, forgetting the oldest beyond [`FAULTS_MAX`].
    pub fn fault(&mut self, fault: RecordedFault) {
        self.faults.push(fault);
        let excess = self.faults.len().saturating_sub(FAULTS_MAX);
        self.faults.drain(..excess);
    }
}

/// What was found at start.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recall {
    /// The newest whole slot.
    pub memory: Option<Memory>,
    /// Files that were damaged and set aside, with the reason.
    pub set_aside: Vec<String>,
    /// There was something, and none of it can be believed: where the pistons stand is not known.
    pub unknown: bool,
}

/// Why memory cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum MemoryError {
    /// The folder or a slot.
    #[error("{path}: {source}; the service must be able to write its state folder (StateDirectory= in the unit, `--state` by hand)")]
    Io {
        /// File or folder.
        path: String,
        /// The system's reason.
        source: io::Error,
    },
    /// Another service.
    #[error("{path}: another retroflex uses this state folder; stop it first, or give `--state` another folder")]
    InUse {
        /// Folder.
        path: String,
    },
    /// It would not come back as it is.
    #[error("a state that holds what is no number was not written")]
    NotFinite,
    /// Larger than a slot.
    #[error("a state of {0} bytes does not fit into its slot")]
    TooLarge(usize),
}

/// The two slots.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
    seq: u64,
    next: usize,
    _lock: File,
}

const NAMES: [&str; 2] = ["memory.a", "memory.b"];

impl Store {
    /// Opens the folder, takes its lock and recalls what is in it.
    ///
    /// # Errors
    /// [`MemoryError`].
    pub fn open(folder: &Path) -> Result<(Self, Recall), MemoryError> {
        let fail = |path: &Path, source| MemoryError::Io { path: path.display().to_string(), source };
        std::fs::create_dir_all(folder).map_err(|e| fail(folder, e))?;
        let lock_path = folder.join("lock");
        if !lock_path.exists() {
            File::create(&lock_path).map_err(|e| fail(&lock_path, e))?;
        }
        // held open for reading only, so that a disk that must become read-only may
        let lock = File::open(&lock_path).map_err(|e| fail(&lock_path, e))?;
        if lock.try_lock().is_err() {
            return Err(MemoryError::InUse { path: folder.display().to_string() });
        }
        let mut recall = Recall::default();
        let mut newest: Option<(u64, usize, Memory)> = None;
        let mut damaged = false;
        for (slot, name) in NAMES.iter().enumerate() {
            let path = folder.join(name);
            match read_slot(&path) {
                Ok(None) => {}
                Ok(Some((seq, memory))) => {
                    if newest.as_ref().is_none_or(|(best, ..)| seq > *best) {
                        newest = Some((seq, slot, memory));
                    }
                }
                Err(why) => {
                    damaged = true;
                    recall.set_aside.push(set_aside(&path, &why));
                }
            }
        }
        recall.unknown = damaged && newest.is_none();
        let (seq, next) = newest.as_ref().map_or((0, 0), |(seq, slot, _)| (*seq, 1 - slot));
        recall.memory = newest.map(|(_, _, memory)| memory);
        let store = Self { folder: folder.to_owned(), seq, next, _lock: lock };
        store.reserve().map_err(|e| fail(folder, e))?;
        Ok((store, recall))
    }

    /// Makes room on the disk for both slots while there is some; a slot that is all spaces is empty.
    fn reserve(&self) -> io::Result<()> {
        for name in NAMES {
            let path = self.folder.join(name);
            if !path.exists() {
                let mut file = File::create(&path)?;
                file.write_all(&vec![b' '; SLOT])?;
                file.sync_all()?;
            }
        }
        File::open(&self.folder)?.sync_all()
    }

    /// Writes and forces to the disk. The number of the write.
    ///
    /// # Errors
    /// [`MemoryError`]; what was written before is still there.
    pub fn write(&mut self, memory: &Memory) -> Result<u64, MemoryError> {
        let path = self.folder.join(NAMES[self.next]);
        let seq = self.seq + 1;
        let slot = compose(seq, memory)?;
        let put = || -> io::Result<()> {
            let mut file = OpenOptions::new().write(true).create(true).truncate(false).open(&path)?;
            file.seek(SeekFrom::Start(0))?;
            file.write_all(&slot)?;
            file.sync_data()
        };
        put().map_err(|source| MemoryError::Io { path: path.display().to_string(), source })?;
        self.seq = seq;
        self.next = 1 - self.next;
        Ok(seq)
    }

    /// The folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }
}

fn compose(seq: u64, memory: &Memory) -> Result<Vec<u8>, MemoryError> {
    let body = serde_json::to_string(memory).map_err(|_| MemoryError::NotFinite)?;
    if serde_json::from_str::<Memory>(&body).ok().as_ref() != Some(memory) {
        return Err(MemoryError::NotFinite);
    }
    let mut slot = sealed(seq, &body).into_bytes();
    if slot.len() > SLOT {
        return Err(MemoryError::TooLarge(slot.len()));
    }
    slot.resize(SLOT, b' ');
    Ok(slot)
}

/// A body under its header, as [`parse`] reads it.
#[must_use]
pub fn sealed(seq: u64, body: &str) -> String {
    let head = format!("{MAGIC} {VERSION} {seq} {} ", body.len());
    format!("{head}{:08x}\n{body}", checksum(&head, body))
}

fn checksum(head: &str, body: &str) -> u32 {
    let mut crc = flate2::Crc::new();
    crc.update(head.as_bytes());
    crc.update(body.as_bytes());
    crc.sum()
}

/// The slot's number and content; `None` where there is none yet.
fn read_slot(path: &Path) -> Result<Option<(u64, Memory)>, String> {
    let mut text = Vec::new();
    match File::open(path).and_then(|f| f.take(SLOT as u64 + 1).read_to_end(&mut text)) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(e.to_string()),
        Ok(_) => {}
    }
    parse(&text)
}

/// Reads a slot; `Ok(None)` for one that was never written.
///
/// # Errors
/// What is wrong with it, in words.
pub fn parse(text: &[u8]) -> Result<Option<(u64, Memory)>, String> {
    let text = std::str::from_utf8(text).map_err(|_| "is not text".to_owned())?;
    if text.trim().is_empty() {
        return Ok(None);
    }
    let (first, rest) = text.split_once('\n').ok_or("has no header line")?;
    let words: Vec<&str> = first.split(' ').collect();
    let &[magic, version, seq, length, crc] = words.as_slice() else { return Err("has a damaged header".to_owned()) };
    if magic != MAGIC {
        return Err("is no memory of retroflex".to_owned());
    }
    if version.parse() != Ok(VERSION) {
        return Err(format!("is of version {version}, this program reads {VERSION}"));
    }
    let length: usize = length.parse().map_err(|_| "has a damaged header")?;
    let body = rest.get(..length).ok_or("is cut short")?;
    let head = &first[..first.len() - crc.len()];
    if u32::from_str_radix(crc, 16) != Ok(checksum(head, body)) {
        return Err("does not match its checksum".to_owned());
    }
    let seq = seq.parse().map_err(|_| "has a damaged header")?;
    let memory = serde_json::from_str(body).map_err(|e| format!("cannot be understood: {e}"))?;
    Ok(Some((seq, memory)))
}

/// Renames a damaged slot; the line for the report.
fn set_aside(path: &Path, why: &str) -> String {
    let mut n = 1;
    let aside = loop {
        let aside = path.with_extension(format!("{}.damaged-{n}", path.extension().map_or("", |e| e.to_str().unwrap_or(""))));
        if !aside.exists() {
            break aside;
        }
        n += 1;
    };
    match std::fs::rename(path, &aside) {
        Ok(()) => format!("{} {why}; kept as {}", path.display(), aside.display()),
        Err(e) => format!("{} {why}; it could not be set aside: {e}", path.display()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn memory(n: i32) -> Memory {
        let kept = RestartState {
            steps: crate::primitives::units::Steps([n, -n, 7]),
            bend_rad: [0.1, 1.0 / 3.0],
            play_output_mm: [0.1, 0.2, 0.3],
            k_epsilon: [2.2; 3],
            k_lambda_mm: [0.9; 3],
            lag_s: 0.03,
            delay_s: 0.01,
            rest: None,
        };
        Memory { tip: "A".to_owned(), kept: Some(kept), ..Memory::default() }
    }

    #[test]
    fn comes_back_as_it_was_the_newest_first() {
        let folder = tempfile::tempdir().unwrap();
        for n in 1..6 {
            let (mut store, recall) = Store::open(folder.path()).unwrap();
            assert!(!recall.unknown && recall.set_aside.is_empty());
            assert_eq!(recall.memory, (n > 1).then(|| memory(n - 1)));
            assert_eq!(store.write(&memory(n)).unwrap(), n as u64);
        }
    }

    #[test]
    fn a_damaged_slot_is_set_aside_and_the_other_used() {
        let folder = tempfile::tempdir().unwrap();
        {
            let (mut store, _) = Store::open(folder.path()).unwrap();
            store.write(&memory(1)).unwrap();
            store.write(&memory(2)).unwrap();
        }
        let newest = folder.path().join("memory.b");
        let mut text = std::fs::read(&newest).unwrap();
        text[100] ^= 1;
        std::fs::write(&newest, &text).unwrap();
        let (store, recall) = Store::open(folder.path()).unwrap();
        assert_eq!(recall.memory, Some(memory(1)));
        assert!(recall.set_aside[0].contains("checksum"), "{:?}", recall.set_aside);
        assert!(folder.path().join("memory.b.damaged-1").exists() && !recall.unknown);
        drop(store);
        std::fs::write(folder.path().join("memory.a"), "retroflex-memory 9 1 1 00000000\nx").unwrap();
        let (_store, recall) = Store::open(folder.path()).unwrap();
        assert!(recall.unknown && recall.memory.is_none());
        assert!(recall.set_aside[0].contains("version 9"), "{:?}", recall.set_aside);
    }

    #[test]
    fn every_torn_write_is_seen() {
        let (old, new) = (compose(1, &memory(1)).unwrap(), compose(3, &memory(-9)).unwrap());
        for cut in 1..old.len().min(600) {
            let torn: Vec<u8> = new[..cut].iter().chain(&old[cut..]).copied().collect();
            match parse(&torn) {
                Err(_) => {}
                Ok(read) => assert!(torn == old || torn == new, "cut {cut}: {read:?}"),
            }
        }
    }

    #[test]
    fn two_services_do_not_share_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let (_one, _) = Store::open(folder.path()).unwrap();
        assert!(matches!(Store::open(folder.path()), Err(MemoryError::InUse { .. })));
    }

    #[test]
    fn what_is_no_number_is_not_written() {
        let mut bad = memory(1);
        bad.kept.as_mut().unwrap().lag_s = f64::NAN;
        assert!(matches!(compose(1, &bad), Err(MemoryError::NotFinite)));
    }
}
