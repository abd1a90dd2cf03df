//! A stop in every mode of the supervised loop: it brakes, it latches, and nothing but an accepted `arm` ends it.

use crate::common::paper_bench;
use retroflex::drill::bench::{Bench, BenchConfig, bend};
use retroflex::supervisor::cycle::CycleOutput;
use retroflex::supervisor::cycle::order::{Order, Refusal};
use retroflex::supervisor::gate::SafeState;
use retroflex::supervisor::mode::Mode;

/// An armed tip on its way to a large bend.
fn in_motion(config: &BenchConfig) -> Bench {
    let mut bench = config.bench(0, 1).unwrap();
    assert!(bench.until(10.0, |t| t.mode == Mode::Disarmed).unwrap());
    bench.turn(Some(Order::Arm)).unwrap();
    bench.run(0.1).unwrap();
    bench.turn(Some(bend(70.0, 30.0))).unwrap();
    let output = bench.run(0.4).unwrap();
    assert_eq!(output.mode, Mode::Tracking);
    bench
}

/// Microsteps of all channels between two cycles.
fn between(a: &CycleOutput, b: &CycleOutput) -> i64 {
    (0..3)
        .map(|i| i64::from((a.steps.0[i] - b.steps.0[i]).abs()))
        .sum()
}

/// Stops, then orders every motion 100 times a second for two seconds. No piston moves further than it needs to brake.
fn stands_after_a_stop(bench: &mut Bench) -> CycleOutput {
    let before = bench.turn(Some(Order::Stop)).unwrap();
    assert_eq!((before.answer, before.stopped), (Some(Ok(())), true));
    let limits = bench.runner.supervisor.config().gate;
    let braking =
        (3.0 * limits.speed_mm_s * limits.speed_mm_s / (2.0 * limits.brake_mm_s2) / limits.step_mm)
            .ceil() as i64
            + 6;
    let motions = [bend(60.0, 200.0), Order::Relax, Order::Calibrate(true)];
    let mut output = before;
    for k in 0..2000usize {
        let order = (k % 10 == 0).then(|| motions[k / 10 % 3]);
        output = bench.turn(order).unwrap();
        if order.is_some() {
            assert_eq!(output.answer, Some(Err(Refusal::Stopped)), "{order:?}");
        }
        assert!(output.stopped);
    }
    let moved = between(&before, &output);
    assert!(
        moved <= braking,
        "{moved} microsteps after the stop, {braking} to brake"
    );
    let later = bench.run(1.0).unwrap();
    assert_eq!(
        between(&output, &later),
        0,
        "feedback moved the pistons after the stop"
    );
    later
}

#[test]
fn a_stop_in_motion_stands_until_arm() {
    let mut bench = in_motion(&paper_bench());
    let stopped = stands_after_a_stop(&mut bench);
    assert_eq!((stopped.mode, stopped.energise), (Mode::Holding, true));
    assert_eq!(bench.turn(Some(Order::Arm)).unwrap().answer, Some(Ok(())));
    bench.run(0.05).unwrap();
    assert_eq!(
        bench.turn(Some(bend(40.0, 30.0))).unwrap().answer,
        Some(Ok(()))
    );
    let output = bench.run(3.0).unwrap();
    assert_eq!((output.mode, output.stopped), (Mode::Holding, false));
    assert!((output.frame.estimate.unwrap().bend.beta().to_degrees() - 40.0).abs() < 1.0);
}

#[test]
fn a_stop_ends_a_return_and_the_gates_own_return() {
    let mut bench = in_motion(&paper_bench());
    bench.turn(Some(Order::Relax)).unwrap();
    assert_eq!(bench.run(0.3).unwrap().mode, Mode::Relaxing);
    assert_eq!(stands_after_a_stop(&mut bench).mode, Mode::Holding);

    // the gate returns to zero after a trip
    let mut config = paper_bench();
    config.supervisor.gate.on.emergency_stop = SafeState::Relax;
    let mut bench = in_motion(&config);
    bench.runner.machine.emergency_stop = true;
    bench.turn(None).unwrap();
    bench.runner.machine.emergency_stop = false;
    let returning = bench.run(0.3).unwrap();
    assert_eq!(returning.mode, Mode::Faulted);
    let stopped = stands_after_a_stop(&mut bench);
    assert!(
        stopped.mode == Mode::Faulted && stopped.energise && stopped.counted.0 != [0; 3],
        "{:?}",
        stopped.counted
    );
    // a further trip holds as well
    bench.runner.machine.emergency_stop = true;
    let before = bench.run(0.01).unwrap();
    let later = bench.run(1.0).unwrap();
    assert!(
        between(&before, &later) <= 1,
        "a trip after the stop returned the pistons"
    );
}

#[test]
fn a_stop_ends_a_calibration() {
    let mut bench = paper_bench().bench(0, 1).unwrap();
    assert!(bench.until(10.0, |t| t.mode == Mode::Disarmed).unwrap());
    for order in [Order::Arm, Order::Calibrate(true), bend(50.0, 10.0)] {
        bench.turn(Some(order)).unwrap();
        bench.run(0.1).unwrap();
    }
    bench.run(0.3).unwrap();
    assert_eq!(stands_after_a_stop(&mut bench).mode, Mode::Holding);
}

#[test]
fn a_refused_arm_keeps_the_latch() {
    let mut bench = in_motion(&paper_bench());
    bench.runner.machine.emergency_stop = true;
    bench.turn(None).unwrap();
    bench.turn(Some(Order::Stop)).unwrap();
    assert_eq!(
        bench.turn(Some(Order::Arm)).unwrap().answer,
        Some(Err(Refusal::Latched))
    );
    let output = bench.turn(None).unwrap();
    assert!(output.stopped, "a refused `arm` released the latch");
    assert_eq!(
        bench.turn(Some(Order::Relax)).unwrap().answer,
        Some(Err(Refusal::Stopped))
    );
}

#[test]
fn relax_does_not_end_lost_and_only_a_confirmed_or_asserted_zero_does() {
    let config = paper_bench();
    // a tip that was bent when its memory was lost
    let start = |rest: bool| {
        let mut before = in_motion(&config);
        before.run(3.0).unwrap();
        let remembered = before.runner.supervisor.keep();
        let mut bench = config.bench_on(
            *before.runner.machine,
            rest.then_some(remembered),
            before.now_s,
        );
        bench.runner.supervisor.doubt();
        assert!(bench.until(10.0, |t| t.mode == Mode::Lost).unwrap());
        bench
    };
    let mut bench = start(true);
    assert_eq!(
        bench.turn(Some(Order::Arm)).unwrap().answer,
        Some(Err(Refusal::Mode(Mode::Lost)))
    );
    // the remembered attitude measures how far the tip hangs away
    let Some(Err(Refusal::NotStraight(tenths))) = bench.turn(Some(Order::Zero)).unwrap().answer
    else {
        panic!("accepted")
    };
    assert!((300..=750).contains(&tenths), "{tenths}");
    // relax drives back by the remembered counts, and the position stays unknown
    assert_eq!(bench.turn(Some(Order::Relax)).unwrap().answer, Some(Ok(())));
    bench.until(15.0, |t| t.mode != Mode::Relaxing).unwrap();
    let output = bench.run(0.1).unwrap();
    assert_eq!((output.mode, output.counted.0), (Mode::Lost, [0; 3]));
    assert!(bench.runner.supervisor.is_lost());

    // without a remembered attitude only the operator's word counts
    let mut bench = start(false);
    assert_eq!(
        bench.turn(Some(Order::Zero)).unwrap().answer,
        Some(Err(Refusal::Unmeasured))
    );
    assert_eq!(
        bench.turn(Some(Order::AssertStraight)).unwrap().answer,
        Some(Ok(()))
    );
    assert!(bench.until(10.0, |t| t.mode == Mode::Disarmed).unwrap());
    assert!(bench.runner.supervisor.is_unverified() && !bench.runner.supervisor.is_lost());
}
