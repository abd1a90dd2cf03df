//! Where a dotted key stands in the text of a TOML file, and which key stands at a place.

use crate::primitives::join;
use std::ops::Range;
use toml::de::{DeTable, DeValue};

/// The dotted key of the innermost key or value that covers a place; empty if none does.
pub fn key_at(text: &str, at: &Range<usize>) -> String {
    DeTable::parse(text)
        .ok()
        .and_then(|table| in_table(table.get_ref(), "", at))
        .unwrap_or_default()
}

fn covers(outer: &Range<usize>, inner: &Range<usize>) -> bool {
    outer.start <= inner.start && inner.end <= outer.end
}

fn in_table(table: &DeTable<'_>, above: &str, at: &Range<usize>) -> Option<String> {
    table.iter().find_map(|(key, value)| {
        let name = join(above, key.get_ref());
        if covers(&key.span(), at) {
            Some(name)
        } else {
            in_value(value.get_ref(), &name, at)
                .or_else(|| covers(&value.span(), at).then_some(name))
        }
    })
}

fn in_value(value: &DeValue<'_>, name: &str, at: &Range<usize>) -> Option<String> {
    match value {
        DeValue::Table(table) => in_table(table, name, at),
        DeValue::Array(list) => list.iter().enumerate().find_map(|(i, entry)| {
            let name = join(name, &i.to_string());
            in_value(entry.get_ref(), &name, at)
                .or_else(|| covers(&entry.span(), at).then_some(name))
        }),
        _ => None,
    }
}

/// The text with the value of a dotted key replaced, everything else left as it is; `None` when the key is
/// not written in it.
pub fn replace(text: &str, key: &str, value: &str) -> Option<String> {
    let (table, last) = key.rsplit_once('.')?;
    // a key that is not written is answered with its table: then the text there is no value of its own
    let span = span_of(text, key)?;
    if span_of(text, table) == Some(span.clone()) {
        return None;
    }
    let line = text[..span.start].rsplit('\n').next().unwrap_or("");
    let named = last.parse::<usize>().is_ok() || line.contains(last);
    named.then(|| format!("{}{value}{}", &text[..span.start], &text[span.end..]))
}

/// Where a dotted key's value stands in the text. A key that is not written (a default that clashes
/// with something written) points at the nearest table that is.
pub fn span_of(text: &str, key: &str) -> Option<Range<usize>> {
    let table = DeTable::parse(text).ok()?;
    let mut parts = key.split('.');
    let first = parts.next()?;
    let (_, mut value) = table.get_ref().iter().find(|(k, _)| k.get_ref() == first)?;
    for part in parts {
        let next = match value.get_ref() {
            DeValue::Table(t) => t.iter().find(|(k, _)| k.get_ref() == part).map(|(_, v)| v),
            DeValue::Array(a) => part.parse::<usize>().ok().and_then(|i| a.get(i)),
            _ => None,
        };
        match next {
            Some(inner) => value = inner,
            None => break,
        }
    }
    Some(value.span())
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
