//! The state writer: the only thread that writes the memory and waits for the disk.

use crate::service::memory::{Memory, MemoryError};
use crate::service::store::Store;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};

/// A memory to write, and the id under which its completion is reported.
type Job = (Box<Memory>, Option<u64>);

/// Handle of the thread.
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

    /// Writes a last time after everything that is queued, waits for the disk and ends the thread.
    pub fn finish(self, memory: &Memory) -> Option<Completed> {
        let sent = self.jobs.send((Box::new(memory.clone()), None)).is_ok();
        drop(self.jobs);
        let last = self.completed.iter().last().filter(|_| sent);
        // it has nothing left to do and nothing to report
        let _ = self.thread.join();
        last
    }
}
