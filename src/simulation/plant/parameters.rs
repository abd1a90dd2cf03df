//! The tables of the plant's parameters: each parameter is written once, with its default, its range and its advice.

use crate::simulation::plant::check::{PlantError, range};
use std::ops::RangeInclusive;

/// Type of a parameter.
pub(crate) trait Value {
    /// Refuses a value outside `allowed`. Elements of an array are counted from 1, as channels are.
    ///
    /// # Errors
    /// [`PlantError::Range`] with `advice`.
    fn check(&self, name: &str, allowed: &RangeInclusive<f64>, advice: &'static str) -> Result<(), PlantError>;
    /// Replaces every number of the value; integers and switches are left alone.
    fn replace(&mut self, _with: &dyn Fn(f64) -> f64) {}
    /// True if every number of the value is 0.
    fn is_zero(&self) -> bool {
        false
    }
}

impl Value for f64 {
    fn check(&self, name: &str, allowed: &RangeInclusive<f64>, advice: &'static str) -> Result<(), PlantError> {
        range(name, *self, allowed, advice)
    }
    fn replace(&mut self, with: &dyn Fn(f64) -> f64) {
        *self = with(*self);
    }
    fn is_zero(&self) -> bool {
        *self == 0.0
    }
}

impl Value for [f64; 3] {
    fn check(&self, name: &str, allowed: &RangeInclusive<f64>, advice: &'static str) -> Result<(), PlantError> {
        (1..).zip(self).try_for_each(|(i, value)| range(&format!("{name}[{i}]"), *value, allowed, advice))
    }
    fn replace(&mut self, with: &dyn Fn(f64) -> f64) {
        *self = self.map(with);
    }
    fn is_zero(&self) -> bool {
        self.iter().all(|x| *x == 0.0)
    }
}

impl Value for u32 {
    fn check(&self, name: &str, allowed: &RangeInclusive<f64>, advice: &'static str) -> Result<(), PlantError> {
        range(name, f64::from(*self), allowed, advice)
    }
}

impl Value for usize {
    fn check(&self, name: &str, allowed: &RangeInclusive<f64>, advice: &'static str) -> Result<(), PlantError> {
        range(name, *self as f64, allowed, advice)
    }
}

impl Value for bool {
    fn check(&self, _: &str, _: &RangeInclusive<f64>, _: &'static str) -> Result<(), PlantError> {
        Ok(())
    }
}

/// A table of parameters.
pub(crate) trait Table {
    /// Refuses the first parameter that is outside its range.
    ///
    /// # Errors
    /// [`PlantError::Range`].
    fn check(&self) -> Result<(), PlantError>;
    /// True if a parameter that states the size of an effect differs from 0.
    fn is_active(&self) -> bool;
    /// Multiplies the parameters that state the size of an effect, within their ranges.
    fn scale(&mut self, factor: f64);
}

/// Range of a channel number.
pub(crate) const CHANNELS: RangeInclusive<f64> = 1.0..=3.0;

/// Defines a table: the structure that TOML files fill, its defaults and its [`Table`].
///
/// `NAME at "path" [sized by PARAMETER, …] { name: type = default, range, "advice"; … }`
macro_rules! parameters {
    (
        $(#[$meta:meta])*
        $table:ident at $path:literal $(sized by $($size:ident),+)? {
            $( $(#[$doc:meta])* $name:ident: $kind:ty = $default:expr, $range:expr, $advice:literal; )*
        }
    ) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct $table {
            $( $(#[$doc])* pub $name: $kind, )*
        }

        impl Default for $table {
            fn default() -> Self {
                Self { $( $name: $default, )* }
            }
        }

        impl $crate::simulation::plant::parameters::Table for $table {
            fn check(&self) -> Result<(), $crate::simulation::plant::check::PlantError> {
                use $crate::simulation::plant::parameters::Value;
                $( self.$name.check(concat!($path, ".", stringify!($name)), &$range, $advice)?; )*
                Ok(())
            }
            fn is_active(&self) -> bool {
                [$( $( $crate::simulation::plant::parameters::Value::is_zero(&self.$size) ),+ )?].contains(&false)
            }
            fn scale(&mut self, _factor: f64) {
                use $crate::simulation::plant::parameters::Value;
                $( $( self.$size.replace(&|x| x * _factor); )+ )?
                $( self.$name.replace(&|x| x.clamp(*$range.start(), *$range.end())); )*
            }
        }
    };
}
pub(crate) use parameters;
