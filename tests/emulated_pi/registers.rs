//! The GPIO registers of a BCM2837 as a mapped file. A thread polls it, applies stores to GPSET0 and GPCLR0 to GPLEV0, and
//! counts them.
//!
//! Two stores to a register between two polls count as one, so this is exact for slow lines only.
#![allow(unsafe_code)]

use retroflex::hardware::rt::{self, RtRequest};
use std::fs::File;
use std::os::fd::AsRawFd;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::JoinHandle;

const SIZE: usize = 4096;
const GPSET0: usize = 0x1C / 4;
const GPCLR0: usize = 0x28 / 4;
const GPLEV0: usize = 0x34 / 4;
/// Time between two polls, ns.
const LOOK_NS: u64 = 10_000;

/// The result.
#[derive(Debug)]
pub struct Seen {
    /// GPFSEL0 to GPFSEL2.
    pub select: [u32; 3],
    /// Sets of each line that follow a clear.
    pub pulses: [u32; 32],
    /// Levels at the end.
    pub level: u32,
}

/// A running watch.
pub struct Registers {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Seen>,
}

impl Registers {
    /// Watches the registers in a file of the calling thread's namespace.
    pub fn watch(path: &Path) -> Self {
        let file = File::options()
            .read(true)
            .write(true)
            .open(path)
            .expect("the emulated registers");
        let stop = Arc::new(AtomicBool::new(false));
        let end = stop.clone();
        let thread = std::thread::spawn(move || {
            let _guard = rt::enter(&RtRequest {
                priority: 91,
                cpu: None,
            });
            look(&file, &end)
        });
        Self { stop, thread }
    }

    /// Ends the watch.
    pub fn done(self) -> Seen {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().expect("the watch does not panic")
    }
}

fn look(file: &File, end: &AtomicBool) -> Seen {
    // SAFETY: a shared mapping of a file of SIZE bytes, kept for the life of the process; null lets the
    // kernel choose the place.
    let base = unsafe {
        libc::mmap(
            std::ptr::null_mut(),
            SIZE,
            libc::PROT_READ | libc::PROT_WRITE,
            libc::MAP_SHARED,
            file.as_raw_fd(),
            0,
        )
    };
    assert_ne!(base, libc::MAP_FAILED);
    // SAFETY: the mapping is SIZE bytes, page-aligned and never unmapped; other processes store to it, which
    // is what atomics are for.
    let words: &[AtomicU32] = unsafe { std::slice::from_raw_parts(base.cast(), SIZE / 4) };
    let mut pulses = [0; 32];
    let mut level = 0_u32;
    while !end.load(Ordering::Relaxed) {
        let (set, clear) = (
            words[GPSET0].swap(0, Ordering::AcqRel),
            words[GPCLR0].swap(0, Ordering::AcqRel),
        );
        // every rise of a line that was low, even if the line has fallen again
        for (line, n) in pulses.iter_mut().enumerate() {
            *n += (set & !level) >> line & 1;
        }
        // a store to both since the last poll is a complete pulse, after which the level is unchanged
        let both = set & clear;
        level = (level | (set & !both)) & !(clear & !both);
        words[GPLEV0].store(level, Ordering::Release);
        rt::sleep_until_ns(rt::monotonic_ns() + LOOK_NS);
    }
    Seen {
        select: [0, 1, 2].map(|i| words[i].load(Ordering::Relaxed)),
        pulses,
        level,
    }
}
