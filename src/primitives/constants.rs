//! Gates that several rooms share, and tables of constants that nobody sets.

/// Standard deviations of a usual error: one normal error in 22 is beyond.
pub const LIKELY_SIGMAS: f64 = 2.0;
/// Standard deviations that an error rarely exceeds: one normal error in 370 is beyond.
pub const SURE_SIGMAS: f64 = 3.0;
/// Standard deviations beyond which the model of the noise does not explain an error: one normal error in 15 800 is beyond.
pub const UNEXPLAINED_SIGMAS: f64 = 4.0;
/// Standard deviations beyond which an error has another cause: one normal error in 1.7 million is beyond.
pub const FOREIGN_SIGMAS: f64 = 5.0;

/// Declares the constants of one mechanism as one table: a structure and its only value. The columns of a row are: what it means, its
/// unit and why it has this value; name; value.
///
/// ```
/// retroflex::constants! {
///     /// The vacuum pump.
///     const PUMP: PumpConstants;
///     /// Time to full speed, s: from its data sheet.
///     starts_s = 0.4;
///     /// Time after which it counts as stuck, s.
///     stuck_s = 5.0 * 0.4;
/// }
/// assert_eq!(PUMP.stuck_s / PUMP.starts_s, 5.0);
/// ```
#[macro_export]
macro_rules! constants {
    ($(#[doc = $about:literal])+ const $table:ident: $kind:ident; $($(#[doc = $why:literal])+ $row:ident = $value:expr;)+) => {
        $(#[doc = $about])+
        struct $kind { $($(#[doc = $why])+ $row: f64,)+ }
        $(#[doc = $about])+
        const $table: $kind = $kind { $($row: $value,)+ };
    };
}
