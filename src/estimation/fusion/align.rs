//! Alignment: means of the sensors over a still stretch at the start.
//!
//! The still stretch *defines* zero bend and the base frame. Its mean specific force and mean field are therefore
//! gravity and magnetic field in base coordinates (including the biases, which the estimator has as states), and its
//! mean rate is the gyroscope bias. Motion restarts the window, and the reason is kept for the status.

use crate::parameters;
use crate::primitives::ImuSample;
use nalgebra::Vector3;

parameters! {
    /// Alignment at start: when the tip counts as still.
    pub struct AlignConfig: Copy {
        /// Length of the still interval that is averaged. A larger value gives a better gyroscope bias (its error falls with
        /// the square root) and a later start.
        window_s: f64 = 1.8, "s", 0.2..=60.0, "the tip stands still for at least 2 s at start";
        /// Largest deviation of one rate sample from the running mean. A larger value accepts a noisier part, and a tip that
        /// still sways.
        gyro_band_rad_s: f64 = 0.15, "rad/s", 0.001..=2.0, "0.15 is several times the noise of the parts used";
        /// Largest deviation of one specific-force sample from the running mean. A larger value accepts more vibration.
        acc_band_m_s2: f64 = 1.5, "m/s²", 0.01..=10.0, "1.5 tolerates a fan nearby";
        /// Largest mean rate that is taken for bias; the default is 8.6 °/s. A larger value would take a steady turn of the
        /// base for bias.
        gyro_bias_max_rad_s: f64 = 0.15, "rad/s", 0.001..=1.0, "0.15 is beyond the zero-rate level of the parts used";
    }
}

/// Samples from which on a mean is used.
const MEAN_SAMPLES: u32 = 10;
/// Rate samples from which on their mean is compared with the largest bias.
const BIAS_SAMPLES: u32 = 100;
/// Fewest rate samples of an alignment.
const SAMPLES_MIN: u32 = 20;

/// Result of a still stretch; vectors in the sensor frame, which is the base frame during alignment.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Alignment {
    /// Mean rate, rad/s.
    pub gyro_bias_rad_s: Vector3<f64>,
    /// Mean specific force, m/s².
    pub acc_rest_m_s2: Vector3<f64>,
    /// Mean field, µT; `None` without a magnetometer.
    pub mag_rest_ut: Option<Vector3<f64>>,
    /// Standard deviation of one rate sample, rad/s (root mean over the axes).
    pub gyro_sigma_rad_s: f64,
    /// Standard deviation of one specific-force sample, m/s².
    pub acc_sigma_m_s2: f64,
    /// Standard deviation of one field sample, µT.
    pub mag_sigma_ut: f64,
    /// Length of the stretch, s.
    pub duration_s: f64,
    /// Number of rate samples.
    pub samples: u32,
    /// Number of field samples.
    pub mag_samples: u32,
    /// Number of rate samples equal to the previous one: large for a source without noise.
    pub repeated: u32,
}

impl Alignment {
    /// Mean period of the samples, and of the field samples, s.
    pub fn periods_s(&self) -> (f64, f64) {
        let mean = |n: u32| self.duration_s / f64::from(n.max(2) - 1);
        (mean(self.samples), mean(self.mag_samples))
    }
    /// True if the source has noise, so that identical samples indicate a fault: fewer than one in fifty repeats.
    pub fn noisy(&self) -> bool {
        self.repeated * 50 < self.samples
    }
}

/// Why the window was restarted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NotStill {
    /// The rate left its band.
    #[error("the gyroscope measures rotation")]
    Turning,
    /// The specific force left its band.
    #[error("the accelerometer measures vibration")]
    Shaking,
    /// The mean rate is too large to be bias.
    #[error("the mean rate is too large for a gyroscope bias")]
    BiasTooLarge,
}

/// Running mean and spread of a vector (Welford 1962).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Spread {
    n: u32,
    mean: Vector3<f64>,
    sum_sq: f64,
}

impl Spread {
    fn add(&mut self, v: &Vector3<f64>) {
        self.n += 1;
        let before = v - self.mean;
        self.mean += before / f64::from(self.n);
        self.sum_sq += before.dot(&(v - self.mean));
    }
    fn sigma(&self) -> f64 {
        match self.n {
            0 | 1 => 0.0,
            n => (self.sum_sq / (3.0 * f64::from(n - 1))).sqrt(),
        }
    }
}

/// A still stretch in progress.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AlignState {
    start_s: Option<f64>,
    gyro: Spread,
    acc: Spread,
    mag: Spread,
    last_gyro: Vector3<f64>,
    repeated: u32,
    /// Why the last window was discarded, if one was.
    pub refused: Option<NotStill>,
}

impl AlignState {
    /// Adds a sample; returns the alignment once the window is complete.
    pub fn add(&mut self, config: &AlignConfig, sample: &ImuSample) -> Option<Alignment> {
        if !sample.is_finite() {
            return None;
        }
        if let Some(reason) = self.motion(config, sample) {
            *self = Self {
                refused: Some(reason),
                ..Self::default()
            };
        }
        let start_s = *self.start_s.get_or_insert(sample.t.0);
        self.repeated += u32::from(self.gyro.n > 0 && sample.gyro_rad_s == self.last_gyro);
        self.last_gyro = sample.gyro_rad_s;
        self.gyro.add(&sample.gyro_rad_s);
        self.acc.add(&sample.acc_m_s2);
        if let Some(m) = &sample.mag_ut {
            self.mag.add(m);
        }
        let duration_s = sample.t.0 - start_s;
        (duration_s >= config.window_s && self.gyro.n >= SAMPLES_MIN)
            .then(|| self.result(duration_s))
    }

    fn motion(&self, config: &AlignConfig, sample: &ImuSample) -> Option<NotStill> {
        // the mean of the first samples is not yet reliable
        if self.gyro.n < MEAN_SAMPLES {
            return None;
        }
        if (sample.gyro_rad_s - self.gyro.mean).amax() > config.gyro_band_rad_s {
            Some(NotStill::Turning)
        } else if (sample.acc_m_s2 - self.acc.mean).amax() > config.acc_band_m_s2 {
            Some(NotStill::Shaking)
        } else if self.gyro.mean.norm() > config.gyro_bias_max_rad_s && self.gyro.n > BIAS_SAMPLES {
            Some(NotStill::BiasTooLarge)
        } else {
            None
        }
    }

    fn result(&self, duration_s: f64) -> Alignment {
        Alignment {
            gyro_bias_rad_s: self.gyro.mean,
            acc_rest_m_s2: self.acc.mean,
            mag_rest_ut: (self.mag.n >= MEAN_SAMPLES).then_some(self.mag.mean),
            gyro_sigma_rad_s: self.gyro.sigma(),
            acc_sigma_m_s2: self.acc.sigma(),
            mag_sigma_ut: self.mag.sigma(),
            duration_s,
            samples: self.gyro.n,
            mag_samples: self.mag.n,
            repeated: self.repeated,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::units::Seconds;

    fn sample(i: usize, rate: f64) -> ImuSample {
        let wiggle = if i.is_multiple_of(2) { 0.003 } else { -0.003 };
        ImuSample {
            t: Seconds(i as f64 * 0.005),
            gyro_rad_s: Vector3::new(0.01 + wiggle, rate, -0.02),
            acc_m_s2: Vector3::new(0.0, 3.0, 9.3),
            mag_ut: i.is_multiple_of(4).then(|| Vector3::new(20.0, 0.0, -40.0)),
        }
    }

    #[test]
    fn a_still_window_gives_bias_gravity_and_field() {
        let (config, mut state) = (AlignConfig::default(), AlignState::default());
        let a = (0..1000)
            .find_map(|i| state.add(&config, &sample(i, 0.0)))
            .unwrap();
        assert!((a.gyro_bias_rad_s - Vector3::new(0.01, 0.0, -0.02)).norm() < 1e-4);
        assert!((a.acc_rest_m_s2.y - 3.0).abs() < 1e-12);
        assert_eq!(a.mag_rest_ut, Some(Vector3::new(20.0, 0.0, -40.0)));
        assert!(a.duration_s >= 1.8);
        assert!((a.gyro_sigma_rad_s - 0.003 / 3f64.sqrt()).abs() < 1e-4);
    }

    #[test]
    fn motion_restarts_the_window_and_is_reported() {
        let (config, mut state) = (AlignConfig::default(), AlignState::default());
        for i in 0..300 {
            assert!(state.add(&config, &sample(i, 0.0)).is_none());
        }
        assert!(state.add(&config, &sample(300, 0.5)).is_none());
        assert_eq!(state.refused, Some(NotStill::Turning));
        let a = (301..1000)
            .find_map(|i| state.add(&config, &sample(i, 0.0)))
            .unwrap();
        assert!(a.samples > 300);
    }

    #[test]
    fn a_steady_rotation_is_not_bias() {
        let (config, mut state) = (AlignConfig::default(), AlignState::default());
        for i in 0..3000 {
            assert!(state.add(&config, &sample(i, 0.3)).is_none());
        }
        assert_eq!(state.refused, Some(NotStill::BiasTooLarge));
    }
}
