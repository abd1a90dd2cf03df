//! Why a recording is refused, and what to do about it.

use nalgebra::Vector3;

/// Why a recording is not sufficient.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// Not enough data.
    #[error("{have} samples are too few, at least {want} are required: record for longer")]
    TooFewSamples {
        /// Usable samples.
        have: usize,
        /// Needed.
        want: usize,
    },
    /// A NaN or infinity among the data.
    #[error("sample {index} is not a finite number: correct the log")]
    NotFinite {
        /// Its position.
        index: usize,
    },
    /// Motion during a rest.
    #[error(
        "not still: {what} is {have:.4} {unit}, the limit is {limit:.4}: secure the tip and repeat"
    )]
    Moving {
        /// The quantity that shows the motion.
        what: &'static str,
        /// Measured.
        have: f64,
        /// Allowed.
        limit: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// The motion covers too little.
    #[error("the motion covers {have:.2} of {what}, {want:.2} is required: {advice}")]
    PoorCoverage {
        /// What must be covered.
        what: &'static str,
        /// Covered share, 0 to 1.
        have: f64,
        /// Needed share.
        want: f64,
        /// How to move.
        advice: &'static str,
    },
    /// A face of the six-position method was never up.
    #[error("no rest with the sensor's {face} axis up: place it on that face for two seconds")]
    MissingFace {
        /// Axis and sign.
        face: &'static str,
    },
    /// The data do not lie on an ellipsoid.
    #[error("the readings do not lie on an ellipsoid: keep away from magnets and repeat")]
    NotAnEllipsoid,
    /// The ellipsoid is too flat: the sensor was hardly turned about one axis.
    #[error(
        "the axes of the ellipsoid have a ratio of {ratio:.1}, the limit is {limit:.1}: turn about all three axes"
    )]
    Flat {
        /// Longest to shortest axis.
        ratio: f64,
        /// Allowed.
        limit: f64,
    },
    /// The result would be too uncertain.
    #[error(
        "the standard deviation of {what} is {sigma:.4} {unit}, the limit is {limit:.4}: cover more directions"
    )]
    TooUncertain {
        /// The quantity.
        what: &'static str,
        /// One sigma.
        sigma: f64,
        /// Allowed.
        limit: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// The residual of the fit is too large.
    #[error(
        "the residual of the fit is {rms:.4} {unit} rms, the limit is {limit:.4}: remove other disturbances of the sensor"
    )]
    PoorFit {
        /// Residual.
        rms: f64,
        /// Allowed.
        limit: f64,
        /// Unit of both.
        unit: &'static str,
    },
}

impl Refusal {
    /// Refuses a NaN or an infinity.
    pub(super) fn unless_finite<'a>(
        mut data: impl Iterator<Item = &'a Vector3<f64>>,
    ) -> Result<(), Self> {
        let broken = data.position(|v| !v.iter().all(|x| x.is_finite()));
        broken.map_or(Ok(()), |index| Err(Self::NotFinite { index }))
    }
    /// Refuses less than `want` samples.
    pub(super) fn unless_enough(have: usize, want: usize) -> Result<(), Self> {
        if have < want {
            Err(Self::TooFewSamples { have, want })
        } else {
            Ok(())
        }
    }
}
