//! What motion promises, for targets nobody would choose: limits never passed, arrival together,
//! steps exact to the last one, nothing allocated on the control path.

#![allow(clippy::unwrap_used)] // a test's helper fails the test

use proptest::prelude::*;
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use retroflex::motion::steps::{ChannelSteps, count};
use retroflex::motion::{ChannelSegment, Motion, MotionConfig, MotionLimits, MotionState, MoveStatus, Segment};

/// What is promised outside: relative excess over a limit.
const PROMISE: f64 = 1e-6;

fn limits(c: &MotionConfig) -> MotionLimits {
    MotionLimits::try_from(c).unwrap()
}

/// How a target behaves.
#[derive(Debug, Clone, Copy)]
enum Manner {
    /// Jumps anywhere, beyond travel too, after a random number of ticks.
    Jumps,
    /// Jumps from one end of travel to the other.
    Ends,
    /// Another place every tick.
    Wild,
    /// Follows sines, with noise.
    Sines,
    /// Trembles by a hair around one place.
    Trembles,
}

/// A target program of one manner.
struct Targets {
    manner: Manner,
    random: SmallRng,
    travel_mm: f64,
    target: [f64; 3],
    hold: u32,
}

impl Targets {
    fn new(manner: Manner, seed: u64, travel_mm: f64) -> Self {
        Self { manner, random: SmallRng::seed_from_u64(seed), travel_mm, target: [0.0; 3], hold: 0 }
    }

    fn next(&mut self, t_s: f64) -> [f64; 3] {
        let (r, travel) = (&mut self.random, self.travel_mm);
        match self.manner {
            Manner::Jumps | Manner::Ends if self.hold > 0 => self.hold -= 1,
            Manner::Jumps => {
                self.target = std::array::from_fn(|_| r.random_range(-1.2 * travel..1.2 * travel));
                self.hold = r.random_range(0..400);
            }
            Manner::Ends => {
                self.target = std::array::from_fn(|_| if r.random_bool(0.5) { travel } else { -travel });
                self.hold = r.random_range(0..900);
            }
            Manner::Wild => self.target = std::array::from_fn(|_| r.random_range(-travel..travel)),
            Manner::Sines => {
                let rate = [1.0, 2.3, 0.7];
                self.target = rate.map(|w| travel * (w * t_s).sin() + r.random_range(-0.01..0.01));
            }
            Manner::Trembles => {
                let middle = self.target;
                self.target = middle.map(|p| p + r.random_range(-1e-3..1e-3));
            }
        }
        self.target
    }
}

/// Checks every piece of a channel's segment against the limits, on the closed form.
fn check_channel(c: &ChannelSegment, l: &MotionLimits) -> Result<(), TestCaseError> {
    let within = |x: f64, max: f64| x.abs() <= max * (1.0 + PROMISE);
    let mut s = c.start;
    for &(d, jerk) in c.pieces() {
        let e = s.after(jerk, d);
        prop_assert!(within(jerk, l.jerk_max_mm_s3), "jerk {jerk}");
        for a in [s.acceleration_mm_s2, e.acceleration_mm_s2] {
            prop_assert!(within(a, l.acceleration_max_mm_s2), "acceleration {a}");
        }
        let mut tops = vec![s.velocity_mm_s, e.velocity_mm_s];
        if s.acceleration_mm_s2 * e.acceleration_mm_s2 < 0.0 {
            tops.push(s.after(jerk, -s.acceleration_mm_s2 / jerk).velocity_mm_s);
        }
        for v in tops {
            prop_assert!(within(v, l.speed_max_mm_s), "speed {v}");
        }
        let (low, high) = s.reach(jerk, d);
        prop_assert!(within(low, l.travel_max_mm) && within(high, l.travel_max_mm), "{low} {high}");
        s = e;
    }
    // the pieces lead to the end state: no hidden jump
    prop_assert!((s.position_mm - c.end.position_mm).abs() < 1e-7, "{s:?} {:?}", c.end);
    let jump = |a: f64, b: f64, max: f64| (a - b).abs() > PROMISE * max;
    prop_assert!(!jump(s.velocity_mm_s, c.end.velocity_mm_s, l.speed_max_mm_s), "{s:?} {:?}", c.end);
    prop_assert!(!jump(s.acceleration_mm_s2, c.end.acceleration_mm_s2, l.acceleration_max_mm_s2), "{s:?} {:?}", c.end);
    Ok(())
}

fn config() -> impl Strategy<Value = MotionConfig> {
    (1.0..200.0f64, 0.02..1.0f64, 0.01..0.3f64, 2.0..40.0f64).prop_map(|(speed, ramp_s, rise_s, travel)| MotionConfig {
        speed_max_mm_s: speed,
        acceleration_max_mm_s2: speed / ramp_s,
        jerk_max_mm_s3: speed / ramp_s / rise_s,
        travel_max_mm: travel,
        retarget_min_mm: 0.0,
    })
}

fn manner() -> impl Strategy<Value = Manner> {
    prop_oneof![Just(Manner::Jumps), Just(Manner::Ends), Just(Manner::Wild), Just(Manner::Sines), Just(Manner::Trembles)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// Limits and continuity hold in every piece of every tick, for every manner of target, and the
    /// planner never has to be rescued.
    #[test]
    fn limits_hold_whatever_the_target(c in config(), m in manner(), seed in any::<u64>(), dt in 0.5e-3..5e-3f64) {
        let l = limits(&c);
        let mut motion = Motion::new(&l);
        let mut targets = Targets::new(m, seed, l.travel_max_mm);
        let mut last = *motion.state();
        for k in 0..1500 {
            let segment = motion.tick(targets.next(f64::from(k) * dt), dt);
            prop_assert_eq!(segment.start(), last, "a segment starts where the last one ended, to the bit");
            last = segment.end();
            for channel in &segment.channels {
                check_channel(channel, &l)?;
            }
        }
        prop_assert_eq!((motion.counts().refusals, motion.counts().brakes), (0, 0));
    }

    /// The last tick's end is the target itself, all channels get there in the same tick, and the
    /// remaining times agree all the way.
    #[test]
    fn channels_arrive_together_and_exactly(
        c in config(),
        seed in any::<u64>(),
        to in prop::array::uniform3(-1.0..1.0f64),
        ticks in 0..400u32,
    ) {
        let l = limits(&c);
        let mut motion = Motion::new(&l);
        let mut targets = Targets::new(Manner::Wild, seed, l.travel_max_mm);
        for k in 0..ticks {
            motion.tick(targets.next(f64::from(k) * 1e-3), 1e-3);
        }
        let to = to.map(|x| x * l.travel_max_mm);
        let mut arrived = [None; 3];
        for k in 0..1_000_000 {
            motion.tick(to, 1e-3);
            let left = motion.arrivals_s();
            for i in 0..3 {
                prop_assert!((left[i] - left[0]).abs() < 1e-9, "{left:?}");
                if motion.state()[i] == MotionState::rest(to[i]) && arrived[i].is_none() {
                    arrived[i] = Some(k);
                }
            }
            if arrived.iter().all(Option::is_some) {
                break;
            }
        }
        prop_assert!(arrived[0].is_some() && arrived.iter().all(|a| *a == arrived[0]), "{arrived:?}");
        prop_assert_eq!(motion.state().map(|s| s.position_mm), to);
    }

    /// Braking from the middle of any motion keeps every limit, travel included, and ends in rest.
    #[test]
    fn braking_keeps_the_limits(c in config(), m in manner(), seed in any::<u64>(), ticks in 1..1200u32) {
        let l = limits(&c);
        let mut motion = Motion::new(&l);
        let mut targets = Targets::new(m, seed, l.travel_max_mm);
        for k in 0..ticks {
            motion.tick(targets.next(f64::from(k) * 1e-3), 1e-3);
        }
        let mut left = 100_000;
        while !motion.state().iter().all(MotionState::is_rest) && left > 0 {
            for channel in &motion.brake(1e-3).channels {
                check_channel(channel, &l)?;
            }
            left -= 1;
        }
        prop_assert!(left > 0);
    }

    /// Targets within the retarget threshold cost no plan and move nothing.
    #[test]
    fn a_threshold_saves_plans(seed in any::<u64>()) {
        let c = MotionConfig { retarget_min_mm: 0.01, ..MotionConfig::default() };
        let mut motion = Motion::new(&limits(&c));
        let mut r = SmallRng::seed_from_u64(seed);
        for _ in 0..1000 {
            motion.tick(std::array::from_fn(|_| r.random_range(-0.009..0.009)), 1e-3);
        }
        prop_assert_eq!(motion.counts().replans, 0);
        prop_assert_eq!(motion.outcome(), MoveStatus::Resting);
    }
}

/// Steps of one channel, counted by somebody who knows only the position.
struct Auditor {
    step_mm: f64,
    count: i32,
    steps: u64,
}

impl Auditor {
    /// Audits a segment's steps: right place, right order, right number.
    fn audit(&mut self, c: &ChannelSegment, steps: &mut ChannelSteps, duration_s: f64) {
        steps.load(c);
        let mut last_s = 0.0;
        while let Some(step) = steps.next_step() {
            let middle_mm = (f64::from(self.count) + 0.5 * f64::from(step.direction)) * self.step_mm;
            let there_mm = c.at(step.t_s).position_mm;
            assert!((there_mm - middle_mm).abs() < 1e-7, "step at {there_mm}, middle at {middle_mm}");
            assert!(step.t_s >= last_s && step.t_s <= duration_s + 1e-9);
            last_s = step.t_s;
            self.count += step.direction;
            self.steps += 1;
        }
        let wanted = (c.end.position_mm / self.step_mm).round();
        assert_eq!(f64::from(self.count), wanted, "lost or doubled");
        assert_eq!(steps.count(), count(c.end.position_mm, self.step_mm));
    }
}

/// Ten million steps, every one audited.
#[test]
fn no_step_is_lost_or_doubled_in_ten_million() {
    let c = MotionConfig {
        speed_max_mm_s: 200.0,
        acceleration_max_mm_s2: 4000.0,
        jerk_max_mm_s3: 200_000.0,
        travel_max_mm: 25.0,
        retarget_min_mm: 0.0,
    };
    let l = limits(&c);
    let step_mm = std::f64::consts::PI * 30.0 / 200.0 / 256.0;
    let mut total = 0;
    for (m, seed) in [Manner::Jumps, Manner::Ends, Manner::Sines, Manner::Wild].into_iter().cycle().zip(0..) {
        let mut motion = Motion::new(&l);
        let mut targets = Targets::new(m, seed, l.travel_max_mm);
        let mut channels: [ChannelSteps; 3] = std::array::from_fn(|_| ChannelSteps::new(step_mm, 0));
        let mut auditors: [Auditor; 3] = std::array::from_fn(|_| Auditor { step_mm, count: 0, steps: 0 });
        for k in 0..4000 {
            let segment = motion.tick(targets.next(f64::from(k) * 2e-3), 2e-3);
            for i in 0..3 {
                auditors[i].audit(&segment.channels[i], &mut channels[i], segment.duration_s);
            }
        }
        total += auditors.iter().map(|a| a.steps).sum::<u64>();
        if total >= 10_000_000 {
            break;
        }
    }
    assert!(total >= 10_000_000);
}

/// The same motion cut at other instants makes the same steps at the same times.
#[test]
fn steps_do_not_depend_on_where_ticks_fall() {
    let l = limits(&MotionConfig::default());
    let step_mm = 0.029_452;
    let times = |dt: f64| {
        let mut motion = Motion::new(&l);
        let mut steps = ChannelSteps::new(step_mm, 0);
        let (mut out, mut t) = (Vec::new(), 0.0);
        while t < 2.0 {
            let segment: Segment = motion.tick([12.0, -7.0, 3.0], dt);
            steps.load(&segment.channels[0]);
            out.extend(std::iter::from_fn(|| steps.next_step()).map(|s| (t + s.t_s, s.direction)));
            t += dt;
        }
        out
    };
    let (fine, coarse) = (times(1e-3), times(7e-3));
    assert_eq!((fine.len(), coarse.len()), (407, 407));
    for (a, b) in fine.iter().zip(&coarse) {
        assert!((a.0 - b.0).abs() < 1e-9 && a.1 == b.1, "{a:?} {b:?}");
    }
}

/// Counts allocations of the thread that asks.
mod counting {
    #![allow(unsafe_code)]
    use std::alloc::{GlobalAlloc, Layout, System};
    use std::cell::Cell;

    thread_local! {
        static COUNT: Cell<u64> = const { Cell::new(0) };
    }

    /// The system's allocator with a counter.
    pub struct Counting;

    // SAFETY: every call is handed to the system allocator unchanged; the counter is a plain
    // thread-local cell without destructor, so touching it neither allocates nor re-enters.
    unsafe impl GlobalAlloc for Counting {
        unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
            COUNT.with(|c| c.set(c.get() + 1));
            // SAFETY: the caller's promise about `layout` is passed on.
            unsafe { System.alloc(layout) }
        }

        unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
            // SAFETY: `pointer` came from `System.alloc` with this layout, as the caller promises.
            unsafe { System.dealloc(pointer, layout) }
        }
    }

    /// Allocations of this thread so far.
    pub fn allocations() -> u64 {
        COUNT.with(Cell::get)
    }
}

#[global_allocator]
static COUNTING: counting::Counting = counting::Counting;

/// After construction neither planning, nor refusing, nor braking, nor stepping allocates.
#[test]
fn the_control_path_allocates_nothing() {
    let l = limits(&MotionConfig::default());
    let mut motion = Motion::new(&l);
    let mut steps: [ChannelSteps; 3] = std::array::from_fn(|_| ChannelSteps::new(0.029_452, 0));
    let mut targets = Targets::new(Manner::Wild, 3, 25.0);
    let before = counting::allocations();
    let mut made = 0;
    for k in 0..20_000 {
        let t = f64::from(k) * 1e-3;
        let segment = match k % 1000 {
            0..700 => motion.tick(targets.next(t), 1e-3),
            700..800 => motion.tick([f64::NAN; 3], 1e-3),
            800..900 => motion.brake(1e-3),
            _ => motion.tick([1.0; 3], 1e-3),
        };
        for (c, s) in segment.channels.iter().zip(&mut steps) {
            s.load(c);
            made += u64::from(s.next_step().is_some());
        }
    }
    assert_eq!(counting::allocations() - before, 0);
    assert!(made > 1000 && motion.counts().replans > 10_000 && motion.counts().brakes > 10);
    let something = Box::new(made);
    assert!(counting::allocations() > before, "the counter counts: {something}");
}
