//! Ranges of the filters' settings: what is outside is refused by name, before a filter is built.

/// A setting that would make a filter meaningless.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("fusion setting {name} = {value} is outside {min} to {max}: leave it out to get the default {default}")]
pub struct OutOfRange {
    /// Name of the setting, as in TOML.
    pub name: &'static str,
    /// What was asked for.
    pub value: f64,
    /// Smallest allowed value.
    pub min: f64,
    /// Largest allowed value.
    pub max: f64,
    /// The shipped value.
    pub default: f64,
}

/// A setting with its shipped value and its range: name, value, default, min, max.
pub(super) type Setting = (&'static str, f64, f64, f64, f64);

/// Refuses the first setting that is not finite or out of range.
pub(super) fn check(settings: &[Setting]) -> Result<(), OutOfRange> {
    let outside = |&&(_, value, _, min, max): &&Setting| !(value >= min && value <= max);
    match settings.iter().find(outside) {
        Some(&(name, value, default, min, max)) => Err(OutOfRange { name, value, min, max, default }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use crate::estimation::fusion::madgwick::MadgwickConfig;
    use crate::estimation::fusion::mekf::MekfConfig;
    use crate::estimation::fusion::rest::RestConfig;
    use crate::estimation::fusion::vqf::VqfConfig;

    #[test]
    fn shipped_settings_pass() {
        assert_eq!(MekfConfig::default().validate(), Ok(()));
        assert_eq!(MadgwickConfig::default().validate(), Ok(()));
        assert_eq!(VqfConfig::default().validate(), Ok(()));
        assert_eq!(VqfConfig::long().validate(), Ok(()));
    }

    #[test]
    fn nonsense_is_named() {
        for bad in [f64::NAN, f64::INFINITY, -1.0] {
            let rest = RestConfig { min_s: bad, ..RestConfig::default() };
            let refusals = [
                (MekfConfig { field_memory_s: bad, ..MekfConfig::default() }.validate(), "field_memory_s"),
                (MekfConfig { rest, ..MekfConfig::default() }.validate(), "min_s"),
                (MadgwickConfig { rest, ..MadgwickConfig::default() }.validate(), "min_s"),
                (MadgwickConfig { beta_field: bad, ..MadgwickConfig::default() }.validate(), "beta_field"),
                (VqfConfig { tau_mag_s: bad, ..VqfConfig::default() }.validate(), "tau_mag_s"),
            ];
            for (refusal, name) in refusals {
                let message = refusal.unwrap_err().to_string();
                assert!(message.contains(name) && message.contains("default"), "{message}");
            }
        }
    }

    #[test]
    fn unknown_settings_are_refused_in_toml() {
        assert!(toml::from_str::<MekfConfig>("block_s = 0.05").is_ok());
        assert!(toml::from_str::<MekfConfig>("blok_s = 0.05").is_err());
        assert!(toml::from_str::<MadgwickConfig>("[rest]\nmin_s = 2.0").is_ok());
        assert!(toml::from_str::<MadgwickConfig>("[rest]\nmin = 2.0").is_err());
    }
}
