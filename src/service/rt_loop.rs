//! The loop's thread: wait for the instant, turn, hand over. Nothing here locks, allocates or waits for
//! anything but the clock.

use crate::control::tick::RestartState;
use crate::hardware::rt::{monotonic_ns, sleep_until_ns};
use crate::primitives::units::Seconds;
use crate::service::notify::Feed;
use crate::supervisor::cycle::order::{Order, Refusal};
use crate::supervisor::cycle::runner::Runner;
use crate::supervisor::cycle::{CycleOutput, Supervisor, SupervisorConfig};
use crate::supervisor::machine::Machine;
use crate::supervisor::machine::MachineError;
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};

/// A message to the loop.
#[derive(Debug)]
pub enum Message {
    /// An order, with the number its answer carries.
    Order(u64, Order),
    /// Another configuration; the old one comes back through the ring of the spent.
    Reload(Box<SupervisorConfig>),
    /// Another pilot, at rest: so that a recording begins with one that remembers nothing else.
    Relieve(Box<Supervisor>),
}

/// What the loop has no use for any more; freed by the hub.
#[derive(Debug)]
pub enum Retired {
    /// An old configuration.
    Config(Box<SupervisorConfig>),
    /// A pilot that was relieved.
    Supervisor(Box<Supervisor>),
}

/// Where the pistons were, worth keeping.
#[derive(Debug, Clone, Copy)]
pub struct KeepNote {
    /// For a restart.
    pub kept: RestartState,
    /// Nothing needs proof: pistons at zero.
    pub at_rest: bool,
}

/// The loop's ends of the rings.
pub struct Wires {
    orders: Consumer<Message>,
    answers: Producer<(u64, Result<(), Refusal>)>,
    frames: Producer<CycleOutput>,
    keeps: Producer<KeepNote>,
    spent: Producer<Retired>,
}

/// The hub's ends of the rings.
pub struct OtherEnd {
    /// Orders to the loop.
    pub orders: Producer<Message>,
    /// Answers from it.
    pub answers: Consumer<(u64, Result<(), Refusal>)>,
    /// Every turn.
    pub frames: Consumer<CycleOutput>,
    /// Where the pistons are, now and then.
    pub keeps: Consumer<KeepNote>,
    /// What is to be disposed of.
    pub spent: Consumer<Retired>,
}

/// Turns the ring of frames holds: at 1 kHz four seconds of a hub that is away.
const FRAMES: usize = 4096;
/// Turns from one note for the keeper to the next.
const KEEP_EVERY: u64 = 20;
/// A hub that has not been round for this long does not deserve the watchdog's meal, s.
const HUB_MAX_S: f64 = 10.0;

/// Both ends of all rings.
#[must_use]
pub fn wires() -> (Wires, OtherEnd) {
    let (orders_in, orders) = RingBuffer::new(64);
    let (answers, answers_out) = RingBuffer::new(64);
    let (frames, frames_out) = RingBuffer::new(FRAMES);
    let (keeps, keeps_out) = RingBuffer::new(256);
    let (spent, spent_out) = RingBuffer::new(16);
    (
        Wires { orders, answers, frames, keeps, spent },
        OtherEnd { orders: orders_in, answers: answers_out, frames: frames_out, keeps: keeps_out, spent: spent_out },
    )
}

/// What both sides read and write without a lock.
#[derive(Debug, Default)]
pub struct Shared {
    quit: AtomicBool,
    /// Counts the hub's rounds.
    pub hub_rounds: AtomicU64,
    /// Counts the turns.
    pub turns: AtomicU64,
    /// Turns that began more than half a period late.
    pub late: AtomicU64,
    /// The latest that one began, µs.
    pub latest_us: AtomicU64,
    /// Frames lost to a slow hub.
    pub lost: AtomicU64,
}

impl Shared {
    /// Ends the loop after its present turn.
    pub fn quit(&self) {
        self.quit.store(true, Relaxed);
    }
}

/// Everything the thread owns.
pub struct Loop {
    /// Pilot and machine.
    pub runner: Runner<Box<dyn Machine>>,
    /// Its ends of the rings.
    pub wires: Wires,
    /// Counters.
    pub shared: Arc<Shared>,
    /// Time of a turn, s.
    pub period_s: f64,
    /// Do not wait.
    pub fast: bool,
    /// The watchdog's line.
    pub feed: Option<Feed>,
}

impl Loop {
    /// Turns until told to quit.
    ///
    /// # Errors
    /// The machine's.
    pub fn run(mut self) -> Result<(), MachineError> {
        let simulated = self.runner.machine.is_simulated();
        let period_ns = (self.period_s * 1e9) as u64;
        let begun_ns = monotonic_ns();
        let mut due_ns = begun_ns;
        let mut periods = 0u64;
        let mut watch = Watch::default();
        while !self.shared.quit.load(Relaxed) {
            let elapsed = if self.fast {
                periods + 1
            } else {
                due_ns += period_ns;
                sleep_until_ns(due_ns);
                let now_ns = monotonic_ns();
                self.note_lateness(now_ns.saturating_sub(due_ns), period_ns);
                if now_ns > due_ns + period_ns {
                    // what was missed is not made up for: the next turn is a period from here
                    due_ns = now_ns;
                }
                if simulated { ((now_ns - begun_ns) / period_ns).max(periods + 1) } else { now_ns - begun_ns }
            };
            periods = elapsed;
            let now_s = if simulated || self.fast { elapsed as f64 * self.period_s } else { elapsed as f64 * 1e-9 };
            self.turn(Seconds(now_s))?;
            watch.step(&self.shared, self.feed.as_ref(), now_s);
        }
        Ok(())
    }

    fn turn(&mut self, now: Seconds) -> Result<(), MachineError> {
        let mut order = None;
        match self.wires.orders.pop() {
            Ok(Message::Order(id, o)) => order = Some((id, o)),
            Ok(Message::Reload(mut config)) => {
                self.runner.supervisor.reload(&mut config);
                // sixteen old ones waiting: better to free one here than to leak it
                drop(self.wires.spent.push(Retired::Config(config)));
            }
            Ok(Message::Relieve(mut supervisor)) => {
                std::mem::swap(&mut self.runner.supervisor, &mut supervisor);
                drop(self.wires.spent.push(Retired::Supervisor(supervisor)));
            }
            Err(_) => {}
        }
        let turned = self.runner.turn(now, order.map(|(_, o)| o))?;
        if let (Some((id, _)), Some(answer)) = (order, turned.answer)
            && self.wires.answers.push((id, answer)).is_err()
        {
            self.shared.lost.fetch_add(1, Relaxed);
        }
        if self.wires.frames.push(turned).is_err() {
            self.shared.lost.fetch_add(1, Relaxed);
        }
        let n = self.shared.turns.fetch_add(1, Relaxed);
        if n.is_multiple_of(KEEP_EVERY) {
            let supervisor = &self.runner.supervisor;
            // a full ring means a hub that is behind; the next note says the same and more
            let _ = self.wires.keeps.push(KeepNote { kept: supervisor.keep(), at_rest: supervisor.is_at_rest() });
        }
        Ok(())
    }

    fn note_lateness(&self, late_ns: u64, period_ns: u64) {
        if late_ns > period_ns / 2 {
            self.shared.late.fetch_add(1, Relaxed);
        }
        self.shared.latest_us.fetch_max(late_ns / 1000, Relaxed);
    }
}

/// Feeds the watchdog as long as both the loop and the hub go round.
#[derive(Default)]
struct Watch {
    fed_s: f64,
    hub_rounds: u64,
    hub_s: f64,
}

impl Watch {
    fn step(&mut self, shared: &Shared, feed: Option<&Feed>, now_s: f64) {
        let Some(feed) = feed else { return };
        let rounds = shared.hub_rounds.load(Relaxed);
        if rounds != self.hub_rounds {
            (self.hub_rounds, self.hub_s) = (rounds, now_s);
        }
        if now_s - self.fed_s >= feed.every_s && now_s - self.hub_s < HUB_MAX_S {
            self.fed_s = now_s;
            feed.feed();
        }
    }
}
