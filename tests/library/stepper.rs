//! The step core under a simulated clock, with late wake-ups, slow pins and preemption between reading the clock and
//! writing. The tests verify the chip's timing on the recorded edges. At the end, the real thread.

use crate::recording_pins::{Edge, LineName, RecordingPins, edges};
use proptest::prelude::*;
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use retroflex::hardware::pins::map::LineMap;
use retroflex::hardware::pins::{InputPin, PinError, Pins, PinsConfig, Pull};
use retroflex::hardware::stepper::Stepper;
use retroflex::motion::lines::{EmergencyStop, Inputs, Levels, PulseTiming};
use retroflex::motion::pulse::{PulseAction, StepCore};
use retroflex::motion::queue::TimedSegment;
use retroflex::motion::report::{StepperFault, StepperMode, StepperOrder};
use retroflex::motion::{
    ChannelSegment, DriveState, Motion, MotionLimits, MotionState, Segment, StepGenerator,
    StepperConfig,
};
use retroflex::primitives::units::Steps;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

const STEP_MM: f64 = 0.029_452;
const TICK_NS: u64 = 2_000_000;
const START_NS: u64 = 1_000_000_000;

fn limits() -> MotionLimits {
    MotionLimits::default()
}

fn timing(config: &StepperConfig) -> PulseTiming {
    config.timing(EmergencyStop::default()).unwrap()
}

/// Largest delays of the machine, ns.
#[derive(Debug, Clone, Copy)]
struct Delays {
    /// Lateness of a wake-up.
    wake_ns: u64,
    /// Time between reading the clock and writing.
    preempt_ns: u64,
    /// Duration of a write.
    write_ns: u64,
}

const CALM: Delays = Delays {
    wake_ns: 1,
    preempt_ns: 1,
    write_ns: 200,
};

/// A core with its clock, its pins and a record of their edges.
struct Machine {
    core: StepCore,
    queue: VecDeque<TimedSegment>,
    now_ns: u64,
    delays: Delays,
    random: SmallRng,
    levels: Levels,
    record: Vec<Edge>,
}

impl Machine {
    fn new(config: &StepperConfig, delays: Delays, seed: u64) -> Self {
        Self::with_step(config, delays, seed, STEP_MM)
    }

    fn with_step(config: &StepperConfig, delays: Delays, seed: u64, step_mm: f64) -> Self {
        Self::with_timing(timing(config), delays, seed, step_mm)
    }

    fn with_timing(timing: PulseTiming, delays: Delays, seed: u64, step_mm: f64) -> Self {
        Self {
            core: StepCore::new(timing, &limits(), step_mm),
            queue: VecDeque::new(),
            now_ns: START_NS,
            delays,
            random: SmallRng::seed_from_u64(seed),
            levels: Levels::default(),
            record: Vec::new(),
        }
    }

    /// A delay up to `most`, distributed like real latencies: most are much shorter, one in a hundred exceeds two thirds.
    fn up_to(&mut self, most: u64) -> u64 {
        let share: f64 = self.random.random_range(0.0..1.0);
        (share.powi(40) * most as f64) as u64
    }

    /// One cycle of the step thread.
    fn turn(&mut self) {
        match self.core.poll(self.now_ns, &mut || self.queue.pop_front()) {
            PulseAction::WaitUntil(t) => {
                // short waits are spun, not slept
                let slept = t > self.now_ns + 20_000;
                let late = if slept {
                    self.up_to(self.delays.wake_ns)
                } else {
                    0
                };
                self.now_ns = self.now_ns.max(t) + late + 30;
            }
            PulseAction::Write(levels) => {
                let begin = self.now_ns + self.up_to(self.delays.preempt_ns);
                let end = begin + 1 + self.up_to(self.delays.write_ns);
                // each edge occurs at its own instant within the write
                let changed: Vec<Edge> = edges(0, &self.levels, &levels).collect();
                for edge in changed {
                    let t_ns = self.random.random_range(begin..=end);
                    self.record.push(Edge { t_ns, ..edge });
                }
                self.levels = levels;
                self.now_ns = end + 30;
                self.core.wrote(self.now_ns);
            }
        }
    }

    fn mode(&self) -> StepperMode {
        self.core.report(self.now_ns).mode
    }

    fn counted(&self) -> Steps {
        self.core.report(self.now_ns).counted
    }

    fn run_until(&mut self, t_ns: u64) {
        while self.now_ns < t_ns {
            self.turn();
        }
    }

    fn feed(&mut self, epoch: u32, start_ns: u64, segments: &[Segment]) -> u64 {
        let mut at = start_ns;
        for segment in segments {
            self.queue.push_back(TimedSegment {
                epoch,
                start_ns: at,
                duration_ns: TICK_NS,
                segment: *segment,
            });
            at += TICK_NS;
        }
        at
    }

    /// Steps of a channel, counted from the record alone: the DIR level at each rising STEP.
    fn pulsed(&self, channel: usize) -> i32 {
        let mut up = false;
        let mut count = 0;
        for e in &self.record {
            match e.line {
                LineName::Dir(c) if c == channel => up = e.high,
                LineName::Step(c) if c == channel && e.high => count += if up { 1 } else { -1 },
                _ => {}
            }
        }
        count
    }
}

/// A random walk of targets that ends at rest.
fn walk(seed: u64, jumps: u32) -> Vec<Segment> {
    let mut random = SmallRng::seed_from_u64(seed);
    let mut motion = Motion::new(&limits());
    let mut segments = Vec::new();
    for _ in 0..jumps {
        let target = std::array::from_fn(|_| random.random_range(-12.0..12.0));
        for _ in 0..random.random_range(20..300) {
            segments.push(motion.tick(target, 2e-3));
        }
    }
    let last = motion.state().map(|s| (s.position_mm * 4.0).round() / 4.0);
    while segments.len() < 60_000 {
        segments.push(motion.tick(last, 2e-3));
        if segments[segments.len() - 1].is_still() {
            break;
        }
    }
    segments
}

/// Verifies the chip's timing on the edges of a record.
fn check_record(record: &[Edge], t: &PulseTiming) -> Result<(), TestCaseError> {
    for channel in 0..3 {
        let (mut rise, mut fall, mut turn, mut awake): (Option<u64>, _, _, Option<u64>) =
            (None, None, None, None);
        let mut high = false;
        for e in record {
            match e.line {
                LineName::Enable => awake = e.high.then_some(e.t_ns),
                LineName::Dir(c) if c == channel => {
                    prop_assert!(!high, "DIR moved while STEP was high");
                    prop_assert!(fall.is_none_or(|f: u64| e.t_ns >= f + t.dir_ns), "DIR hold");
                    turn = Some(e.t_ns);
                }
                LineName::Step(c) if c == channel && e.high => {
                    prop_assert!(
                        awake.is_some_and(|a| e.t_ns >= a + t.wake_ns),
                        "a driver was stepped before it was awake"
                    );
                    prop_assert!(
                        turn.is_none_or(|d: u64| e.t_ns >= d + t.dir_ns),
                        "DIR set-up"
                    );
                    prop_assert!(fall.is_none_or(|f| e.t_ns >= f + t.low_ns), "STEP low");
                    prop_assert!(rise.is_none_or(|r| e.t_ns >= r + t.interval_ns), "interval");
                    (rise, high) = (Some(e.t_ns), true);
                }
                LineName::Step(c) if c == channel => {
                    prop_assert!(rise.is_some_and(|r| e.t_ns >= r + t.high_ns), "STEP high");
                    (fall, high) = (Some(e.t_ns), false);
                }
                _ => {}
            }
        }
    }
    Ok(())
}

fn delays() -> impl Strategy<Value = Delays> {
    (1u64..900_000, 1u64..60_000, 1u64..60_000).prop_map(|(wake_ns, preempt_ns, write_ns)| Delays {
        wake_ns,
        preempt_ns,
        write_ns,
    })
}

fn config() -> impl Strategy<Value = StepperConfig> {
    (1.0..20.0f64, 1.0..20.0f64, 0.2..10.0f64, 0.0..60.0f64).prop_map(|(high, low, dir, more)| {
        StepperConfig {
            pulse_high_us: high,
            pulse_low_us: low,
            dir_setup_us: dir,
            step_interval_min_us: high + low + more,
            ..StepperConfig::default()
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    /// With any delays, no edge violates the chip's timing, and the count equals the pulses. With short delays no step is
    /// lost or doubled and there is no fault. Long delays may add up to a fault, which is then reported. With fine steps
    /// several are due at once after a late wake-up.
    #[test]
    fn timing_holds_in_any_delays(c in config(), w in delays(), seed in any::<u64>(), fine in any::<bool>()) {
        let step_mm = if fine { STEP_MM / 8.0 } else { STEP_MM };
        let mut m = Machine::with_step(&c, w, seed, step_mm);
        let segments = walk(seed, 8);
        let end_ns = m.feed(0, START_NS + 4_000_000, &segments);
        m.run_until(end_ns + 10_000_000);
        check_record(&m.record, &timing(&c))?;
        let pulsed = std::array::from_fn(|channel| m.pulsed(channel));
        prop_assert_eq!(m.counted().0, pulsed);
        match m.mode() {
            StepperMode::Resting => {
                let end = segments[segments.len() - 1].end().map(|s| s.position_mm);
                prop_assert_eq!(pulsed, end.map(|p| (p / step_mm).round() as i32));
                prop_assert!(m.record.len() > 200);
            }
            StepperMode::Faulted(StepperFault::Late { late_ns, .. }) => prop_assert!(late_ns > 1_000_000 && w.wake_ns > 200_000),
            other => prop_assert!(false, "{:?}", other),
        }
    }

    /// Stalls beyond the bound: the first one that delays a step causes a fault, no pulse follows, and the reported count
    /// equals the pulses.
    #[test]
    fn a_stall_beyond_the_bound_latches_without_a_burst(seed in any::<u64>(), stall_ms in 2.5..60.0f64, at in 0.05..0.9f64) {
        let c = StepperConfig::default();
        let mut m = Machine::new(&c, Delays { wake_ns: 20_000, preempt_ns: 2_000, write_ns: 2_000 }, seed);
        let segments = walk(seed, 4);
        let end_ns = m.feed(0, START_NS, &segments);
        m.run_until(START_NS + ((end_ns - START_NS) as f64 * at) as u64);
        let before = m.record.len();
        let fast = segments[(segments.len() as f64 * at) as usize].channels.iter().any(|c| c.start.velocity_mm_s.abs() > 25.0 && c.end.velocity_mm_s.abs() > 25.0);
        m.now_ns += (stall_ms * 1e6) as u64;
        m.run_until(end_ns + 100_000_000);
        check_record(&m.record, &timing(&c))?;
        for channel in 0..3 {
            prop_assert_eq!(m.counted().0[channel], m.pulsed(channel));
        }
        if let StepperMode::Faulted(fault) = m.mode() {
            let late = matches!(fault, StepperFault::Late { late_ns, .. } if late_ns > 1_000_000);
            prop_assert!(late, "{:?}", fault);
            let rises = m.record[before..].iter().filter(|e| e.high && matches!(e.line, LineName::Step(_))).count();
            prop_assert!(rises == 0, "{rises} pulses after the stall");
            prop_assert!(m.levels.enable && m.levels.step == [false; 3], "holds");
        } else {
            // no step was due during the stall, or motion could continue after it
            prop_assert!(!fast, "a stall at full speed was not detected");
        }
    }

    /// When the queue is empty the pistons brake within the limits: after the last segment they continue by exactly the
    /// shortest stopping distance, and no step is lost.
    #[test]
    fn running_dry_brakes(seed in any::<u64>(), part in 0.05..0.95f64) {
        let c = StepperConfig::default();
        let mut m = Machine::new(&c, Delays { wake_ns: 100_000, preempt_ns: 2_000, write_ns: 2_000 }, seed);
        let segments = walk(seed, 4);
        let fed = &segments[..((segments.len() as f64 * part) as usize).max(1)];
        let end_ns = m.feed(0, START_NS, fed);
        m.run_until(end_ns + 1_000_000_000);
        check_record(&m.record, &timing(&c))?;
        prop_assert_eq!(m.mode(), StepperMode::Resting);
        let report = m.core.report(m.now_ns);
        let moving = fed[fed.len() - 1].end().iter().any(|s| !s.is_rest());
        prop_assert_eq!((report.epoch, report.underruns), (u32::from(moving), u32::from(moving)));
        for channel in 0..3 {
            let last = fed[fed.len() - 1].end()[channel];
            let stop = retroflex::motion::stop::Stop::from(last, &limits());
            prop_assert!((report.rest_mm[channel] - stop.end_mm).abs() < 1e-9);
            prop_assert_eq!(report.counted.0[channel], (stop.end_mm / STEP_MM).round() as i32);
            prop_assert_eq!(m.pulsed(channel), report.counted.0[channel]);
        }
        // motion that was planned before the break is dropped
        let taken = m.record.len();
        if moving {
            m.feed(0, m.now_ns + 4_000_000, &segments[fed.len()..]);
            m.run_until(m.now_ns + 500_000_000);
            prop_assert_eq!(m.record.len(), taken);
        }
    }
}

/// A segment of 10 ms in which channel 1 starts with a speed and decelerates steadily.
fn decelerating(speed_mm_s: f64, braked_mm_s2: f64) -> Segment {
    let start = MotionState {
        position_mm: 0.0,
        velocity_mm_s: speed_mm_s,
        acceleration_mm_s2: -braked_mm_s2,
    };
    let mut moving = ChannelSegment::starting(start);
    moving.push(0.01, 0.0);
    let still = ChannelSegment::holding(0.0, 0.01);
    Segment {
        duration_s: 0.01,
        channels: [moving.ending(start.after(0.0, 0.01)), still, still],
    }
}

#[test]
fn a_step_up_and_down_within_microseconds_keeps_dir_timing() {
    // up to a nanometre above the middle between two microsteps and down again: 6 µs between the steps
    let step_mm = 2.0 * (1.0 / 400.0 - 1e-9);
    let c = StepperConfig {
        dir_setup_us: 5.0,
        step_interval_min_us: 4.0,
        ..StepperConfig::default()
    };
    for seed in 0..200 {
        let mut m = Machine::with_step(
            &c,
            Delays {
                wake_ns: 300_000,
                preempt_ns: 3_000,
                write_ns: 1_000,
            },
            seed,
            step_mm,
        );
        let segment = decelerating(1.0, 200.0);
        m.queue.push_back(TimedSegment {
            epoch: 0,
            start_ns: START_NS + 4_000_000,
            duration_ns: 10_000_000,
            segment,
        });
        m.run_until(START_NS + 13_000_000);
        assert_eq!(
            m.record
                .iter()
                .filter(|e| matches!(e.line, LineName::Step(0)) && e.high)
                .count(),
            2
        );
        assert_eq!((m.mode(), m.pulsed(0)), (StepperMode::Following, 0));
        check_record(&m.record, &timing(&c)).unwrap();
    }
}

#[test]
fn a_released_driver_gets_its_time_to_wake() {
    let c = StepperConfig {
        wake_delay_ms: 6.0,
        ..StepperConfig::default()
    };
    let mut m = Machine::new(&c, CALM, 1);
    let segment = decelerating(20.0, 0.0);
    m.queue.push_back(TimedSegment {
        epoch: 0,
        start_ns: START_NS + 1_000_000,
        duration_ns: 10_000_000,
        segment,
    });
    m.run_until(START_NS + 500_000_000);
    check_record(&m.record, &timing(&c)).unwrap();
    assert_eq!(
        m.mode(),
        StepperMode::Resting,
        "a step that waits for the driver is not late"
    );
    assert!(m.pulsed(0) > 6 && m.pulsed(0) == m.counted().0[0]);
}

/// A machine with short delays that moves all channels towards 12 mm.
fn on_the_way(timing: PulseTiming) -> (Machine, Motion) {
    let mut m = Machine::with_timing(timing, CALM, 1, STEP_MM);
    let mut motion = Motion::new(&limits());
    let segments: Vec<Segment> = (0..150)
        .map(|_| motion.tick([12.0, -12.0, 6.0], 2e-3))
        .collect();
    m.feed(0, START_NS + 4_000_000, &segments);
    m.run_until(START_NS + 200_000_000);
    assert_eq!(m.mode(), StepperMode::Following);
    (m, motion)
}

#[test]
fn an_order_to_stop_brakes_and_drops_the_queue() {
    let (mut m, _) = on_the_way(timing(&StepperConfig::default()));
    m.core.order(StepperOrder::Stop);
    m.run_until(m.now_ns + 500_000_000);
    let report = m.core.report(m.now_ns);
    assert_eq!(
        (report.mode, report.epoch, report.underruns),
        (StepperMode::Resting, 1, 0)
    );
    assert!(
        report.rest_mm[0] > 1.0 && report.rest_mm[0] < 9.0,
        "{:?}",
        report.rest_mm
    );
    assert_eq!(
        report.counted.0[0],
        (report.rest_mm[0] / STEP_MM).round() as i32
    );
    assert!(m.queue.is_empty() && report.refused > 0);
    assert!(report.energised, "a stop holds");
}

#[test]
fn after_a_break_motion_goes_on_from_where_it_rests() {
    let (mut m, mut motion) = on_the_way(timing(&StepperConfig::default()));
    m.core.order(StepperOrder::Stop);
    m.run_until(m.now_ns + 500_000_000);
    motion.reset(m.core.report(m.now_ns).rest_mm);
    let segments: Vec<Segment> = (0..1500)
        .map(|_| motion.tick([-3.0, 2.0, 1.0], 2e-3))
        .collect();
    let end_ns = m.feed(1, m.now_ns + 4_000_000, &segments);
    m.run_until(end_ns + 10_000_000);
    let wanted = [-3.0, 2.0, 1.0_f64].map(|p| (p / STEP_MM).round() as i32);
    assert_eq!(m.counted().0, wanted);
    assert_eq!(std::array::from_fn::<i32, 3, _>(|c| m.pulsed(c)), wanted);
}

#[test]
fn a_fault_holds_until_cleared_and_then_motion_goes_on_from_the_count() {
    let (mut m, mut motion) = on_the_way(timing(&StepperConfig::default()));
    m.now_ns += 5_000_000;
    m.turn();
    assert!(
        matches!(m.mode(), StepperMode::Faulted(StepperFault::Late { .. })),
        "{:?}",
        m.mode()
    );
    m.core.order(StepperOrder::Stop);
    m.core.order(StepperOrder::Rebase([0.0; 3]));
    m.run_until(m.now_ns + 50_000_000);
    assert!(matches!(m.mode(), StepperMode::Faulted(_)) && m.levels.enable);
    m.core.order(StepperOrder::Clear);
    m.run_until(m.now_ns + 1_000_000);
    let report = m.core.report(m.now_ns);
    assert_eq!(report.mode, StepperMode::Resting);
    assert_eq!(
        report.rest_mm,
        report.counted.0.map(|n| f64::from(n) * STEP_MM)
    );
    motion.reset(report.rest_mm);
    let segments: Vec<Segment> = (0..1500).map(|_| motion.tick([0.0; 3], 2e-3)).collect();
    let end_ns = m.feed(report.epoch, m.now_ns + 4_000_000, &segments);
    m.run_until(end_ns + 10_000_000);
    assert_eq!(m.counted().0, [0; 3]);
    assert_eq!([m.pulsed(0), m.pulsed(1), m.pulsed(2)], [0; 3]);
}

#[test]
fn the_emergency_stop_releases_at_once_or_brakes_and_holds() {
    let pressed = Inputs {
        emergency_stop: true,
        ..Inputs::default()
    };
    let (mut m, _) = on_the_way(timing(&StepperConfig::default()));
    m.core.observe(pressed);
    assert_eq!(
        m.mode(),
        StepperMode::Following,
        "one reading may be a disturbance"
    );
    m.core.observe(Inputs::default());
    m.core.observe(pressed);
    assert_eq!(m.mode(), StepperMode::Following);
    m.core.observe(pressed);
    let before = m
        .record
        .iter()
        .filter(|e| matches!(e.line, LineName::Step(_)) && e.high)
        .count();
    m.run_until(m.now_ns + 100_000_000);
    let after = m
        .record
        .iter()
        .filter(|e| matches!(e.line, LineName::Step(_)) && e.high)
        .count();
    assert_eq!(
        (m.mode(), m.levels.enable, after - before),
        (StepperMode::Faulted(StepperFault::EmergencyStop), false, 0)
    );
    m.core.order(StepperOrder::Clear);
    assert_eq!(
        m.mode(),
        StepperMode::Faulted(StepperFault::EmergencyStop),
        "still pressed"
    );
    m.core.observe(Inputs::default());
    m.core.order(StepperOrder::Clear);
    assert_eq!(m.mode(), StepperMode::Resting);

    let hold = PulseTiming {
        emergency_stop: EmergencyStop::Hold,
        ..timing(&StepperConfig::default())
    };
    let (mut m, _) = on_the_way(hold);
    m.core.observe(pressed);
    m.core.observe(pressed);
    assert_eq!(m.mode(), StepperMode::Stopping);
    m.run_until(m.now_ns + 500_000_000);
    let report = m.core.report(m.now_ns);
    assert_eq!(
        (report.mode, report.energised),
        (StepperMode::Faulted(StepperFault::EmergencyStop), true)
    );
    assert_eq!(
        report.counted.0[0],
        (report.rest_mm[0] / STEP_MM).round() as i32
    );
}

#[test]
fn a_segment_that_jumps_is_refused_before_it_moves_anything() {
    for bad in [5.0, f64::NAN] {
        let mut m = Machine::new(&StepperConfig::default(), CALM, 1);
        m.feed(
            0,
            START_NS + 4_000_000,
            &[Segment::holding([0.0, bad, 0.0], 2e-3)],
        );
        m.run_until(START_NS + 20_000_000);
        assert!(
            matches!(
                m.mode(),
                StepperMode::Faulted(StepperFault::Discontinuity { channel: 1, .. })
            ),
            "{:?}",
            m.mode()
        );
        assert!(m.record.is_empty());
    }
    let mut m = Machine::new(&StepperConfig::default(), CALM, 1);
    let mut fast = Segment::holding([0.0; 3], 2e-3);
    fast.channels[2] = fast.channels[2].ending(MotionState::rest(3.0));
    m.feed(0, START_NS + 4_000_000, &[fast]);
    m.run_until(START_NS + 20_000_000);
    assert!(
        matches!(m.mode(), StepperMode::Faulted(StepperFault::Discontinuity { channel: 2, jump_mm }) if jump_mm == 3.0)
    );
}

#[test]
fn drivers_are_released_when_idle_and_woken_in_time() {
    let c = StepperConfig {
        idle_release_s: Some(0.5),
        wake_delay_ms: 3.0,
        ..StepperConfig::default()
    };
    let mut m = Machine::new(&c, CALM, 1);
    let mut motion = Motion::new(&limits());
    let there: Vec<Segment> = (0..250).map(|_| motion.tick([2.0; 3], 2e-3)).collect();
    let end_ns = m.feed(0, START_NS + 4_000_000, &there);
    m.run_until(end_ns);
    assert!(m.levels.enable);
    m.run_until(end_ns + 700_000_000);
    assert!(!m.levels.enable, "released at rest");
    let back: Vec<Segment> = (0..700).map(|_| motion.tick([0.0; 3], 2e-3)).collect();
    let end_ns = m.feed(0, m.now_ns + 4_000_000, &back);
    m.run_until(end_ns + 1_000_000);
    check_record(&m.record, &timing(&c)).unwrap();
    assert_eq!((m.mode(), m.counted().0), (StepperMode::Resting, [0; 3]));
}

#[test]
fn finishing_brakes_releases_and_ends() {
    let (mut m, _) = on_the_way(timing(&StepperConfig::default()));
    m.core.order(StepperOrder::Finish);
    let mut turns = 0;
    while !m.core.is_finished() {
        m.turn();
        turns += 1;
        assert!(turns < 100_000);
    }
    let report = m.core.report(m.now_ns);
    assert_eq!(
        (report.mode, m.levels.enable, m.levels.step),
        (StepperMode::Resting, false, [false; 3])
    );
    assert_eq!(
        report.counted.0[1],
        (report.rest_mm[1] / STEP_MM).round() as i32
    );
}

/// A fault or an emergency stop while the last motion brakes must not keep the thread, and with it the program, from ending.
#[test]
fn finishing_ends_whatever_happens_while_it_brakes() {
    let hold = PulseTiming {
        emergency_stop: EmergencyStop::Hold,
        ..timing(&StepperConfig::default())
    };
    let late: fn(&mut Machine) = |m| m.now_ns += 5_000_000;
    let pressed: fn(&mut Machine) = |m| {
        let stop = Inputs {
            emergency_stop: true,
            ..Inputs::default()
        };
        m.core.observe(stop);
        m.core.observe(stop);
    };
    for happens in [late, pressed] {
        let (mut m, _) = on_the_way(hold);
        m.core.order(StepperOrder::Finish);
        m.turn();
        happens(&mut m);
        let ended = (0..100_000).any(|_| {
            m.turn();
            m.core.is_finished()
        });
        assert!(ended && !m.levels.enable, "{:?}", m.mode());
    }
}

#[test]
fn a_rebase_sets_position_and_count_at_rest_only() {
    let mut m = Machine::new(&StepperConfig::default(), CALM, 1);
    m.core.order(StepperOrder::Rebase([1.0, -2.0, 0.0]));
    assert_eq!(m.counted().0, [34, -68, 0]);
    m.core.order(StepperOrder::Rebase([f64::NAN; 3]));
    assert_eq!(m.counted().0, [34, -68, 0]);
    let (mut m, _) = on_the_way(timing(&StepperConfig::default()));
    let before = m.counted();
    m.core.order(StepperOrder::Rebase([0.0; 3]));
    assert_eq!(m.counted(), before);
}

#[test]
fn a_segment_too_late_to_begin_is_refused_and_the_epoch_tells() {
    let mut m = Machine::new(&StepperConfig::default(), CALM, 1);
    m.run_until(START_NS + 50_000_000);
    m.feed(0, START_NS + 10_000_000, &walk(3, 1)[..20]);
    m.run_until(START_NS + 60_000_000);
    let report = m.core.report(m.now_ns);
    assert_eq!(
        (report.mode, report.epoch, report.counted.0),
        (StepperMode::Resting, 1, [0; 3])
    );
    assert_eq!(report.refused, 20);
}

#[test]
fn failing_pins_are_left_alone_until_cleared() {
    let (mut m, _) = on_the_way(timing(&StepperConfig::default()));
    m.core.pins_failed();
    for _ in 0..100 {
        let t = m.now_ns;
        assert!(
            matches!(m.core.poll(t, &mut || m.queue.pop_front()), PulseAction::WaitUntil(u) if u > t),
            "failing pins are not accessed again"
        );
        m.now_ns += 100_000;
    }
    assert_eq!(m.mode(), StepperMode::Faulted(StepperFault::Pins));
    m.core.order(StepperOrder::Clear);
    assert!(
        matches!(
            m.core.poll(m.now_ns, &mut || m.queue.pop_front()),
            PulseAction::Write(_)
        ),
        "the levels are written again"
    );
}

// ---------------------------------------------------------------- the real thread

/// Configuration of the real thread with bounds that a busy test machine meets.
fn patient() -> StepperConfig {
    StepperConfig {
        late_max_us: 100_000.0,
        lead_ms: 60.0,
        priority: 0,
        ..StepperConfig::default()
    }
}

fn mock(emergency_stop: Option<InputPin>) -> RecordingPins {
    let map = LineMap::new(
        &PinsConfig {
            emergency_stop,
            ..PinsConfig::default()
        },
        16,
    )
    .unwrap();
    RecordingPins::new(map, 100_000)
}

/// Feeds a stepper until the motion rests at its target or the thread reports something else.
fn drive(stepper: &mut Stepper, motion: &mut Motion, target: [f64; 3]) -> Result<(), DriveState> {
    for _ in 0..4000 {
        let now = retroflex::hardware::rt::monotonic_ns();
        match stepper.sync(now) {
            Ok(None) => {}
            Ok(Some(rest_mm)) => motion.reset(rest_mm),
            Err(DriveState::Busy) => {
                std::thread::sleep(std::time::Duration::from_millis(1));
                continue;
            }
            Err(end) => return Err(end),
        }
        if stepper.feeder().lead_ns(now) > 100_000_000 {
            std::thread::sleep(std::time::Duration::from_millis(2));
            continue;
        }
        let segment = motion.tick(target, 2e-3);
        assert!(stepper.feeder().push(&segment, now));
        let there = stepper
            .latest()
            .is_some_and(|r| r.counted.0 == target.map(|p| (p / STEP_MM).round() as i32));
        if there && segment.is_still() {
            break;
        }
    }
    Ok(())
}

#[test]
fn the_thread_pulses_what_the_loop_feeds() {
    let c = patient();
    let pins = mock(None);
    let mut stepper = Stepper::start(
        pins.clone(),
        &c,
        &MotionLimits::default(),
        STEP_MM,
        EmergencyStop::Release,
    )
    .unwrap();
    let mut motion = Motion::new(&limits());
    for target in [[3.0, -2.0, 1.0], [-1.0, 0.5, 2.0]] {
        assert_eq!(drive(&mut stepper, &mut motion, target), Ok(()));
    }
    let summary = stepper.finish().unwrap();
    let record = pins.record();
    assert_eq!(
        summary.report.counted.0,
        [-1.0, 0.5, 2.0_f64].map(|p| (p / STEP_MM).round() as i32)
    );
    assert_eq!(
        (summary.report.mode, record.dropped, record.levels.enable),
        (StepperMode::Resting, 0, false)
    );
    check_record(&record.edges, &timing(&c)).unwrap();
    assert_eq!(
        summary.report.lateness.count(),
        record
            .edges
            .iter()
            .filter(|e| e.high && matches!(e.line, LineName::Step(_)))
            .count() as u64
    );
}

/// Drivers that an earlier program left energised stay energised when their lines are taken over.
#[test]
fn drivers_found_energised_stay_so_until_they_are_told() {
    let c = StepperConfig {
        idle_release_s: Some(3600.0),
        ..patient()
    };
    let pins = mock(None).energised();
    let mut stepper = Stepper::start(
        pins.clone(),
        &c,
        &MotionLimits::default(),
        STEP_MM,
        EmergencyStop::Release,
    )
    .unwrap();
    assert!(stepper.is_energised(), "before the first report");
    let mut motion = Motion::new(&limits());
    std::thread::sleep(std::time::Duration::from_millis(30));
    assert_eq!(drive(&mut stepper, &mut motion, [0.3, 0.0, 0.0]), Ok(()));
    assert!(stepper.is_energised());
    stepper.finish().unwrap();
    let record = pins.record();
    let enable: Vec<bool> = record
        .edges
        .iter()
        .filter(|e| e.line == LineName::Enable)
        .map(|e| e.high)
        .collect();
    assert_eq!(
        enable,
        [false],
        "only the end of the thread releases the drivers"
    );
    assert!(record.edges.len() > 10);
}

#[test]
fn the_thread_stops_for_the_emergency_stop_and_reports_it() {
    let pins = mock(Some(InputPin {
        pin: 26,
        active_low: false,
        pull: Pull::Down,
    }));
    let button = pins.inputs();
    let mut stepper = Stepper::start(
        pins.clone(),
        &patient(),
        &MotionLimits::default(),
        STEP_MM,
        EmergencyStop::Release,
    )
    .unwrap();
    let mut motion = Motion::new(&limits());
    std::thread::spawn(move || {
        std::thread::sleep(std::time::Duration::from_millis(150));
        button.store(1, std::sync::atomic::Ordering::Relaxed);
    });
    assert_eq!(
        drive(&mut stepper, &mut motion, [20.0; 3]),
        Err(DriveState::Faulted(StepperFault::EmergencyStop))
    );
    let summary = stepper.finish().unwrap();
    assert!(!pins.record().levels.enable && summary.report.inputs.emergency_stop);
}

/// Pins whose inputs cannot be read for as long as the flag is set: the call does not return.
struct Hanging(RecordingPins, Arc<AtomicBool>);

impl Pins for Hanging {
    fn write(&mut self, levels: &Levels) -> Result<(), PinError> {
        self.0.write(levels)
    }
    fn read(&mut self) -> Result<Inputs, PinError> {
        while self.1.load(Relaxed) {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        self.0.read()
    }
}

/// The thread that polls the emergency stop is watched itself: when a pin hangs, the loop learns it from the age of the
/// last report.
#[test]
fn a_thread_that_hangs_in_a_pin_is_silent_until_it_goes_on() {
    let hangs = Arc::new(AtomicBool::new(false));
    let button = Some(InputPin {
        pin: 26,
        active_low: false,
        pull: Pull::Down,
    });
    let pins = Hanging(mock(button), hangs.clone());
    let mut stepper = Stepper::start(
        pins,
        &patient(),
        &MotionLimits::default(),
        STEP_MM,
        EmergencyStop::Release,
    )
    .unwrap();
    let mut becomes = |silent: bool| {
        let begun = std::time::Instant::now();
        while (stepper.sync(retroflex::hardware::rt::monotonic_ns()) == Err(DriveState::Silent))
            != silent
        {
            assert!(begun.elapsed().as_secs() < 30, "silent: {}", !silent);
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
    };
    becomes(false);
    hangs.store(true, Relaxed);
    becomes(true);
    hangs.store(false, Relaxed);
    becomes(false);
    assert!(stepper.finish().is_some());
}

#[test]
fn the_thread_survives_failing_pins_and_reports_the_reason() {
    let pins = mock(None).failing_after(40);
    let mut stepper = Stepper::start(
        pins,
        &patient(),
        &MotionLimits::default(),
        STEP_MM,
        EmergencyStop::Release,
    )
    .unwrap();
    let mut motion = Motion::new(&limits());
    assert_eq!(
        drive(&mut stepper, &mut motion, [20.0; 3]),
        Err(DriveState::Faulted(StepperFault::Pins))
    );
    assert!(stepper.pin_error().unwrap().contains("set to fail"));
}

#[test]
fn a_rate_the_chip_is_not_allowed_is_refused_at_the_start() {
    let fast = MotionLimits {
        speed_max_mm_s: 300.0,
        ..MotionLimits::default()
    };
    let error = Stepper::start(
        mock(None),
        &patient(),
        &fast,
        STEP_MM,
        EmergencyStop::Release,
    )
    .unwrap_err();
    assert!(
        error.to_string().contains("stepper.step_interval_min_us"),
        "{error}"
    );
}
