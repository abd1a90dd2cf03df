//! Guarantees of motion for arbitrary targets: the limits hold, no channel waits for another, every step
//! is exact, and the control path does not allocate.

use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use retroflex::motion::drive::DriveLimits;
use retroflex::motion::follow::KEEP_TICKS_MAX;
use retroflex::motion::plan::{ChannelPlan, Plan, PlanFault};
use retroflex::motion::solver::{Ruckig, Solver};
use retroflex::motion::steps::ChannelSteps;
use retroflex::motion::{ChannelSegment, Motion, MotionLimits, MotionState, MoveStatus, Segment};

/// Guaranteed bound on the relative excess over a limit.
const TOLERANCE: f64 = 1e-6;

fn limits(c: &MotionLimits) -> MotionLimits {
    c.validate().unwrap();
    *c
}

/// A pattern of targets.
#[derive(Debug, Clone, Copy)]
enum Pattern {
    /// Jumps to a random position, also beyond travel, after a random number of ticks.
    Jumps,
    /// Jumps from one end of travel to the other.
    Ends,
    /// A random position every tick.
    Wild,
    /// Sines with noise.
    Sines,
    /// A random walk in steps of at most 1 µm.
    Walk,
}

/// A source of targets.
struct Targets {
    pattern: Pattern,
    random: SmallRng,
    travel_mm: f64,
    target: [f64; 3],
    hold: u32,
}

impl Targets {
    fn new(pattern: Pattern, seed: u64, travel_mm: f64) -> Self {
        Self {
            pattern,
            random: SmallRng::seed_from_u64(seed),
            travel_mm,
            target: [0.0; 3],
            hold: 0,
        }
    }

    fn next(&mut self, t_s: f64) -> [f64; 3] {
        let (r, travel) = (&mut self.random, self.travel_mm);
        match self.pattern {
            Pattern::Jumps | Pattern::Ends if self.hold > 0 => self.hold -= 1,
            Pattern::Jumps => {
                self.target = std::array::from_fn(|_| r.random_range(-1.2 * travel..1.2 * travel));
                self.hold = r.random_range(0..400);
            }
            Pattern::Ends => {
                self.target =
                    std::array::from_fn(|_| if r.random_bool(0.5) { travel } else { -travel });
                self.hold = r.random_range(0..900);
            }
            Pattern::Wild => self.target = std::array::from_fn(|_| r.random_range(-travel..travel)),
            Pattern::Sines => {
                let rate = [1.0, 2.3, 0.7];
                self.target = rate.map(|w| travel * (w * t_s).sin() + r.random_range(-0.01..0.01));
            }
            Pattern::Walk => {
                let middle = self.target;
                self.target = middle.map(|p| p + r.random_range(-1e-3..1e-3));
            }
        }
        self.target
    }
}

/// Checks every piece of a channel's segment against the limits on the closed form.
fn check_channel(c: &ChannelSegment, l: &MotionLimits) -> Result<(), TestCaseError> {
    let within = |x: f64, max: f64| x.abs() <= max * (1.0 + TOLERANCE);
    let mut s = c.start;
    for &(d, jerk) in c.pieces() {
        let e = s.after(jerk, d);
        prop_assert!(within(jerk, l.jerk_max_mm_s3), "jerk {jerk}");
        for a in [s.acceleration_mm_s2, e.acceleration_mm_s2] {
            prop_assert!(within(a, l.acceleration_max_mm_s2), "acceleration {a}");
        }
        let mut extremes = vec![s.velocity_mm_s, e.velocity_mm_s];
        if s.acceleration_mm_s2 * e.acceleration_mm_s2 < 0.0 {
            extremes.push(s.after(jerk, -s.acceleration_mm_s2 / jerk).velocity_mm_s);
        }
        for v in extremes {
            prop_assert!(within(v, l.speed_max_mm_s), "speed {v}");
        }
        let (low, high) = s.position_range(jerk, d);
        prop_assert!(
            within(low, l.travel_max_mm) && within(high, l.travel_max_mm),
            "{low} {high}"
        );
        s = e;
    }
    // The pieces lead to the end state without a jump.
    prop_assert!(
        (s.position_mm - c.end.position_mm).abs() < 1e-7,
        "{s:?} {:?}",
        c.end
    );
    let jump = |a: f64, b: f64, max: f64| (a - b).abs() > TOLERANCE * max;
    prop_assert!(
        !jump(s.velocity_mm_s, c.end.velocity_mm_s, l.speed_max_mm_s),
        "{s:?} {:?}",
        c.end
    );
    prop_assert!(
        !jump(
            s.acceleration_mm_s2,
            c.end.acceleration_mm_s2,
            l.acceleration_max_mm_s2
        ),
        "{s:?} {:?}",
        c.end
    );
    Ok(())
}

fn config() -> impl Strategy<Value = MotionLimits> {
    (1.0..200.0f64, 0.02..1.0f64, 0.01..0.3f64, 2.0..40.0f64).prop_map(
        |(speed, ramp_s, rise_s, travel)| MotionLimits {
            speed_max_mm_s: speed,
            acceleration_max_mm_s2: speed / ramp_s,
            jerk_max_mm_s3: speed / ramp_s / rise_s,
            travel_max_mm: travel,
            retarget_min_mm: 0.0,
        },
    )
}

fn pattern() -> impl Strategy<Value = Pattern> {
    prop_oneof![
        Just(Pattern::Jumps),
        Just(Pattern::Ends),
        Just(Pattern::Wild),
        Just(Pattern::Sines),
        Just(Pattern::Walk)
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// Limits and continuity hold in every piece of every tick, and planning never fails.
    #[test]
    fn limits_hold_whatever_the_target(c in config(), m in pattern(), seed in any::<u64>(), dt in 0.5e-3..5e-3f64) {
        let l = limits(&c);
        let mut motion = Motion::new(&l);
        let mut targets = Targets::new(m, seed, l.travel_max_mm);
        let mut last = *motion.state();
        for k in 0..1500 {
            let segment = motion.tick(targets.next(f64::from(k) * dt), dt);
            prop_assert_eq!(segment.channels.map(|c| c.start), last, "a segment starts exactly where the previous one ended");
            last = segment.end();
            for channel in &segment.channels {
                check_channel(channel, &l)?;
            }
            let planned = matches!(motion.status(), MoveStatus::Resting | MoveStatus::Following | MoveStatus::Replanned);
            prop_assert!(planned, "{:?}", motion.status());
        }
    }

    /// The motion ends exactly at the target, and a channel is as fast as if it moved alone.
    #[test]
    fn channels_arrive_exactly_and_do_not_wait(
        c in config(),
        seed in any::<u64>(),
        to in prop::array::uniform3(-1.0..1.0f64),
        ticks in 0..400u32,
    ) {
        let l = limits(&c);
        let to = to.map(|x| x * l.travel_max_mm);
        // ticks until each channel arrives; `alone` stills the others
        let arrivals = |alone: Option<usize>| {
            let only = |target: [f64; 3]| std::array::from_fn(|i| if alone.is_none_or(|only| only == i) { target[i] } else { 0.0 });
            let mut motion = Motion::new(&l);
            let mut targets = Targets::new(Pattern::Wild, seed, l.travel_max_mm);
            for k in 0..ticks {
                motion.tick(only(targets.next(f64::from(k) * 1e-3)), 1e-3);
            }
            let mut arrived = [None; 3];
            for k in 0..1_000_000 {
                motion.tick(only(to), 1e-3);
                for (i, arrived) in arrived.iter_mut().enumerate() {
                    if motion.state()[i] == MotionState::rest(only(to)[i]) && arrived.is_none() {
                        *arrived = Some(k);
                    }
                }
                if arrived.iter().all(Option::is_some) {
                    break;
                }
            }
            arrived
        };
        let together = arrivals(None);
        for i in 0..3 {
            prop_assert!(together[i].is_some() && together[i] == arrivals(Some(i))[i], "{together:?}");
        }
    }

    /// Braking from any motion keeps every limit, including travel, and ends at rest.
    #[test]
    fn braking_keeps_the_limits(c in config(), m in pattern(), seed in any::<u64>(), ticks in 1..1200u32) {
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

    /// Targets within the retarget threshold cause neither a plan nor motion.
    #[test]
    fn a_target_within_the_threshold_is_not_planned_for(seed in any::<u64>()) {
        let c = MotionLimits { retarget_min_mm: 0.01, ..MotionLimits::default() };
        let mut motion = Motion::new(&limits(&c));
        let mut r = SmallRng::seed_from_u64(seed);
        for _ in 0..1000 {
            motion.tick(std::array::from_fn(|_| r.random_range(-0.009..0.009)), 1e-3);
            prop_assert_eq!(motion.status(), MoveStatus::Resting);
        }
    }
}

/// Counts the steps of one channel from its position alone.
struct Auditor {
    step_mm: f64,
    count: i32,
    steps: u64,
}

impl Auditor {
    /// Checks place, order and number of a segment's steps.
    fn audit(&mut self, c: &ChannelSegment, steps: &mut ChannelSteps, duration_s: f64) {
        steps.load(c);
        let mut last_s = 0.0;
        while let Some(step) = steps.next_step() {
            let midpoint_mm =
                (f64::from(self.count) + 0.5 * f64::from(step.direction)) * self.step_mm;
            let there_mm = position_mm(c, step.t_s);
            assert!(
                (there_mm - midpoint_mm).abs() < 1e-7,
                "step at {there_mm}, midpoint at {midpoint_mm}"
            );
            assert!(step.t_s >= last_s && step.t_s <= duration_s + 1e-9);
            last_s = step.t_s;
            self.count += step.direction;
            self.steps += 1;
        }
        let wanted = (c.end.position_mm / self.step_mm).round();
        assert_eq!(f64::from(self.count), wanted, "a step was lost or doubled");
    }
}

/// Position of a channel at a time after the start of a segment, mm.
fn position_mm(c: &ChannelSegment, t_s: f64) -> f64 {
    let (mut at, mut left) = (c.start, t_s);
    for &(d, jerk) in c.pieces() {
        at = at.after(jerk, left.clamp(0.0, d));
        left -= d;
    }
    at.position_mm
}

/// Every step of ten million is checked.
#[test]
fn no_step_is_lost_or_doubled_in_ten_million() {
    let c = MotionLimits {
        speed_max_mm_s: 200.0,
        acceleration_max_mm_s2: 4000.0,
        jerk_max_mm_s3: 200_000.0,
        travel_max_mm: 25.0,
        retarget_min_mm: 0.0,
    };
    let l = limits(&c);
    let step_mm = std::f64::consts::PI * 30.0 / 200.0 / 256.0;
    let mut total = 0;
    for (m, seed) in [Pattern::Jumps, Pattern::Ends, Pattern::Sines, Pattern::Wild]
        .into_iter()
        .cycle()
        .zip(0..)
    {
        let mut motion = Motion::new(&l);
        let mut targets = Targets::new(m, seed, l.travel_max_mm);
        let mut channels: [ChannelSteps; 3] =
            std::array::from_fn(|_| ChannelSteps::new(step_mm, 0));
        let mut auditors: [Auditor; 3] = std::array::from_fn(|_| Auditor {
            step_mm,
            count: 0,
            steps: 0,
        });
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

/// The same motion cut into other ticks makes the same steps at the same times.
#[test]
fn steps_do_not_depend_on_the_length_of_a_tick() {
    let l = limits(&MotionLimits::default());
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

/// Counts the allocations of the calling thread.
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

    /// Number of allocations of this thread so far.
    pub fn allocations() -> u64 {
        COUNT.with(Cell::get)
    }
}

#[global_allocator]
static COUNTING: counting::Counting = counting::Counting;

/// After construction, planning, failing to plan, braking and stepping do not allocate.
#[test]
fn the_control_path_allocates_nothing() {
    let l = limits(&MotionLimits::default());
    let mut motion = Motion::new(&l);
    let mut steps: [ChannelSteps; 3] = std::array::from_fn(|_| ChannelSteps::new(0.029_452, 0));
    let mut targets = Targets::new(Pattern::Wild, 3, 25.0);
    let before = counting::allocations();
    let (mut made, mut replans, mut brakes) = (0, 0, 0);
    for k in 0..20_000 {
        let t = f64::from(k) * 1e-3;
        let segment = match k % 1000 {
            0..700 => motion.tick(targets.next(t), 1e-3),
            700..800 => motion.tick([f64::NAN; 3], 1e-3),
            800..900 => motion.brake(1e-3),
            _ => motion.tick([1.0; 3], 1e-3),
        };
        replans += u32::from(motion.status() == MoveStatus::Replanned);
        brakes += u32::from(matches!(motion.status(), MoveStatus::Braking(_)));
        for (c, s) in segment.channels.iter().zip(&mut steps) {
            s.load(c);
            made += u64::from(s.next_step().is_some());
        }
    }
    assert_eq!(counting::allocations() - before, 0);
    assert!(made > 1000 && replans > 10_000 && brakes > 10);
    let allocation = Box::new(made);
    assert!(
        counting::allocations() > before,
        "the counter does not count: {allocation}"
    );
}

fn default_motion() -> Motion {
    Motion::new(&limits(&MotionLimits::default()))
}

/// Advances by `ticks` ticks of 1 ms.
fn run<S: Solver>(motion: &mut Motion<S>, target_mm: [f64; 3], ticks: u32) {
    for _ in 0..ticks {
        motion.tick(target_mm, 1e-3);
    }
}

#[test]
fn an_unchanged_target_is_planned_once() {
    let mut m = default_motion();
    let mut replans = 0;
    for _ in 0..2000 {
        m.tick([3.0, -2.0, 1.0], 1e-3);
        replans += u32::from(m.status() == MoveStatus::Replanned);
    }
    assert_eq!(replans, 1);
    assert_eq!(m.state(), &[3.0, -2.0, 1.0].map(MotionState::rest));
}

#[test]
fn a_target_beyond_travel_is_clamped() {
    let mut m = default_motion();
    run(&mut m, [80.0, 0.0, -80.0], 4000);
    let travel_mm = MotionLimits::default().travel_max_mm;
    assert_eq!(
        m.state(),
        &[travel_mm, 0.0, -travel_mm].map(MotionState::rest)
    );
}

#[test]
fn after_a_target_that_is_not_a_number_the_plan_is_kept_and_then_braked() {
    let mut m = default_motion();
    run(&mut m, [10.0; 3], 100);
    for _ in 0..KEEP_TICKS_MAX {
        m.tick([10.0, 10.0, f64::NAN], 1e-3);
        assert_eq!(m.status(), MoveStatus::Kept(PlanFault::TargetNotFinite));
    }
    assert!(m.state()[0].velocity_mm_s > 5.0);
    run(&mut m, [10.0, 10.0, f64::NAN], 500);
    assert!(m.state().iter().all(MotionState::is_rest) && m.state()[0].position_mm < 9.9);
    m.tick([10.0; 3], 1e-3);
    assert_eq!(m.status(), MoveStatus::Replanned);
}

/// Fails while the flag is set.
struct Failing(std::rc::Rc<std::cell::Cell<bool>>, Ruckig);

impl Solver for Failing {
    fn solve(
        &mut self,
        l: &MotionLimits,
        from: &[MotionState; 3],
        to: &[f64; 3],
        out: &mut Plan,
    ) -> Result<(), PlanFault> {
        if self.0.get() {
            Err(PlanFault::NoProfile)
        } else {
            self.1.solve(l, from, to, out)
        }
    }
}

#[test]
fn a_failing_solver_ends_at_rest_and_motion_recovers() {
    let fails = std::rc::Rc::default();
    let mut m = Motion::with_solver(
        &limits(&MotionLimits::default()),
        Failing(std::rc::Rc::clone(&fails), Ruckig::default()),
    );
    for k in 0..300 {
        m.tick([10.0 + 1e-3 * f64::from(k), -5.0, 5.0], 1e-3);
    }
    fails.set(true);
    for k in 0..300 {
        m.tick([-10.0 - 1e-3 * f64::from(k), -5.0, 5.0], 1e-3);
    }
    assert!(m.state().iter().all(MotionState::is_rest));
    fails.set(false);
    run(&mut m, [-10.0, 0.0, 5.0], 3000);
    assert_eq!(m.state(), &[-10.0, 0.0, 5.0].map(MotionState::rest));
}

#[test]
fn braking_ends_at_rest_and_the_next_target_starts_there() {
    let mut m = default_motion();
    run(&mut m, [20.0; 3], 150);
    for _ in 0..300 {
        m.brake(1e-3);
    }
    let rest = m.state()[0];
    assert!(
        rest.is_rest() && rest.position_mm > 0.5 && rest.position_mm < 15.0,
        "{rest:?}"
    );
    run(&mut m, [20.0; 3], 3000);
    assert_eq!(m.state()[0], MotionState::rest(20.0));
}

/// Plans a motion that reverses exactly at the end of travel while it still decelerates hard. It is within
/// every limit, but shortly before the reversal no stop stays within travel.
struct EndOfTravel(f64);

impl EndOfTravel {
    /// Durations and signs of the jerk.
    fn phases(&self) -> [(f64, f64); 5] {
        let (t, root) = (self.0, 3.0_f64.sqrt());
        [
            (t, 1.0),
            (3.0 * t, -1.0),
            (2.0 * t, 1.0),
            (root * t, 1.0),
            (root * t, -1.0),
        ]
    }
}

impl Solver for EndOfTravel {
    fn solve(
        &mut self,
        l: &MotionLimits,
        from: &[MotionState; 3],
        _: &[f64; 3],
        out: &mut Plan,
    ) -> Result<(), PlanFault> {
        *out = Plan::resting([0.0; 3]);
        let (mut at, mut plan) = (from[0], ChannelPlan::default());
        for (d, sign) in self.phases() {
            plan.push(at, sign * l.jerk_max_mm_s3, d);
            at = at.after(sign * l.jerk_max_mm_s3, d);
        }
        plan.end_mm = at.position_mm;
        out.channels[0] = plan;
        Ok(())
    }
}

#[test]
fn a_plan_that_leaves_no_room_for_a_stop_is_braked_in_time() {
    let (t, start_mm) = (0.03, 20.0);
    let c = MotionLimits {
        speed_max_mm_s: 30.0,
        acceleration_max_mm_s2: 1e4,
        jerk_max_mm_s3: 6000.0,
        travel_max_mm: 1000.0,
        retarget_min_mm: 0.0,
    };
    let farthest_mm = MotionState::rest(0.0)
        .after(c.jerk_max_mm_s3, t)
        .position_range(-c.jerk_max_mm_s3, 3.0 * t)
        .1;
    let l = limits(&MotionLimits {
        travel_max_mm: start_mm + farthest_mm + 1e-6,
        ..c
    });
    let mut m = Motion::with_solver(&l, EndOfTravel(t));
    m.reset([start_mm, 0.0, 0.0]);
    let (mut highest_mm, mut cornered) = (0.0_f64, false);
    for _ in 0..1000 {
        let segment = if cornered {
            m.brake(1e-3)
        } else {
            m.tick([19.0, 0.0, 0.0], 1e-3)
        };
        cornered |= m.status() == MoveStatus::Braking(Some(PlanFault::NoStop));
        let mut s = segment.channels[0].start;
        for &(d, j) in segment.channels[0].pieces() {
            highest_mm = highest_mm.max(s.position_range(j, d).1);
            s = s.after(j, d);
        }
    }
    assert!(cornered, "{:?}", m.status());
    assert!(m.state()[0].is_rest());
    assert!(
        highest_mm <= l.travel_max_mm + 1e-7 && highest_mm > l.travel_max_mm - 0.1,
        "{highest_mm}"
    );
}

#[test]
fn a_tick_without_a_positive_duration_moves_nothing() {
    let mut m = default_motion();
    for dt in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(m.tick([5.0; 3], dt).end().map(|s| s.position_mm), [0.0; 3]);
    }
}

/// A motion that is on its way can hide in unchanged counts, but for no longer than the drive says.
#[test]
fn counts_that_stay_for_the_time_of_rest_stay_for_good() {
    let (mut rng, mut runner) = (SmallRng::seed_from_u64(24), TestRunner::deterministic());
    let dt_s = 0.5e-3;
    for _ in 0..24 {
        let c = config().new_tree(&mut runner).unwrap().current();
        let limits = limits(&c);
        let drive = DriveLimits {
            limits,
            lead_s: 0.0,
        };
        let step_mm = rng.random_range(0.01..0.1_f64);
        let rest_s = drive.rest_s(step_mm);
        let mut motion = Motion::new(&limits);
        motion.reset([0.0; 3]);
        let mut longest_s = 0.0_f64;
        for _ in 0..60 {
            // a few steps to and fro, or a long way, and the next order at any moment
            let travel = 0.9 * c.travel_max_mm / step_mm;
            let far = if rng.random_bool(0.3) { travel } else { 4.0 };
            let sent = rng.random_range(-far..far).round();
            let last = rng.random_range(1..400) + if rng.random_bool(0.2) { 40_000 } else { 0 };
            let mut agreed_s = 0.0;
            for _ in 0..last {
                let end = motion.tick([sent * step_mm, 0.0, 0.0], dt_s).end();
                if (end[0].position_mm / step_mm).round() == sent {
                    agreed_s += dt_s;
                } else {
                    longest_s = longest_s.max(agreed_s);
                    agreed_s = 0.0;
                }
            }
        }
        println!("hidden for {longest_s:.4} s, rest {rest_s:.4} s");
        assert!(
            longest_s > 0.0 && longest_s < rest_s,
            "{longest_s} {rest_s} {c:?}"
        );
    }
}
