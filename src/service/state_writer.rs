//! The keeper: the one thread that forces memory to the disk.

use crate::service::memory::{Memory, MemoryError, Store};
use std::sync::mpsc::{Receiver, Sender, SyncSender, TrySendError, channel, sync_channel};

/// Something to keep; who waits for it gives a number.
#[derive(Debug)]
struct Job {
    memory: Box<Memory>,
    waiting: Option<u64>,
}

/// The hub's handle.
#[derive(Debug)]
pub struct StateWriter {
    jobs: Option<SyncSender<Job>>,
    done: Receiver<Done>,
    thread: Option<std::thread::JoinHandle<()>>,
}

/// What became of a job.
#[derive(Debug)]
pub struct Done {
    /// The number of who waits.
    pub waiting: Option<u64>,
    /// The number of the write, or why there was none.
    pub result: Result<u64, MemoryError>,
}

/// Starts the thread.
///
/// # Errors
/// The system's.
pub fn start(mut store: Store) -> std::io::Result<StateWriter> {
    let (jobs, work) = sync_channel::<Job>(4);
    let (tell, done): (Sender<Done>, Receiver<Done>) = channel();
    let thread = std::thread::Builder::new().name("keeper".into()).spawn(move || {
        for job in work {
            let result = store.write(&job.memory);
            if tell.send(Done { waiting: job.waiting, result }).is_err() {
                return;
            }
        }
    })?;
    Ok(StateWriter { jobs: Some(jobs), done, thread: Some(thread) })
}

impl StateWriter {
    /// Hands over a checkpoint; false when the disk is still busy with the ones before.
    pub fn checkpoint(&self, memory: &Memory) -> bool {
        self.put(memory, None)
    }

    /// Hands over what somebody waits for.
    pub fn keep(&self, memory: &Memory, waiting: u64) -> bool {
        self.put(memory, Some(waiting))
    }

    fn put(&self, memory: &Memory, waiting: Option<u64>) -> bool {
        let Some(jobs) = &self.jobs else { return false };
        match jobs.try_send(Job { memory: Box::new(memory.clone()), waiting }) {
            Ok(()) => true,
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => false,
        }
    }

    /// The next thing that is done, if any.
    #[must_use]
    pub fn done(&self) -> Option<Done> {
        self.done.try_recv().ok()
    }

    /// The last words of a service that ends: waits for the disk.
    pub fn finish(mut self, memory: &Memory) -> Option<Done> {
        let jobs = self.jobs.take()?;
        // whoever ends has time; everything before it goes first
        let sent = jobs.send(Job { memory: Box::new(memory.clone()), waiting: Some(u64::MAX) });
        drop(jobs);
        if sent.is_err() {
            return None;
        }
        let last = self.done.iter().find(|d| d.waiting == Some(u64::MAX));
        if let Some(thread) = self.thread.take() {
            // it has ended: it told us its last word
            let _ = thread.join();
        }
        last
    }
}
