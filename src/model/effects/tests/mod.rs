//! Tests of the catalogue as a whole, and the checks that every effect has to pass.

pub(crate) mod proof;

use crate::model::effects::{by_name, catalogue};

/// Names and stages of the published table, in its order.
const TABLE: [(&str, &str); 26] = [
    ("missed_steps", "drive"),
    ("gear_periodic", "drive"),
    ("leak", "transmission"),
    ("gas_compression", "transmission"),
    ("line_lag", "transmission"),
    ("thermal_drift", "transmission"),
    ("crosstalk", "transmission"),
    ("stiffening", "bellows"),
    ("asymmetry", "bellows"),
    ("hysteresis", "bellows"),
    ("creep", "bellows"),
    ("softening", "bellows"),
    ("gravity", "shape"),
    ("curvature", "shape"),
    ("clocking", "shape"),
    ("cable_stiffness", "shape"),
    ("torsion", "shape"),
    ("contact", "shape"),
    ("gyro_bias", "sensor"),
    ("accel_bias", "sensor"),
    ("hard_iron", "sensor"),
    ("motor_field", "sensor"),
    ("mount_misalignment", "sensor"),
    ("transport_delay", "timing"),
    ("sensor_latency", "timing"),
    ("base_motion", "base"),
];

#[test]
fn the_catalogue_is_the_published_table() {
    let got: Vec<_> = catalogue()
        .iter()
        .map(|e| (e.name(), e.stage().name()))
        .collect();
    assert_eq!(got, TABLE);
    for (name, _) in TABLE {
        assert_eq!(by_name(name).map(|e| e.name()), Some(name));
    }
    assert!(by_name("ghost").is_none());
}

#[test]
fn an_effect_is_only_taken_for_others_of_the_catalogue() {
    for e in catalogue() {
        assert!(!e.info().confused_with.is_empty(), "{}", e.name());
        for other in e.info().confused_with {
            assert!(
                by_name(other).is_some() && *other != e.name(),
                "{} / {other}",
                e.name()
            );
        }
        assert!(
            e.info().signature.len() > 20 && e.info().separated_by.len() > 10,
            "{}",
            e.name()
        );
    }
}
