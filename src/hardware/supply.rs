//! What the firmware of a Raspberry Pi says about its supply and its temperature.

use std::path::{Path, PathBuf};

/// The folder of the firmware's node, which has another name on each model: `soc/soc:firmware` up to the Pi 4,
/// `soc@107c000000/soc@107c000000:firmware` on a Pi 5.
const PLATFORM: &str = "/sys/devices/platform";
/// The status word in it, as `vcgencmd get_throttled` prints it.
const STATUS: &str = "get_throttled";
/// The alarm of the kernel's driver `raspberrypi-hwmon`, whose `name` is `rpi_volt`.
const HWMON: &str = "/sys/class/hwmon";
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
    let read = |path: PathBuf| std::fs::read_to_string(path).ok();
    let inside = |folder: &Path| {
        let entries = std::fs::read_dir(folder).ok();
        entries.into_iter().flatten().flatten().map(|e| e.path())
    };
    let soc = inside(Path::new(PLATFORM)).filter(|path| {
        (path.file_name()).is_some_and(|name| name.to_string_lossy().starts_with("soc"))
    });
    let word = soc
        .flat_map(|soc| inside(&soc))
        .find_map(|node| parse(&read(node.join(STATUS))?));
    let alarm = inside(Path::new(HWMON))
        .filter(|chip| read(chip.join("name")).is_some_and(|name| name.trim() == "rpi_volt"))
        .find_map(|chip| read(chip.join("in0_lcrit_alarm")));
    let sags = alarm.as_deref().map(str::trim) == Some("1");
    let mut troubles = word.or(alarm.map(|_| Vec::new()))?;
    if sags && !troubles.contains(&BITS[0].1) {
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
