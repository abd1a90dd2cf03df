//! The state that survives `kill -9`, power loss and a full disk.
//!
//! Two slots of fixed size are written in turn, each `magic version sequence length crc\n`, JSON, and padding. A write overwrites the
//! older slot in place, waits for the disk and reads the slot back. Slots are overwritten in place because a full disk accepts no new
//! file. A slot that does not exist yet is written under another name first, so that it appears as a whole or not at all.
//!
//! The memory is written ahead: drivers are armed only once the slot that says so is on the disk. A slot that says
//! "pistons at rest" is therefore true as long as it is the newest.
//!
//! Only a pair of slots that is whole is believed: both of full size and intact, each in its place (odd sequence numbers
//! in the first), one write apart. Otherwise the newest write may be missing, and the position is unknown. A damaged slot
//! is renamed and reported. The first write alone is no damage: it fills both slots before any driver is armed, and was ended between
//! the two.

use crate::service::memory::MemoryError;
use crate::service::{Memory, disk};
use serde::{Deserialize, Serialize};
use std::fs::{DirBuilder, File, OpenOptions, Permissions};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};

/// Version of the format.
const VERSION: u32 = 1;
/// First word of a slot.
const MAGIC: &str = "retroflex-memory";
/// Largest sequence number: more writes than a disk survives.
const SEQUENCE_MAX: u64 = 1 << 53;
/// Size of a slot, bytes.
const SIZE: usize = 32 * 1024;
/// What fills it up.
const PADDING: u8 = b' ';

/// The slot of a write.
///
/// # Errors
/// [`MemoryError::NotFinite`], [`MemoryError::TooLarge`].
fn compose(sequence: u64, memory: &Memory) -> Result<Vec<u8>, MemoryError> {
    let body = serde_json::to_string(memory).map_err(|_| MemoryError::NotFinite)?;
    if serde_json::from_str::<Memory>(&body).ok().as_ref() != Some(memory) {
        return Err(MemoryError::NotFinite);
    }
    let mut slot = seal(sequence, &body).into_bytes();
    if slot.len() > SIZE {
        return Err(MemoryError::TooLarge(slot.len()));
    }
    slot.resize(SIZE, PADDING);
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
pub fn read_slot(path: &Path) -> Result<Option<(u64, Memory)>, String> {
    let mut text = Vec::new();
    let opened = disk::open(OpenOptions::new().read(true), path);
    match opened.and_then(|f| f.take(SIZE as u64 + 1).read_to_end(&mut text)) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(e.to_string()),
        Ok(SIZE) => {}
        Ok(size) if size < SIZE => return Err(format!("has {size} bytes instead of {SIZE}")),
        Ok(_) => return Err(format!("has more than {SIZE} bytes")),
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
    let (body, rest) = body.split_at_checked(length).ok_or("is truncated")?;
    let head = &header[..header.len() - crc.len()];
    if crc != format!("{:08x}", checksum(head, body)) {
        return Err("does not match its checksum".to_owned());
    }
    if rest.bytes().any(|byte| byte != PADDING) {
        return Err("has more than its text and blanks".to_owned());
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

/// File names of the slots.
pub const SLOTS: [&str; 2] = ["memory.a", "memory.b"];

/// State of the two slots.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Found {
    /// Neither exists, or the first write was ended between the two.
    #[default]
    Absent,
    /// Both are intact and belong together.
    Intact,
    /// Anything else: the newest write may be missing.
    Damaged,
}

/// What was found in the state folder.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recall {
    /// The newest intact slot. Unless the slots are [`Found::Intact`], its position must not be believed.
    pub memory: Option<Memory>,
    /// What is wrong, with the new name of a damaged file.
    pub damaged: Vec<String>,
    /// State of the slots.
    pub found: Found,
    /// Sequence number of that slot.
    pub sequence: u64,
}

/// How far a remembered position can be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Belief {
    /// Nothing has moved the pistons since it was written.
    Certain,
    /// The drivers were armed afterwards: the measured pose decides.
    Checked,
    /// Nothing tells where the pistons are.
    Lost,
}

impl Recall {
    /// How far the position can be trusted.
    pub fn belief(&self) -> Belief {
        match &self.memory {
            Some(memory) if self.found != Found::Intact || memory.lost => Belief::Lost,
            Some(memory) if !memory.armed => Belief::Certain,
            Some(memory) if memory.restart.is_some() => Belief::Checked,
            _ => Belief::Lost,
        }
    }
}

/// The two slots.
#[derive(Debug)]
pub struct Store {
    folder: PathBuf,
    sequence: u64,
    /// Both slots hold a write of this program.
    whole: bool,
    _lock: File,
}

impl Store {
    /// Locks the folder and reads it.
    ///
    /// # Errors
    /// [`MemoryError`].
    pub fn open(folder: &Path) -> Result<(Self, Recall), MemoryError> {
        let mut builder = DirBuilder::new();
        let created = builder.recursive(true).mode(0o700).create(folder);
        created.map_err(MemoryError::io(folder))?;
        let lock_path = folder.join("lock");
        let (mut read, mut create) = (OpenOptions::new(), OpenOptions::new());
        // opened for reading only, so that the file system can still be remounted read-only
        let lock = disk::open(read.read(true), &lock_path)
            .or_else(|e| match e.kind() {
                io::ErrorKind::NotFound => {
                    disk::open(create.write(true).create_new(true), &lock_path)?;
                    disk::open(read.read(true), &lock_path)
                }
                _ => Err(e),
            })
            .map_err(MemoryError::io(&lock_path))?;
        for file in SLOTS.into_iter().chain(["lock"]) {
            // files of an older version let others read them, and hold the lock; those of another user are left alone
            let path = folder.join(file);
            if std::fs::symlink_metadata(&path).is_ok_and(|m| m.is_file() && m.mode() & 0o077 != 0)
            {
                let _ = std::fs::set_permissions(&path, Permissions::from_mode(0o600));
            }
        }
        if lock.try_lock().is_err() {
            return Err(MemoryError::InUse(folder.display().to_string()));
        }
        let mut recall = Recall::default();
        let slots = SLOTS.map(|name| {
            let path = folder.join(name);
            read_slot(&path).unwrap_or_else(|reason| {
                recall.damaged.push(rename_damaged(&path, &reason));
                None
            })
        });
        let sequences = [0, 1].map(|slot| slots[slot].as_ref().map(|(sequence, _)| *sequence));
        recall.found = match sequences {
            [None | Some(1), None] if recall.damaged.is_empty() => Found::Absent,
            [Some(a), Some(b)] if a.abs_diff(b) == 1 && place(a) == 0 => Found::Intact,
            _ => Found::Damaged,
        };
        if recall.found == Found::Damaged && recall.damaged.is_empty() {
            let why = format!("the writes {sequences:?} of the two slots do not belong together");
            recall.damaged.push(format!("{}: {why}", folder.display()));
        }
        let slots = slots.into_iter().flatten();
        if let Some((sequence, memory)) = slots.max_by_key(|(sequence, _)| *sequence) {
            (recall.sequence, recall.memory) = (sequence, Some(memory));
        }
        let store = Self {
            folder: folder.to_owned(),
            sequence: recall.sequence,
            whole: recall.found == Found::Intact,
            _lock: lock,
        };
        if recall.found == Found::Damaged {
            // until the next write an empty slot stands for a damaged one, which counts as damaged too
            for path in SLOTS.map(|name| folder.join(name)) {
                if std::fs::symlink_metadata(&path).is_err() {
                    create_slot(&path, &[PADDING; SIZE]).map_err(MemoryError::io(&path))?;
                }
            }
        }
        Ok((store, recall))
    }

    /// Writes, waits for the disk and reads back. Returns the sequence number of the write. The first write after slots that
    /// were not intact fills both.
    ///
    /// # Errors
    /// [`MemoryError`]; the previous write is still intact.
    pub fn write(&mut self, memory: &Memory) -> Result<u64, MemoryError> {
        if !self.whole {
            self.write_slot(memory)?;
        }
        let sequence = self.write_slot(memory)?;
        self.whole = true;
        Ok(sequence)
    }

    fn write_slot(&mut self, memory: &Memory) -> Result<u64, MemoryError> {
        let sequence = self.sequence + 1;
        let path = self.folder.join(SLOTS[place(sequence)]);
        let slot = compose(sequence, memory)?;
        let put = || -> io::Result<()> {
            if std::fs::symlink_metadata(&path).is_err() {
                create_slot(&path, &slot)?;
            }
            let mut file = disk::open(OpenOptions::new().read(true).write(true), &path)?;
            file.write_all(&slot)?;
            file.set_len(SIZE as u64)?;
            file.sync_data()?;
            let mut back = Vec::with_capacity(SIZE);
            file.rewind()?;
            file.read_to_end(&mut back)?;
            if back == slot {
                Ok(())
            } else {
                Err(io::Error::other("what was written reads back differently"))
            }
        };
        put().map_err(MemoryError::io(&path))?;
        self.sequence = sequence;
        Ok(sequence)
    }
}

/// Creates a slot as a whole: under another name, which then becomes its own.
fn create_slot(path: &Path, slot: &[u8]) -> io::Result<()> {
    let beside = path.with_added_extension("part");
    // one that was left by a start that was ended
    match std::fs::remove_file(&beside) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
        _ => {}
    }
    let mut file = disk::open(OpenOptions::new().write(true).create_new(true), &beside)?;
    file.write_all(slot)?;
    file.sync_all()?;
    std::fs::rename(&beside, path)?;
    File::open(path.parent().unwrap_or(Path::new(".")))?.sync_all()
}

/// Index of the slot of a write.
fn place(sequence: u64) -> usize {
    usize::from(sequence.is_multiple_of(2))
}

/// Renames a damaged slot and returns a line for the report.
fn rename_damaged(path: &Path, reason: &str) -> String {
    let shown = path.display();
    let mut names = (1..).map(|n| path.with_added_extension(format!("damaged-{n}")));
    let renamed = names.find(|name| !name.exists()).unwrap_or_default();
    match std::fs::rename(path, &renamed) {
        Ok(()) => format!("{shown} {reason}; renamed to {}", renamed.display()),
        Err(e) => format!("{shown} {reason}; it could not be renamed: {e}"),
    }
}

/// A memory to write, and the id under which its completion is reported.
type Job = (Box<Memory>, Option<u64>);

/// Handle of the state writer: the only thread that writes the memory and waits for the disk.
#[derive(Debug)]
pub struct StateWriter {
    jobs: SyncSender<Job>,
    completed: Receiver<Completed>,
    under_way: Arc<AtomicUsize>,
    thread: std::thread::JoinHandle<()>,
}

/// The id given with a write, and its sequence number or why it failed.
pub type Completed = (Option<u64>, Result<u64, MemoryError>);

impl StateWriter {
    /// Starts the thread.
    ///
    /// # Errors
    /// The operating system's.
    pub fn start(mut store: Store) -> std::io::Result<Self> {
        let (jobs, work) = sync_channel::<Job>(4);
        let (report, completed) = channel();
        let under_way = Arc::new(AtomicUsize::new(0));
        let own = Arc::clone(&under_way);
        let thread = std::thread::Builder::new()
            .name("state".into())
            .spawn(move || {
                for (memory, id) in work {
                    let result = store.write(&memory);
                    own.fetch_sub(1, Relaxed);
                    if report.send((id, result)).is_err() {
                        return;
                    }
                }
            })?;
        Ok(Self {
            jobs,
            completed,
            under_way,
            thread,
        })
    }

    /// Queues a write; false if the queue is full because the disk is slow.
    pub fn write(&self, memory: &Memory, id: Option<u64>) -> bool {
        self.under_way.fetch_add(1, Relaxed);
        let queued = self.jobs.try_send((Box::new(memory.clone()), id)).is_ok();
        if !queued {
            self.under_way.fetch_sub(1, Relaxed);
        }
        queued
    }

    /// True if no write is under way.
    pub fn is_idle(&self) -> bool {
        self.under_way.load(Relaxed) == 0
    }

    /// The next completed write, if any.
    pub fn completed(&self) -> Option<Completed> {
        self.completed.try_recv().ok()
    }

    /// Writes a last time after everything that is queued, waits for the disk and ends the thread. `None` if the thread has panicked.
    pub fn finish(self, memory: &Memory) -> Option<Completed> {
        // a thread that has panicked takes no job, and its last result is not that of this one
        let _ = self.jobs.send((Box::new(memory.clone()), None));
        drop(self.jobs);
        let last = self.completed.iter().last();
        self.thread.join().ok().and(last)
    }
}

#[cfg(test)]
mod tests;
