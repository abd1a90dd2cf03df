//! The state that survives `kill -9`, power loss and a full disk.
//!
//! Two slots of fixed size ([`slot`]) are written in turn. A write overwrites the older slot in place, waits for the disk and reads the slot back. Slots are overwritten in place because a full disk
//! accepts no new file.
//!
//! The memory is written ahead: drivers are armed only once the slot that says so is on the disk. A slot that says
//! "pistons at rest" is therefore true as long as it is the newest.
//!
//! Only a pair of slots that is whole is believed: both of full size and intact, each in its place (odd sequence numbers
//! in the first), one write apart. Otherwise the newest write may be missing, and the position is unknown. A damaged slot
//! is renamed and reported.

use crate::service::disk;
use crate::service::memory::{Memory, MemoryError};
use crate::service::slot::{self, SIZE};
use std::fs::{DirBuilder, File, OpenOptions, Permissions};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

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
        let fail = |path: &Path, source| MemoryError::Io {
            path: path.display().to_string(),
            source,
        };
        let mut builder = DirBuilder::new();
        let created = builder.recursive(true).mode(0o700).create(folder);
        created.map_err(|e| fail(folder, e))?;
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
            .map_err(|e| fail(&lock_path, e))?;
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
            slot::read(&path).unwrap_or_else(|reason| {
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
            recall.damaged.push(format!(
                "{}: the writes {sequences:?} of the two slots do not belong together",
                folder.display()
            ));
        }
        let newest = slots
            .into_iter()
            .flatten()
            .max_by_key(|(sequence, _)| *sequence);
        (recall.sequence, recall.memory) =
            newest.map_or((0, None), |(sequence, memory)| (sequence, Some(memory)));
        let store = Self {
            folder: folder.to_owned(),
            sequence: recall.sequence,
            whole: recall.found == Found::Intact,
            _lock: lock,
        };
        store.reserve().map_err(|e| fail(folder, e))?;
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
        let slot = slot::compose(sequence, memory)?;
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
        put().map_err(|source| MemoryError::Io {
            path: path.display().to_string(),
            source,
        })?;
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
    let extension = path
        .extension()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let free = (1..)
        .map(|n| path.with_extension(format!("{extension}.damaged-{n}")))
        .find(|p| !p.exists());
    let renamed = free.unwrap_or_else(|| path.with_extension("damaged"));
    match std::fs::rename(path, &renamed) {
        Ok(()) => format!(
            "{} {reason}; renamed to {}",
            path.display(),
            renamed.display()
        ),
        Err(e) => format!("{} {reason}; it could not be renamed: {e}", path.display()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::slot::tests::memory;

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
}
