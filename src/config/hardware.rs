//! `[machine]`, `[imu]`, `[base_imu]` and `[homing]` of a board file, and what must hold between them.
//!
//! Relations are judged here and not where a value is used: a board that contradicts itself is refused
//! as it is read, with the place in the file.

use crate::config::board::Board;
use crate::config::pins::check_pins;
use crate::hardware::imu::ChipConfig;
use crate::hardware::machine::{MachineConfig, SensorConfig};
use crate::motion::lines::EmergencyStop;
use crate::motion::stop::longest_stop_mm;
use crate::motion::{ConfigError, MotionLimits};
use crate::primitives::check::Checker;
use crate::supervisor::gate::SafeState;
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Which lines a header has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Header {
    /// Any chip with any lines.
    #[default]
    Any,
    /// The 40-pin header of a Raspberry Pi: GPIO 2 to 27, 0 and 1 belong to the identification EEPROM.
    RaspberryPi,
}

/// The computer and the loop on it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MachineSection {
    /// Name, for reports. Default "unnamed".
    pub name: String,
    /// Which lines there are: `any` (default) or `raspberry_pi`.
    pub header: Header,
    /// Time of one turn of the loop on hardware, s. Default 0.002. Larger spares the processor and
    /// delays everything.
    pub period_s: f64,
    /// SCHED_FIFO priority of the thread that reads the IMU. Default 75; 0 asks for none.
    pub imu_priority: i32,
}

impl Default for MachineSection {
    fn default() -> Self {
        Self { name: "unnamed".to_owned(), header: Header::Any, period_s: 0.002, imu_priority: 75 }
    }
}

/// How the bus is reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BusBackend {
    /// The kernel's bus file, through `linux-embedded-hal`.
    #[default]
    Linux,
    /// The same file, through `rppal`.
    Rppal,
}

/// An IMU and where it sits.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImuSection {
    /// Device file of the bus. Default `/dev/i2c-1`.
    pub bus: String,
    /// How it is reached: `linux` (default) or `rppal`.
    pub backend: BusBackend,
    /// Rotation from the sensor to the tip (or base) as a rotation vector, degrees. Default none: the
    /// sensor's z axis points out of the tip. A calibration refines it.
    pub mount_deg: [f64; 3],
    /// The part and its settings.
    pub chip: ChipConfig,
}

impl Default for ImuSection {
    fn default() -> Self {
        Self { bus: "/dev/i2c-1".to_owned(), backend: BusBackend::Linux, mount_deg: [0.0; 3], chip: ChipConfig::default() }
    }
}

impl ImuSection {
    /// The mount as a rotation.
    #[must_use]
    pub fn mount(&self) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(Vector3::from(self.mount_deg).map(f64::to_radians))
    }

    fn check(&self, table: &str, to: &mut Checker) {
        let key = |name: &str| format!("{table}.{name}");
        to.holds(&key("bus"), self.bus.starts_with('/'), &format!("`{}` is no device file", self.bus), "`ls /dev/i2c-*` lists the buses");
        to.ranges(&key("mount_deg"), &self.mount_deg, -360.0..=360.0, "deg", "a rotation vector: axis times angle");
        if let Err(e) = self.chip.check() {
            to.refuse(
                &key(&format!("chip.{}", e.field)),
                format!("{} does not exist on the {}", e.value, e.part),
                &format!("write {}", e.allowed),
            );
        }
    }
}

impl Board {
    /// What hardware is made from; `None` on a board without `[pins]`.
    #[must_use]
    pub fn hardware(&self) -> Option<MachineConfig> {
        let sensor = |s: &ImuSection| SensorConfig {
            bus: s.bus.clone(),
            rppal: s.backend == BusBackend::Rppal,
            mount: s.mount(),
            chip: s.chip.clone(),
            rate_hz: s.chip.rate_hz(),
            priority: self.machine.imu_priority,
        };
        Some(MachineConfig {
            name: self.machine.name.clone(),
            period_s: self.machine.period_s,
            rest_length_mm: self.geometry.rest_length_mm,
            step_mm: self.drive.law().step_mm,
            microsteps: self.drive.microsteps,
            pins: self.pins.clone()?,
            stepper: self.stepper,
            emergency_stop: match self.safety.on.emergency_stop {
                SafeState::Release => EmergencyStop::Release,
                SafeState::Hold | SafeState::Relax => EmergencyStop::Hold,
            },
            motion: self.motion_config(),
            imu: self.imu.as_ref().map(sensor),
            base_imu: self.base_imu.as_ref().map(sensor),
        })
    }
}

/// How zero is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HomingMethod {
    /// A person brings the pistons to rest and says so.
    #[default]
    Operator,
    /// Every channel has a home switch.
    Switches,
}

/// How zero is found.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HomingSection {
    /// `operator` (default): a person confirms the rest; `switches`: every channel has one.
    pub method: HomingMethod,
    /// Speed of the first approach, mm/s. Default 4. Larger is quicker and overruns the switch further.
    pub speed_mm_s: f64,
    /// How far to back off a closed switch before the slow second approach, mm. Default 2. Larger than
    /// the switch's own travel.
    pub back_off_mm: f64,
    /// Most that two approaches may differ, mm. Default 0.09, three microsteps. Larger accepts a worse
    /// switch.
    pub repeat_max_mm: f64,
    /// Piston position of each channel where its switch closes, mm. Default −30: the end of travel
    /// that shortens the bellow. The sign says which way to search.
    pub at_mm: [f64; 3],
}

impl Default for HomingSection {
    fn default() -> Self {
        Self { method: HomingMethod::Operator, speed_mm_s: 4.0, back_off_mm: 2.0, repeat_max_mm: 0.09, at_mm: [-30.0; 3] }
    }
}

/// Everything of a board that has to do with hardware, and the relations between its tables.
pub(super) fn check_hardware(board: &Board, to: &mut Checker) {
    let m = &board.machine;
    to.range("machine.period_s", m.period_s, 5e-4..=0.02, "s", "0.002 is a loop at 500 Hz");
    to.range("machine.imu_priority", f64::from(m.imu_priority), 0.0..=98.0, "", "0 asks for no real-time scheduling");
    let steps = board.stepper.priority;
    for (key, value) in [("service.priority", board.service.priority), ("machine.imu_priority", m.imu_priority)] {
        let problem = format!("{value} is not below stepper.priority = {steps}");
        to.holds(key, value == 0 || steps == 0 || value < steps, &problem, "the step thread comes first: give it the highest priority");
    }
    board.power.check(&board.limits, board.drive.pinion_pitch_diameter_mm, to);
    check_motion(board, to);
    check_homing(board, to);
    if let Some(pins) = &board.pins {
        check_pins(board, pins, to);
    }
    for (table, imu) in [("imu", &board.imu), ("base_imu", &board.base_imu)] {
        if let Some(imu) = imu {
            imu.check(table, to);
        }
    }
    if let (Some(tip), Some(base)) = (&board.imu, &board.base_imu) {
        let apart = tip.bus != base.bus || tip.chip.address() != base.chip.address();
        let problem = format!("{:#04x} on {} is the tip's IMU already", base.chip.address(), base.bus);
        to.holds("base_imu.chip.address", apart, &problem, "pull the address pin of one sensor the other way, or use another bus");
    }
}

/// Motion and pulses, each alone and together.
fn check_motion(board: &Board, to: &mut Checker) {
    let motion = board.motion_config();
    let verdict = board
        .stepper
        .validate()
        .and_then(|()| if board.pins.is_some() { board.stepper.validate_rate(&motion, board.drive.law().step_mm) } else { Ok(()) });
    if let Err(ConfigError { key, value, allowed, mend }) = verdict {
        to.refuse(key, format!("{value} must be {allowed}"), mend);
    }
    let Ok(limits) = MotionLimits::try_from(&motion) else { return };
    let stop_mm = longest_stop_mm(&limits);
    let problem = format!("a stop from full speed takes {stop_mm:.2} mm, more than the travel of {} mm", board.limits.travel_mm);
    let mend = "lower motion.speed_max_mm_s or raise motion.acceleration_max_mm_s2";
    to.holds("limits.travel_mm", stop_mm < board.limits.travel_mm, &problem, mend);
    let lead_s = board.stepper.lead_ms * 1e-3;
    let problem = format!("{} ms is less than one turn of the loop, {} ms", board.stepper.lead_ms, board.machine.period_s * 1e3);
    to.holds(
        "stepper.lead_ms",
        board.pins.is_none() || lead_s >= board.machine.period_s,
        &problem,
        "two turns of machine.period_s are a good lead",
    );
}

fn check_homing(board: &Board, to: &mut Checker) {
    let (h, travel) = (&board.homing, board.limits.travel_mm);
    to.range(
        "homing.speed_mm_s",
        h.speed_mm_s,
        0.1..=board.motion.speed_max_mm_s.min(10.0),
        "mm/s",
        "slow enough to stop within the switch's travel",
    );
    to.range("homing.back_off_mm", h.back_off_mm, 0.1..=travel, "mm", "more than the switch's own travel");
    to.range("homing.repeat_max_mm", h.repeat_max_mm, board.drive.law().step_mm..=1.0, "mm", "a few microsteps");
    to.ranges("homing.at_mm", &h.at_mm, -travel..=travel, "mm", "where the switch closes, within limits.travel_mm");
    if h.method == HomingMethod::Switches {
        let missing = board.pins.as_ref().and_then(|p| p.channels.iter().position(|c| c.home.is_none()));
        let problem = match (&board.pins, missing) {
            (None, _) => "switches are asked for, and the board has no [pins]".to_owned(),
            (_, Some(i)) => format!("switches are asked for, and channel {} has none", i + 1),
            _ => String::new(),
        };
        to.holds("homing.method", problem.is_empty(), &problem, "give every channel a `home` line, or write \"operator\"");
        to.holds(
            "homing.at_mm",
            h.at_mm.iter().all(|p| *p != 0.0),
            "a switch at rest has no side to search on",
            "write the position with its sign",
        );
    }
}
