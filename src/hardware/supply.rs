//! What the firmware of a Raspberry Pi says about its supply and its temperature.

use std::path::Path;

/// The status word of the firmware, as `vcgencmd get_throttled` prints it: up to the Pi 4, and on a Pi 5.
const STATUS: [&str; 2] = [
    "sys/devices/platform/soc/soc:firmware/get_throttled",
    "sys/devices/platform/soc@107c000000/soc@107c000000:firmware/get_throttled",
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

/// What the firmware reports now, worst first; `None` on a computer without such a firmware. Its files are under `root`.
pub fn troubles(root: &Path) -> Option<Vec<&'static str>> {
    let read = |path: &str| std::fs::read_to_string(root.join(path)).ok();
    let word = STATUS.iter().find_map(|path| parse(&read(path)?));
    let chip = |n: u32| {
        let chip = format!("sys/class/hwmon/hwmon{n}");
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
    let set = BITS.iter().filter(|(bit, _)| bits >> bit & 1 == 1);
    Some(set.map(|(_, name)| *name).collect())
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

    /// Firmware of either kind, any word, and the kernel's sensor at any number: what one of them says is reported.
    #[test]
    fn under_voltage_is_seen_on_every_model() {
        let told = |files: &[(String, &str)]| {
            let root = tempfile::tempdir().unwrap();
            for (path, text) in files {
                let path = root.path().join(path);
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, text).unwrap();
            }
            troubles(root.path())
        };
        assert_eq!(told(&[]), None);
        for word in STATUS.map(str::to_owned) {
            for (bits, name) in BITS {
                let text = format!("{:x}\n", 1_u32 << bits);
                assert_eq!(told(&[(word.clone(), &text)]), Some(vec![name]));
            }
            assert_eq!(told(&[(word, "0\n")]), Some(vec![]));
        }
        for n in CHIPS {
            let chip = |name, alarm| {
                let folder = format!("sys/class/hwmon/hwmon{n}");
                [
                    (format!("{folder}/name"), name),
                    (format!("{folder}/in0_lcrit_alarm"), alarm),
                ]
            };
            let word = (STATUS[1].to_owned(), "50000\n");
            assert_eq!(told(&chip("rpi_volt\n", "0\n")), Some(vec![]));
            assert_eq!(told(&chip("rpi_volt\n", "1\n")), Some(vec![BITS[0].1]));
            assert_eq!(told(&chip("cpu_thermal\n", "1\n")), None);
            let [name, alarm] = chip("rpi_volt\n", "1\n");
            let all = [
                "under-voltage now",
                "under-voltage since boot",
                "throttled since boot",
            ];
            assert_eq!(told(&[name, alarm, word]), Some(all.to_vec()));
        }
    }
}
