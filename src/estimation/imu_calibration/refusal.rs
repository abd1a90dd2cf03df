//! Why a recording is refused, with the motion that was missing.

/// Why a recording is not good enough, with what is missing.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// Not enough data.
    #[error("{have} samples are too few, {want} are needed: record longer")]
    TooFewSamples {
        /// Usable samples.
        have: usize,
        /// Needed.
        want: usize,
    },
    /// A NaN or infinity among the data.
    #[error("sample {index} is not a finite number: mend the log")]
    NotFinite {
        /// Its position.
        index: usize,
    },
    /// It moved where it should have been still.
    #[error("not still: {what} is {have:.4} {unit}, allowed is {limit:.4}: fix the tip and repeat")]
    Moving {
        /// What gave the motion away.
        what: &'static str,
        /// Measured.
        have: f64,
        /// Allowed.
        limit: f64,
        /// Unit of both.
        unit: &'static str,
    },
    /// The motion left too much of its space out.
    #[error("the motion covers {have:.2} of {what}, {want:.2} are needed: {advice}")]
    PoorCoverage {
        /// Space to be covered.
        what: &'static str,
        /// Covered share, 0 to 1.
        have: f64,
        /// Needed share.
        want: f64,
        /// How to move.
        advice: &'static str,
    },
    /// A face of the six-position method was never up.
    #[error("no rest with the sensor's {face} axis up: lay it on that face for two seconds")]
    MissingFace {
        /// Axis and sign.
        face: &'static str,
    },
    /// The data do not lie on an ellipsoid.
    #[error("the readings lie on no ellipsoid: keep away from magnets and repeat")]
    NotAnEllipsoid,
    /// The readings fill a pancake or a needle: one axis was hardly turned.
    #[error("the ellipsoid is {ratio:.1} times longer than wide, allowed is {limit:.1}: turn about all three axes")]
    Flat {
        /// Longest to shortest axis.
        ratio: f64,
        /// Allowed.
        limit: f64,
    },
    /// The result would be too uncertain.
    #[error("{what} would be uncertain by {sigma:.4} {unit}, allowed is {limit:.4}: cover more directions")]
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
    /// The model leaves too much unexplained.
    #[error("the fit leaves {rms:.4} {unit}, allowed is {limit:.4}: something else disturbed the sensor")]
    PoorFit {
        /// Residual.
        rms: f64,
        /// Allowed.
        limit: f64,
        /// Unit of both.
        unit: &'static str,
    },
}
