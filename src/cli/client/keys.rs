//! The keys of a terminal, from the bytes that it sends.

pub use ratatui::crossterm::event::KeyCode as Key;

/// The keys of bytes that came together. An escape sequence that is unknown, or does not end among them, is no key.
pub fn keys(bytes: &[u8]) -> Vec<Key> {
    let mut in_sequence = false;
    let key = |&byte: &u8| match byte {
        // introducers and parameters (ECMA-48, 5.4)
        b'[' | b'O' | b'0'..=b'?' if in_sequence => None,
        _ if std::mem::replace(&mut in_sequence, byte == 0x1b) => match byte {
            b'A' => Some(Key::Up),
            b'B' => Some(Key::Down),
            b'C' => Some(Key::Right),
            b'D' => Some(Key::Left),
            _ => None,
        },
        _ => Some(Key::Char(char::from(byte))),
    };
    bytes.iter().filter_map(key).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_escape_sequence_hides_a_later_key() {
        assert_eq!(
            keys(b"\x1b[D\x1bOCs"),
            [
                Key::Char('\x1b'),
                Key::Left,
                Key::Char('\x1b'),
                Key::Right,
                Key::Char('s')
            ]
        );
        assert_eq!(
            keys(b"\x1b[<0;10;10M\x1b[1;5Bq").last(),
            Some(&Key::Char('q'))
        );
        assert_eq!(keys(b"\x1b[<"), [Key::Char('\x1b')]);
    }
}
