//! Map files: the meaning of the columns of a bench log of another rig.
//!
//! `docs/other-rigs.md` documents every key; unknown keys are errors.

use crate::primitives::{check::Checker, parameters::Check};
use serde::{Deserialize, Serialize};

/// Nominal model of a rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Nominal {
    /// `y = a + Σ b_i u_i`.
    #[default]
    Line,
    /// `y = a`: no input.
    Still,
    /// A linear second-order oscillator driven by the input.
    Resonance,
}

/// One column or several.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "expected the name of a column, or a list of names"
)]
pub enum Columns {
    /// One.
    One(String),
    /// Several.
    Many(Vec<String>),
}

impl Columns {
    /// Names of the columns, trimmed as those of a header are.
    pub fn names(&self) -> Vec<&str> {
        match self {
            Self::One(name) => vec![name.trim()],
            Self::Many(names) => names.iter().map(|name| name.trim()).collect(),
        }
    }
}

/// A map file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapFile {
    /// Column that drives the rig, or columns, whose best linear combination does; none for `still`.
    pub input: Option<Columns>,
    /// Output column; of several columns the norm is used.
    pub output: Columns,
    /// Column whose speed friction depends on; default the first input.
    pub motion: Option<String>,
    /// Column of time, s.
    pub time: Option<String>,
    /// Rows per second, without a column of time.
    pub rate_hz: Option<f64>,
    /// Unit of the input, for display.
    #[serde(default)]
    pub input_unit: String,
    /// Unit of the output, for display.
    #[serde(default)]
    pub output_unit: String,
    /// Nominal model: `line` (default), `still` or `resonance`.
    #[serde(default)]
    pub nominal: Nominal,
    /// Use every n-th row. Default 1; larger is faster and resolves less.
    #[serde(default = "one")]
    pub every: usize,
}

impl MapFile {
    /// Names of the inputs.
    pub fn inputs(&self) -> Vec<&str> {
        self.input.as_ref().map_or(vec![], Columns::names)
    }

    /// Name of the column of motion, trimmed as those of a header are.
    pub fn motion(&self) -> Option<&str> {
        self.motion.as_deref().map(str::trim)
    }

    /// Name of the column of time, trimmed likewise.
    pub fn time(&self) -> Option<&str> {
        self.time.as_deref().map(str::trim)
    }

    /// Every column that is named, under its key.
    pub fn columns(&self) -> Vec<(&'static str, &str)> {
        let all = [
            ("input", self.inputs()),
            ("output", self.output.names()),
            ("motion", self.motion().into_iter().collect()),
            ("time", self.time().into_iter().collect()),
        ];
        let each = all.into_iter();
        each.flat_map(|(key, names)| names.into_iter().map(move |name| (key, name)))
            .collect()
    }

    /// Whether times are in seconds, and not in rows.
    pub fn is_clocked(&self) -> bool {
        self.time.is_some() || self.rate_hz.is_some()
    }

    /// Checks the map, whose keys have this prefix.
    pub fn check_within(&self, to: &mut Checker, prefix: &str) {
        let at = |key: &str| format!("{prefix}{key}");
        to.at(&at("every"))
            .range(self.every as f64, 1.0..=10_000.0, "")
            .hint("1 uses every row");
        if let Some(rate) = self.rate_hz {
            to.at(&at("rate_hz"))
                .range(rate, 1e-6..=1e7, "Hz")
                .hint("rows per second");
            to.at(&at("rate_hz"))
                .holds(self.time.is_none(), "is given together with `time`")
                .hint("a log has one clock: remove one of the two");
        }
        to.at(&at("output"))
            .holds(!self.output.names().is_empty(), "names no column")
            .hint("name the output column");
        let columns = self.columns();
        let signals = columns.iter().enumerate();
        for (n, (key, name)) in signals.filter(|(_, c)| matches!(c.0, "input" | "output")) {
            let is_first = columns[..n].iter().all(|(_, other)| other != name);
            to.at(&at(key))
                .holds(is_first, &format!("column `{name}` is named twice"))
                .hint("a column is one input or belongs to the output: name it once");
        }
        let (inputs, driven) = (self.inputs().len(), !self.inputs().is_empty());
        match self.nominal {
            Nominal::Still => to
                .at(&at("input"))
                .holds(!driven, "is given although nominal = \"still\" has none")
                .hint("remove the input, or set nominal = \"line\""),
            Nominal::Line => to
                .at(&at("input"))
                .holds(driven, "names no column")
                .hint("name the input, or set nominal = \"still\""),
            Nominal::Resonance => {
                to.at(&at("nominal"))
                    .holds(inputs == 1, "an oscillator has one input")
                    .hint("name one column");
                to.at(&at("nominal"))
                    .holds(self.is_clocked(), "an oscillator needs a clock")
                    .hint("give `time` or `rate_hz`");
            }
        }
    }
}

fn one() -> usize {
    1
}

impl Check for MapFile {
    const REMEDY: &'static str = "docs/maps holds a map for each rig of docs/other-rigs.md";

    fn check(&self, to: &mut Checker) {
        self.check_within(to, "");
    }
}
