//! The tables of a board file that describe the machine.

use crate::control::{Drive, Geometry};
use crate::{choices, parameters};

choices! {
    /// Which lines a header has.
    pub enum Header {
        /// Any chip with any lines.
        Any = "any",
        /// The 40-pin header of a Raspberry Pi: GPIO 2 to 27; 0 and 1 belong to the identification EEPROM.
        RaspberryPi = "raspberry_pi",
    }
}

parameters! {
    /// The computer and the loop on it.
    pub struct MachineSection {
        /// Name, for reports and the status.
        name: String = "unnamed".to_owned();
        /// Which lines there are. `raspberry_pi`: the 40-pin header with GPIO 2 to 27, in Broadcom numbers; `any`: whatever the
        /// chip has. A line that does not exist is refused when the file is read.
        header: Header = Header::Any;
        /// Period of the loop on hardware. A larger value spares the processor and delays everything.
        period_s: f64 = 0.002, "s", 0.0005..=0.02, "0.002 is a loop at 500 Hz";
        /// SCHED_FIFO priority of the thread that reads the IMU; 0 requests none. A larger value displaces more of the system.
        imu_priority: i32 = 75, "", 0..=98, "below the step thread; 0 requests no real-time scheduling";
    }
}

parameters! {
    /// The bending section.
    pub struct GeometrySection: Copy {
        /// Side of the triangle whose corners are the bellows. A larger value needs more bellow stroke per degree of bend.
        triangle_side_mm: f64 = 7.0, "mm", 2.0..=30.0, "measure between two bellow axes";
        /// Bellow length at atmospheric pressure. A larger value moves the tip further at the same bend. A plant that reports
        /// its own length replaces this one.
        rest_length_mm: f64 = 20.0, "mm", 5.0..=100.0, "measure a bellow at atmospheric pressure";
        /// Shortest bellow. A larger value forbids tighter bends.
        bellow_min_mm: f64 = 14.0, "mm", 1.0..=100.0, "shorter than rest_length_mm";
        /// Longest bellow. A smaller value forbids tighter bends.
        bellow_max_mm: f64 = 29.0, "mm", 5.0..=200.0, "longer than rest_length_mm";
    }
}

impl GeometrySection {
    /// The kinematic law of this section.
    pub fn law(&self) -> Geometry {
        Geometry {
            r_mm: self.triangle_side_mm / 3f64.sqrt(),
            rest_length_mm: self.rest_length_mm,
        }
    }
}

parameters! {
    /// Motor, rack and pinion.
    pub struct DriveSection: Copy {
        /// Pitch diameter of the pinion. A larger value moves the piston further per step and gives the pressure a longer lever
        /// on the motor.
        pinion_pitch_diameter_mm: f64 = 30.0, "mm", 2.0..=100.0, "module times number of teeth";
        /// Full steps of the motor per turn. A larger value moves the piston less per step.
        full_steps: u32 = 200, "", 20..=800, "200 for a 1.8° motor";
        /// Microsteps per full step: up to 16 on the A4988. Where the `ms` lines are wired they are set to it, otherwise the
        /// driver must be strapped to it. A larger value resolves finer and needs a faster step clock.
        microsteps: u32 = 16, "", [1, 2, 4, 8, 16, 32], "as the driver is strapped";
    }
}

impl DriveSection {
    /// The drive law of this section.
    pub fn law(&self) -> Drive {
        let diameter_mm = self.pinion_pitch_diameter_mm;
        Drive::rack_and_pinion(diameter_mm, self.full_steps, self.microsteps)
    }
}
