//! The state that survives `kill -9`, power loss and a full disk.
//!
//! Two slots of fixed size are written in turn: `magic version sequence length crc\n`, JSON, padding. A write overwrites
//! the older slot in place and waits for the disk. A torn write fails its checksum, and the other slot, one write older,
//! is still intact. Slots are overwritten in place because a full disk accepts no new file.
//!
//! The memory is written ahead: drivers are armed only once the slot that says so is on the disk. A slot that says
//! "pistons at rest" is therefore true.
//!
//! A damaged slot is renamed and reported, and never used.

use crate::service::memory::Memory;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// Version of the format.
const VERSION: u32 = 1;
/// First word of a slot.
const MAGIC: &str = "retroflex-memory";
/// Size of a slot, bytes.
const SLOT: usize = 32 * 1024;
/// File names of the slots.
const NAMES: [&str; 2] = ["memory.a", "memory.b"];

/// What was found in the state folder.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recall {
    /// The newest intact slot.
    pub memory: Option<Memory>,
    /// Damaged files, renamed, with the reason.
    pub damaged: Vec<String>,
    /// There was a memory, but no intact slot is left: the piston positions are unknown.
    pub unreadable: bool,
}

/// Why the memory cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum MemoryError {
    /// The folder or a slot.
    #[error("{path}: {source}; the service must be able to write to its state folder (StateDirectory= in the unit, or `--state`)")]
    Io {
        /// File or folder.
        path: String,
        /// The operating system's reason.
        source: io::Error,
    },
    /// Another service holds the lock.
    #[error("{path}: another retroflex uses this state folder; stop it first, or give `--state` another folder")]
    InUse {
        /// Folder.
        path: String,
    },
    /// Reading it back would give something else.
    #[error("the state contains a value that is not a finite number and was not written")]
    NotFinite,
    /// Larger than a slot.
    #[error("a state of {0} bytes does not fit into its slot")]
    TooLarge(usize),
}

/// The two slots.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
    sequence: u64,
    next: usize,
    _lock: File,
}

impl Store {
    /// Locks the folder and reads it.
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
        // opened for reading only, so that the file system can still be remounted read-only
        let lock = File::open(&lock_path).map_err(|e| fail(&lock_path, e))?;
        if lock.try_lock().is_err() {
            return Err(MemoryError::InUse { path: folder.display().to_string() });
        }
        let mut recall = Recall::default();
        let mut newest: Option<(u64, usize, Memory)> = None;
        for (slot, name) in NAMES.iter().enumerate() {
            let path = folder.join(name);
            match read_slot(&path) {
                Ok(None) => {}
                Ok(Some((sequence, memory))) => {
                    if newest.as_ref().is_none_or(|(best, ..)| sequence > *best) {
                        newest = Some((sequence, slot, memory));
                    }
                }
                Err(reason) => recall.damaged.push(rename_damaged(&path, &reason)),
            }
        }
        recall.unreadable = newest.is_none() && !recall.damaged.is_empty();
        let (sequence, next) = newest.as_ref().map_or((0, 0), |(sequence, slot, _)| (*sequence, 1 - slot));
        recall.memory = newest.map(|(_, _, memory)| memory);
        let store = Self { folder: folder.to_owned(), sequence, next, _lock: lock };
        store.reserve().map_err(|e| fail(folder, e))?;
        Ok((store, recall))
    }

    /// Reserves the disk space of both slots. A slot that contains only spaces is empty.
    fn reserve(&self) -> io::Result<()> {
        for path in NAMES.map(|name| self.folder.join(name)) {
            if !path.exists() {
                let mut file = File::create(&path)?;
                file.write_all(&vec![b' '; SLOT])?;
                file.sync_all()?;
            }
        }
        File::open(&self.folder)?.sync_all()
    }

    /// Writes and waits for the disk. Returns the sequence number of the write.
    ///
    /// # Errors
    /// [`MemoryError`]; the previous write is still intact.
    pub fn write(&mut self, memory: &Memory) -> Result<u64, MemoryError> {
        let path = self.folder.join(NAMES[self.next]);
        let sequence = self.sequence + 1;
        let slot = compose(sequence, memory)?;
        let put = || -> io::Result<()> {
            let mut file = OpenOptions::new().write(true).create(true).truncate(false).open(&path)?;
            file.write_all(&slot)?;
            file.sync_data()
        };
        put().map_err(|source| MemoryError::Io { path: path.display().to_string(), source })?;
        self.sequence = sequence;
        self.next = 1 - self.next;
        Ok(sequence)
    }
}

fn compose(sequence: u64, memory: &Memory) -> Result<Vec<u8>, MemoryError> {
    let body = serde_json::to_string(memory).map_err(|_| MemoryError::NotFinite)?;
    if serde_json::from_str::<Memory>(&body).ok().as_ref() != Some(memory) {
        return Err(MemoryError::NotFinite);
    }
    let mut slot = seal(sequence, &body).into_bytes();
    if slot.len() > SLOT {
        return Err(MemoryError::TooLarge(slot.len()));
    }
    slot.resize(SLOT, b' ');
    Ok(slot)
}

/// Puts the header before a body, as [`parse`] expects it.
#[must_use]
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

/// Sequence number and content of a slot; `None` if it was never written.
fn read_slot(path: &Path) -> Result<Option<(u64, Memory)>, String> {
    let mut text = Vec::new();
    match File::open(path).and_then(|f| f.take(SLOT as u64 + 1).read_to_end(&mut text)) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(e.to_string()),
        Ok(_) => {}
    }
    parse(&text)
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
    let &[magic, version, sequence, length, crc] = fields.as_slice() else { return Err("has a damaged header".to_owned()) };
    if magic != MAGIC {
        return Err("is not a memory of retroflex".to_owned());
    }
    if version.parse() != Ok(VERSION) {
        return Err(format!("has version {version}; this program reads version {VERSION}"));
    }
    let length: usize = length.parse().map_err(|_| "has a damaged header")?;
    let body = body.get(..length).ok_or("is truncated")?;
    let head = &header[..header.len() - crc.len()];
    if u32::from_str_radix(crc, 16) != Ok(checksum(head, body)) {
        return Err("does not match its checksum".to_owned());
    }
    let sequence = sequence.parse().map_err(|_| "has a damaged header")?;
    let memory = serde_json::from_str(body).map_err(|e| format!("is not understood: {e}"))?;
    Ok(Some((sequence, memory)))
}

/// Renames a damaged slot and returns a line for the report.
fn rename_damaged(path: &Path, reason: &str) -> String {
    let extension = path.extension().unwrap_or_default().to_string_lossy().into_owned();
    let free = (1..).map(|n| path.with_extension(format!("{extension}.damaged-{n}"))).find(|p| !p.exists());
    let renamed = free.unwrap_or_else(|| path.with_extension("damaged"));
    match std::fs::rename(path, &renamed) {
        Ok(()) => format!("{} {reason}; renamed to {}", path.display(), renamed.display()),
        Err(e) => format!("{} {reason}; it could not be renamed: {e}", path.display()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::tick::RestartState;

    fn memory(n: i32) -> Memory {
        let restart = RestartState {
            steps: crate::primitives::units::Steps([n, -n, 7]),
            bend_rad: [0.1, 1.0 / 3.0],
            play_output_mm: [0.1, 0.2, 0.3],
            k_epsilon: [2.2; 3],
            k_lambda_mm: [0.9; 3],
            lag_s: 0.03,
            delay_s: 0.01,
            dynamics_uncertainty_s: 0.02,
            caution: 1.0,
            rest: None,
        };
        Memory { tip: "A".to_owned(), restart: Some(restart), ..Memory::default() }
    }

    #[test]
    fn open_returns_the_newest_write() {
        let folder = tempfile::tempdir().unwrap();
        for n in 1..6 {
            let (mut store, recall) = Store::open(folder.path()).unwrap();
            assert!(!recall.unreadable && recall.damaged.is_empty());
            assert_eq!(recall.memory, (n > 1).then(|| memory(n - 1)));
            assert_eq!(store.write(&memory(n)).unwrap(), n as u64);
        }
    }

    #[test]
    fn a_damaged_slot_is_renamed_and_the_other_one_used() {
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
        assert!(recall.damaged[0].contains("checksum"), "{:?}", recall.damaged);
        assert!(folder.path().join("memory.b.damaged-1").exists() && !recall.unreadable);
        drop(store);
        std::fs::write(folder.path().join("memory.a"), "retroflex-memory 9 1 1 00000000\nx").unwrap();
        let (_store, recall) = Store::open(folder.path()).unwrap();
        assert!(recall.unreadable && recall.memory.is_none());
        assert!(recall.damaged[0].contains("version 9"), "{:?}", recall.damaged);
    }

    #[test]
    fn every_torn_write_fails_its_checksum() {
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
    fn a_folder_in_use_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (_one, _) = Store::open(folder.path()).unwrap();
        assert!(matches!(Store::open(folder.path()), Err(MemoryError::InUse { .. })));
    }

    #[test]
    fn a_state_that_is_not_finite_is_not_written() {
        let mut bad = memory(1);
        bad.restart.as_mut().unwrap().lag_s = f64::NAN;
        assert!(matches!(compose(1, &bad), Err(MemoryError::NotFinite)));
    }
}
