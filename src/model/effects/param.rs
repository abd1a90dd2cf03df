//! Construction and display of the parameters of effects.
//!
//! Angles are radians inside the catalogue; [`Param::shown`] converts them to degrees.

use crate::model::effects::Param;

/// Number of parameters of a periodic mode.
pub const MODE_PARAMS: usize = 7;

impl Param {
    /// A parameter that belongs to no channel: `start` is the value at which the effect vanishes,
    /// `scale` the standard deviation of its prior, `range` the least and the largest physical value.
    pub const fn new(
        name: &'static str,
        unit: &'static str,
        start: f64,
        scale: f64,
        range: (f64, f64),
    ) -> Self {
        Self {
            name,
            unit,
            channel: 0,
            start,
            scale,
            low: range.0,
            high: range.1,
        }
    }
    /// The same for one channel, 1 to 3.
    #[must_use]
    pub const fn on(self, channel: u8) -> Self {
        Self { channel, ..self }
    }
    /// The same for each of the three channels.
    pub const fn each(self) -> [Self; 3] {
        [self.on(1), self.on(2), self.on(3)]
    }
    /// The same under each of `names`.
    pub const fn named<const N: usize>(self, names: [&'static str; N]) -> [Self; N] {
        let (mut out, mut k) = ([self; N], 0);
        while k < N {
            out[k].name = names[k];
            k += 1;
        }
        out
    }
    /// A value of this parameter as files and reports show it, with its unit: degrees for radians.
    pub fn shown(&self, value: f64) -> (f64, &'static str) {
        match self.unit {
            "rad" => (value.to_degrees(), "deg"),
            "rad/s" => (value.to_degrees(), "deg/s"),
            unit => (value, unit),
        }
    }
}

/// All parameters of `parts` in one array of `N`; a wrong `N` is a compile error where the result is a
/// constant.
pub const fn join<const N: usize>(parts: &[&[Param]]) -> [Param; N] {
    let mut out = [Param::new("", "", 0.0, 1.0, (0.0, 0.0)); N];
    let (mut part, mut at) = (0, 0);
    while part < parts.len() {
        let mut k = 0;
        while k < parts[part].len() {
            out[at] = parts[part][k];
            (k, at) = (k + 1, at + 1);
        }
        part += 1;
    }
    assert!(at == N, "N is not the number of parameters");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_shown_in_degrees() {
        let p = Param::new("bias", "rad/s", 0.0, 1.0, (0.0, 2.0));
        assert_eq!(p.shown(std::f64::consts::PI), (180.0, "deg/s"));
        assert_eq!(Param { unit: "mm", ..p }.shown(2.0), (2.0, "mm"));
    }
}
