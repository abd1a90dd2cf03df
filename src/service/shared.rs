//! What the threads share without locks, and the watch that the loop keeps over them.

use crate::named;
use crate::service::stop::StopSignal;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering::Relaxed};

/// The heartbeat stops if a thread makes no progress for longer than this, s.
const STALL_MAX_S: f64 = 10.0;
/// Largest increase of a thread's age in one cycle, s: a loop that was suspended does not blame the others.
const AGE_STEP_MAX_S: f64 = 0.05;

named! {
    /// A thread whose progress the loop watches.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Watched {
        /// The command socket.
        Control = "control",
        /// The status socket.
        Status = "status",
        /// The socket of `stop`.
        Stop = "stop",
        /// The hub.
        Hub = "hub",
    }
}

/// How far a thread has come.
#[derive(Debug, Default)]
struct Progress {
    rounds: AtomicU64,
    /// Its rounds when the loop last looked.
    seen: AtomicU64,
    /// Bits of the time since its last progress as the loop sees it, s.
    age_s: AtomicU64,
}

impl Progress {
    fn age_s(&self) -> f64 {
        f64::from_bits(self.age_s.load(Relaxed))
    }
}

/// State shared by the threads without locks.
#[derive(Debug, Default)]
pub struct Shared {
    quit: AtomicBool,
    progress: [Progress; 4],
    /// Clients of each thread's socket.
    pub clients: [AtomicUsize; 4],
    /// Requests and completed stops.
    pub stop: StopSignal,
    /// Cycles of the loop.
    pub cycles: AtomicU64,
    /// Cycles that began more than half a period late.
    pub late: AtomicU64,
    /// Largest delay of a cycle, µs.
    pub max_lateness_us: AtomicU64,
    /// Frames and answers lost because a ring was full.
    pub lost: AtomicU64,
}

impl Shared {
    /// Reports that a thread has begun a round.
    pub fn progress(&self, thread: Watched) {
        self.progress[thread as usize].rounds.fetch_add(1, Relaxed);
    }

    /// Time since the last progress of a thread as the loop sees it, s.
    pub fn age_s(&self, thread: Watched) -> f64 {
        self.progress[thread as usize].age_s()
    }

    /// The loop looks at the progress of all threads, `dt_s` after it did so last.
    pub fn watch(&self, dt_s: f64) {
        for thread in &self.progress {
            let rounds = thread.rounds.load(Relaxed);
            let waits = thread.seen.swap(rounds, Relaxed) == rounds;
            let age_s = thread.age_s() + dt_s.min(AGE_STEP_MAX_S);
            let age_s = if waits { age_s } else { 0.0 };
            thread.age_s.store(age_s.to_bits(), Relaxed);
        }
    }

    /// True if a thread has made no progress for too long.
    pub fn is_stalled(&self) -> bool {
        self.progress
            .iter()
            .any(|thread| thread.age_s() >= STALL_MAX_S)
    }

    /// Ends the loop and the socket threads after their present round.
    pub fn quit(&self) {
        self.quit.store(true, Relaxed);
    }

    /// True once [`Shared::quit`] was called.
    pub fn is_quitting(&self) -> bool {
        self.quit.load(Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_without_progress_ages_and_a_suspended_loop_blames_nobody() {
        let shared = Shared::default();
        for _ in 0..2000 {
            shared.progress(Watched::Hub);
            shared.watch(1e-3);
        }
        assert_eq!(shared.age_s(Watched::Hub), 0.0);
        assert!((shared.age_s(Watched::Control) - 2.0).abs() < 1e-6);
        shared.progress(Watched::Control);
        shared.watch(1e-3);
        shared.watch(3600.0);
        assert!(shared.age_s(Watched::Control) < 0.1);
    }
}
