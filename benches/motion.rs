//! What a control tick and a step cost. Run with `cargo bench --bench motion`.
//!
//! `tick` in its three cases (resting, following a plan, planning anew), the solver alone, the steps of a tick, and one round of the step core.

use divan::{Bencher, black_box};
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use retroflex::motion::lines::EmergencyStop;
use retroflex::motion::plan::Plan;
use retroflex::motion::pulse::{PulseAction, StepCore};
use retroflex::motion::queue::TimedSegment;
use retroflex::motion::solver::{Ruckig, Solver};
use retroflex::motion::steps::ChannelSteps;
use retroflex::motion::{Motion, MotionLimits, MotionState, Segment, StepperConfig};
use std::collections::VecDeque;

const STEP_MM: f64 = 0.029_452;

fn main() {
    divan::main();
}

/// Targets as a closed loop gives them: slow sines and a little noise.
struct Sines(SmallRng, u32);

impl Sines {
    fn new() -> Self {
        Self(SmallRng::seed_from_u64(1), 0)
    }

    fn next(&mut self) -> [f64; 3] {
        self.1 += 1;
        let t = f64::from(self.1) * 1e-3;
        [1.0, 2.3, 0.7].map(|w| 6.0 * f64::sin(w * t) + self.0.random_range(-0.02..0.02))
    }
}

#[divan::bench]
fn tick_resting(bencher: Bencher) {
    let mut motion = Motion::new(&MotionLimits::default());
    bencher.bench_local(|| motion.tick(black_box([0.0; 3]), 1e-3));
}

#[divan::bench]
fn tick_following(bencher: Bencher) {
    let mut motion = Motion::new(&MotionLimits {
        travel_max_mm: 1e6,
        ..MotionLimits::default()
    });
    motion.tick([1e6, -1e6, 5e5], 1e-3);
    bencher.bench_local(|| motion.tick(black_box([1e6, -1e6, 5e5]), 1e-9));
}

#[divan::bench]
fn tick_replanning_sines(bencher: Bencher) {
    let (mut motion, mut targets) = (Motion::new(&MotionLimits::default()), Sines::new());
    bencher.bench_local(|| motion.tick(targets.next(), 1e-3));
}

#[divan::bench]
fn tick_replanning_wild(bencher: Bencher) {
    let (mut motion, mut random) = (
        Motion::new(&MotionLimits::default()),
        SmallRng::seed_from_u64(1),
    );
    bencher.bench_local(|| {
        motion.tick(
            std::array::from_fn(|_| random.random_range(-20.0..20.0)),
            1e-3,
        )
    });
}

#[divan::bench]
fn solver_alone(bencher: Bencher) {
    let (l, mut solver, mut plan) = (MotionLimits::default(), Ruckig::default(), Plan::default());
    let from = [3.0, -7.0, 1.0].map(|v| MotionState {
        velocity_mm_s: v,
        acceleration_mm_s2: 40.0,
        ..MotionState::rest(0.5)
    });
    bencher.bench_local(|| {
        solver
            .solve(&l, black_box(&from), &[4.0, -2.0, 7.0], &mut plan)
            .is_ok()
    });
}

#[divan::bench]
fn verify_a_plan(bencher: Bencher) {
    let (l, mut plan) = (MotionLimits::default(), Plan::default());
    let from = [3.0, -7.0, 1.0].map(|v| MotionState {
        velocity_mm_s: v,
        ..MotionState::rest(0.5)
    });
    if Ruckig::default()
        .solve(&l, &from, &[4.0, -2.0, 7.0], &mut plan)
        .is_ok()
    {
        bencher.bench_local(|| black_box(&plan).verify(&from, &l).is_ok());
    }
}

#[divan::bench]
fn steps_of_a_tick_at_full_speed(bencher: Bencher) {
    let mut motion = Motion::new(&MotionLimits::default());
    for _ in 0..300 {
        motion.tick([20.0; 3], 1e-3);
    }
    let segment = motion.tick([20.0; 3], 1e-3);
    let mut steps = ChannelSteps::new(STEP_MM, 0);
    let begin = (segment.channels[0].start.position_mm / STEP_MM).round() as i32;
    bencher.bench_local(|| {
        steps = ChannelSteps::new(STEP_MM, begin);
        steps.load(black_box(&segment.channels[0]));
        while let Some(step) = steps.next_step() {
            black_box(step);
        }
    });
}

/// One second of motion of three channels through the step core, its clock jumping from wait to wait.
#[divan::bench(sample_count = 50)]
fn step_core_one_second(bencher: Bencher) {
    let Ok(timing) = StepperConfig::default().timing(EmergencyStop::default()) else {
        unreachable!("the defaults are tested to be valid")
    };
    let mut motion = Motion::new(&MotionLimits::default());
    let segments: Vec<Segment> = (0..500)
        .map(|_| motion.tick([22.0, -22.0, 20.0], 2e-3))
        .collect();
    let queue: VecDeque<TimedSegment> = segments
        .iter()
        .zip(0_u64..)
        .map(|(s, k)| TimedSegment {
            epoch: 0,
            start_ns: 1_000_000 + k * 2_000_000,
            duration_ns: 2_000_000,
            segment: *s,
        })
        .collect();
    bencher
        .with_inputs(|| {
            (
                StepCore::new(timing, &MotionLimits::default(), STEP_MM),
                queue.clone(),
            )
        })
        .bench_local_values(|(mut core, mut queue)| {
            let mut now = 0;
            while now < 1_000_000_000 {
                match core.poll(now, &mut || queue.pop_front()) {
                    PulseAction::WaitUntil(t) => now = t,
                    PulseAction::Write(_) => {
                        now += 300;
                        core.wrote(now);
                    }
                }
            }
            core
        });
}
