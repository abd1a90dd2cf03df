//! The real-time thread: one control cycle per period. It never locks, never allocates and waits for nothing but the
//! clock.

use crate::control::tick::RestartState;
use crate::hardware::rt::{monotonic_ns, sleep_until_ns};
use crate::primitives::units::Seconds;
use crate::service::notify::Heartbeat;
use crate::service::stop::{StopCounter, StopSignal};
use crate::supervisor::cycle::order::{Order, Refusal};
use crate::supervisor::cycle::runner::Runner;
use crate::supervisor::cycle::{CycleOutput, Supervisor, SupervisorConfig};
use crate::supervisor::machine::{Machine, MachineError};
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};

/// A message to the loop.
#[derive(Debug)]
pub enum Message {
    /// An order.
    Order {
        /// Identifies the answer.
        id: u64,
        /// What to do.
        order: Order,
        /// Number of stops requested when the order was received, see [`StopCounter`].
        stops: u64,
    },
    /// Replaces the configuration. The old one comes back as [`Retired::Config`].
    Reload(Box<SupervisorConfig>),
    /// Replaces the supervisor with a freshly reset one, so that a recording starts from a known state.
    ReplaceSupervisor(Box<Supervisor>),
}

/// Objects retired by the loop. The hub drops them so that the loop never frees memory.
#[derive(Debug)]
pub enum Retired {
    /// A replaced configuration.
    Config(Box<SupervisorConfig>),
    /// A replaced supervisor.
    Supervisor(Box<Supervisor>),
}

/// What a restart needs, sampled by the loop.
#[derive(Debug, Clone, Copy)]
pub struct RestartNote {
    /// Position and learned parameters.
    pub state: RestartState,
    /// The pistons are at zero, so a restart has nothing to verify.
    pub at_rest: bool,
}

/// Result of an order, with the id of its message.
pub type Answer = (u64, Result<(), Refusal>);

/// The loop's ends of the rings. All rings are wait-free.
pub struct LoopRings {
    orders: Consumer<Message>,
    answers: Producer<Answer>,
    frames: Producer<CycleOutput>,
    notes: Producer<RestartNote>,
    retired: Producer<Retired>,
}

/// The hub's ends of the rings.
pub struct HubRings {
    /// Orders to the loop.
    pub orders: Producer<Message>,
    /// Answers to orders.
    pub answers: Consumer<Answer>,
    /// The output of every cycle.
    pub frames: Consumer<CycleOutput>,
    /// Restart data, every `NOTE_EVERY` cycles.
    pub notes: Consumer<RestartNote>,
    /// Objects to drop.
    pub retired: Consumer<Retired>,
}

/// Capacity of the frame ring, cycles: the hub may be late by 4 s at 1 kHz.
const FRAMES: usize = 4096;
/// Cycles between two restart notes.
const NOTE_EVERY: u64 = 20;
/// The heartbeat stops if the hub stalls for longer than this, s.
const HUB_STALL_MAX_S: f64 = 10.0;

/// Creates the rings.
#[must_use]
pub fn rings() -> (LoopRings, HubRings) {
    let (orders, loop_orders) = RingBuffer::new(64);
    let (loop_answers, answers) = RingBuffer::new(64);
    let (loop_frames, frames) = RingBuffer::new(FRAMES);
    let (loop_notes, notes) = RingBuffer::new(256);
    let (loop_retired, retired) = RingBuffer::new(16);
    (
        LoopRings { orders: loop_orders, answers: loop_answers, frames: loop_frames, notes: loop_notes, retired: loop_retired },
        HubRings { orders, answers, frames, notes, retired },
    )
}

/// State shared by the threads without locks.
#[derive(Debug, Default)]
pub struct Shared {
    quit: AtomicBool,
    /// Requests and completed stops.
    pub stop: StopSignal,
    /// Rounds of the hub.
    pub hub_rounds: AtomicU64,
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
    /// Ends the loop and the command thread after their present round.
    pub fn quit(&self) {
        self.quit.store(true, Relaxed);
    }

    /// True once [`Shared::quit`] was called.
    #[must_use]
    pub fn is_quitting(&self) -> bool {
        self.quit.load(Relaxed)
    }
}

/// Everything the real-time thread owns.
pub struct Loop {
    /// Supervisor and machine.
    pub runner: Runner<Box<dyn Machine>>,
    /// The loop's ends of the rings.
    pub rings: LoopRings,
    /// Counters.
    pub shared: Arc<Shared>,
    /// Period of a cycle, s.
    pub period_s: f64,
    /// How many times faster than real time a simulation runs; infinity: as fast as possible. `None`: in real time.
    pub pace: Option<f64>,
    /// The watchdog heartbeat.
    pub heartbeat: HeartbeatMonitor,
    /// Recognises what was queued before a stop.
    pub stops: StopCounter,
}

impl Loop {
    /// Runs cycles until [`Shared::quit`].
    ///
    /// # Errors
    /// [`MachineError`].
    pub fn run(mut self) -> Result<(), MachineError> {
        let simulated = self.runner.machine.is_simulated();
        let period_ns = (self.period_s * 1e9) as u64;
        let start_ns = monotonic_ns();
        let mut due_ns = start_ns;
        let mut periods = 0u64;
        while !self.shared.is_quitting() {
            let elapsed = if let Some(pace) = self.pace {
                due_ns += (period_ns as f64 / pace) as u64;
                sleep_until_ns(due_ns);
                periods + 1
            } else {
                due_ns += period_ns;
                sleep_until_ns(due_ns);
                let now_ns = monotonic_ns();
                self.record_lateness(now_ns.saturating_sub(due_ns), period_ns);
                if now_ns > due_ns + period_ns {
                    // missed cycles are skipped, not caught up
                    due_ns = now_ns;
                }
                if simulated { ((now_ns - start_ns) / period_ns).max(periods + 1) } else { now_ns - start_ns }
            };
            periods = elapsed;
            let now_s = if simulated || self.pace.is_some() { elapsed as f64 * self.period_s } else { elapsed as f64 * 1e-9 };
            self.cycle(Seconds(now_s))?;
            self.heartbeat.update(&self.shared, now_s);
        }
        Ok(())
    }

    fn cycle(&mut self, now: Seconds) -> Result<(), MachineError> {
        // a stop comes before every queued message
        let stop = self.stops.take_request(&self.shared.stop);
        let (id, order) = match stop {
            Some(_) => (None, Some(Order::Stop)),
            None => self.next_order(),
        };
        let output = self.runner.turn(now, order)?;
        if let (Some(id), Some(answer)) = (id, output.answer) {
            self.answer(id, answer);
        }
        if self.rings.frames.push(output).is_err() {
            self.shared.lost.fetch_add(1, Relaxed);
        }
        if let Some(number) = stop {
            // after the frame, so that a status that follows the answer reports the stop
            self.shared.stop.complete(number);
        }
        if self.shared.cycles.fetch_add(1, Relaxed).is_multiple_of(NOTE_EVERY) {
            let supervisor = &self.runner.supervisor;
            // if the ring is full the hub is late, and a newer note will replace this one
            let _ = self.rings.notes.push(RestartNote { state: supervisor.keep(), at_rest: supervisor.is_at_rest() });
        }
        Ok(())
    }

    /// Takes one message; returns the order for this cycle with its id.
    fn next_order(&mut self) -> (Option<u64>, Option<Order>) {
        match self.rings.orders.pop() {
            Ok(Message::Order { id, order, stops }) => match self.stops.admit(&order, stops) {
                Ok(()) => return (Some(id), Some(order)),
                Err(refusal) => self.answer(id, Err(refusal)),
            },
            Ok(Message::Reload(mut config)) => {
                self.runner.supervisor.reload(&mut config);
                self.retire(Retired::Config(config));
            }
            Ok(Message::ReplaceSupervisor(mut supervisor)) => {
                supervisor.inherit(&self.runner.supervisor);
                std::mem::swap(&mut self.runner.supervisor, &mut supervisor);
                self.retire(Retired::Supervisor(supervisor));
            }
            Err(_) => {}
        }
        (None, None)
    }

    fn answer(&mut self, id: u64, result: Result<(), Refusal>) {
        if self.rings.answers.push((id, result)).is_err() {
            self.shared.lost.fetch_add(1, Relaxed);
        }
    }

    fn retire(&mut self, object: Retired) {
        // with sixteen objects waiting, freeing one here is better than leaking it
        drop(self.rings.retired.push(object));
    }

    fn record_lateness(&self, late_ns: u64, period_ns: u64) {
        if late_ns > period_ns / 2 {
            self.shared.late.fetch_add(1, Relaxed);
        }
        self.shared.max_lateness_us.fetch_max(late_ns / 1000, Relaxed);
    }
}

/// Sends the heartbeat while both the loop and the hub make progress.
pub struct HeartbeatMonitor {
    heartbeat: Option<Heartbeat>,
    sent_s: f64,
    hub_rounds: u64,
    hub_progress_s: f64,
}

impl HeartbeatMonitor {
    /// `heartbeat` is `None` without a watchdog.
    #[must_use]
    pub fn new(heartbeat: Option<Heartbeat>) -> Self {
        Self { heartbeat, sent_s: 0.0, hub_rounds: 0, hub_progress_s: 0.0 }
    }

    fn update(&mut self, shared: &Shared, now_s: f64) {
        let Some(heartbeat) = &self.heartbeat else { return };
        let rounds = shared.hub_rounds.load(Relaxed);
        if rounds != self.hub_rounds {
            (self.hub_rounds, self.hub_progress_s) = (rounds, now_s);
        }
        if now_s - self.sent_s >= heartbeat.period_s && now_s - self.hub_progress_s < HUB_STALL_MAX_S {
            self.sent_s = now_s;
            heartbeat.send();
        }
    }
}
