//! The tables of the plant's parameters: rows as in [`primitives::parameters`](crate::primitives::parameters), whose keys name
//! the unit, and the size of an effect.

use crate::primitives::{Allowed, Parameters};
use crate::simulation::plant::check::PlantError;

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
    /// [`PlantError::Range`].
    fn check(&self) -> Result<(), PlantError> {
        Ok(self.checked(Self::PATH)?)
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
