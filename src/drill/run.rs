//! One flight: bend, inject a fault during the next move, observe, repair, and bend again.

use crate::drill::bench::{Bench, BenchConfig, bend, distance};
use crate::drill::row::{FaultResult, require};
use crate::drill::spec::{Bound, Detector, Injection, Spec};
use crate::supervisor::{CycleOutput, MachineError, Mode, Order, Refusal, SafeState};

/// From the start of the move to the injection, s.
const MID_MOTION_S: f64 = 0.22;
/// From the start of the move to the injection at a held pose, s: the last feedback correction is over.
const HELD_S: f64 = 8.0;
/// Duration of the observation, s.
const OBSERVED_S: f64 = 7.0;
/// A fault without detection is followed by a further move after this time, s.
const FURTHER_S: f64 = 4.5;
/// Period of the orders to move that follow a stop, s.
const RUNAWAY_S: f64 = 0.01;
/// Time for a line to vent at rest, s.
const VENT_S: f64 = 30.0;
/// Largest error of the pose after the repair, degrees.
const AFTER_MAX_DEG: f64 = 2.5;
/// Axis in the world about which a base sways.
const SWAY_AXIS: [f64; 3] = [0.6, 0.5, 0.6];
/// Bend and direction of the poses, degrees: before the move, its standard target, the further move, after the repair.
const FROM: (f64, f64) = (45.0, 30.0);
const TO: (f64, f64) = (68.0, 80.0);
const FURTHER: (f64, f64) = (55.0, 230.0);
const AFTER: (f64, f64) = (35.0, 150.0);

/// Microsteps that are allowed after a detection, all channels.
#[derive(Debug, Clone, Copy)]
pub struct Allowance {
    /// What braking from full speed needs.
    pub stopping: i64,
    braking: i64,
    moving: i64,
}

impl Allowance {
    /// Braking takes the braking distance of every piston after the longest blind time at full speed. A move takes twice what the same
    /// flight needs without a fault, because a correction may need as much again, and the travel of every piston.
    ///
    /// # Errors
    /// [`MachineError`].
    pub fn new(config: &BenchConfig) -> Result<Self, MachineError> {
        let mut bench = config.bench(0, 1)?;
        let supervisor = bench.runner.supervisor.config();
        let (gate, motion) = (supervisor.gate, supervisor.tick.motion);
        let blind_mm = motion.limits.speed_max_mm_s * supervisor.tick.fuse.health.blind_max_s;
        let steps = |mm: f64| (3.0 * mm / gate.step_mm).ceil() as i64 + 6;
        let stopping = steps(motion.braking_mm());
        let braking = steps(motion.braking_mm() + blind_mm);
        let mut moving = 0;
        if let Some(mut last) = take_off(&mut bench)? {
            bench.turn(Some(bend(TO.0, TO.1)))?;
            for _ in 0..(OBSERVED_S / bench.period_s) as usize {
                let output = bench.turn(None)?;
                moving += distance(&last.counted, &output.counted);
                last = output;
            }
            moving = 2 * moving + (3.0 * gate.travel_mm / gate.step_mm) as i64;
        }
        Ok(Self {
            stopping,
            braking,
            moving,
        })
    }

    fn of(&self, bound: Bound) -> i64 {
        match bound {
            Bound::Freezes => 0,
            Bound::Brakes => self.stopping,
            Bound::Holds => self.braking,
            Bound::Continues | Bound::Copes => self.moving,
        }
    }
}

/// Aligns, arms and moves to the first pose; `None` if the alignment fails.
fn take_off(bench: &mut Bench) -> Result<Option<CycleOutput>, MachineError> {
    if !bench.until(10.0, |t| t.mode == Mode::Disarmed)? {
        return Ok(None);
    }
    bench.arm()?;
    bench.turn(Some(bend(FROM.0, FROM.1)))?;
    bench.run(2.0).map(Some)
}

/// Flies one fault.
///
/// # Errors
/// [`MachineError`].
pub fn fly(
    config: &BenchConfig,
    spec: &Spec,
    allowance: &Allowance,
) -> Result<FaultResult, MachineError> {
    let steps_allowed = allowance.of(spec.bound);
    let requires = spec.words(steps_allowed, AFTER_MAX_DEG);
    let mut row = FaultResult::new(spec.name, requires).ending("boot");
    row.steps_allowed = steps_allowed;
    let mut config = config.clone();
    if spec.mode == Mode::Faulted {
        config.supervisor.gate.on.emergency_stop = SafeState::Relax;
    }
    if let Some(sway_deg) = spec.base_sway_deg {
        config.plant.base.imu = true;
        let motion = config.plant.effects.base_motion.get_or_insert_default();
        (motion.sway_deg, motion.axis) = (sway_deg, SWAY_AXIS);
    }
    let mut bench = config.bench(0, 1)?;
    if take_off(&mut bench)?.is_none() {
        row.fail("not aligned");
        return Ok(row);
    }
    let before = enter(&mut bench, spec)?;
    require!(row: before.mode == spec.mode; "injected in mode {}", before.mode);
    let last = observe(&mut bench, spec, before, &mut row)?;
    let (after_s, steps) = (row.detected_s, row.steps_after);
    require!(row: after_s.is_some(); "not detected");
    require!(row: after_s.is_none_or(|s| s <= spec.within_s); "detected after {after_s:?} s");
    require!(row: steps <= steps_allowed; "{steps} microsteps after the detection");
    require!(row: spec.states.contains(&row.state.as_str()); "final state {}", row.state);
    let named = last.suspicion.map_or_else(String::new, |s| s.to_string());
    require!(row: spec.detector.accepts(&last); "diagnosed as `{named}`");
    let error = recover(&mut bench, spec, &mut row)?;
    row.error_deg_after = error;
    let estimate = bench.runner.supervisor.state().fusion.estimate();
    let estimate = estimate.map_or(0.0, |f| f.bend.beta().to_degrees());
    let truth = bench.true_bend().beta().to_degrees();
    require!(row: error <= AFTER_MAX_DEG;
        "error {error:.1}° after the repair (estimate {estimate:.1}°, truth {truth:.1}°)");
    Ok(row)
}

/// Brings the machine into the situation in which the fault is injected.
fn enter(bench: &mut Bench, spec: &Spec) -> Result<CycleOutput, MachineError> {
    if spec.mode == Mode::Calibrating {
        bench.turn(Some(Order::Calibrate(true)))?;
    }
    bench.turn(Some(bend(spec.target.0, spec.target.1)))?;
    let held = spec.mode == Mode::Holding;
    let output = bench.run(if held { HELD_S } else { MID_MOTION_S })?;
    match spec.mode {
        Mode::Relaxing => bench.turn(Some(Order::Relax))?,
        Mode::Faulted => {
            bench.runner.machine.emergency_stop = true;
            bench.turn(None)?;
            bench.runner.machine.emergency_stop = false;
            bench.turn(None)?
        }
        _ => return Ok(output),
    };
    bench.run(MID_MOTION_S)
}

/// Injects the fault and observes its effect.
fn observe(
    bench: &mut Bench,
    spec: &Spec,
    before: CycleOutput,
    row: &mut FaultResult,
) -> Result<CycleOutput, MachineError> {
    let start_s = bench.now_s;
    let [mut order, mut next] = spec.injection.apply(bench);
    let mut last = before;
    let mut moved_further = false;
    while bench.now_s - start_s < OBSERVED_S {
        if bench.now_s - start_s >= spec.injection.duration_s() {
            bench.runner.machine.clear_faults();
        }
        let output = bench.turn(order.take())?;
        order = next.take();
        let elapsed_s = bench.now_s - start_s;
        if matches!(spec.detector, Detector::Residual(_))
            && row.detected_s.is_none()
            && !moved_further
            && elapsed_s > FURTHER_S
        {
            moved_further = true;
            order = Some(bend(FURTHER.0, FURTHER.1));
        }
        if matches!(spec.injection, Injection::Stop) {
            let moves = output.order.is_some_and(|order| order.starts_motion());
            let refused = !moves || output.answer == Some(Err(Refusal::Stopped));
            require!(row: refused; "{:?} was not refused", output.order);
            let every = (RUNAWAY_S / bench.period_s) as u64;
            let due = ((elapsed_s / bench.period_s) as u64).is_multiple_of(every);
            order = due.then(|| bend(FURTHER.0, FURTHER.1));
        }
        if row.detected_s.is_some() {
            row.steps_after += distance(&last.counted, &output.counted);
        } else if let Some(message) = spec.detector.detects(&output) {
            row.detected_s = Some((elapsed_s * 1e6).round() * 1e-6);
            row.message = message;
        }
        let error = bench.true_bend().0 - output.frame.setpoint.bend.0;
        row.error_deg_during = row.error_deg_during.max(error.norm().to_degrees());
        last = output;
    }
    if let Some(s) = last.suspicion {
        row.message = s.to_string();
    }
    let held = last.frame.senses.held && last.mode.moves();
    row.state = if held { "holding" } else { last.mode.name() }.to_owned();
    Ok(last)
}

/// The operator's procedure: clear the fault, return to rest, repair, align again if necessary, and move to the next pose.
/// Returns the error of that pose, degrees.
fn recover(bench: &mut Bench, spec: &Spec, row: &mut FaultResult) -> Result<f64, MachineError> {
    if matches!(spec.injection, Injection::Stop) {
        if bench.runner.supervisor.mode() == Mode::Faulted {
            order(bench, Order::Reset, row)?;
        }
        order(bench, Order::Arm, row)?;
        bench.run(0.05)?;
    }
    let mut stays = !spec.zero && bench.runner.supervisor.mode().moves();
    let mut zero = spec.zero;
    use Injection::{Alarm, Bus, ClockJump, EmergencyStop};
    let ends = matches!(
        spec.injection,
        EmergencyStop | Alarm(_) | Bus(..) | ClockJump(..)
    );
    if stays || ends {
        bench.runner.machine.clear_faults();
        // a tip that is released jumps, which can look like a moved base: then a new alignment is needed
        bench.until(20.0, |t| t.frame.senses.in_force.is_empty())?;
        let moved = bench.run(2.0)?.frame.base_moved;
        (stays, zero) = (stays && !moved, zero || moved);
    }
    if bench.runner.supervisor.mode() == Mode::Faulted {
        // the gate may still brake: an operator tries again
        let accepted = (0..100).any(|_| {
            let output = bench.run(0.1).and_then(|_| bench.turn(Some(Order::Reset)));
            output.is_ok_and(|t| t.answer == Some(Ok(())))
        });
        require!(row: accepted; "the fault could not be reset within 10 s");
    }
    if !stays {
        return_to_rest(bench, spec, zero, row)?;
    }
    if zero {
        if matches!(bench.runner.supervisor.mode(), Mode::Disarmed | Mode::Lost) {
            order(bench, Order::AssertStraight, row)?;
        }
        bench.set_straight();
    }
    require!(row: bench.until(8.0, |t| t.mode != Mode::Aligning)?; "not aligned again");
    if bench.runner.supervisor.mode() == Mode::Disarmed {
        order(bench, Order::Arm, row)?;
        bench.run(0.05)?;
    }
    order(bench, bend(AFTER.0, AFTER.1), row)?;
    let output = bench.run(3.5)?;
    require!(row: output.mode == Mode::Holding; "mode {} after the repair", output.mode);
    let (mut sum, n) = (0.0, (0.3 / bench.period_s) as u32);
    for _ in 0..n {
        bench.turn(None)?;
        sum += bench.error_deg(AFTER.0, AFTER.1);
    }
    Ok(sum / f64::from(n))
}

fn return_to_rest(
    bench: &mut Bench,
    spec: &Spec,
    zero: bool,
    row: &mut FaultResult,
) -> Result<(), MachineError> {
    let supervisor = &bench.runner.supervisor;
    if supervisor.mode() != Mode::Relaxing && supervisor.keep().steps.0 != [0; 3] {
        order(bench, Order::Relax, row)?;
    }
    let rests = |t: &CycleOutput| matches!(t.mode, Mode::Disarmed | Mode::Aligning | Mode::Lost);
    require!(row: bench.until(15.0, rests)?; "did not return to rest");
    // at rest, a leaking line reaches the ambient pressure, at which it is closed again
    bench.run(if zero { VENT_S } else { 1.0 })?;
    bench.runner.machine.clear_faults();
    if spec.by_hand {
        bench.runner.machine.restore_racks();
    }
    bench.run(1.0)?;
    Ok(())
}

/// Gives an order; a refusal is a failure.
fn order(bench: &mut Bench, order: Order, row: &mut FaultResult) -> Result<(), MachineError> {
    if let Some(Err(why)) = bench.turn(Some(order))?.answer {
        row.fail(format!("{order:?} was refused: {why}"));
    }
    Ok(())
}
