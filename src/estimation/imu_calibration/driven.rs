//! What samples beside driven pistons hold for the calibration: readings beside motors that step, and bends.

use crate::estimation::fusion::tip::{FuseConfig, Fusion, FusionInput, STILL_AFTER_S};
use crate::estimation::imu_calibration::{motor, mount, still};
use crate::model::Drive;
use crate::primitives::{ImuReading, ImuSample, Steps};
use nalgebra::Vector3;

/// Magnetometer readings in the base frame with the motors' step counts; `piston_mm` are the pistons at the samples. The tip
/// orientation is estimated without the magnetometer.
pub fn of_motors(
    samples: &[ImuSample],
    piston_mm: &[Vector3<f64>],
    idle_after_s: f64,
) -> Vec<motor::MotorSample> {
    let mut config = FuseConfig::default();
    config.bend.use_mag = false;
    let (drive, mut fusion) = (Drive::default(), Fusion::default());
    let (mut last, mut moved_s, mut out) = (Steps::default(), [f64::NEG_INFINITY; 3], Vec::new());
    for (k, sample) in samples.iter().enumerate() {
        let steps = drive.steps(&piston_mm[k]);
        for (moved, (now, before)) in moved_s.iter_mut().zip(steps.0.iter().zip(last.0)) {
            if *now != before {
                *moved = sample.t.0;
            }
        }
        last = steps;
        let still = moved_s.iter().all(|m| sample.t.0 - m > STILL_AFTER_S);
        let input = FusionInput {
            now: sample.t,
            tip: ImuReading::from_world(Some(*sample)),
            base: None,
            coils_ut: Vector3::zeros(),
            still,
        };
        fusion.update(&config, &input);
        if let (Some(estimate), Some(mag)) = (fusion.estimate(), sample.mag_ut) {
            let energised = moved_s.map(|m| sample.t.0 - m < idle_after_s);
            out.push(motor::MotorSample {
                mag_ut: estimate.r_base_tip.apply(&mag),
                counts: steps.0,
                energised,
            });
        }
    }
    out
}

/// Rotations between two held poses in the same bending plane; `command` are the commands at the samples, as a bend log has them.
pub fn bends(samples: &[ImuSample], command: &[Vector3<f64>]) -> Vec<mount::BendTurn> {
    let Some(bias) = still::rests(samples).first().map(|r| r.gyro_rad_s) else {
        return Vec::new();
    };
    let changes: Vec<usize> = (1..samples.len())
        .filter(|&k| command.get(k) != command.get(k - 1))
        .collect();
    let ends = changes.iter().skip(1).copied().chain([samples.len()]);
    let turn = |(&from, to): (&usize, usize)| {
        let (before, after) = (command[from - 1], command[from]);
        let direction_rad = plane(&before, &after)?.to_radians();
        let lost = samples[from..to].iter().any(|s| !s.is_finite());
        (!lost).then(|| mount::BendTurn {
            turn_rad: mount::turn_of(&samples[from..to], &bias),
            direction_rad: Some(direction_rad),
        })
    };
    changes.iter().zip(ends).filter_map(turn).collect()
}

/// Direction, degrees, in which the bend increases from one command to the next, if both lie in one plane.
fn plane(before: &Vector3<f64>, after: &Vector3<f64>) -> Option<f64> {
    let one_plane = before.x == 0.0 || after.x == 0.0 || (before.y - after.y).abs() < 1e-6;
    let grows = after.x > before.x;
    let direction = if grows { after.y } else { before.y + 180.0 };
    (one_plane && direction.is_finite() && after.x != before.x).then_some(direction)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_has_the_direction_of_growing_bend() {
        let v = |bend: f64, dir: f64| Vector3::new(bend, dir, 20.0);
        assert_eq!(plane(&v(0.0, 0.0), &v(30.0, 120.0)), Some(120.0));
        assert_eq!(plane(&v(30.0, 120.0), &v(0.0, 0.0)), Some(300.0));
        assert_eq!(plane(&v(60.0, 90.0), &v(30.0, 90.0)), Some(270.0));
        assert_eq!(plane(&v(60.0, 90.0), &v(30.0, 120.0)), None);
    }
}
