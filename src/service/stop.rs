//! The path of `stop` from the threads of the sockets to the loop.
//!
//! A stop shares no queue with other orders. The thread that receives it increments an atomic counter, as the loop does for a stop of its
//! own; the loop compares it in every cycle before it takes a message, hands [`Order::Stop`] to the supervisor, and stores the number of
//! the stop that it has carried out. [`StopSignal::pending`], [`StopSignal::admit`] and [`StopSignal::report`] are for the loop alone. The latch itself is part of the supervisor; [`StopSignal::admit`] adds that an order which was received
//! before the stop cannot release it.

use crate::service::Failure;
use crate::supervisor::{Order, Refusal};
use serde_json::{Value, json};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// The loop must carry out a stop within this time.
const ANSWER_MAX: Duration = Duration::from_millis(150);

/// Counters shared by the threads of the sockets and the loop.
#[derive(Debug, Default)]
pub struct StopSignal {
    requested: AtomicU64,
    completed: AtomicU64,
    latched: AtomicBool,
}

impl StopSignal {
    /// Requests a stop and returns its number.
    pub fn request(&self) -> u64 {
        self.requested.fetch_add(1, Ordering::AcqRel) + 1
    }

    /// Number of stops requested so far.
    pub fn requested(&self) -> u64 {
        self.requested.load(Ordering::Acquire)
    }

    /// Number of the last stop that the loop has carried out.
    pub fn completed(&self) -> u64 {
        self.completed.load(Ordering::Acquire)
    }

    /// The answer to a stop that was requested at this instant: at once while one is latched, because nothing moves until the loop has
    /// seen this one too; `None` while the loop still has time to carry it out.
    pub fn answer(&self, number: u64, since: Instant) -> Option<Result<Value, Failure>> {
        if self.completed() >= number || self.latched.load(Ordering::Acquire) {
            Some(Ok(json!({})))
        } else {
            let late = || Err(Failure::unreachable("the loop does not respond"));
            (since.elapsed() > ANSWER_MAX).then(late)
        }
    }

    /// Reports which stop the loop has carried out in a cycle, if any, and whether one is latched after it.
    pub fn report(&self, completed: Option<u64>, latched: bool) {
        if let Some(number) = completed {
            self.completed.store(number, Ordering::Release);
        }
        self.latched.store(latched, Ordering::Release);
    }

    /// The number of the last stop, unless the loop has carried it out.
    pub fn pending(&self) -> Option<u64> {
        let requested = self.requested();
        (requested != self.completed()).then_some(requested)
    }

    /// Decides whether an order may reach the supervisor. `stops` is the number of stops that were requested when the
    /// order was received: what was queued before a stop starts no motion and does not release the latch.
    ///
    /// # Errors
    /// [`Refusal::Stopped`].
    pub fn admit(&self, order: &Order, stops: u64) -> Result<(), Refusal> {
        if stops != self.completed() && order.starts_motion() {
            Err(Refusal::Stopped)
        } else {
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_queued_before_a_stop_starts_no_motion_after_it() {
        let signal = StopSignal::default();
        assert_eq!(
            (signal.pending(), signal.admit(&Order::Relax, 0)),
            (None, Ok(()))
        );
        assert_eq!((signal.request(), signal.pending()), (1, Some(1)));
        signal.report(Some(1), true);
        assert_eq!(signal.pending(), None);
        for order in [Order::Relax, Order::Calibrate(true), Order::Arm] {
            assert_eq!(
                signal.admit(&order, 0),
                Err(Refusal::Stopped),
                "{order:?} was queued before the stop"
            );
            assert_eq!(
                signal.admit(&order, 1),
                Ok(()),
                "the supervisor decides about {order:?}"
            );
        }
        for order in [
            Order::Disarm,
            Order::Hold,
            Order::Zero,
            Order::Reset,
            Order::Calibrate(false),
        ] {
            assert_eq!(
                signal.admit(&order, 0),
                Ok(()),
                "{order:?} starts no motion"
            );
        }
    }
}
