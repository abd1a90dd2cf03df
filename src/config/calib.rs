//! Calibration files: what this tip is.

use crate::control::learning::batch::Prior;
use crate::control::{Dynamics, DynamicsPrior, Line};
use crate::estimation::imu_calibration::ImuCalibration;
use crate::parameters;
use crate::primitives::{Check, Checker, Parameters, Table, join};
use time::Date;
use time::format_description::well_known::Iso8601;
use toml::{Table as Values, Value};

parameters! {
    /// A calibration: what this tip is.
    pub struct Calibration {
        /// Model of the machine, saved by `retroflex gap diagnose --save`, through whose inverse the pistons are fed forward;
        /// a relative path starts at the folder of this file. Its gains take the place of those below. Empty: the nominal
        /// model.
        feedforward: String = String::new();
        /// Extension and backlash of the three lines.
        transmission: TransmissionSection;
        /// Lag and dead time.
        dynamics: DynamicsSection;
        /// Errors of the tip IMU, as `retroflex calibrate imu` writes them.
        imu: ImuCalibration;
    }
}

parameters! {
    /// Extension and backlash of the three lines. The defaults of the standard deviations are the spread between units.
    pub struct TransmissionSection {
        /// Extension gains k_ε of channels 1 to 3: piston travel lost in the air per bellow travel. A larger gain moves the
        /// piston further for the same bellow.
        k_epsilon: [f64; 3], "", 0.0..=10.0, "the paper found 2.2 to 2.5; `retroflex calibrate transmission` identifies it";
        /// Backlash half-widths k_λ of channels 1 to 3. A larger value makes a larger step at every reversal.
        k_lambda_mm: [f64; 3], "mm", 0.0..=3.0, "the paper found 0.8 to 0.9 mm; `retroflex calibrate transmission` identifies it";
        /// Standard deviation of each k_ε. A larger value gives the calibration less weight as a prior.
        k_epsilon_sigma: [f64; 3] = [0.25; 3], "", 0.0001..=5.0, "the spread between units is about 0.25";
        /// Standard deviation of each k_λ. A larger value gives the calibration less weight as a prior.
        k_lambda_sigma_mm: [f64; 3] = [0.08; 3], "mm", 0.0001..=2.0, "the spread between units is about 0.08 mm";
        /// Tip that was calibrated.
        tip: String = String::new();
        /// Day of the calibration, `YYYY-MM-DD`.
        date: String = String::new();
        /// Origin of the numbers: a log, a command, a publication.
        source: String = String::new();
    }
}

parameters! {
    /// Lag and dead time from piston to estimated bend.
    pub struct DynamicsSection: Copy {
        /// First-order lag τ. A larger value makes the feedforward lead further and raises the proportional gain.
        lag_s: f64 = 0.03, "s", 0.001..=2.0, "0.03 suits a bare tip on 1.2 m of line";
        /// Dead time T, of the line and of the sensor. A larger value slows the loop down.
        delay_s: f64 = 0.01, "s", 0.0..=0.6, "0.01 suits a local bus";
        /// Standard deviation of both. The loop starts slow enough for three of them and becomes quicker as the tip moves.
        /// A larger value starts slower and survives a slower line.
        uncertainty_s: f64 = 0.3, "s", 0.005..=1.0, "0.3 is an unknown line, 0.03 a calibrated one";
    }
}

impl DynamicsSection {
    /// For the control law.
    pub fn law(&self) -> DynamicsPrior {
        DynamicsPrior {
            expected: Dynamics {
                lag_s: self.lag_s,
                delay_s: self.delay_s,
            },
            uncertainty_s: self.uncertainty_s,
        }
    }
}

impl Calibration {
    /// The transmission law per channel.
    pub fn lines(&self) -> [Line; 3] {
        Line::each(self.transmission.k_epsilon, self.transmission.k_lambda_mm)
    }

    /// As the prior of a new tip's calibration.
    pub fn prior(&self) -> [Prior; 3] {
        let (t, lines) = (&self.transmission, self.lines());
        std::array::from_fn(|i| Prior {
            line: lines[i],
            k_epsilon_sigma: t.k_epsilon_sigma[i],
            k_lambda_sigma_mm: t.k_lambda_sigma_mm[i],
        })
    }
}

impl Check for Calibration {
    const TABLE: Option<&'static Table> = Some(<Self as Parameters>::TABLE);
    const REMEDY: &'static str =
        "`retroflex board show --calib` prints every key with its meaning, unit and range";

    fn check(&self, to: &mut Checker) {
        if let Ok(values) = Values::try_from(self) {
            dates("", &values, to);
        }
    }
}

/// Checks every date of a table, also those of the tables in it. An empty one is not known.
fn dates(at: &str, values: &Values, to: &mut Checker) {
    for (name, value) in values {
        let key = join(at, name);
        match value {
            Value::Table(inner) => dates(&key, inner, to),
            Value::String(text) if name == "date" => to
                .at(&key)
                .holds(text.is_empty() || is_day(text), "this is no day")
                .hint("write it as YYYY-MM-DD, such as 2026-03-31"),
            _ => {}
        }
    }
}

/// True for a day that is written `YYYY-MM-DD`.
pub fn is_day(text: &str) -> bool {
    Date::parse(text, &Iso8601::DATE).is_ok_and(|date| date.to_string() == text)
}
