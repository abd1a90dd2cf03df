//! Where a dotted key stands in the text of a TOML file, and which key stands at a place.

use crate::primitives::join;
use std::ops::Range;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A key that is written in a text.
struct Written {
    /// The dotted key.
    name: String,
    /// Where the key stands, and where its value.
    key: Range<usize>,
    value: Range<usize>,
}

/// Every key that is written in a text, tables and lists before what is in them.
fn written(text: &str) -> Vec<Written> {
    let mut out = Vec::new();
    if let Ok(table) = DeTable::parse(text) {
        add_table(&mut out, "", table.get_ref());
    }
    out
}

fn add_table(out: &mut Vec<Written>, above: &str, table: &DeTable<'_>) {
    for (key, value) in table.iter() {
        add(out, join(above, key.get_ref()), key.span(), value);
    }
}

fn add(out: &mut Vec<Written>, name: String, key: Range<usize>, value: &Spanned<DeValue<'_>>) {
    out.push(Written {
        name: name.clone(),
        key,
        value: value.span(),
    });
    match value.get_ref() {
        DeValue::Table(table) => add_table(out, &name, table),
        DeValue::Array(list) => list.iter().enumerate().for_each(|(i, entry)| {
            add(out, join(&name, &i.to_string()), entry.span(), entry);
        }),
        _ => {}
    }
}

/// The dotted key of the innermost key or value that covers a place; empty if none does.
pub fn key_at(text: &str, at: &Range<usize>) -> String {
    let covers = |outer: &Range<usize>| outer.start <= at.start && at.end <= outer.end;
    let mut inner_first = written(text).into_iter().rev();
    let found = inner_first.find(|w| covers(&w.key) || covers(&w.value));
    found.map(|w| w.name).unwrap_or_default()
}

/// Where the value of a dotted key stands in the text; `None` when the key is not written in it.
pub fn value_of(text: &str, key: &str) -> Option<Range<usize>> {
    let found = written(text).into_iter().find(|w| w.name == key);
    found.map(|w| w.value)
}

/// The text with the value of a dotted key replaced, everything else left as it is; `None` when the key is
/// not written in it.
pub fn replace(text: &str, key: &str, value: &str) -> Option<String> {
    let span = value_of(text, key)?;
    let (before, after) = (&text[..span.start], &text[span.end..]);
    Some(format!("{before}{value}{after}"))
}

/// Where a dotted key's value stands in the text. A key that is not written (a default that clashes
/// with something written) points at the nearest table that is.
pub fn span_of(text: &str, key: &str) -> Option<Range<usize>> {
    let above = || span_of(text, key.rsplit_once('.')?.0);
    value_of(text, key).or_else(above)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_key_at_a_place_is_the_innermost_one() {
        let text = "[a]\nx = 1\nmany = [1.0, 2.0]\n[[c]]\nn = 1\n[[c]]\nn = 27\n";
        for (part, key) in [
            ("x = 1", "a.x"),
            ("2.0", "a.many.1"),
            ("27", "c.1.n"),
            ("many", "a.many"),
        ] {
            let start = text.find(part).unwrap();
            assert_eq!(
                key_at(
                    text,
                    &(start..start + part.split(' ').next().unwrap().len())
                ),
                key
            );
        }
        assert_eq!(key_at("[a", &(0..1)), "");
    }

    #[test]
    fn a_value_is_replaced_in_place_and_only_if_it_is_there() {
        let text = "[a]\n# why\nx_mm = 0.5 # so\n[[c]]\nn = 1\n[[c]]\nn = 2\n";
        assert_eq!(
            replace(text, "a.x_mm", "0.25").unwrap(),
            text.replace("0.5", "0.25")
        );
        assert_eq!(
            replace(text, "c.1.n", "7").unwrap(),
            text.replace("n = 2", "n = 7")
        );
        assert_eq!(replace(text, "a.y_mm", "1"), None);
        assert_eq!(replace(text, "c.1.m", "1"), None);
    }
}
