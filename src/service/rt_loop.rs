//! The real-time thread: one control cycle per period. It never locks, never allocates and waits for nothing but the
//! clock.

use crate::control::{Path, RestartState};
use crate::hardware::rt::{monotonic_ns, sleep_until_ns};
use crate::primitives::Seconds;
use crate::service::connection::UNANSWERED_MAX;
use crate::service::notify::Heartbeat;
use crate::service::server::CLIENTS_MAX;
use crate::service::{Shared, Watched};
use crate::supervisor::{
    CycleOutput, Machine, MachineError, Mode, Order, Refusal, Runner, Supervisor, SupervisorConfig,
};
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Instant;

/// A message to the loop.
#[derive(Debug)]
pub enum Message {
    /// An order.
    Order {
        /// Identifies the answer.
        id: u64,
        /// What to do.
        order: Order,
        /// What must still hold in the cycle that carries it out.
        precondition: Precondition,
    },
    /// What takes the place of something that the loop uses.
    Change(Change),
}

/// What takes the place of something that the loop uses. What it replaces comes back to the hub, which drops it, so that the
/// loop never frees memory.
#[derive(Debug)]
pub enum Change {
    /// Another configuration.
    Config(Box<SupervisorConfig>),
    /// The path for [`Order::Play`].
    Path(Option<Box<Path>>),
    /// A freshly reset supervisor for an idle one, so that a recording starts from a known state. Its first cycle says
    /// [`CycleOutput::first`]; a supervisor that is not idle any more stays.
    Supervisor(Box<Supervisor>),
}

/// What an order was decided on. The picture of the hub may be old, so the loop compares it with the present.
#[derive(Debug, Clone, Copy)]
pub struct Precondition {
    /// Number of stops requested when the order was received, see [`crate::service::stop`].
    pub stops: u64,
    /// When it was received: an order that nobody waits for any longer is not carried out.
    pub since: Instant,
    /// The only mode in which it may be carried out; `None` leaves that to the supervisor. A running calibration carries out what
    /// [`Order::calibrates`] only if it names this mode, as its own orders do.
    pub mode: Option<Mode>,
}

/// The output of a cycle on its way to the hub, with what a restart after it needs.
#[derive(Debug, Clone, Copy)]
pub struct LoopFrame {
    /// Number of the cycle.
    pub number: u64,
    /// Position and learned parameters.
    pub restart: RestartState,
    /// The pistons are at zero, so a restart has nothing to verify.
    pub at_rest: bool,
    /// The position of the pistons is unknown.
    pub lost: bool,
    /// A freshly reset supervisor may take the place of this one.
    pub idle: bool,
    /// Changes that the loop had carried out before it.
    pub changes: u64,
    /// The output.
    pub output: CycleOutput,
}

/// Result of an order, with the id of its message and the number of the cycle.
pub type Answer = (u64, u64, Result<(), Refusal>);

/// The loop's ends of the rings. All rings are wait-free.
pub struct LoopRings {
    orders: Consumer<Message>,
    setpoints: Consumer<Message>,
    answers: Producer<Answer>,
    frames: Producer<LoopFrame>,
    changes: u64,
    retired: Producer<Change>,
}

/// The hub's ends of the rings.
pub struct HubRings {
    /// Messages to the loop, all but set-points.
    pub orders: Producer<Message>,
    /// Orders that lead the set-point, but [`Order::Play`], which follows its path: a flood of them leaves the other ring free, and delays it by this short one.
    pub setpoints: Producer<Message>,
    /// Answers to orders.
    pub answers: Consumer<Answer>,
    /// The output of every cycle.
    pub frames: Consumer<LoopFrame>,
    /// What was replaced, to drop.
    pub retired: Consumer<Change>,
}

/// The loop must answer an order within this time, s.
pub const ANSWER_MAX_S: f64 = 2.0;
/// Capacity of the frame ring, cycles: the hub may be late by 4 s at 1 kHz.
const FRAMES: usize = 4096;
/// Capacity of the rings of orders and answers: every client of the command socket may have as many as are accepted.
const ORDERS: usize = CLIENTS_MAX * UNANSWERED_MAX + 64;
/// Oldest order that is carried out, s: whoever gave it has not yet been told that the loop does not respond.
const ORDER_MAX_S: f64 = 0.95 * ANSWER_MAX_S;
/// The tip stops if nobody could command a stop for longer than this, s.
const UNCOMMANDED_MAX_S: f64 = 1.0;
/// Longest delay that simulated time makes up for, ns.
const CATCH_UP_NS: u64 = 200_000_000;

/// Creates the rings.
pub fn rings() -> (LoopRings, HubRings) {
    let (orders, loop_orders) = RingBuffer::new(ORDERS);
    let (setpoints, loop_setpoints) = RingBuffer::new(64);
    let (loop_answers, answers) = RingBuffer::new(ORDERS);
    let (loop_frames, frames) = RingBuffer::new(FRAMES);
    let (loop_retired, retired) = RingBuffer::new(16);
    (
        LoopRings {
            orders: loop_orders,
            setpoints: loop_setpoints,
            answers: loop_answers,
            frames: loop_frames,
            changes: 0,
            retired: loop_retired,
        },
        HubRings {
            orders,
            setpoints,
            answers,
            frames,
            retired,
        },
    )
}

/// Everything the real-time thread owns.
pub struct Loop {
    /// Supervisor and machine.
    pub runner: Runner<dyn Machine>,
    /// The loop's ends of the rings.
    pub rings: LoopRings,
    /// Counters.
    pub shared: Arc<Shared>,
    /// Period of a cycle, s.
    pub period_s: f64,
    /// Pace of simulated time beside real time; infinity: as fast as possible. `None`: real time.
    pub pace: Option<f64>,
    /// The watchdog heartbeat.
    pub heartbeat: Heartbeat,
}

impl Loop {
    /// Runs cycles until [`Shared::quit`].
    ///
    /// # Errors
    /// [`MachineError`].
    pub fn run(mut self) -> Result<(), MachineError> {
        let period_ns = (self.period_s * 1e9) as u64;
        let paced_ns = |pace| (period_ns as f64 / pace) as u64;
        let wait_ns = self.pace.map_or(period_ns, paced_ns);
        let start_ns = monotonic_ns();
        let (mut due_ns, mut cycle_ns, mut periods) = (start_ns, start_ns, 0u64);
        let shared = Arc::clone(&self.shared);
        while !shared.is_quitting() {
            due_ns += wait_ns;
            sleep_until_ns(due_ns);
            let now_ns = monotonic_ns();
            let now_s = if self.pace.is_some() {
                // simulated time stands while the computer does not get to it
                due_ns = due_ns.max(now_ns.saturating_sub(CATCH_UP_NS));
                periods += 1;
                periods as f64 * self.period_s
            } else {
                let late_ns = now_ns.saturating_sub(due_ns);
                let is_late = late_ns > period_ns / 2;
                shared.late.fetch_add(is_late.into(), Relaxed);
                shared.max_lateness_us.fetch_max(late_ns / 1000, Relaxed);
                if now_ns > due_ns + period_ns {
                    // missed cycles are skipped, not caught up
                    due_ns = now_ns;
                }
                (now_ns - start_ns) as f64 * 1e-9
            };
            let passed_s = now_ns.saturating_sub(cycle_ns) as f64 * 1e-9;
            cycle_ns = now_ns;
            shared.watch(passed_s);
            self.cycle(Seconds(now_s))?;
            self.heartbeat.update(shared.is_stalled(), now_s);
        }
        Ok(())
    }

    pub(super) fn cycle(&mut self, now: Seconds) -> Result<(), MachineError> {
        let sensed = self.runner.sense(now)?;
        let supervisor = &self.runner.supervisor;
        let could_move = supervisor.mode().moves() && !supervisor.is_stopped();
        if could_move && self.shared.age_s(Watched::Control) > UNCOMMANDED_MAX_S {
            // nobody could stop the tip
            self.shared.stop.request();
        }
        // a stop comes before every queued message, also one that came while a slow plant was waited for
        let stop = self.shared.stop.pending();
        let (id, order) = match stop {
            Some(_) => (None, Some(Order::Stop)),
            None => self.next_order(),
        };
        let output = self.runner.act(&sensed, order);
        let number = self.shared.cycles.fetch_add(1, Relaxed);
        let supervisor = &self.runner.supervisor;
        let stopped = supervisor.is_stopped();
        let frame = LoopFrame {
            number,
            restart: supervisor.keep(),
            at_rest: supervisor.is_at_rest(),
            lost: supervisor.is_lost(),
            idle: supervisor.is_idle(),
            changes: self.rings.changes,
            output,
        };
        if self.rings.frames.push(frame).is_err() {
            self.shared.lost.fetch_add(1, Relaxed);
        }
        // after the frame, so that a status that follows an answer reports what was answered
        if let (Some(id), Some(answer)) = (id, output.answer) {
            self.answer(id, answer);
        }
        self.shared.stop.report(stop, stopped);
        Ok(())
    }

    /// Takes the older of the next messages of both rings; returns its order with its id.
    fn next_order(&mut self) -> (Option<u64>, Option<Order>) {
        let age = |ring: &Consumer<Message>| match ring.peek() {
            Ok(Message::Order { id, .. }) => *id,
            Ok(_) => 0,
            Err(_) => u64::MAX,
        };
        let rings = &mut self.rings;
        let ring = if age(&rings.setpoints) < age(&rings.orders) {
            &mut rings.setpoints
        } else {
            &mut rings.orders
        };
        match ring.pop() {
            Ok(Message::Order {
                id,
                order,
                precondition,
            }) => match self.admit(&order, &precondition) {
                Ok(()) => return (Some(id), Some(order)),
                Err(refusal) => self.answer(id, Err(refusal)),
            },
            Ok(Message::Change(mut change)) => {
                let supervisor = &mut self.runner.supervisor;
                match &mut change {
                    Change::Config(config) => supervisor.reload(config),
                    Change::Path(path) => supervisor.load(path),
                    // the hub must learn of the first cycle
                    Change::Supervisor(new) if supervisor.is_idle() && rings.frames.slots() > 0 => {
                        new.inherit(supervisor);
                        std::mem::swap(supervisor, new);
                    }
                    Change::Supervisor(_) => {}
                }
                rings.changes += 1;
                // with sixteen objects waiting, freeing one here is better than leaking it
                drop(rings.retired.push(change));
            }
            Err(_) => {}
        }
        (None, None)
    }

    /// Whether what an order was decided on still holds.
    fn admit(&self, order: &Order, then: &Precondition) -> Result<(), Refusal> {
        let mode = self.runner.supervisor.mode();
        self.shared.stop.admit(order, then.stops)?;
        if then.since.elapsed().as_secs_f64() > ORDER_MAX_S {
            return Err(Refusal::Late);
        }
        match then.mode {
            Some(expected) if expected != mode => Err(Refusal::Mode(mode)),
            None if mode == Mode::Calibrating && order.calibrates() => Err(Refusal::Mode(mode)),
            _ => Ok(()),
        }
    }

    fn answer(&mut self, id: u64, result: Result<(), Refusal>) {
        let cycle = self.shared.cycles.load(Relaxed);
        if self.rings.answers.push((id, cycle, result)).is_err() {
            self.shared.lost.fetch_add(1, Relaxed);
        }
    }
}
