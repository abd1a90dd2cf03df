//! `retroflex bench rt`: measures the lateness of the step thread on this machine, optionally under load.
//!
//! The real step thread ([`Stepper`]) with the real queue drives three channels at a steady rate, through
//! the mock or through real pins, while other threads may keep the processors busy. The bench measures
//! the lateness of every wake-up and of every step (from the due time to the end of the write), the
//! deviation of every interval between steps, and the time that the loop takes to plan and queue a tick.

use crate::hardware::pins::{PinError, Pins};
use crate::hardware::rt::{self, RtRequest, RtStatus, monotonic_ns};
use crate::hardware::stepper::{StartError, Stepper, Summary};
use crate::motion::{
    DriveState, EmergencyStop, Histogram, Inputs, Levels, Motion, MotionLimits, StepGenerator,
    StepperConfig, StepperMode,
};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

/// What to measure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RtBenchConfig {
    /// Steps per second on each channel.
    pub rate_hz: f64,
    /// Duration at that rate, s.
    pub duration_s: f64,
    /// Number of threads that load the processors meanwhile.
    pub load_threads: usize,
    /// Configuration of the step thread.
    pub stepper: StepperConfig,
}

/// The step thread of a bench that is given no board.
pub fn stepper() -> StepperConfig {
    StepperConfig {
        step_interval_min_us: 50.0,
        ..StepperConfig::default()
    }
}

/// The result of a bench.
#[derive(Debug)]
pub struct RtBench {
    /// What was measured.
    pub config: RtBenchConfig,
    /// What the kernel granted to the step thread.
    pub status: RtStatus,
    /// Time for which the pins were driven, ramps included, s.
    pub elapsed_s: f64,
    /// Results of the step thread.
    pub steps: Summary,
    /// Time to plan and queue one tick.
    pub tick: Histogram,
}

/// Pins that never energise the drivers, so that a bench pulses real lines and no motor turns.
#[derive(Debug)]
pub struct NoCurrent<P>(pub P);

impl<P: Pins> Pins for NoCurrent<P> {
    fn write(&mut self, levels: &Levels) -> Result<(), PinError> {
        self.0.write(&Levels {
            enable: false,
            ..*levels
        })
    }
    fn read(&mut self) -> Result<Inputs, PinError> {
        self.0.read()
    }
}

/// Length of a control tick, s.
const TICK_S: f64 = 2e-3;
/// Microstep of the bench, mm. Only the step rate matters, so the value is arbitrary.
const STEP_MM: f64 = 0.01;

/// Runs the bench on the given pins.
///
/// # Errors
/// [`StartError`]: a rate that the configuration forbids, or no thread.
pub fn run(config: &RtBenchConfig, pins: impl Pins + 'static) -> Result<RtBench, StartError> {
    let ended = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let _end = EndOfLoad(&ended);
        for _ in 0..config.load_threads {
            scope.spawn(|| load(&ended));
        }
        measure(config, pins)
    })
}

/// Ends the threads of the load, also after a panic.
struct EndOfLoad<'a>(&'a AtomicBool);

impl Drop for EndOfLoad<'_> {
    fn drop(&mut self) {
        self.0.store(true, Relaxed);
    }
}

/// The bench, under whatever load there is.
fn measure(config: &RtBenchConfig, pins: impl Pins + 'static) -> Result<RtBench, StartError> {
    let speed = config.rate_hz * STEP_MM;
    let limits = MotionLimits {
        speed_max_mm_s: speed,
        acceleration_max_mm_s2: speed * 10.0,
        jerk_max_mm_s3: speed * 200.0,
        travel_max_mm: (speed * (config.duration_s + 2.0)).min(1000.0),
        retarget_min_mm: 0.0,
    };
    let stop = EmergencyStop::Release;
    let mut stepper = Stepper::start(pins, &config.stepper, &limits, STEP_MM, stop)?;
    let status = stepper.status.clone();
    let start_ns = monotonic_ns();
    // The loop runs at a lower priority than the step thread, as in the service.
    let request = RtRequest {
        priority: (config.stepper.priority - 10).max(0),
        cpu: None,
    };
    let tick = std::thread::scope(|scope| {
        let control = scope.spawn(|| {
            let (_status, _guard) = rt::enter(&request);
            drive(config, &limits, &mut stepper)
        });
        control.join().map_err(|_| StartError::Died)
    })?;
    let elapsed_s = (monotonic_ns() - start_ns) as f64 * 1e-9;
    let steps = stepper.finish().ok_or(StartError::Died)?;
    Ok(RtBench {
        config: *config,
        status,
        elapsed_s,
        steps,
        tick,
    })
}

/// The loop's part: moves between the ends of travel, one tick at a time, at absolute times.
fn drive(
    config: &RtBenchConfig,
    limits: &MotionLimits,
    stepper: &mut impl StepGenerator,
) -> Histogram {
    let mut motion = Motion::new(limits);
    let mut times = Histogram::default();
    let tick_ns = (TICK_S * 1e9) as u64;
    let mut next_ns = monotonic_ns();
    let end_ns = next_ns + (config.duration_s * 1e9) as u64;
    let mut side = 1.0;
    while next_ns < end_ns {
        let now_ns = monotonic_ns();
        next_ns += tick_ns;
        match stepper.sync(now_ns) {
            Ok(Some(rest_mm)) => motion.reset(rest_mm),
            Ok(None) => {}
            Err(DriveState::Busy) => {
                rt::sleep_until_ns(next_ns);
                continue;
            }
            Err(_) => break,
        }
        let first = motion.state()[0];
        if first.is_rest() && first.position_mm.abs() > 0.5 * limits.travel_max_mm {
            side = -side;
        }
        let segment = motion.tick([side * limits.travel_max_mm; 3], TICK_S);
        // A refused segment appears as an underrun in the result.
        let _ = stepper.feeder().push(&segment, now_ns);
        times.record(monotonic_ns() - now_ns);
        rt::sleep_until_ns(next_ns);
    }
    times
}

/// Loads a processor until `ended`.
fn load(ended: &AtomicBool) {
    let mut block = vec![1.0_f64; 1 << 16];
    while !ended.load(Relaxed) {
        for x in &mut block {
            *x = (*x * 1.000_001).sin() + 1.0;
        }
        std::hint::black_box(&block);
    }
}

impl RtBench {
    /// Whether no step was late enough to be a fault and no underrun occurred.
    pub fn is_good(&self) -> bool {
        !matches!(self.steps.report.mode, StepperMode::Faulted(_))
            && self.steps.report.underruns == 0
    }
}
