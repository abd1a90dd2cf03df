//! What the firmware of a Raspberry Pi says about its supply and its temperature.

/// The status word of the firmware, as `vcgencmd get_throttled` prints it: up to the Pi 4, and on a Pi 5.
const STATUS: [&str; 2] = [
    "/sys/devices/platform/soc/soc:firmware/get_throttled",
    "/sys/devices/platform/soc@107c000000/soc@107c000000:firmware/get_throttled",
];
/// Chips of the kernel's sensor interface that are looked at for the driver `raspberrypi-hwmon`.
const CHIPS: std::ops::Range<u32> = 0..16;
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
    let read = |path: &str| std::fs::read_to_string(path).ok();
    let word = STATUS.iter().find_map(|path| parse(&read(path)?));
    let chip = |n: u32| {
        let chip = format!("/sys/class/hwmon/hwmon{n}");
        let name = read(&format!("{chip}/name"))?;
        let alarm = read(&format!("{chip}/in0_lcrit_alarm"))?;
        (name.trim() == "rpi_volt").then_some(alarm.trim() == "1")
    };
    let sags = CHIPS.into_iter().find_map(chip);
    let mut troubles = word.or(sags.map(|_| Vec::new()))?;
    if sags == Some(true) && !troubles.contains(&BITS[0].1) {
        troubles.insert(0, BITS[0].1);
    }
    Some(troubles)
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
