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

/// State shared by the threads without locks.
#[derive(Debug, Default)]
pub struct Shared {
    quit: AtomicBool,
    rounds: [AtomicU64; 4],
    ages_ms: [AtomicU64; 4],
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
        self.rounds[thread as usize].fetch_add(1, Relaxed);
    }

    /// Time since the last progress of a thread as the loop sees it, s.
    pub fn age_s(&self, thread: Watched) -> f64 {
        self.ages_ms[thread as usize].load(Relaxed) as f64 * 1e-3
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

/// How long ago each thread last made progress.
#[derive(Debug, Default)]
pub struct ThreadWatch {
    rounds: [u64; 4],
    ages_s: [f64; 4],
}

impl ThreadWatch {
    /// One cycle that took `dt_s`.
    pub fn step(&mut self, shared: &Shared, dt_s: f64) {
        for k in 0..self.rounds.len() {
            let rounds = shared.rounds[k].load(Relaxed);
            let waits = std::mem::replace(&mut self.rounds[k], rounds) == rounds;
            self.ages_s[k] = if waits {
                self.ages_s[k] + dt_s.min(AGE_STEP_MAX_S)
            } else {
                0.0
            };
            shared.ages_ms[k].store((self.ages_s[k] * 1e3) as u64, Relaxed);
        }
    }

    /// Time since the last progress of a thread, s.
    pub fn age_s(&self, thread: Watched) -> f64 {
        self.ages_s[thread as usize]
    }

    /// True if a thread has made no progress for too long.
    pub fn is_stalled(&self) -> bool {
        self.ages_s.iter().any(|age_s| *age_s >= STALL_MAX_S)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_without_progress_ages_and_a_suspended_loop_blames_nobody() {
        let (shared, mut watch) = (Shared::default(), ThreadWatch::default());
        for _ in 0..2000 {
            shared.progress(Watched::Hub);
            watch.step(&shared, 1e-3);
        }
        assert!(
            watch.age_s(Watched::Hub) == 0.0 && (watch.age_s(Watched::Control) - 2.0).abs() < 1e-6
        );
        assert!((shared.age_s(Watched::Control) - 2.0).abs() < 2e-3);
        shared.progress(Watched::Control);
        watch.step(&shared, 1e-3);
        watch.step(&shared, 3600.0);
        assert!(watch.age_s(Watched::Control) < 0.1);
    }
}
