//! Board files: what the machine is.

use crate::config::ServiceSection;
use crate::config::power::PowerSection;
use crate::config::sections::{DriveSection, GeometrySection, MachineSection};
use crate::config::service::SafetySection;
use crate::control::ActuatorLimits;
use crate::hardware::machine::{GaugeConfig, ImuSection, MachineConfig};
use crate::hardware::pins::PinsConfig;
use crate::hardware::pressure::PressureSection;
use crate::hardware::{DriveLimits, EmergencyStop, MotionLimits, StepperConfig};
use crate::parameters;
use crate::simulation::plant::PlantConfig;
use crate::supervisor::commission::homing::HomingConfig;
use crate::supervisor::{MachineInfo, SafeState};

parameters! {
    /// A board: what the machine is. Every key may be left out; its default then applies. A board without `[pins]` has no
    /// hardware, one without `[plant]` has no built-in plant.
    pub struct Board {
        /// Board that this file builds on: the name of a board that comes with the program, or a file beside this one. The file
        /// then states only what differs.
        base: Option<String> = None;
        /// The computer and the loop that runs on it.
        machine: MachineSection;
        /// The bending section.
        geometry: GeometrySection;
        /// Motor, rack and pinion.
        drive: DriveSection;
        /// Speed of the pistons.
        motion: MotionLimits;
        /// Travel and pressure of the pistons.
        limits: ActuatorLimits;
        /// Power loss: the effect of trapped pressure on a motor without current.
        power: PowerSection;
        /// How zero is found.
        homing: HomingConfig;
        /// Pulses and the thread that makes them.
        stepper: StepperConfig;
        /// The wiring, on boards that have any.
        pins: Option<PinsConfig> = None;
        /// The tip's IMU, on boards that have one.
        imu: Option<ImuSection> = None;
        /// An IMU on the base, with the keys of `[imu]`. Left out, the base is assumed to stand still. On the same bus it needs
        /// the other address.
        base_imu: Option<ImuSection> = None;
        /// Pressure sensors of the lines, on boards that have any.
        pressure: Option<PressureSection> = None;
        /// The gate between controller and step generator.
        safety: SafetySection;
        /// The service.
        service: ServiceSection;
        /// The built-in plant, on boards that have one.
        plant: Option<PlantSection> = None;
    }
}

/// `[plant]`: the built-in plant.
pub type PlantSection = PlantConfig;

impl Board {
    /// Motion of one piston within this board's limits.
    pub fn motion_limits(&self) -> MotionLimits {
        MotionLimits {
            travel_max_mm: self.limits.travel_mm,
            ..self.motion
        }
    }

    /// How the drive moves the pistons.
    pub fn drive_limits(&self) -> DriveLimits {
        DriveLimits {
            limits: self.motion_limits(),
            lead_s: self.stepper.lead_ms * 1e-3,
        }
    }

    /// The static limits of this board.
    pub fn limits(&self) -> ActuatorLimits {
        ActuatorLimits {
            bellow_min_mm: self.geometry.bellow_min_mm,
            bellow_max_mm: self.geometry.bellow_max_mm,
            ..self.limits
        }
    }

    /// What hardware is made from; `None` on a board without `[pins]`.
    pub fn hardware(&self) -> Option<MachineConfig> {
        // whatever is not an immediate release brakes first; the gate then decides between hold and relax
        let emergency_stop = match self.safety.on.emergency_stop {
            SafeState::Release => EmergencyStop::Release,
            SafeState::Hold | SafeState::Relax => EmergencyStop::Hold,
        };
        Some(MachineConfig {
            info: MachineInfo {
                name: self.machine.name.clone(),
                period_s: self.machine.period_s,
                step_mm: self.drive.law().step_mm,
                rest_length_mm: self.geometry.rest_length_mm,
            },
            microsteps: self.drive.microsteps,
            pins: self.pins.clone()?,
            stepper: self.stepper,
            emergency_stop,
            motion: self.drive_limits(),
            imu: self.imu.clone(),
            base_imu: self.base_imu.clone(),
            imu_priority: self.machine.imu_priority,
            gauges: GaugeConfig {
                pressure: self.pressure.clone(),
                pressure_max_kpa: self.safety.pressure_max_kpa,
                temp_offset_c: self.imu.as_ref().map_or(0.0, |imu| imu.temp_offset_c),
                tip_warm_c: self.safety.tip_warm_c,
                tip_max_c: self.safety.tip_max_c,
            },
        })
    }
}
