//! The state that survives `kill -9`, power loss and a full disk.
//!
//! Two slots of fixed size are written in turn, each `magic version sequence length crc\n`, JSON, and padding. A write overwrites the
//! older slot in place, waits for the disk and reads the slot back. Slots are overwritten in place because a full disk accepts no new
//! file.
//!
//! The memory is written ahead: drivers are armed only once the slot that says so is on the disk. A slot that says
//! "pistons at rest" is therefore true as long as it is the newest.
//!
//! Only a pair of slots that is whole is believed: both of full size and intact, each in its place (odd sequence numbers
//! in the first), one write apart. Otherwise the newest write may be missing, and the position is unknown. A damaged slot
//! is renamed and reported.

use crate::service::disk;
use crate::service::memory::{Memory, MemoryError};
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
pub fn read_slot(path: &Path) -> Result<Option<(u64, Memory)>, String> {
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

/// File names of the slots.
const NAMES: [&str; 2] = ["memory.a", "memory.b"];

/// State of the two slots.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Found {
    /// Neither exists.
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
            Some(memory) if self.found == Found::Intact && !memory.lost => match memory.armed {
                false => Belief::Certain,
                true if memory.restart.is_some() => Belief::Checked,
                true => Belief::Lost,
            },
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
        for file in NAMES.into_iter().chain(["lock"]) {
            // files of an older version let others read them, and hold the lock; those of another user are left alone
            let path = folder.join(file);
            if std::fs::symlink_metadata(&path).is_ok_and(|m| m.is_file() && m.mode() & 0o077 != 0)
            {
                let _ = std::fs::set_permissions(&path, Permissions::from_mode(0o600));
            }
        }
        if lock.try_lock().is_err() {
            return Err(MemoryError::InUse {
                path: folder.display().to_string(),
            });
        }
        let mut recall = Recall::default();
        let slots = NAMES.map(|name| {
            let path = folder.join(name);
            read_slot(&path).unwrap_or_else(|reason| {
                recall.damaged.push(rename_damaged(&path, &reason));
                None
            })
        });
        let sequences = [0, 1].map(|slot| slots[slot].as_ref().map(|(sequence, _)| *sequence));
        recall.found = match sequences {
            [None, None] if recall.damaged.is_empty() => Found::Absent,
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
        store.reserve().map_err(MemoryError::io(folder))?;
        Ok((store, recall))
    }

    /// Reserves the disk space of both slots. A slot that contains only spaces is empty.
    fn reserve(&self) -> io::Result<()> {
        for path in NAMES.map(|name| self.folder.join(name)) {
            if std::fs::symlink_metadata(&path).is_err() {
                let mut file = disk::open(OpenOptions::new().write(true).create_new(true), &path)?;
                file.write_all(&vec![b' '; SIZE])?;
                file.sync_all()?;
            }
        }
        File::open(&self.folder)?.sync_all()
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
        let path = self.folder.join(NAMES[place(sequence)]);
        let slot = compose(sequence, memory)?;
        let put = || -> io::Result<()> {
            let mut options = OpenOptions::new();
            let mut file = disk::open(options.read(true).write(true).create(true), &path)?;
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
mod tests {
    use super::*;
    use crate::control::tick::RestartState;
    use crate::service::memory::LearnedGains;

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

    #[test]
    fn open_returns_the_newest_write() {
        let folder = tempfile::tempdir().unwrap();
        for n in 1..6 {
            let (mut store, recall) = Store::open(folder.path()).unwrap();
            assert_eq!(
                recall.found,
                if n == 1 { Found::Absent } else { Found::Intact },
                "{:?}",
                recall.damaged
            );
            assert_eq!(recall.memory, (n > 1).then(|| memory(n - 1)));
            // the first write fills both slots
            assert_eq!(store.write(&memory(n)).unwrap(), n as u64 + 1);
        }
    }

    /// What the store says after `change` to a folder with five writes: state, newest memory, and the report.
    fn after(change: impl Fn(&Path)) -> Recall {
        let folder = tempfile::tempdir().unwrap();
        let (mut store, _) = Store::open(folder.path()).unwrap();
        (1..5).for_each(|n| assert!(store.write(&memory(n)).is_ok()));
        drop(store);
        change(folder.path());
        Store::open(folder.path()).unwrap().1
    }

    #[test]
    fn only_a_whole_pair_of_slots_is_intact() {
        let (a, b) = ("memory.a", "memory.b");
        assert_eq!(after(|_| ()).found, Found::Intact);
        assert_eq!(
            after(|f| [a, b]
                .iter()
                .for_each(|n| std::fs::remove_file(f.join(n)).unwrap()))
            .found,
            Found::Absent
        );
        for name in [a, b] {
            let write = |f: &Path, bytes: &[u8]| std::fs::write(f.join(name), bytes).unwrap();
            let old = |f: &Path| std::fs::read(f.join(name)).unwrap();
            type Change<'a> = (&'static str, &'a dyn Fn(&Path));
            let changes: [Change<'_>; 8] = [
                ("has 0 bytes", &|f| write(f, b"")),
                ("has 500 bytes", &|f| write(f, &old(f)[..500])),
                ("header", &|f| write(f, &[0; SIZE])),
                ("empty", &|f| write(f, &[b' '; SIZE])),
                ("belong together", &|f| {
                    std::fs::remove_file(f.join(name)).unwrap()
                }),
                ("checksum", &|f| {
                    write(f, &{
                        let mut t = old(f);
                        t[100] ^= 1;
                        t
                    })
                }),
                ("belong together", &|f| {
                    std::fs::copy(f.join(if name == a { b } else { a }), f.join(name)).unwrap();
                }),
                ("version 9", &|f| {
                    write(f, &{
                        let mut t = b"retroflex-memory 9 1 1 00000000\nx".to_vec();
                        t.resize(SIZE, b' ');
                        t
                    })
                }),
            ];
            for (part, change) in changes {
                let recall = after(change);
                assert_eq!(recall.found, Found::Damaged, "{name}: {part}");
                assert!(
                    recall.damaged.iter().any(|d| d.contains(part)),
                    "{name}: {part}: {:?}",
                    recall.damaged
                );
            }
        }
        let swapped = after(|f| {
            std::fs::rename(f.join(a), f.join("x")).unwrap();
            std::fs::rename(f.join(b), f.join(a)).unwrap();
            std::fs::rename(f.join("x"), f.join(b)).unwrap();
        });
        assert_eq!(swapped.found, Found::Damaged);
    }

    #[test]
    fn a_damaged_slot_is_renamed_and_the_next_write_fills_both() {
        let folder = tempfile::tempdir().unwrap();
        Store::open(folder.path())
            .unwrap()
            .0
            .write(&memory(1))
            .unwrap();
        std::fs::write(folder.path().join("memory.b"), [0; SIZE]).unwrap();
        let (mut store, recall) = Store::open(folder.path()).unwrap();
        assert!(
            recall.found == Found::Damaged && folder.path().join("memory.b.damaged-1").exists()
        );
        store.write(&memory(2)).unwrap();
        drop(store);
        let (_store, recall) = Store::open(folder.path()).unwrap();
        assert_eq!(
            (recall.found, recall.memory),
            (Found::Intact, Some(memory(2)))
        );
    }

    /// Every file of the state in turn: a link, a pipe, a folder, a socket.
    #[test]
    fn only_regular_files_of_the_owner_are_opened_and_no_links() {
        use std::os::unix::net::UnixListener;
        let mode = |path: &Path| std::fs::metadata(path).unwrap().mode() & 0o777;
        for name in ["memory.a", "memory.b", "lock"] {
            for kind in ["link", "dangling", "pipe", "folder", "socket"] {
                let outer = tempfile::tempdir().unwrap();
                let folder = outer.path().join("state");
                Store::open(&folder).unwrap().0.write(&memory(1)).unwrap();
                assert_eq!(mode(&folder), 0o700);
                for name in ["memory.a", "memory.b", "lock"] {
                    assert_eq!(mode(&folder.join(name)), 0o600, "{name}");
                }
                let (path, other) = (folder.join(name), outer.path().join("other"));
                std::fs::remove_file(&path).unwrap();
                let _listener = match kind {
                    "socket" => Some(UnixListener::bind(&path).unwrap()),
                    _ => None,
                };
                match kind {
                    "link" => {
                        std::fs::write(&other, "mine").unwrap();
                        std::os::unix::fs::symlink(&other, &path).unwrap();
                    }
                    "dangling" => std::os::unix::fs::symlink(&other, &path).unwrap(),
                    "folder" => std::fs::create_dir(&path).unwrap(),
                    "pipe" => {
                        use std::os::unix::ffi::OsStrExt;
                        let name = std::ffi::CString::new(path.as_os_str().as_bytes()).unwrap();
                        // a command would hold the locks of other tests until it runs
                        // SAFETY: the name is a live string that ends in a zero
                        #[allow(unsafe_code)]
                        let made = unsafe { libc::mkfifo(name.as_ptr(), 0o600) };
                        assert_eq!(made, 0);
                    }
                    _ => {}
                }
                // a slot is renamed as damaged, which the lock cannot be
                match Store::open(&folder) {
                    Ok((mut store, recall)) => {
                        assert_eq!(recall.found, Found::Damaged, "{name} {kind}");
                        store.write(&memory(2)).unwrap();
                        assert_ne!(name, "lock");
                    }
                    Err(e) => assert_eq!(name, "lock", "{kind}: {e}"),
                }
                let there = std::fs::read_to_string(&other).unwrap_or_default();
                assert_eq!(
                    there,
                    if kind == "link" { "mine" } else { "" },
                    "{name} {kind}"
                );
            }
        }
    }

    #[test]
    fn a_folder_in_use_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (_one, _) = Store::open(folder.path()).unwrap();
        assert!(matches!(
            Store::open(folder.path()),
            Err(MemoryError::InUse { .. })
        ));
    }

    #[test]
    fn only_an_intact_memory_is_believed() {
        let recall = |found, armed, lost| Recall {
            memory: Some(Memory {
                armed,
                lost,
                ..Memory::default()
            }),
            damaged: vec![],
            found,
            sequence: 1,
        };
        assert_eq!(
            Recall::default().belief(),
            Belief::Lost,
            "a machine without a memory"
        );
        assert_eq!(
            recall(Found::Intact, false, false).belief(),
            Belief::Certain
        );
        for bad in [
            recall(Found::Intact, true, false),
            recall(Found::Intact, false, true),
            recall(Found::Damaged, false, false),
        ] {
            assert_eq!(bad.belief(), Belief::Lost, "{bad:?}");
        }
    }
}
