//! The tables of the plant's parameters: rows as in [`primitives::parameters`](crate::primitives::parameters), whose keys name
//! the unit, and the size of an effect.

use crate::primitives::{Allowed, Checker, Invalid, Parameters};
use nalgebra::Vector3;
use thiserror::Error;

/// Why a plant cannot be built.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PlantError {
    /// A parameter is outside the range that the physics supports; its key counts from `[plant]`.
    #[error("plant.{} = {}; {}", .0.shown_key(), .0.problem, .0.hint)]
    Range(#[from] Invalid),
    /// An effect that the plant does not have.
    #[error("no effect is called `{name}`; the plant has {known}")]
    UnknownEffect {
        /// The name given.
        name: String,
        /// All names that exist.
        known: String,
    },
}

/// Refuses a direction without a length.
pub(crate) fn directed(key: &str, direction: [f64; 3]) -> Result<(), Invalid> {
    let mut checker = Checker::default();
    let length = Vector3::from(direction).norm();
    let checked = checker.at(key).range(length, 1e-3..=1e4, "");
    checked.hint("a direction has a length");
    checker.done()
}

/// Type of a parameter that states the size of an effect.
pub(crate) trait Size {
    /// Its numbers.
    fn numbers(&mut self) -> &mut [f64];
}

impl Size for f64 {
    fn numbers(&mut self) -> &mut [f64] {
        std::slice::from_mut(self)
    }
}

impl Size for [f64; 3] {
    fn numbers(&mut self) -> &mut [f64] {
        self
    }
}

/// A table of parameters.
pub(crate) trait Table: Parameters + Clone {
    /// Path below `[plant]`.
    const PATH: &'static str;
    /// The parameters that state the size of an effect, by key.
    fn sizes(&mut self) -> Vec<(&'static str, &mut [f64])>;

    /// True if a parameter that states the size of an effect differs from 0.
    fn is_active(&self) -> bool {
        self.clone()
            .sizes()
            .iter()
            .any(|(_, numbers)| numbers.iter().any(|x| *x != 0.0))
    }
    /// Refuses the first parameter that is outside its range.
    ///
    /// # Errors
    /// [`Invalid`], whose key counts from `[plant]`.
    fn check(&self) -> Result<(), Invalid> {
        self.checked(Self::PATH)
    }
    /// Multiplies the parameters that state the size of an effect, within their ranges.
    fn scale(&mut self, factor: f64) {
        for (key, numbers) in self.sizes() {
            if let Some(Allowed::Range(low, high)) = Self::TABLE.row(key).map(|row| row.allowed) {
                numbers
                    .iter_mut()
                    .for_each(|x| *x = (*x * factor).clamp(low, high));
            }
        }
    }
}

/// Defines a table: the structure that TOML files fill, with its [`Parameters`] and its [`Table`].
///
/// `NAME at "path" [sized by PARAMETER, …] { name: type = default, "", range, "advice"; … }`
macro_rules! parameters {
    (
        $(#[doc = $about:literal])+
        $table:ident at $path:literal $(sized by $($size:ident),+)? { $($rows:tt)* }
    ) => {
        $crate::parameters! {
            $(#[doc = $about])+
            pub struct $table { $($rows)* }
        }

        impl $crate::simulation::plant::parameters::Table for $table {
            const PATH: &'static str = $path;
            fn sizes(&mut self) -> Vec<(&'static str, &mut [f64])> {
                vec![$($((stringify!($size), $crate::simulation::plant::parameters::Size::numbers(&mut self.$size))),+)?]
            }
        }
    };
}
pub(crate) use parameters;

/// Defines an effect: its table as in `parameters!`, the imperfection that real units have of it, how each parameter is
/// drawn, and what its law remembers. Locals and parameters are drawn from top to bottom; a parameter without `draw` keeps its
/// default. An effect without a law below the parameters is its own law; the law of others starts with
/// its fields as given, of which each may refer to those above it.
///
/// ```text
/// NAME at "path" sized by PARAMETER, …; [background SIZE;] [background by UP_TO { name: EXPRESSION, … };]
/// [directed by PARAMETER;] drawn by RNG, SEVERITY {
///     [let LOCAL = EXPRESSION;] …
///     name: type = default, range, "advice" [, draw EXPRESSION];
///     …
/// }
/// [LAW runs CONFIG [, UNIT] {
///     field: type = EXPRESSION;
///     …
/// }]
/// ```
macro_rules! effect {
    (
        $(#[doc = $about:literal])+
        $effect:ident at $path:literal sized by $($size:ident),+;
        $(background $background:literal;)?
        $(background by $up_to:ident { $($imperfect:ident: $imperfection:expr),+ };)?
        $(directed by $direction:ident;)?
        drawn by $rng:ident, $severity:ident {
            $(let $local:ident = $first:expr;)*
            $(
                $(#[doc = $paragraph:literal])+
                $name:ident: $kind:ty = $default:expr, $low:literal ..= $high:literal, $advice:literal $(, draw $draw:expr)?;
            )+
        }
        $($law:tt)*
    ) => {
        parameters! {
            $(#[doc = $about])+
            $effect at $path sized by $($size),+ { $(
                $(#[doc = $paragraph])+
                $name: $kind = $default, "", $low ..= $high, $advice;
            )+ }
        }

        impl PlantEffect for $effect {
            $(const BACKGROUND: f64 = $background;)?
            $(fn background($up_to: &mut dyn FnMut(f64) -> f64) -> Option<Self> {
                Some(Self { $($imperfect: $imperfection,)+ ..Self::default() })
            })?
            $(fn consistent(&self) -> Result<(), Invalid> {
                directed(concat!($path, ".", stringify!($direction), " length"), self.$direction)
            })?
            #[allow(clippy::needless_update)] // some effects draw every parameter
            fn draw($severity: f64, $rng: &mut PlantRng) -> Self {
                $(let $local = $first;)*
                Self { $($($name: $draw,)?)+ ..Self::default() }
            }
            fn law(&self, _unit: &UnitData) -> Box<dyn Law> {
                effect!(@start self, _unit, $($law)*)
            }
        }
        effect!(@law $effect $($law)*);
    };
    (@start $effect:ident, $unit:ident,) => { Box::new($effect.clone()) };
    // a law that names the unit is given it
    (@start $effect:ident, $unit:ident, $(#[doc = $about:literal])+ $law:ident runs $config:ident $(, $of:ident)? { $($memory:tt)* }) => {
        Box::new($law::new($effect.clone() $(, { let $of = $unit; $of })?))
    };
    (@law $effect:ident) => {};
    (
        @law $effect:ident $(#[doc = $about:literal])+ $law:ident runs $config:ident $(, $unit:ident)? {
            $($(#[doc = $note:literal])* $field:ident: $kind:ty = $start:expr;)+
        }
    ) => {
        $(#[doc = $about])+
        #[derive(Debug, Clone)]
        pub(crate) struct $law {
            #[allow(dead_code)] // some laws need their parameters at the start only
            pub(crate) $config: $effect,
            $($(#[doc = $note])* $field: $kind,)+
        }

        impl $law {
            pub(crate) fn new($config: $effect $(, $unit: &UnitData)?) -> Self {
                $(#[allow(unused_mut)] let mut $field: $kind = $start;)+
                Self { $config, $($field,)+ }
            }
        }
    };
}
pub(crate) use effect;
