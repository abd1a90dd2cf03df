//! Disturbances of magnetometer and accelerometer.

use super::super::checks::field_disturbed;
use super::*;

#[test]
fn magnetic_faults_select_gravity_only() {
    let mut b = Rig::new();
    b.settle();
    let v = b.with(|s, q| (s.mag_ut, q.mag_overflow) = (None, true));
    assert!(v.faults.contains(HealthCause::MagOverflow) && v.action() == HealthAction::GravityOnly);
    let n = b.until_recovered(HealthCause::MagOverflow);
    assert!(
        (46..=50).contains(&n),
        "ten magnetometer values take fifty samples: {n}"
    );
    b.source.mag += Vector3::new(12.0, 0.0, 0.0);
    let mut caught = false;
    for _ in 0..5 {
        let v = b.good();
        caught |= v.faults.contains(HealthCause::FieldDisturbed);
        assert!(v.gyro && v.acc && (!caught || !v.mag));
    }
    assert!(
        caught,
        "12 µT change the strength by 9 % and the dip by 10°"
    );
    b.source.mag -= Vector3::new(12.0, 0.0, 0.0);
    b.until_recovered(HealthCause::FieldDisturbed);
}

#[test]
fn strength_and_dip_are_checked_separately() {
    let reference =
        FieldShape::from_rest(&Vector3::z(), &Vector3::new(20.0, 0.0, -45.0)).expect("sound");
    assert!(
        (reference.dip_rad.to_degrees() - 66.04).abs() < 0.01,
        "the dip is positive below the horizon"
    );
    let (c, up) = (HealthConfig::default(), Vector3::new(0.0, 0.0, 9.81));
    let turned = |deg: f64| {
        let a = (reference.dip_rad.to_degrees() + deg).to_radians();
        Vector3::new(a.cos(), 0.0, -a.sin()) * reference.norm_ut
    };
    assert!(!field_disturbed(
        &c,
        &reference,
        Some(&up),
        &turned(9.0),
        0.0
    ));
    assert!(field_disturbed(
        &c,
        &reference,
        Some(&up),
        &turned(11.0),
        0.0
    ));
    assert!(
        !field_disturbed(&c, &reference, None, &turned(11.0), 0.0),
        "no dip check without a vertical"
    );
    assert!(field_disturbed(
        &c,
        &reference,
        None,
        &(turned(0.0) * 1.16),
        0.0
    ));
    assert!(!field_disturbed(
        &c,
        &reference,
        Some(&up),
        &(turned(0.0) * 0.86),
        0.0
    ));
}

#[test]
fn shaking_does_not_disturb_the_field() {
    let mut b = Rig::new();
    b.settle();
    for k in 0..1500 {
        let shake = 5.0 * (f64::from(k) * DT * 40.0).sin();
        let v = b.with(|s, _| s.acc_m_s2.x += shake);
        assert!(!v.faults.contains(HealthCause::FieldDisturbed), "{k}");
    }
    assert!(b.times(HealthCause::AccelDisturbed) > 5);
}

#[test]
fn the_vertical_follows_the_rotation_of_the_tip() {
    let mut b = Rig::new();
    b.settle();
    let rate = Vector3::new(0.0, 1.5, 0.0);
    b.source.rate = rate;
    let (acc, mag) = (b.source.acc, b.source.mag);
    for k in 0..1000_u32 {
        let back = Rotation3::new(-rate * f64::from(k + 1) * DT);
        (b.source.acc, b.source.mag) = (back * acc, back * mag);
        let v = b.with(|s, _| s.acc_m_s2.y += if k < 300 { 0.0 } else { 7.0 }); // a constant push
        assert!(!v.faults.contains(HealthCause::FieldDisturbed), "{k}");
    }
}

#[test]
fn a_silent_magnetometer_is_detected_unless_absent() {
    for expect_mag in [true, false] {
        let mut b = Rig::new();
        b.config.expect_mag = expect_mag;
        let mut detected = None;
        for n in 1..=200 {
            let v = b.with(|s, _| s.mag_ut = None);
            if v.faults.contains(HealthCause::MagSilent) && detected.is_none() {
                detected = Some(f64::from(n) * DT);
            }
        }
        assert_eq!(detected.is_some(), expect_mag);
        assert!(
            detected.is_none_or(|t| (0.2..0.206).contains(&t)),
            "{detected:?}"
        );
    }
}

#[test]
fn a_shaken_tip_coasts_and_then_holds() {
    let mut b = Rig::new();
    b.settle();
    for n in 1..=2600 {
        let v = b.with(|s, _| s.acc_m_s2.x += 6.0); // |a| = 11.5
        assert!(v.faults.contains(HealthCause::AccelDisturbed) && v.gyro && !v.acc && !v.mag);
        let t = f64::from(n - 1) * DT;
        if (t - 5.0).abs() > 1e-6 {
            assert_eq!(
                v.action(),
                if t > 5.0 {
                    HealthAction::Hold
                } else {
                    HealthAction::CoastOnGyro
                },
                "{t}"
            );
        }
    }
    b.until_recovered(HealthCause::AccelDisturbed);
    assert_eq!(b.good().action(), HealthAction::Use);
}

#[test]
fn repeated_field_disturbances_lengthen_the_recovery() {
    let (config, mut monitor) = (HealthConfig::default(), SensorMonitor::default());
    let field = Vector3::new(20.0, 0.0, -45.0);
    let rest = at_rest(Vector3::new(0.0, 0.0, 9.81), field);
    monitor.set_known(KnownErrors::default(), &rest);
    let mut t = 0.0;
    let mut assess = |times: f64| {
        t += 0.01;
        let sample = ImuSample {
            t: Seconds(t),
            gyro_rad_s: Vector3::new(t % 0.02, 0.0, 0.0),
            acc_m_s2: Vector3::new(0.0, 0.0, 9.81),
            mag_ut: Some(field * times),
        };
        // this source is free of noise
        monitor.assess(&config, Seconds(t), &ImuReading::from_world(Some(sample)))
    };
    let mut waits = Vec::new();
    for _ in 0..5 {
        assess(1.4);
        let mut wait = 1;
        while !assess(1.0).mag {
            wait += 1;
        }
        waits.push(wait);
    }
    assert_eq!(waits, [10, 20, 40, 80, 160]);
    for _ in 0..7000 {
        assess(1.0);
    }
    assess(1.4);
    assert!(
        (0..10).any(|_| assess(1.0).mag),
        "after an undisturbed minute the recovery is short again"
    );
}
