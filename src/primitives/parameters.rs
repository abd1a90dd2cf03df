//! The parameter table. A parameter is written once, as a row of [`parameters!`](crate::parameters), and everything
//! else follows from that row: the field with its serde form and rustdoc, the default, the range check, the
//! paragraph that `retroflex board show` prints, and the list of keys that messages may name.
//!
//! ```
//! retroflex::parameters! {
//!     /// `[pump]`: the vacuum pump.
//!     pub struct Pump: Copy {
//!         /// Time constant of the pump. A larger value reacts more slowly.
//!         tau_s: f64 = 0.1, "s", 0.01..=10.0, "0.1 is brisk, 0.5 is calm";
//!         /// Number of strokes per turn.
//!         strokes: u32 = 2, "", [1, 2, 4], "see the data sheet";
//!         /// Runs the pump at all.
//!         enabled: bool = true;
//!     }
//! }
//! assert_eq!(Pump::default().tau_s, 0.1);
//! ```
//!
//! The columns of a row are: paragraph, key, type, default, unit, allowed values, hint for the error message. A row
//! without a default is required in the file; a row without unit and range accepts every value of its type. A row
//! whose type is itself such a structure is a sub-table. `name as "key"` gives the field another name in the file.
//! Fields that no file holds follow in a block `set in code { … }`. After `by Key -> Value`, rows `name of Variant` are also found by the
//! variant of an enumeration `Key`.

use crate::primitives::check::{Checker, Invalid};
use toml::{Table as Values, Value};

/// A table of a TOML file: what it is for and its rows.
#[derive(Debug)]
pub struct Table {
    /// Lines of the description.
    pub about: &'static [&'static str],
    /// The parameters, in the order of the file.
    pub rows: &'static [Parameter],
}

/// One parameter.
#[derive(Debug)]
pub struct Parameter {
    /// Key in the file.
    pub key: &'static str,
    /// Lines of the paragraph: meaning, and the effect of a larger value.
    pub paragraph: &'static [&'static str],
    /// Unit; empty for a number without one.
    pub unit: &'static str,
    /// Accepted numbers.
    pub allowed: Allowed,
    /// How to choose an accepted value.
    pub hint: &'static str,
    /// The row has no default.
    pub required: bool,
    /// Form of the value.
    pub shape: Shape,
}

/// Numbers that a parameter accepts. NaN is never accepted where there is a limit.
#[derive(Debug, Clone, Copy)]
pub enum Allowed {
    /// Whatever the type holds.
    Any,
    /// Both ends included.
    Range(f64, f64),
    /// These values only.
    OneOf(&'static [f64]),
}

/// The accepted numbers in words, without the unit: `0.01 to 10`, `1, 2 or 4`.
impl std::fmt::Display for Allowed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Any => Ok(()),
            Self::Range(low, high) => write!(f, "{low} to {high}"),
            Self::OneOf(list) => {
                let words: Vec<String> = list.iter().map(f64::to_string).collect();
                match words.split_last() {
                    Some((last, rest)) if !rest.is_empty() => {
                        write!(f, "{} or {last}", rest.join(", "))
                    }
                    _ => f.write_str(&words.concat()),
                }
            }
        }
    }
}

/// Form of a value in a file.
#[derive(Debug)]
pub enum Shape {
    /// A number, a flag, a text, or an inline table: its type checks it.
    Scalar,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// A value that may be left out.
    Optional(&'static Shape),
    /// A list of equal values.
    List(&'static Shape),
    /// A sub-table.
    Table(&'static Table),
    /// A sub-table whose rows depend on the word under a key: the key, then word and rows of each alternative.
    Tagged(&'static str, &'static [(&'static str, &'static Table)]),
    /// A sub-table that is described elsewhere.
    Opaque,
}

/// A type that a row can have.
pub trait Setting {
    /// Its form in a file.
    const SHAPE: Shape;
}

macro_rules! scalars {
    ($($kind:ty),+) => { $(impl Setting for $kind { const SHAPE: Shape = Shape::Scalar; })+ };
}
scalars! { f64, u8, u16, u32, i32, usize, bool, String, std::path::PathBuf }

impl<T: Setting, const N: usize> Setting for [T; N] {
    const SHAPE: Shape = Shape::List(&T::SHAPE);
}
impl<T: Setting> Setting for Option<T> {
    const SHAPE: Shape = Shape::Optional(&T::SHAPE);
}

/// The content of a file that is checked after it was read.
pub trait Check {
    /// Its parameter table, if it has one: single values are checked against it.
    const TABLE: Option<&'static Table> = None;
    /// What to do about a key or a value that is not understood.
    const REMEDY: &'static str =
        "`retroflex board show` prints every key with its meaning, unit and range";

    /// Reports relations between values that do not hold.
    fn check(&self, to: &mut Checker);
}

/// A structure that [`parameters!`](crate::parameters) declares.
pub trait Parameters: Setting + Default + serde::Serialize {
    /// Its rows.
    const TABLE: &'static Table;

    /// Checks the ranges of a structure that was built in code. `at` is its key in the file, for the message.
    ///
    /// # Errors
    /// The first value that is out of range.
    fn checked(&self, at: &str) -> Result<(), Invalid> {
        let mut checker = Checker::default();
        match Values::try_from(self) {
            Ok(values) => Self::TABLE.check(&values, at, true, &mut checker),
            Err(e) => checker.refuse(at, e.to_string(), ""),
        }
        checker.done()
    }
}

impl Table {
    /// Reports values outside their range, and keys that are missing from a `whole` file: one that states only what differs from
    /// another lacks nothing. `at` is the key of this table, empty at the top. Types and unknown keys are the affair of serde.
    pub fn check(&self, values: &Values, at: &str, whole: bool, to: &mut Checker) {
        for row in self.rows {
            let key = join(at, row.key);
            match (values.get(row.key), &row.shape) {
                (Some(value), shape) => row.check(shape, value, &key, whole, to),
                (None, Shape::Table(table)) => table.check(&Values::new(), &key, whole, to),
                // described elsewhere, and every entry of it may be absent
                (None, Shape::Opaque) => {}
                (None, _) if row.required && whole => {
                    to.refuse(at, format!("`{}` is missing", row.key), row.hint)
                }
                _ => {}
            }
        }
    }

    /// The row of a dotted key; the indices of lists are passed over. `None` if the key is not known or depends on a word.
    pub fn row(&self, key: &str) -> Option<&'static Parameter>
    where
        Self: 'static,
    {
        let (first, rest) = key.split_once('.').unwrap_or((key, ""));
        let row = self.rows.iter().find(|r| r.key == first)?;
        let is_index = |part: &&str| part.parse::<usize>().is_ok();
        let below: Vec<&str> = rest.split('.').skip_while(is_index).collect();
        match below.join(".").as_str() {
            "" => Some(row),
            below => row.shape.table()?.row(below),
        }
    }
}

impl Shape {
    fn table(&self) -> Option<&'static Table> {
        match self {
            Self::Table(table) => Some(table),
            Self::Optional(inner) | Self::List(inner) => inner.table(),
            _ => None,
        }
    }
}

impl Parameter {
    fn check(&self, shape: &Shape, value: &Value, key: &str, whole: bool, to: &mut Checker) {
        match (shape, value) {
            (Shape::Optional(inner), value) => self.check(inner, value, key, whole, to),
            (Shape::List(inner), Value::Array(list)) => {
                list.iter()
                    .enumerate()
                    .for_each(|(i, v)| self.check(inner, v, &format!("{key}.{i}"), whole, to));
            }
            (Shape::Table(table), Value::Table(values)) => table.check(values, key, whole, to),
            (Shape::Tagged(tag, alternatives), Value::Table(values)) => {
                let word = values.get(*tag).and_then(Value::as_str);
                if let Some((_, table)) = alternatives.iter().find(|(name, _)| Some(*name) == word)
                {
                    table.check(values, key, whole, to);
                }
            }
            (_, Value::Float(x)) => self.check_number(*x, key, to),
            (_, Value::Integer(n)) => self.check_number(*n as f64, key, to),
            _ => {}
        }
    }

    fn check_number(&self, value: f64, key: &str, to: &mut Checker) {
        match self.allowed {
            Allowed::Any => {}
            Allowed::Range(low, high) => to
                .at(key)
                .range(value, low..=high, self.unit)
                .hint(self.hint),
            Allowed::OneOf(list) => to
                .at(key)
                .holds(
                    list.contains(&value),
                    &format!("{value} is not {}", self.allowed),
                )
                .hint(self.hint),
        }
    }
}

/// A key below a table.
pub fn join(at: &str, key: &str) -> String {
    if at.is_empty() {
        key.to_owned()
    } else {
        format!("{at}.{key}")
    }
}

/// Declares a structure of parameters; see [`primitives::parameters`](crate::primitives::parameters). After the name
/// and a colon stand further traits to derive.
#[macro_export]
macro_rules! parameters {
    (
        $(#[doc = $about:literal])+
        pub struct $name:ident $(: $($extra:ident),+)? $(by $of:ident -> $result:ident)? { $(
            $(#[doc = $paragraph:literal])+
            $field:ident $(of $variant:ident)? $(as $key:literal)?: $kind:ty $(= $default:expr)?
            $(, $unit:literal, $([$($one:literal),+])? $($low:literal ..= $high:literal)?, $hint:literal)?;
        )+ }
        $(set in code { $($(#[doc = $code_doc:literal])+ $code_field:ident: $code_kind:ty = $code_default:expr;)+ })?
    ) => {
        $(#[doc = $about])+
        #[derive(Debug, Clone, PartialEq, $($($extra,)+)? serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct $name { $(
            $(#[doc = $paragraph])+
            #[doc = concat!("" $(, "\n\nDefault `", stringify!($default), "`.")? $(, " Unit: ", $unit, $(" allowed: ", stringify!($low), " to ", stringify!($high),)? ".")?)]
            $(#[serde(rename = $key)])?
            pub $field: $kind,
        )+
        $($($(#[doc = $code_doc])+ #[serde(skip)] pub $code_field: $code_kind,)+)?
        }

        impl Default for $name {
            fn default() -> Self {
                Self {
                    $($field: $crate::parameters!(@default $($default)?),)+
                    $($($code_field: $code_default,)+)?
                }
            }
        }

        $crate::parameters!(@of $name [$($of $result)?] $($($variant $field)?)+);

        impl $crate::primitives::parameters::Setting for $name {
            const SHAPE: $crate::primitives::parameters::Shape =
                $crate::primitives::parameters::Shape::Table(<Self as $crate::primitives::parameters::Parameters>::TABLE);
        }

        impl $crate::primitives::parameters::Parameters for $name {
            const TABLE: &'static $crate::primitives::parameters::Table = &$crate::primitives::parameters::Table {
                about: &[$($about),+],
                rows: &[$($crate::primitives::parameters::Parameter {
                    key: $crate::parameters!(@key $field $($key)?),
                    paragraph: &[$($paragraph),+],
                    unit: concat!($($unit)?),
                    allowed: $crate::parameters!(@allowed $($([$($one),+])? $($low, $high)?)?),
                    hint: concat!($($hint)?),
                    required: $crate::parameters!(@required $($default)?),
                    shape: <$kind as $crate::primitives::parameters::Setting>::SHAPE,
                }),+],
            };
        }
    };
    (@of $name:ident []) => {};
    (@of $name:ident [$of:ident $result:ident] $($variant:ident $field:ident)+) => {
        impl $name {
            #[doc = concat!("What is set for a [`", stringify!($of), "`].")]
            pub fn of(&self, key: $of) -> $result {
                match key { $($of::$variant => self.$field,)+ }
            }
        }
    };
    (@default) => { Default::default() };
    (@default $default:expr) => { $default };
    (@required) => { true };
    (@required $default:expr) => { false };
    (@key $field:ident) => { stringify!($field) };
    (@key $field:ident $key:literal) => { $key };
    (@allowed) => { $crate::primitives::parameters::Allowed::Any };
    (@allowed [$($one:literal),+]) => { $crate::primitives::parameters::Allowed::OneOf(&[$($one as f64),+]) };
    (@allowed $low:literal, $high:literal) => { $crate::primitives::parameters::Allowed::Range($low as f64, $high as f64) };
}

/// Declares an enumeration whose values are words in a file: `Variant = "word"`. The first one is the default.
#[macro_export]
macro_rules! choices {
    ($(#[doc = $about:literal])+ pub enum $name:ident {
        $(#[doc = $first_doc:literal])+ $first:ident = $first_word:literal,
        $($(#[doc = $doc:literal])+ $variant:ident = $word:literal,)+
    }) => {
        $(#[doc = $about])+
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
        pub enum $name {
            $(#[doc = $first_doc])+
            #[default]
            #[serde(rename = $first_word)]
            $first,
            $($(#[doc = $doc])+ #[serde(rename = $word)] $variant,)+
        }

        impl $crate::primitives::parameters::Setting for $name {
            const SHAPE: $crate::primitives::parameters::Shape =
                $crate::primitives::parameters::Shape::Choice(&[$first_word, $($word),+]);
        }
    };
}

/// Declares an enumeration whose values have names, `Variant = "name"`, or names and advice, `Variant = "name": "advice"`.
#[macro_export]
macro_rules! named {
    ($(#[$about:meta])+ $vis:vis enum $kind:ident {
        $($(#[$doc:meta])+ $variant:ident = $name:literal: $advice:literal,)+
    }) => {
        $crate::named! { $(#[$about])+ $vis enum $kind { $($(#[$doc])+ $variant = $name,)+ } }

        impl $kind {
            /// Advice to the operator.
            pub const fn advice(self) -> &'static str {
                [$($advice),+][self as usize]
            }
        }
    };
    ($(#[$about:meta])+ $vis:vis enum $kind:ident { $($(#[$doc:meta])+ $variant:ident = $name:literal,)+ }) => {
        $(#[$about])+
        $vis enum $kind { $($(#[$doc])+ $variant,)+ }

        impl $kind {
            /// Every value, in the order of the declaration.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$variant),+];

            /// The name, as in files, logs and messages.
            pub const fn name(self) -> &'static str {
                [$($name),+][self as usize]
            }
        }

        impl std::fmt::Display for $kind {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.pad(self.name())
            }
        }
    };
}
