//! The path of `stop` from the command thread to the loop.
//!
//! A stop shares no queue with other orders. The command thread increments an atomic counter; the loop compares it in
//! every cycle before it takes a message, brakes, and stores the number of the stop that it has carried out. Afterwards
//! [`StopLatch`] refuses every order that can start motion until an `arm` that was received after the stop.

use crate::supervisor::cycle::order::{Order, Refusal};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Counters shared by the command thread and the loop.
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
    #[must_use]
    pub fn requested(&self) -> u64 {
        self.requested.load(Ordering::Acquire)
    }

    /// Number of the last stop that the loop has carried out.
    #[must_use]
    pub fn completed(&self) -> u64 {
        self.completed.load(Ordering::Acquire)
    }

    /// Reports that the loop has carried out a stop.
    pub fn complete(&self, number: u64) {
        self.completed.store(number, Ordering::Release);
    }

    /// True from a stop until the next `arm`.
    #[must_use]
    pub fn is_latched(&self) -> bool {
        self.latched.load(Ordering::Acquire)
    }
}

/// Why the loop did not carry out an order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Rejection {
    /// A stop is latched, or was requested after this order was received.
    #[error("stopped: `retroflex arm` first")]
    Stopped,
    /// The supervisor refused it.
    #[error(transparent)]
    Supervisor(Refusal),
}

/// The loop's side: refuses motion from a stop until the next `arm`.
#[derive(Debug, Default)]
pub struct StopLatch {
    seen: u64,
    latched: bool,
}

impl StopLatch {
    /// The number of a stop that was requested since the last call, if any. Engages the latch.
    pub fn take_request(&mut self, signal: &StopSignal) -> Option<u64> {
        let requested = signal.requested();
        // published here, in the cycle after the latch changed
        signal.latched.store(self.latched || requested != self.seen, Ordering::Release);
        if requested == self.seen {
            return None;
        }
        (self.seen, self.latched) = (requested, true);
        Some(requested)
    }

    /// Decides whether an order may reach the supervisor. `stops` is the number of stops that were requested when the
    /// order was received: an `arm` that was queued before the stop does not release the latch.
    ///
    /// # Errors
    /// [`Rejection::Stopped`].
    pub fn admit(&mut self, order: &Order, stops: u64) -> Result<(), Rejection> {
        if *order == Order::Arm && stops == self.seen {
            // also where the supervisor refuses to energise: after a lost position `relax` has to come next
            self.latched = false;
        }
        let starts_motion = matches!(order, Order::Arm | Order::Bend(..) | Order::Stream(_) | Order::Relax | Order::Calibrate(true));
        if self.latched && starts_motion { Err(Rejection::Stopped) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_latches_until_an_arm_that_was_received_after_it() {
        let (signal, mut latch) = (StopSignal::default(), StopLatch::default());
        assert_eq!(latch.take_request(&signal), None);
        assert_eq!(latch.admit(&Order::Relax, 0), Ok(()));
        assert_eq!(signal.request(), 1);
        assert_eq!(latch.take_request(&signal), Some(1));
        assert!(signal.is_latched());
        for order in [Order::Relax, Order::Calibrate(true), Order::Arm] {
            assert_eq!(latch.admit(&order, 0), Err(Rejection::Stopped), "{order:?} was queued before the stop");
        }
        for order in [Order::Disarm, Order::Hold, Order::Zero, Order::Reset, Order::Calibrate(false)] {
            assert_eq!(latch.admit(&order, 1), Ok(()), "{order:?} starts no motion");
        }
        assert_eq!(latch.admit(&Order::Relax, 1), Err(Rejection::Stopped));
        assert_eq!(latch.admit(&Order::Arm, 1), Ok(()));
        assert_eq!(latch.admit(&Order::Relax, 1), Ok(()));
        assert_eq!(latch.take_request(&signal), None);
        assert!(!signal.is_latched());
    }
}
