//! How much units differ: one standard deviation of everything that is not alike.

use crate::simulation::plant::check::{PlantError, range};
use serde::{Deserialize, Serialize};

/// `[spread]`
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Spread {
    /// Of each k_ε, as a share. Default 0; 0.06 is a batch of moulded bellows. Bigger needs its own
    /// calibration sooner.
    pub k_epsilon: f64,
    /// Of each k_λ, as a share. Default 0; 0.1 is printed gears.
    pub k_lambda: f64,
    /// Of each bellow's distance from the centre line, as a share. Default 0; 0.01 is a glued tip.
    pub r: f64,
    /// Of each bellow's angle, degrees. Default 0; 1 is a glued tip.
    pub angle_deg: f64,
    /// Of the lag, as a share. Default 0; 0.2 is likely.
    pub lag: f64,
    /// Of each effect's size, standard deviation of its logarithm. Default 0; 0.2 is a batch.
    pub effects: f64,
    /// Of the base's pitch and roll, degrees. Default 0; 5 is held by hand.
    pub tilt_deg: f64,
    /// Of the base's heading, degrees, evenly spread over ± this. Default 0; 180 is anyhow.
    pub heading_deg: f64,
    /// Of the magnetic field's strength, as a share. Default 0; 0.1 is indoors.
    pub field: f64,
    /// Of the field's dip, degrees. Default 0; 4 is indoors.
    pub dip_deg: f64,
    /// Of each axis' constant gyroscope bias, °/s. Default 0; 0.5 is a chip out of the bag.
    pub gyro_bias_deg_s: f64,
    /// Of each axis' constant accelerometer bias, mg. Default 0; 5 is a chip after a six-face
    /// calibration, 20 one out of the bag.
    pub acc_bias_mg: f64,
    /// Of each axis' constant magnetometer bias, µT. Default 0; 0.5 is a chip after calibration.
    pub mag_bias_ut: f64,
}

impl Spread {
    pub(crate) fn validate(&self) -> Result<(), PlantError> {
        let shares = [
            ("k_epsilon", self.k_epsilon),
            ("k_lambda", self.k_lambda),
            ("r", self.r),
            ("lag", self.lag),
            ("effects", self.effects),
            ("field", self.field),
        ];
        for (name, share) in shares {
            range(&format!("spread.{name}"), share, 0.0..=0.4, "a standard deviation as a share; 0.2 is a lot")?;
        }
        range("spread.angle_deg", self.angle_deg, 0.0..=6.0, "1 is a glued tip")?;
        range("spread.tilt_deg", self.tilt_deg, 0.0..=45.0, "5 is held by hand")?;
        range("spread.heading_deg", self.heading_deg, 0.0..=180.0, "180 is anyhow")?;
        range("spread.dip_deg", self.dip_deg, 0.0..=20.0, "4 is indoors")?;
        range("spread.gyro_bias_deg_s", self.gyro_bias_deg_s, 0.0..=5.0, "0.5 is a chip out of the bag")?;
        range("spread.acc_bias_mg", self.acc_bias_mg, 0.0..=50.0, "5 is a calibrated chip")?;
        range("spread.mag_bias_ut", self.mag_bias_ut, 0.0..=50.0, "0.5 is a calibrated chip")
    }
}
