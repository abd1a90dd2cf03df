//! What the firmware of a Raspberry Pi says about its supply and its temperature.

/// The status word of the firmware, as `vcgencmd get_throttled` prints it.
const STATUS: &str = "/sys/devices/platform/soc/soc:firmware/get_throttled";
/// Meaning of its bits (Raspberry Pi documentation, `vcgencmd`).
const BITS: [(u32, &str); 8] = [
    (0, "under-voltage now"),
    (1, "frequency capped now"),
    (2, "throttled now"),
    (3, "soft temperature limit now"),
    (16, "under-voltage since boot"),
    (17, "frequency capped since boot"),
    (18, "throttled since boot"),
    (19, "soft temperature limit since boot"),
];

/// What to do about any of it.
pub const REMEDY: &str =
    "use the official power supply, a separate one for the motors, and let the computer cool";

/// What the firmware reports now, worst first; `None` on a computer without such a firmware.
pub fn troubles() -> Option<Vec<&'static str>> {
    parse(&std::fs::read_to_string(STATUS).ok()?)
}

fn parse(text: &str) -> Option<Vec<&'static str>> {
    let bits = u32::from_str_radix(text.trim().trim_start_matches("0x"), 16).ok()?;
    Some(
        BITS.iter()
            .filter(|(bit, _)| bits >> bit & 1 == 1)
            .map(|(_, name)| *name)
            .collect(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bits_have_names() {
        assert_eq!(parse("0\n"), Some(vec![]));
        assert_eq!(
            parse("0x50005\n"),
            Some(vec![
                "under-voltage now",
                "throttled now",
                "under-voltage since boot",
                "throttled since boot"
            ])
        );
        assert_eq!(parse("volts"), None);
    }
}
