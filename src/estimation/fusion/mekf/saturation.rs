//! Gyroscope readings at the end of the range, recognised without knowing the range.
//!
//! A reading that is the largest so far and then repeats itself exactly is at the end of the range, since noise moves every other
//! reading. A larger one shows that it was not.

use nalgebra::Vector3;

/// Number of equal readings that mean saturation. Of a smooth peak, quantised to a few times its noise, two are often equal.
const REPEATS: u32 = 3;

/// Smallest range of a part, rad/s (57 °/s).
const RANGE_MIN_RAD_S: f64 = 1.0;

/// Largest magnitude of any axis, and how often each axis has repeated it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Saturation {
    largest_rad_s: f64,
    repeats: [u32; 3],
    /// The largest magnitude is the end of the range.
    confirmed: bool,
}

impl Saturation {
    /// Adds a reading; the rate at which an axis saturates, if one does, rad/s.
    pub fn update(&mut self, gyro_rad_s: &Vector3<f64>) -> Option<f64> {
        let largest = gyro_rad_s.amax();
        if largest > self.largest_rad_s {
            *self = Self {
                largest_rad_s: largest,
                ..Self::default()
            };
        }
        for (repeats, rate) in self.repeats.iter_mut().zip(gyro_rad_s.iter()) {
            let at_end = rate.abs() >= self.largest_rad_s.max(RANGE_MIN_RAD_S);
            *repeats = if at_end { *repeats + 1 } else { 0 };
            self.confirmed |= *repeats >= REPEATS;
        }
        let at_end = self.confirmed && self.repeats != [0; 3];
        at_end.then_some(self.largest_rad_s)
    }
}
