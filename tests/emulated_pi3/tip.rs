//! The tip on the host: pulses of the trace move the built-in plant in real time, and the plant's motion goes
//! down the serial line to the sensor in the guest.

use super::guest::Guest;
use super::trace::Lines;
use super::wire;
use crate::fake_imu::Motion;
use retroflex::config::board::Board;
use retroflex::hardware::rt::monotonic_ns;
use retroflex::model::bend::Bend;
use retroflex::primitives::units::Steps;
use retroflex::simulation::plant::{Plant, Truth};
use std::io::Write;
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// One step of the plant, ns.
const PLANT_NS: u64 = 1_000_000;
/// From one frame to the next, in steps of the plant.
const FRAME_EVERY: u64 = 20;

/// Steps that a piston which was caught makes up for in one step of the plant; no drive is as fast.
const FREED_STEPS: i32 = 2;
/// Without current the air pushes a piston back to here, steps: 5 kPa at 1.4 kPa/mm, see [power] of the board.
const DETENT_STEPS: i32 = 121;

/// What both threads and the test share.
#[derive(Debug)]
struct Shared {
    lines: Mutex<Lines>,
    truth: Mutex<Option<Truth>>,
    caught: AtomicBool,
    vented: AtomicBool,
    last_store_ns: AtomicU64,
}

fn held<T>(lock: &Mutex<T>) -> MutexGuard<'_, T> {
    lock.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The tip and what drives it.
pub struct TheTip {
    shared: Arc<Shared>,
}

impl TheTip {
    /// A plant with the pins of a board, on the lines of a guest that has just been started.
    pub fn start(
        guest: &Guest,
        board: &Board,
        make: &retroflex::simulation::plant::PlantConfig,
    ) -> Self {
        let lines = Lines::new(board.pins.as_ref().expect("a board with pins"));
        let mut make = make.clone();
        make.drive.step_mm = board.drive.law().step_mm;
        let plant = Plant::new(&make, 1).expect("the plant of the paper twin");
        let shared = Arc::new(Shared {
            lines: Mutex::new(lines),
            truth: Mutex::new(None),
            caught: AtomicBool::new(false),
            vented: AtomicBool::new(false),
            last_store_ns: AtomicU64::new(monotonic_ns()),
        });
        let trace = guest.trace();
        let to = guest.motion();
        let counting = shared.clone();
        std::thread::spawn(move || {
            for line in trace.filter(|l| l.contains("gpio")) {
                held(&counting.lines).take(&line);
                counting.last_store_ns.store(monotonic_ns(), Relaxed);
            }
        });
        let moving = shared.clone();
        std::thread::spawn(move || follow(plant, &moving, to));
        Self { shared }
    }

    /// The lines once nothing has been stored to them for a while.
    pub fn lines_at_rest(&self) -> Lines {
        loop {
            let quiet_ns = monotonic_ns().saturating_sub(self.shared.last_store_ns.load(Relaxed));
            if quiet_ns > 1_500_000_000 {
                return held(&self.shared.lines).clone();
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// The true bend.
    pub fn bend(&self) -> Bend {
        held(&self.shared.truth).map_or(Bend::STRAIGHT, |t| Bend::from_rotation(&t.r_base_tip))
    }

    /// A person lets the air out: pistons back at rest.
    pub fn vent(&self) {
        self.shared.vented.store(true, Relaxed);
    }

    /// The pistons are caught, and stay where they are whatever is pulsed; or no more.
    pub fn catch(&self, caught: bool) {
        self.shared.caught.store(caught, Relaxed);
    }
}

/// Where the pistons are: what was counted, unless they are caught, pushed back or vented.
#[derive(Debug, Default)]
struct Pistons {
    at: [i32; 3],
    counted: [i32; 3],
    owed: [i32; 3],
}

impl Pistons {
    fn step(&mut self, lines: &Lines, caught: bool) {
        for i in 0..3 {
            self.owed[i] += lines.counted[i] - self.counted[i];
            if !caught {
                let moved = self.owed[i].clamp(-FREED_STEPS, FREED_STEPS);
                self.owed[i] -= moved;
                self.at[i] += moved;
            }
            if !lines.energised() && self.at[i].abs() > DETENT_STEPS {
                self.at[i] -= self.at[i].signum();
            }
        }
        self.counted = lines.counted;
    }
}

/// Moves the plant and sends its motion until the guest is gone.
fn follow(mut plant: Plant, shared: &Shared, mut to: UnixStream) {
    let (mut reached_ns, mut steps, mut pistons) = (monotonic_ns(), 0_u64, Pistons::default());
    let mut motion = Motion::default();
    loop {
        let now_ns = monotonic_ns();
        while reached_ns + PLANT_NS <= now_ns {
            reached_ns += PLANT_NS;
            steps += 1;
            pistons.step(&held(&shared.lines), shared.caught.load(Relaxed));
            if shared.vented.swap(false, Relaxed) {
                pistons.at = [0; 3];
            }
            let out = plant.step(&Steps(pistons.at), PLANT_NS as f64 * 1e-9);
            *held(&shared.truth) = Some(out.truth);
            if let Some(s) = out.imu {
                (motion.acc_m_s2, motion.gyro_rad_s) = (s.acc_m_s2, s.gyro_rad_s);
                motion.mag_ut = s.mag_ut.unwrap_or(motion.mag_ut);
            }
            if steps.is_multiple_of(FRAME_EVERY)
                && reached_ns + FRAME_EVERY * PLANT_NS > now_ns
                && to.write_all(&wire::encode(&motion)).is_err()
            {
                return;
            }
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}
