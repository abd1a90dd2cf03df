//! A 9-axis MEMS chip: bias, noise, range and quantisation.
//!
//! White noise of density `d` sampled at `f` has the standard deviation `d √(f/2)`; a slow
//! Gauss-Markov wander per axis is added. Defaults are the ICM-20948's (DS-000189 rev 1.3, tables 1-3) at
//! ±500 °/s and ±4 g, with its AK09916 at 100 Hz.

use crate::primitives::{ImuSample, Seconds};
use crate::simulation::plant::imu::stimulus::{GRAVITY_M_S2, Stimulus};
use crate::simulation::plant::memory::Wander;
use crate::simulation::plant::parameters::parameters;
use crate::simulation::plant::rng::PlantRng;
use nalgebra::Vector3;

parameters! {
    /// `[imu]`: a 9-axis chip.
    ImuConfig at "imu" {
        /// Time between samples, s. Default 0.002 (500 Hz). A larger value is slower; samples come at the end of
        /// the plant's own steps, so a plant stepped more coarsely samples more coarsely.
        period_s: f64 = 0.002, "", 1e-4..=0.2, "0.002 is 500 Hz";
        /// Time between magnetometer readings, s. Default 0.01. A larger value corrects the heading less often.
        mag_period_s: f64 = 0.01, "", 1e-4..=2.0, "0.01 is 100 Hz";
        /// White noise of the gyroscope, °/s/√Hz. Default 0.015. A larger value is noisier.
        gyro_noise_deg_s_rthz: f64 = 0.015, "", 0.0..=10.0, "0.015 is the ICM-20948";
        /// White noise of the accelerometer, mg/√Hz. Default 0.23. A larger value is noisier.
        acc_noise_mg_rthz: f64 = 0.23, "", 0.0..=100.0, "0.23 is the ICM-20948";
        /// Noise of one magnetometer reading, µT. Default 0.3. A larger value is noisier.
        mag_noise_ut: f64 = 0.3, "", 0.0..=50.0, "0.3 is typical";
        /// Slow wander of the gyroscope's bias, °/s. Default 0.01. A larger value drifts more within a minute.
        gyro_wander_deg_s: f64 = 0.01, "", 0.0..=10.0, "0.01 is typical";
        /// Slow wander of the accelerometer's bias, mg. Default 0.15. A larger value drifts more within a minute.
        acc_wander_mg: f64 = 0.15, "", 0.0..=100.0, "0.15 is typical";
        /// Slow wander of the magnetometer, µT. Default 0.05. A larger value drifts more within a minute.
        mag_wander_ut: f64 = 0.05, "", 0.0..=50.0, "0.05 is typical";
        /// Correlation time of the wanders, s. Default 60. A larger value is slower.
        wander_s: f64 = 60.0, "", 0.01..=1e6, "60 is typical";
        /// Constant bias of the gyroscope, °/s. Default 0; the chip's is within ±5. A start at rest
        /// finds it.
        gyro_bias_deg_s: [f64; 3] = [0.0; 3], "", -50.0..=50.0, "±5 is the data sheet's";
        /// Constant bias of the accelerometer, mg. Default 0; the chip's is within ±50 as delivered.
        /// 17 mg tilt the vertical by 1°.
        acc_bias_mg: [f64; 3] = [0.0; 3], "", -500.0..=500.0, "±50 is the data sheet's";
        /// Constant bias of the magnetometer, µT. Default 0. A larger value turns the heading with attitude.
        mag_bias_ut: [f64; 3] = [0.0; 3], "", -2000.0..=2000.0, "tens of µT are typical";
        /// Least significant digit of the gyroscope, °/s. Default 0.015267 (±500 °/s in 16 bit). 0 does not quantise.
        gyro_digit_deg_s: f64 = 1.0 / 65.5, "", 0.0..=10.0, "0.015 is ±500 °/s in 16 bit";
        /// Least significant digit of the accelerometer, mg. Default 0.12207 (±4 g in 16 bit). 0 does not quantise.
        acc_digit_mg: f64 = 1000.0 / 8192.0, "", 0.0..=100.0, "0.122 is ±4 g in 16 bit";
        /// Least significant digit of the magnetometer, µT. Default 0.15. 0 does not quantise.
        mag_digit_ut: f64 = 0.15, "", 0.0..=50.0, "0.15 is the AK09916";
        /// Range of the gyroscope, ±°/s. Default 500. Smaller clips fast motion.
        gyro_range_deg_s: f64 = 500.0, "", 10.0..=1e5, "250, 500, 1000 or 2000";
        /// Range of the accelerometer, ±g. Default 4. Smaller clips knocks.
        acc_range_g: f64 = 4.0, "", 1.5..=1000.0, "2, 4, 8 or 16";
        /// Range of the magnetometer, ±µT. Default 4900. Smaller clips near magnets.
        mag_range_ut: f64 = 4900.0, "", 100.0..=1e6, "4900 is the AK09916";
        /// How the chip's axes are turned against the tip's by design, a rotation vector in degrees.
        /// Default 0. The controller is configured with it; an unknown tilt is `effects.mount_misalignment`.
        mount_deg: [f64; 3] = [0.0; 3], "", -180.0..=180.0, "a rotation vector is at most half a turn long";
    }
}

/// One quantity of the chip in SI units.
#[derive(Debug, Clone)]
struct Axes {
    bias: Vector3<f64>,
    sigma: f64,
    wander: Wander,
    digit: f64,
    range: f64,
}

impl Axes {
    fn read(&mut self, truth: &Vector3<f64>, dt_s: f64, rng: &mut PlantRng) -> Vector3<f64> {
        let mut x = truth + self.bias + self.wander.step(dt_s, rng);
        if self.sigma > 0.0 {
            x += rng.normals() * self.sigma;
        }
        let mut clipped = x.map(|x| x.clamp(-self.range, self.range));
        if self.digit > 0.0 {
            clipped = clipped.map(|x| (x / self.digit).round() * self.digit);
        }
        clipped
    }
}

/// The chip with its noise.
#[derive(Debug, Clone)]
pub(crate) struct Chip {
    pub(crate) period_s: f64,
    pub(crate) mag_period_s: f64,
    gyro: Axes,
    acc: Axes,
    mag: Axes,
    rng: PlantRng,
    mag_dt_s: f64,
}

impl Chip {
    pub(crate) fn new(config: &ImuConfig, mut rng: PlantRng) -> Self {
        let c = config;
        let (white, deg, mg) = (
            (0.5 / c.period_s).sqrt(),
            1f64.to_radians(),
            1e-3 * GRAVITY_M_S2,
        );
        // bias, then noise, wander, digit and range in `unit`, as a multiple of the SI unit
        let mut axes = |unit: f64, bias: [f64; 3], sizes: [f64; 4]| {
            let [sigma, wander, digit, range] = sizes.map(|size| size * unit);
            Axes {
                bias: Vector3::from(bias) * unit,
                sigma,
                wander: Wander::new(wander, c.wander_s, &mut rng),
                digit,
                range,
            }
        };
        let (noise, range) = (c.gyro_noise_deg_s_rthz * white, c.gyro_range_deg_s);
        let sizes = [noise, c.gyro_wander_deg_s, c.gyro_digit_deg_s, range];
        let gyro = axes(deg, c.gyro_bias_deg_s, sizes);
        let (noise, range) = (c.acc_noise_mg_rthz * white, c.acc_range_g * 1000.0);
        let sizes = [noise, c.acc_wander_mg, c.acc_digit_mg, range];
        let acc = axes(mg, c.acc_bias_mg, sizes);
        let (noise, range) = (c.mag_noise_ut, c.mag_range_ut);
        let sizes = [noise, c.mag_wander_ut, c.mag_digit_ut, range];
        let mag = axes(1.0, c.mag_bias_ut, sizes);
        Self {
            period_s: c.period_s,
            mag_period_s: c.mag_period_s,
            gyro,
            acc,
            mag,
            rng,
            mag_dt_s: 0.0,
        }
    }
    /// A sample of the stimulus; the caller sets its time.
    pub(crate) fn read(&mut self, stimulus: &Stimulus, dt_s: f64, with_mag: bool) -> ImuSample {
        self.mag_dt_s += dt_s;
        let gyro_rad_s = self.gyro.read(&stimulus.rate, dt_s, &mut self.rng);
        let acc_m_s2 = self.acc.read(&stimulus.force, dt_s, &mut self.rng);
        let mag_ut = with_mag.then(|| {
            let dt_s = std::mem::take(&mut self.mag_dt_s);
            self.mag.read(&stimulus.field, dt_s, &mut self.rng)
        });
        ImuSample {
            t: Seconds(0.0),
            gyro_rad_s,
            acc_m_s2,
            mag_ut,
        }
    }
    /// Full scale on every axis of rate and force, on the side of the present reading.
    pub(crate) fn pin_to_range(&self, sample: &mut ImuSample) {
        sample.gyro_rad_s = sample.gyro_rad_s.map(|x| self.gyro.range.copysign(x));
        sample.acc_m_s2 = sample.acc_m_s2.map(|x| self.acc.range.copysign(x));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::plant::rng::Stream;

    fn still() -> Stimulus {
        Stimulus {
            rate: Vector3::zeros(),
            force: Vector3::new(0.0, 0.0, GRAVITY_M_S2),
            field: Vector3::new(20.0, 0.0, -43.0),
        }
    }

    #[test]
    fn white_noise_has_the_stated_density() {
        let config = ImuConfig {
            gyro_wander_deg_s: 0.0,
            gyro_digit_deg_s: 0.0,
            ..ImuConfig::default()
        };
        let mut chip = Chip::new(&config, PlantRng::new(5, Stream::TipImu));
        let n = 20_000;
        let square: f64 = (0..n)
            .map(|_| chip.read(&still(), 0.002, false).gyro_rad_s.norm_squared() / 3.0)
            .sum();
        let density = (square / f64::from(n)).sqrt().to_degrees() / 250f64.sqrt();
        assert!((density / 0.015 - 1.0).abs() < 0.02, "{density}");
    }

    #[test]
    fn readings_have_bias_range_and_quantisation() {
        let config = ImuConfig {
            acc_bias_mg: [10.0, 0.0, 0.0],
            ..ImuConfig::default()
        };
        let mut chip = Chip::new(&config, PlantRng::new(5, Stream::TipImu));
        let n = 5000;
        let mean: Vector3<f64> = (0..n)
            .map(|_| chip.read(&still(), 0.002, false).acc_m_s2)
            .sum::<Vector3<f64>>()
            / f64::from(n);
        assert!(
            (mean - Vector3::new(0.0981, 0.0, GRAVITY_M_S2)).norm() < 0.01,
            "{mean}"
        );
        let s = chip.read(
            &Stimulus {
                rate: Vector3::new(99.0, 0.0, -99.0),
                ..still()
            },
            0.002,
            true,
        );
        assert!(
            (s.gyro_rad_s.x.to_degrees() - 500.0).abs() < 0.02
                && (s.gyro_rad_s.z.to_degrees() + 500.0).abs() < 0.02
        );
        let mag = s.mag_ut.unwrap();
        assert!(
            mag.iter()
                .all(|x| ((x / 0.15).round() - x / 0.15).abs() < 1e-6)
        );
    }
}
