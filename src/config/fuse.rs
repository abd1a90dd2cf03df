//! Ranges of the `[fuse]` tables of a gains file.

use crate::estimation::fusion::align::AlignConfig;
use crate::estimation::fusion::base::BaseConfig;
use crate::estimation::fusion::base_watch::WatchConfig;
use crate::estimation::fusion::bend::BendFilterConfig;
use crate::estimation::fusion::health;
use crate::estimation::fusion::second::SecondConfig;
use crate::estimation::fusion::tip::FuseConfig;
use crate::primitives::check::Checker;

/// Reports the first setting of fusion that is out of its range.
pub(super) fn check(fuse: &FuseConfig, to: &mut Checker) {
    align(&fuse.align, to);
    bend(&fuse.bend, to);
    second(&fuse.second, to);
    judge(&fuse.health, to);
    base(&fuse.base, to);
    watch(&fuse.watch, to);
}

fn align(a: &AlignConfig, to: &mut Checker) {
    to.range("fuse.align.window_s", a.window_s, 0.2..=60.0, "s", "the tip rests for at least 2 s at start");
    to.range("fuse.align.gyro_band_rad_s", a.gyro_band_rad_s, 1e-3..=2.0, "rad/s", "0.15");
    to.range("fuse.align.acc_band_m_s2", a.acc_band_m_s2, 0.01..=10.0, "m/s²", "1.5");
    to.range("fuse.align.gyro_bias_max_rad_s", a.gyro_bias_max_rad_s, 1e-3..=1.0, "rad/s", "0.15");
}

fn bend(b: &BendFilterConfig, to: &mut Checker) {
    to.range("fuse.bend.correction_period_s", b.correction_period_s, 0.0005..=0.5, "s", "0.01");
    to.range("fuse.bend.acc_bias_sigma_m_s2", b.acc_bias_sigma_m_s2, 1e-4..=3.0, "m/s²", "0.25");
    to.range("fuse.bend.mag_bias_sigma_ut", b.mag_bias_sigma_ut, 1e-3..=100.0, "µT", "6");
    to.range("fuse.bend.twist_sigma", b.twist_sigma, 1e-6..=1.0, "rad/rad", "0.1");
    to.range("fuse.bend.mount_sigma_rad", b.mount_sigma_rad, 1e-6..=1.0, "rad", "0.03");
    to.range("fuse.bend.gyro_walk_rad_s_rts", b.gyro_walk_rad_s_rts, 0.0..=0.1, "rad/s/√s", "1e-4");
    to.range("fuse.bend.acc_walk_m_s2_rts", b.acc_walk_m_s2_rts, 0.0..=1.0, "m/s²/√s", "0.002");
    to.range("fuse.bend.mag_walk_ut_rts", b.mag_walk_ut_rts, 0.0..=50.0, "µT/√s", "0.05");
    to.range("fuse.bend.acc_motion_m_s2_per_rad_s", b.acc_motion_m_s2_per_rad_s, 0.0..=20.0, "m/s² per rad/s", "0.15");
    to.range("fuse.bend.direction_error", b.direction_error, 1e-5..=1.0, "", "0.004");
    to.range("fuse.bend.direction_time_s", b.direction_time_s, 0.0..=100.0, "s", "1");
    to.range("fuse.bend.arc_mm", b.arc_mm, 0.0..=500.0, "mm", "20, the length of the bellows");
    to.range("fuse.bend.beyond_mm", b.beyond_mm, -100.0..=200.0, "mm", "5");
    to.range("fuse.bend.field_error", b.field_error, 1e-5..=1.0, "", "0.012");
    to.range("fuse.bend.twist_error", b.twist_error, 1e-4..=10.0, "rad/rad", "0.03");
    to.range("fuse.bend.gyro_walk_factor_max", b.gyro_walk_factor_max, 1.0..=1000.0, "", "12");
    to.range("fuse.bend.twist_walk", b.twist_walk, 0.0..=1.0, "rad/rad/√rad", "0.02");
    to.range("fuse.bend.still_rate_sigma_rad_s", b.still_rate_sigma_rad_s, 1e-5..=1.0, "rad/s", "0.005");
}

fn second(s: &SecondConfig, to: &mut Checker) {
    to.range("fuse.second.period_s", s.period_s, 0.0005..=0.5, "s", "0.01");
    to.range("fuse.second.angle_deg", s.angle_deg, 0.1..=180.0, "deg", "8");
    to.range("fuse.second.angle_per_rate_s", s.angle_per_rate_s, 0.0..=10.0, "s", "0.05");
    to.range("fuse.second.time_s", s.time_s, 0.0..=600.0, "s", "2");
}

fn judge(h: &health::HealthConfig, to: &mut Checker) {
    if let Err(e) = h.validate() {
        to.refuse(
            &format!("fuse.health.{}", e.field),
            format!("{} is out of range: allowed is {}", e.value, e.allowed),
            "leave it out for the default",
        );
    }
}

fn base(b: &BaseConfig, to: &mut Checker) {
    to.ranges("fuse.base.mount_deg", &b.mount_deg, -180.0..=180.0, "deg", "[0, 0, 0] is mounted like the tip's IMU");
    to.range("fuse.base.gravity_time_s", b.gravity_time_s, 0.05..=1000.0, "s", "2");
    to.range("fuse.base.field_time_s", b.field_time_s, 0.0..=10_000.0, "s", "20; 0 leaves the field out");
    to.range("fuse.base.still_rate_rad_s", b.still_rate_rad_s, 1e-4..=1.0, "rad/s", "0.02");
}

fn watch(w: &WatchConfig, to: &mut Checker) {
    to.range("fuse.watch.twist_deg", w.twist_deg, 0.1..=90.0, "deg", "5");
    to.range("fuse.watch.twist_share", w.twist_share, 0.0..=2.0, "", "0.45");
    to.range("fuse.watch.bend_deg", w.bend_deg, 0.1..=90.0, "deg", "5.5");
    to.range("fuse.watch.onset_deg", w.onset_deg, 0.01..=w.bend_deg.max(0.01), "deg", "below bend_deg");
    to.range("fuse.watch.settled_deg", w.settled_deg, 0.01..=45.0, "deg", "1.5");
    to.range("fuse.watch.misfit", w.misfit, 0.05..=100.0, "sigma", "0.8");
    to.range("fuse.watch.memory_s", w.memory_s, 0.1..=600.0, "s", "1.5");
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(change: impl Fn(&mut FuseConfig)) -> Option<String> {
        let mut fuse = FuseConfig::default();
        change(&mut fuse);
        let mut to = Checker::default();
        check(&fuse, &mut to);
        to.done().err().map(|e| e.key)
    }

    #[test]
    fn the_default_passes_and_nonsense_is_named() {
        assert_eq!(refused(|_| ()), None);
        assert_eq!(refused(|f| f.bend.twist_sigma = 0.0).as_deref(), Some("fuse.bend.twist_sigma"));
        assert_eq!(refused(|f| f.second.period_s = f64::NAN).as_deref(), Some("fuse.second.period_s"));
        assert_eq!(refused(|f| f.health.recover_samples = 0).as_deref(), Some("fuse.health.recover_samples"));
        assert_eq!(refused(|f| f.base.mount_deg[2] = 400.0).as_deref(), Some("fuse.base.mount_deg.2"));
        assert_eq!(refused(|f| f.watch.onset_deg = 9.0).as_deref(), Some("fuse.watch.onset_deg"));
    }
}
