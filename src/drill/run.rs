//! One flight of a drill: bend, strike in the middle of the next move, watch, mend, and bend again.

use crate::drill::Row;
use crate::drill::bench::{Bench, Make, bend};
use crate::drill::list::{Notice, Promise, Spec, Strike};
use crate::supervisor::cycle::CycleOutput;
use crate::supervisor::cycle::order::Order;
use crate::supervisor::machine::MachineError;
use crate::supervisor::mode::Mode;

/// From the start of the move to the fault, s.
const MID_MOTION_S: f64 = 0.22;
/// From the start of the move to a fault that strikes a held pose, s: the last nudge of the pistons is over.
const HELD_S: f64 = 8.0;
/// How long a fault is watched, s.
const WATCHED_S: f64 = 7.0;
/// After how long the operator goes on with a fault that was not noticed, s.
const GOES_ON_S: f64 = 4.5;
/// Where it was, where it was to go, where it goes on to, where it goes afterwards.
const FROM: (f64, f64) = (45.0, 30.0);
const TO: (f64, f64) = (68.0, 80.0);
const FURTHER: (f64, f64) = (55.0, 230.0);
const AFTER: (f64, f64) = (35.0, 150.0);
/// How long a line is left to vent at rest before it is closed, s.
const VENTS_S: f64 = 30.0;
/// Largest error of the pose after it, degrees.
const AFTER_MAX_DEG: f64 = 2.5;

/// What a braking piston, a hold and a whole move may still emit, microsteps over all channels.
#[derive(Debug, Clone, Copy)]
pub struct Allowance {
    braking: i64,
    moving: i64,
}

impl Allowance {
    /// From the limits of motion (v²/2a of three pistons), and twice what the same flight without a
    /// fault emits.
    ///
    /// # Errors
    /// The plant's.
    pub fn new(make: &Make) -> Result<Self, MachineError> {
        let mut bench = make.bench(0, 1)?;
        let gate = bench.runner.supervisor.config().gate;
        let pace = bench.runner.supervisor.config().tick.piston_pace;
        let stopping_mm = pace.speed * pace.speed / (2.0 * pace.acceleration);
        // it may go on blindly for a while at full speed before it is held, and then it brakes
        let blind_mm = pace.speed * bench.runner.supervisor.config().tick.fuse.health.blind_max_s;
        let braking = (3.0 * (stopping_mm + blind_mm) / gate.step_mm).ceil() as i64 + 6;
        let Some(mut last) = take_off(&mut bench)? else { return Ok(Self { braking, moving: 0 }) };
        let mut moving = 0;
        bench.turn(Some(bend(TO.0, TO.1)))?;
        for _ in 0..(WATCHED_S / bench.period_s()) as usize {
            let turned = bench.turn(None)?;
            moving += emitted(&last, &turned);
            last = turned;
        }
        // a fault that is corrected may ask for as much again, and a piston at its end for its travel
        Ok(Self { braking, moving: 2 * moving + (3.0 * gate.travel_mm / gate.step_mm) as i64 })
    }

    fn of(&self, predicted_gain: Promise) -> i64 {
        match predicted_gain {
            Promise::Freezes => 0,
            Promise::Holds => self.braking,
            Promise::GoesOn | Promise::Copes => self.moving,
        }
    }
}

fn emitted(before: &CycleOutput, after: &CycleOutput) -> i64 {
    (0..3).map(|i| (i64::from(after.counted.0[i]) - i64::from(before.counted.0[i])).abs()).sum()
}

/// Aligned, armed and resting at the first pose; `None` if it never got there.
fn take_off(bench: &mut Bench) -> Result<Option<CycleOutput>, MachineError> {
    if !bench.until(10.0, |t| t.mode == Mode::Disarmed)? {
        return Ok(None);
    }
    bench.turn(Some(Order::Arm))?;
    bench.run(0.05)?;
    bench.turn(Some(bend(FROM.0, FROM.1)))?;
    bench.run(2.0).map(Some)
}

/// Flies a row.
///
/// # Errors
/// The plant's.
pub fn fly(make: &Make, spec: &Spec, allowance: &Allowance) -> Result<Row, MachineError> {
    let mut row = Row::process(spec.name, None, "boot", String::new());
    row.steps_allowed = allowance.of(spec.predicted_gain);
    let mut bench = make.bench(0, 1)?;
    if take_off(&mut bench)?.is_none() {
        row.fail("never aligned");
        return Ok(row);
    }
    bench.turn(Some(bend(spec.to.0, spec.to.1)))?;
    let (after_s, mode) = if spec.held { (HELD_S, Mode::Holding) } else { (MID_MOTION_S, Mode::Tracking) };
    let before = bench.run(after_s)?;
    row.demand(before.mode == mode, |_| format!("struck in mode {}", before.mode));
    let last = watch(&mut bench, spec, before, &mut row)?;
    row.demand(row.detected_s.is_some(), |_| "not noticed".to_owned());
    row.demand(row.steps_after <= row.steps_allowed, |row| format!("{} microsteps after it was noticed", row.steps_after));
    row.demand(spec.states.contains(&row.state.as_str()), |row| format!("came to {}", row.state));
    row.demand(spec.notice.names_it(&last), |_| format!("called `{}`", last.suspicion.map_or_else(String::new, |s| s.to_string())));
    row.error_deg_after = recover(&mut bench, spec, &mut row)?;
    let estimate = bench.runner.supervisor.state().fusion.estimate().map_or(0.0, |f| f.bend.beta().to_degrees());
    let truly = bench.true_bend().beta().to_degrees();
    row.demand(row.error_deg_after <= AFTER_MAX_DEG, |row| {
        format!("{:.1}° off after it was mended (felt {estimate:.1}°, truly {truly:.1}°)", row.error_deg_after)
    });
    Ok(row)
}

/// The fault and the seconds after it.
fn watch(bench: &mut Bench, spec: &Spec, before: CycleOutput, row: &mut Row) -> Result<CycleOutput, MachineError> {
    let begun_s = bench.now_s;
    let (mut order, mut next) = spec.strike.strike(bench);
    let mut last = before;
    let mut went_on = false;
    while bench.now_s - begun_s < WATCHED_S {
        if bench.now_s - begun_s >= spec.strike.lasts_s() {
            bench.runner.machine.mend();
        }
        let turned = bench.turn(order.take())?;
        order = next.take();
        if matches!(spec.notice, Notice::Words(_)) && row.detected_s.is_none() && !went_on && bench.now_s - begun_s > GOES_ON_S {
            // the operator, who has noticed nothing either, goes on
            went_on = true;
            order = Some(bend(FURTHER.0, FURTHER.1));
        }
        if row.detected_s.is_some() {
            row.steps_after += emitted(&last, &turned);
        } else if let Some(message) = spec.notice.sees(&turned) {
            row.detected_s = Some(((bench.now_s - begun_s) * 1e6).round() * 1e-6);
            row.message = message;
        }
        let off = (bench.true_bend().0 - turned.frame.setpoint.bend.0).norm().to_degrees();
        row.error_deg_during = row.error_deg_during.max(off);
        last = turned;
    }
    if let Some(s) = last.suspicion {
        row.message = s.to_string();
    }
    row.state = if last.frame.senses.held && last.mode.moves() { "holding".to_owned() } else { last.mode.name().to_owned() };
    Ok(last)
}

/// The operator's way back: out of the fault, to rest, mended there, the rest found again where it was
/// lost, and the next pose. The error of that pose, degrees.
fn recover(bench: &mut Bench, spec: &Spec, row: &mut Row) -> Result<f64, MachineError> {
    let mut stays = !spec.zero && bench.runner.supervisor.mode().moves();
    let mut zero = spec.zero;
    let mend_first = matches!(spec.strike, Strike::Press | Strike::Bus(..) | Strike::Clock(..)) || stays;
    if mend_first {
        bench.runner.machine.mend();
        // what is let go of leaps, and then the base may seem to have moved: the rest is to be found again
        bench.until(20.0, |t| t.frame.senses.in_force.is_empty())?;
        let moved = bench.run(2.0)?.frame.base_moved;
        (stays, zero) = (stays && !moved, zero || moved);
    }
    if bench.runner.supervisor.mode() == Mode::Faulted {
        refuse_is_failure(bench, Order::Reset, row)?;
    }
    if !stays && bench.runner.supervisor.mode() != Mode::Relaxing && bench.runner.supervisor.keep().steps.0 != [0; 3] {
        refuse_is_failure(bench, Order::Relax, row)?;
    }
    if !stays {
        let rested = bench.until(15.0, |t| matches!(t.mode, Mode::Disarmed | Mode::Aligning))?;
        row.demand(rested, |_| "did not come back to rest".to_owned());
        // at rest a line that leaks comes to the pressure of the room, which is where it is to be closed
        bench.run(if zero { VENTS_S } else { 1.0 })?;
        bench.runner.machine.mend();
        if spec.by_hand {
            bench.runner.machine.put_back();
        }
        bench.run(1.0)?;
    }
    if zero {
        if bench.runner.supervisor.mode() == Mode::Disarmed {
            refuse_is_failure(bench, Order::Zero, row)?;
        }
        bench.call_straight();
    }
    let ready = bench.until(8.0, |t| t.mode != Mode::Aligning)?;
    row.demand(ready, |_| "did not align again".to_owned());
    if bench.runner.supervisor.mode() == Mode::Disarmed {
        refuse_is_failure(bench, Order::Arm, row)?;
        bench.run(0.05)?;
    }
    refuse_is_failure(bench, bend(AFTER.0, AFTER.1), row)?;
    let turned = bench.run(3.5)?;
    row.demand(turned.mode == Mode::Holding, |_| format!("came to {} after it was mended", turned.mode));
    let (mut sum, n) = (0.0, (0.3 / bench.period_s()) as u32);
    let wanted = crate::model::bend::Bend::from_deg(AFTER.0, AFTER.1);
    for _ in 0..n {
        bench.turn(None)?;
        sum += (bench.true_bend().0 - wanted.0).norm().to_degrees();
    }
    Ok(sum / f64::from(n))
}

fn refuse_is_failure(bench: &mut Bench, order: Order, row: &mut Row) -> Result<(), MachineError> {
    if let Some(Err(why)) = bench.turn(Some(order))?.answer {
        row.fail(format!("{order:?} was refused: {why}"));
    }
    Ok(())
}
