//! A resolved file as TOML, with the paragraph, default and range of every key.

use crate::primitives::{Allowed, Parameter, Parameters, Shape, Table, join};
use toml::{Table as Values, Value};

/// The whole of a structure: every key, with its value.
pub fn whole<T: Parameters>(value: &T) -> String {
    let table = |v: &T| Values::try_from(v).unwrap_or_default();
    let mut page = Page::default();
    page.comment(T::TABLE.about);
    page.rows(T::TABLE, "", &table(value), &table(&T::default()));
    page.0
}

/// The whole of a structure without comments, for a machine: it does not depend on a later program's defaults.
pub fn compact<T: Parameters>(value: &T) -> String {
    toml::to_string(value).unwrap_or_default()
}

#[derive(Default)]
struct Page(String);

impl Page {
    fn line(&mut self, text: &str) {
        self.0 += &format!("{text}\n");
    }

    fn comment(&mut self, lines: &[&str]) {
        for line in lines {
            self.line(&format!("#{line}"));
        }
    }

    /// Plain values first, as TOML wants it, then the sub-tables.
    fn rows(&mut self, table: &Table, at: &str, values: &Values, defaults: &Values) {
        for row in table.rows.iter().filter(|r| !is_table(&r.shape)) {
            self.comment(row.paragraph);
            self.line(&format!("# {}", limits(row, defaults.get(row.key))));
            match values.get(row.key) {
                Some(value) => self.line(&format!("{} = {}", row.key, written(row, value))),
                None => self.line(&format!("# {} is left out.", row.key)),
            }
        }
        for row in table.rows.iter().filter(|r| is_table(&r.shape)) {
            let (value, default) = (values.get(row.key), defaults.get(row.key));
            self.sub_table(row, &row.shape, &join(at, row.key), value, default);
        }
    }

    fn heading(&mut self, row: &Parameter, title: &str) {
        self.line("");
        self.comment(row.paragraph);
        self.line(title);
    }

    fn sub_table(
        &mut self,
        row: &Parameter,
        shape: &Shape,
        at: &str,
        value: Option<&Value>,
        default: Option<&Value>,
    ) {
        let none = Values::new();
        let defaults = default.and_then(Value::as_table).unwrap_or(&none);
        match (shape, value) {
            (Shape::Optional(inner), Some(_)) => self.sub_table(row, inner, at, value, default),
            (Shape::List(Shape::Table(table)), Some(Value::Array(list))) => {
                for (n, values) in list.iter().filter_map(Value::as_table).enumerate() {
                    self.line("");
                    if n == 0 {
                        self.comment(row.paragraph);
                    }
                    self.line(&format!("[[{at}]]"));
                    self.rows(table, at, values, &none);
                }
            }
            (Shape::Table(table), Some(Value::Table(values))) => {
                self.heading(row, &format!("[{at}]"));
                self.rows(table, at, values, defaults);
            }
            (Shape::Tagged(tag, alternatives), Some(Value::Table(values))) => {
                let word = values.get(*tag).and_then(Value::as_str);
                let chosen = alternatives.iter().find(|(name, _)| Some(*name) == word);
                if let Some((word, table)) = chosen {
                    self.heading(row, &format!("[{at}]"));
                    let words: Vec<&str> = alternatives.iter().map(|(name, _)| *name).collect();
                    self.line(&format!("# One of: {}.", words.join(", ")));
                    self.line(&format!("{tag} = \"{word}\""));
                    self.rows(table, at, values, defaults);
                }
            }
            (Shape::Opaque, Some(Value::Table(values))) if !values.is_empty() => {
                let nested = Values::from_iter([(at.to_owned(), Value::Table(values.clone()))]);
                let text = toml::to_string(&nested).unwrap_or_default();
                self.heading(row, text.replace(&format!("\"{at}\""), at).trim_end());
            }
            _ => self.heading(row, &format!("# [{at}] is left out.")),
        }
    }
}

fn is_table(shape: &Shape) -> bool {
    match shape {
        Shape::Table(_) | Shape::Tagged(..) | Shape::Opaque => true,
        Shape::Optional(inner) | Shape::List(inner) => is_table(inner),
        Shape::Scalar | Shape::Choice(_) => false,
    }
}

/// Default and accepted values, as a sentence: `Default 0.1 s; 0.01 to 10.`
fn limits(row: &Parameter, default: Option<&Value>) -> String {
    let unit = match row.unit {
        "" | OCTAL => String::new(),
        unit => format!(" {unit}"),
    };
    let default = match default {
        _ if row.required => "Required".to_owned(),
        Some(value) => format!("Default {}{unit}", written(row, value)),
        None => "Left out by default".to_owned(),
    };
    match (&row.shape, row.allowed) {
        (Shape::Choice(words), _) => format!("{default}; one of {}.", words.join(", ")),
        (_, Allowed::Any) => format!("{default}."),
        (_, Allowed::Range(..)) if row.unit == OCTAL => format!("{default}."),
        (_, allowed) if row.required => format!("{default}; {allowed}{unit}."),
        (_, allowed) => format!("{default}; {allowed}."),
    }
}

/// Unit of permission bits, which are written in octal.
pub const OCTAL: &str = "octal";

fn written(row: &Parameter, value: &Value) -> String {
    match value {
        Value::Integer(bits) if row.unit == OCTAL => format!("{bits:#o}"),
        value => value.to_string(),
    }
}
