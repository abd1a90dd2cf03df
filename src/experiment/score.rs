//! Errors of an orientation filter on recordings with an optical reference.
//!
//! The metric of BROAD (Laidig, Caruso, Cereatti & Seel, Data 6(7):72, 2021). The filter runs over the whole
//! recording from its first sample. With the error in world axes `e = q_estimated q_reference⁻¹`,
//!
//! ```text
//! total       2 acos |e_w|
//! heading     2 atan |e_z / e_w|
//! inclination 2 acos √(e_w² + e_z²)
//! ```
//!
//! the score is the root mean square of each over the samples that move and have a reference. No alignment is fitted.
//! The score of a set of recordings is the mean over the recordings.

use crate::estimation::fusion::mekf::saturation::Saturation;
use crate::estimation::fusion::{FilterName, OrientationFilter, Periods};
use crate::log::error::ReadError;
use crate::log::recording::{self, Recording};
use crate::primitives::{Rotation, Sensor, World};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The filter that is scored if none is named.
pub const DEFAULT_FILTER: FilterName = FilterName::Mekf;

/// Root mean square errors of one filter on one recording, degrees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Total error.
    pub total_deg: f64,
    /// Error about the vertical.
    pub heading_deg: f64,
    /// Error of the inclination.
    pub inclination_deg: f64,
}

/// One row of the JSON of `imu score`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FileScore {
    /// File name of the recording.
    pub file: String,
    /// The filter.
    pub filter: FilterName,
    /// RMS errors.
    #[serde(flatten)]
    pub score: Score,
    /// Share of the samples in which the gyroscope is at the end of its range.
    #[serde(skip)]
    pub saturated: f64,
}

/// Why a recording has no score.
#[derive(Debug, thiserror::Error)]
pub enum ScoreError {
    /// A recording cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A recording has no moving sample with a reference.
    #[error(
        "{file}: no row has both moving = 1 and a reference (ref_qw … ref_qz), so there is nothing to compare with"
    )]
    NoTruth {
        /// Name of the file.
        file: String,
    },
}

/// Total, heading and inclination error of an estimate, rad.
pub fn error_angles(
    estimate: &Rotation<World, Sensor>,
    truth: &Rotation<World, Sensor>,
) -> [f64; 3] {
    let e = (estimate.quat() * truth.quat().inverse()).into_inner();
    let total = 2.0 * e.w.abs().min(1.0).acos();
    let heading = 2.0 * e.k.abs().atan2(e.w.abs());
    let inclination = 2.0 * e.w.hypot(e.k).min(1.0).acos();
    [total, heading, inclination]
}

/// Sampling periods of a recording.
pub fn periods(recording: &Recording) -> Periods {
    Periods {
        imu_s: recording.period_s(),
        mag_s: recording.mag_period_s(),
    }
}

/// Runs a new filter over a recording and scores it.
///
/// # Errors
/// [`ScoreError::NoTruth`] if no row is both moving and referenced.
pub fn score(
    recording: &Recording,
    filter: &mut dyn OrientationFilter,
) -> Result<Score, ScoreError> {
    let period_s = recording.period_s();
    let (mut squares, mut count) = ([0.0; 3], 0usize);
    let mut before_s = None;
    for row in &recording.rows {
        let t_s = row.sample.t.0;
        let since_s = before_s.map_or(period_s, |before_s| t_s - before_s);
        filter.update(&row.sample, since_s);
        before_s = Some(t_s);
        let Some(truth) = row.reference.filter(|_| row.moving) else {
            continue;
        };
        let angles = error_angles(&filter.orientation(), &truth);
        for (sum, angle) in squares.iter_mut().zip(angles) {
            *sum += angle * angle;
        }
        count += 1;
    }
    if count == 0 {
        return Err(ScoreError::NoTruth {
            file: recording.name.clone(),
        });
    }
    let [total_deg, heading_deg, inclination_deg] =
        squares.map(|s| (s / count as f64).sqrt().to_degrees());
    Ok(Score {
        total_deg,
        heading_deg,
        inclination_deg,
    })
}

/// Scores files: with `all` every filter, else `filter`, else [`DEFAULT_FILTER`].
///
/// The rows are ordered by file as given, then by filter as in [`FilterName::ALL`].
///
/// # Errors
/// The first file, in the order given, that cannot be read or scored.
pub fn run(
    files: &[PathBuf],
    filter: Option<FilterName>,
    all: bool,
) -> Result<Vec<FileScore>, ScoreError> {
    let one = [filter.unwrap_or(DEFAULT_FILTER)];
    let filters: &[FilterName] = if all { &FilterName::ALL } else { &one };
    let mut scored = Vec::new();
    for file in files {
        let recording = recording::read(file)?;
        let (periods, mut range) = (periods(&recording), Saturation::default());
        let rates = recording.rows.iter().map(|row| row.sample.gyro_rad_s);
        let n = rates.filter(|rate| range.update(rate).is_some()).count();
        for &filter in filters {
            scored.push(FileScore {
                file: recording.name.clone(),
                filter,
                score: score(&recording, &mut *filter.build(periods))?,
                saturated: n as f64 / recording.rows.len().max(1) as f64,
            });
        }
    }
    Ok(scored)
}

/// Mean of one filter over the recordings; `None` if it has no row.
pub fn mean(rows: &[FileScore], filter: FilterName) -> Option<Score> {
    let of = || rows.iter().filter(|r| r.filter == filter);
    let count = of().count();
    let over = |value: fn(&Score) -> f64| of().map(|r| value(&r.score)).sum::<f64>() / count as f64;
    (count > 0).then(|| Score {
        total_deg: over(|s| s.total_deg),
        heading_deg: over(|s| s.heading_deg),
        inclination_deg: over(|s| s.inclination_deg),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::recording;
    use crate::primitives::sample::ImuSample;
    use crate::primitives::units::Seconds;
    use nalgebra::{UnitQuaternion, Vector3};

    fn rotation(roll_deg: f64, pitch_deg: f64, yaw_deg: f64) -> Rotation<World, Sensor> {
        let [r, p, y] = [roll_deg, pitch_deg, yaw_deg].map(f64::to_radians);
        Rotation::assert_frames(UnitQuaternion::from_euler_angles(r, p, y))
    }

    fn angles_deg(estimate: &Rotation<World, Sensor>, truth: &Rotation<World, Sensor>) -> [f64; 3] {
        error_angles(estimate, truth).map(f64::to_degrees)
    }

    #[test]
    fn a_rotation_about_the_vertical_is_heading_error_only() {
        for yaw in [-170.0, -30.0, 0.0, 1e-6, 45.0, 179.0] {
            let truth = rotation(20.0, -50.0, 130.0);
            let [total, heading, inclination] =
                angles_deg(&(rotation_world(0.0, yaw) * truth), &truth);
            assert!((total - f64::abs(yaw)).abs() < 1e-5, "{yaw}: {total}");
            assert!((heading - f64::abs(yaw)).abs() < 1e-5, "{yaw}: {heading}");
            assert!(inclination < 1e-5, "{yaw}: {inclination}");
        }
    }

    #[test]
    fn a_tilt_is_inclination_error_only() {
        let truth = rotation(20.0, -50.0, 130.0);
        let [total, heading, inclination] =
            angles_deg(&(rotation_world(25.0, 0.0) * truth), &truth);
        assert!((total - 25.0).abs() < 1e-9 && heading < 1e-9 && (inclination - 25.0).abs() < 1e-9);
        let [total, heading, inclination] =
            angles_deg(&(rotation_world(25.0, 60.0) * truth), &truth);
        let both = 2.0
            * (12.5_f64.to_radians().cos() * 30.0_f64.to_radians().cos())
                .acos()
                .to_degrees();
        assert!(
            (total - both).abs() < 1e-9
                && (heading - 60.0).abs() < 1e-9
                && (inclination - 25.0).abs() < 1e-9
        );
    }

    #[test]
    fn the_sign_of_a_quaternion_is_irrelevant_and_half_a_turn_is_finite() {
        let truth = rotation(10.0, 20.0, 30.0);
        let flipped =
            Rotation::assert_frames(UnitQuaternion::new_unchecked(-truth.quat().into_inner()));
        assert!(angles_deg(&flipped, &truth).iter().all(|a| *a < 1e-5));
        let [total, heading, _] = angles_deg(&(rotation_world(0.0, 180.0) * truth), &truth);
        assert!((total - 180.0).abs() < 1e-5 && (heading - 180.0).abs() < 1e-5);
    }

    /// A rotation about the world's x by `tilt_deg`, then about its z by `yaw_deg`.
    fn rotation_world(tilt_deg: f64, yaw_deg: f64) -> Rotation<World, World> {
        let tilt = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), tilt_deg.to_radians());
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_deg.to_radians());
        Rotation::assert_frames(yaw * tilt)
    }

    /// A still, level sensor facing north whose reference deviates by `yaw_deg` in heading.
    fn still_recording(
        yaw_deg: f64,
        moving: impl Fn(usize) -> bool,
        referenced: impl Fn(usize) -> bool,
    ) -> Recording {
        let reference = rotation(0.0, 0.0, yaw_deg);
        let row = |k: usize| recording::RecordingRow {
            sample: ImuSample {
                t: Seconds(k as f64 * 0.01),
                gyro_rad_s: Vector3::zeros(),
                acc_m_s2: Vector3::new(0.0, 0.0, 9.81),
                mag_ut: Some(Vector3::new(16.0, 0.0, -41.0)),
            },
            reference: referenced(k).then_some(reference),
            moving: moving(k),
        };
        Recording {
            name: "still.csv".into(),
            rows: (0..2000).map(row).collect(),
        }
    }

    #[test]
    fn every_filter_reports_a_constant_reference_error() {
        for filter in FilterName::ALL {
            let recording = still_recording(7.0, |k| k > 500, |k| k % 3 == 0);
            let s = score(&recording, &mut *filter.build(periods(&recording))).unwrap();
            assert!(
                (s.total_deg - 7.0).abs() < 0.01 && (s.heading_deg - 7.0).abs() < 0.01,
                "{filter}: {s:?}"
            );
            assert!(s.inclination_deg < 0.01, "{filter}: {s:?}");
        }
    }

    #[test]
    fn a_recording_without_truth_is_refused() {
        for (moving, referenced) in [(false, true), (true, false)] {
            let recording = still_recording(0.0, |_| moving, |_| referenced);
            let mut filter = FilterName::Vqf.build(periods(&recording));
            let error = score(&recording, &mut *filter).unwrap_err();
            assert!(error.to_string().contains("still.csv"), "{error}");
        }
        assert!(run(&[], None, true).unwrap().is_empty());
    }

    #[test]
    fn rows_match_the_json_contract_and_have_means() {
        let score = |total_deg| Score {
            total_deg,
            heading_deg: 1.0,
            inclination_deg: 0.5,
        };
        let row = |file: &str, filter, total_deg| FileScore {
            file: file.into(),
            filter,
            score: score(total_deg),
            saturated: 0.0,
        };
        let rows = [
            row("a", FilterName::VqfLong, 1.0),
            row("b", FilterName::VqfLong, 4.0),
        ];
        assert_eq!(
            serde_json::to_string(&rows[0]).unwrap(),
            r#"{"file":"a","filter":"vqf-long","total_deg":1.0,"heading_deg":1.0,"inclination_deg":0.5}"#
        );
        assert_eq!(mean(&rows, FilterName::VqfLong).unwrap().total_deg, 2.5);
        assert_eq!(mean(&rows, FilterName::Mekf), None);
    }
}
