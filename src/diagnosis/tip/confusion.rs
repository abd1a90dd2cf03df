//! Effects that resemble each other in a log.

use crate::model::effects::by_name;

/// Pairs that no motion separates (the tip IMU observes only the sum of the two delays), and whether a tracker separates them. Displaced bellows multiply the bend by a
/// constant matrix, and so does an anisotropic stiffness.
const INSEPARABLE_BY_MOTION: [([&str; 2], bool); 2] = [
    (["transport_delay", "sensor_latency"], true),
    (["clocking", "cable_stiffness"], false),
];

/// Whether motion can separate two effects, given a tracker or not.
pub fn separable(a: &str, b: &str, tracker: bool) -> bool {
    !INSEPARABLE_BY_MOTION.iter().any(|(pair, by_tracker)| {
        a != b && pair.contains(&a) && pair.contains(&b) && !(*by_tracker && tracker)
    })
}

/// Names of the effects with a signature similar to that of `name`; empty for an unknown name.
pub fn confused_with(name: &str) -> &'static [&'static str] {
    by_name(name).map_or(&[], |e| e.info().confused_with)
}

/// The manoeuvre that separates the effect `name` from those; empty for an unknown name.
pub fn separated_by(name: &str) -> &'static str {
    by_name(name).map_or("", |e| e.info().separated_by)
}

/// The pairs of which a log, with a tracker or not, shows the sum alone.
pub fn alike(tracker: bool) -> Vec<[&'static str; 2]> {
    let mut pairs = INSEPARABLE_BY_MOTION.to_vec();
    pairs.retain(|(_, by_tracker)| *by_tracker && !tracker);
    pairs.into_iter().map(|(pair, _)| pair).collect()
}
