//! The drivers of IMU and pressure sensors: byte for byte against scripts written from the data sheets, and in motion
//! against register-level fakes. A published driver reads the same fake for comparison.

use crate::fake_imu::{
    FakeBus, FakeBusError, FakeDelay, FakeIcm20948, FakeLis2mdl, FakeLsm6dso, FakePressure, Motion,
    Noise,
};
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::{ErrorKind, I2c, NoAcknowledgeSource, Operation};
use embedded_hal_mock::eh1::delay::NoopDelay;
use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
use nalgebra::{Matrix3, Rotation3, Vector3};
use retroflex::estimation::fusion::align::Alignment;
use retroflex::estimation::fusion::health::{HealthCause, KnownErrors, SensorMonitor};
use retroflex::estimation::imu_calibration::{self, ImuCalibration, Pedigree};
use retroflex::hardware::imu::icm20948::{self, Icm20948};
use retroflex::hardware::imu::lsm6dso::{self, Lsm6dsoLis2mdl};
use retroflex::hardware::imu::{
    Axes, Axis, Chip, ChipConfig, Imu, ImuError, Part, RawImu, STANDARD_GRAVITY_M_S2, open,
};
use retroflex::hardware::pressure::{PressureError, PressureSection, PressureSensor};
use retroflex::primitives::units::Seconds;
use retroflex::primitives::{ImuReading, ReadFault};
use std::pin::pin;
use std::task::{Context, Poll, Waker};

const ICM: u8 = 0x68;
const LSM: u8 = 0x6A;
const LIS: u8 = 0x1E;

// ---------------------------------------------------------------------------------- scripts

fn put(address: u8, register: u8, value: u8) -> Transaction {
    Transaction::write(address, vec![register, value])
}

fn get(address: u8, register: u8, values: &[u8]) -> Transaction {
    Transaction::write_read(address, vec![register], values.to_vec())
}

/// One byte through the internal bus: set up slave 4, read the done bit, fetch the byte.
fn aux(slave: u8, register: u8, out: u8, data_in: u8) -> Vec<Transaction> {
    vec![
        get(ICM, 0x17, &[0x00]),
        put(ICM, 0x7F, 0x30),
        put(ICM, 0x13, slave),
        put(ICM, 0x14, register),
        put(ICM, 0x16, out),
        put(ICM, 0x15, 0x80),
        put(ICM, 0x7F, 0x00),
        get(ICM, 0x17, &[0x40]),
        put(ICM, 0x7F, 0x30),
        get(ICM, 0x17, &[data_in]),
        put(ICM, 0x7F, 0x00),
    ]
}

/// The transfers of the default configuration, from DS-000189.
fn icm_init_script() -> Vec<Transaction> {
    let mut script = vec![
        put(ICM, 0x7F, 0x00),
        get(ICM, 0x00, &[0xEA]),
        put(ICM, 0x06, 0x80), // reset
        get(ICM, 0x06, &[0x41]),
        put(ICM, 0x06, 0x01), // awake, PLL
        put(ICM, 0x07, 0x00), // all axes
        put(ICM, 0x05, 0x00), // no duty cycling
        put(ICM, 0x0F, 0x00), // no bypass
        put(ICM, 0x7F, 0x20), // bank 2
        put(ICM, 0x09, 0x01),
        put(ICM, 0x00, 0x01), // 562.5 Hz
        put(ICM, 0x01, 0x13), // 119.5 Hz, 500 dps
        put(ICM, 0x10, 0x00),
        put(ICM, 0x11, 0x01),
        put(ICM, 0x14, 0x1B), // 50.4 Hz, 4 g
        put(ICM, 0x7F, 0x00),
        put(ICM, 0x03, 0x02), // internal master: reset, on
        put(ICM, 0x03, 0x20),
        put(ICM, 0x7F, 0x30),
        put(ICM, 0x01, 0x17),
        put(ICM, 0x02, 0x80),
        put(ICM, 0x7F, 0x00),
    ];
    script.extend(aux(0x0C, 0x32, 0x01, 0x00)); // AK09916 soft reset
    script.extend(aux(0x8C, 0x01, 0x00, 0x09)); // WIA2
    script.extend(aux(0x0C, 0x31, 0x08, 0x00)); // 100 Hz
    script.extend(aux(0x8C, 0x31, 0x00, 0x08));
    script.extend([
        put(ICM, 0x7F, 0x30),
        put(ICM, 0x03, 0x8C), // slave 0: nine bytes from ST1
        put(ICM, 0x04, 0x10),
        put(ICM, 0x05, 0x89),
        put(ICM, 0x7F, 0x00),
    ]);
    script
}

fn burst(st1: u8, mag: [i16; 3], st2: u8) -> Vec<u8> {
    let mut b = Vec::new();
    for c in [1, -2, 8192, 100, -200, 300, 1335] {
        b.extend(i16::to_be_bytes(c));
    }
    b.push(st1);
    for c in mag {
        b.extend(i16::to_le_bytes(c));
    }
    b.extend([0x00, st2]);
    b
}

/// Runs the scripted driver through init and then `reads` readings of `tail`.
fn scripted_icm(
    tail: Vec<Transaction>,
    canary_every: u16,
    reads: usize,
) -> Vec<Result<RawImu, ImuError>> {
    let mut script = icm_init_script();
    script.extend(tail);
    let config = icm20948::IcmConfig {
        canary_every,
        ..Default::default()
    };
    let mut bus = Mock::new(&script);
    let mut imu = Icm20948::new(bus.clone(), &config).unwrap();
    imu.init(&mut NoopDelay::new()).unwrap();
    let results = (0..reads).map(|_| imu.read()).collect();
    bus.done();
    results
}

#[test]
fn icm_reads_nine_axes_in_one_burst() {
    let tail = vec![
        get(ICM, 0x2D, &burst(0x01, [10, 20, -30], 0x10)),
        get(ICM, 0x2D, &burst(0x00, [10, 20, -30], 0x10)),
        get(ICM, 0x2D, &burst(0x00, [10, 21, -30], 0x10)), // data-ready cleared by an earlier poll
        get(ICM, 0x2D, &burst(0x01, [10, 20, -30], 0x18)),
    ];
    let r: Vec<_> = scripted_icm(tail, 0, 4)
        .into_iter()
        .map(|r| r.unwrap())
        .collect();
    assert_eq!(
        (r[0].acc, r[0].gyro, r[0].temp),
        ([1, -2, 8192], [100, -200, 300], 1335)
    );
    assert_eq!(
        r.iter().map(|r| r.mag).collect::<Vec<_>>(),
        [
            Some([10, 20, -30]),
            None,
            Some([10, 21, -30]),
            Some([10, 20, -30])
        ]
    );
    assert_eq!(
        r.iter().map(|r| r.fresh).collect::<Vec<_>>(),
        [true, false, false, false]
    );
    assert!(r[3].mag_overflow && !r[0].mag_overflow);
    let mut bus = Mock::new(&[]);
    let mut unused = Icm20948::new(bus.clone(), &icm20948::IcmConfig::default()).unwrap();
    let s = unused.scale().sample(&r[0], Seconds(3.0));
    assert!(
        (s.acc_m_s2.z - STANDARD_GRAVITY_M_S2).abs() < 1e-9,
        "8192 counts at 4 g"
    );
    assert!((s.gyro_rad_s.x.to_degrees() - 100.0 / 65.5).abs() < 1e-12);
    assert!(
        (s.mag_ut.unwrap() - Vector3::new(1.5, -3.0, 4.5)).norm() < 1e-12,
        "y and z are inverted"
    );
    assert!((unused.scale().temperature_c(&r[0]) - (21.0 + 1335.0 / 333.87)).abs() < 1e-9);
    assert!(matches!(
        unused.read(),
        Err(ImuError::NotReady(Part::Icm20948))
    ));
    bus.done();
}

#[test]
fn icm_distinguishes_another_part_a_missing_one_and_a_broken_bus() {
    let config = icm20948::IcmConfig::default();
    let init = |script: &[Transaction]| {
        let mut bus = Mock::new(script);
        let result = Icm20948::new(bus.clone(), &config)
            .unwrap()
            .init(&mut NoopDelay::new());
        bus.done();
        result.unwrap_err()
    };
    let other_part = init(&[put(ICM, 0x7F, 0), get(ICM, 0, &[0x71])]);
    assert_eq!(
        other_part,
        ImuError::WrongId {
            chip: Chip {
                part: Part::Icm20948,
                address: ICM
            },
            have: 0x71,
            want: 0xEA
        }
    );
    assert!(
        other_part.to_string().contains("imu.chip.part"),
        "{other_part}"
    );
    let nack = ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address);
    let missing = init(&[put(ICM, 0x7F, 0).with_error(nack)]);
    assert_eq!(
        missing,
        ImuError::Nack(Chip {
            part: Part::Icm20948,
            address: ICM
        })
    );
    assert_eq!(missing.fault(), ReadFault::Nack);
    let broken = init(&[put(ICM, 0x7F, 0).with_error(ErrorKind::ArbitrationLoss)]);
    assert_eq!(broken.fault(), ReadFault::Bus);
    let script = [
        put(ICM, 0x7F, 0),
        get(ICM, 0, &[0xEA]).with_error(ErrorKind::Overrun),
    ];
    assert_eq!(init(&script).fault(), ReadFault::ShortRead);
}

#[test]
fn icm_detects_a_transfer_that_ends_early() {
    let mut dead = burst(0x01, [10, 20, -30], 0x10);
    dead[11..].fill(0xFF);
    let r = scripted_icm(vec![get(ICM, 0x2D, &dead)], 0, 1);
    assert!(
        matches!(
            r[0],
            Err(ImuError::ShortRead {
                have: 11,
                want: 23,
                ..
            })
        ),
        "{:?}",
        r[0]
    );
}

#[test]
fn icm_canary_checks_power_ranges_and_mode_in_turn() {
    let good = burst(0x00, [0; 3], 0x10);
    let tail = vec![
        get(ICM, 0x2D, &good),
        get(ICM, 0x03, &[0x20, 0, 0, 0x01, 0]),
        get(ICM, 0x2D, &good),
        put(ICM, 0x7F, 0x20),
        get(ICM, 0x00, &[0x01, 0x13]),
        get(ICM, 0x14, &[0x1B]),
        put(ICM, 0x7F, 0x00),
        get(ICM, 0x2D, &good),
        get(ICM, 0x17, &[0x00]),
        put(ICM, 0x7F, 0x30), // asks for the mode of the magnetometer
        put(ICM, 0x13, 0x8C),
        put(ICM, 0x14, 0x31),
        put(ICM, 0x16, 0x00),
        put(ICM, 0x15, 0x80),
        put(ICM, 0x7F, 0x00),
        get(ICM, 0x2D, &good),
        get(ICM, 0x03, &[0x20, 0, 0, 0x01, 0]),
        get(ICM, 0x2D, &good),
        put(ICM, 0x7F, 0x20),
        get(ICM, 0x00, &[0x00, 0x01]), // 250 dps, full rate: the power-on values
    ];
    let r = scripted_icm(tail, 1, 6);
    assert!(r[..4].iter().all(Result::is_ok));
    let want = ImuError::ResetToDefaults {
        part: Part::Icm20948,
        register: 0x00,
        have: 0,
        want: 1,
    };
    assert_eq!(r[4], Err(want));
    assert!(
        matches!(r[5], Err(ImuError::NotReady(_))),
        "no reading before the next init"
    );
}

#[test]
fn lsm_and_lis_send_the_bytes_of_their_data_sheets() {
    let mut inertial = vec![0x07, 0x00];
    for c in [256_i16, 10, -20, 30, 1, -2, 8196] {
        inertial.extend(c.to_le_bytes());
    }
    let mut magnetic = vec![0x0F];
    for c in [100_i16, -200, 300] {
        magnetic.extend(c.to_le_bytes());
    }
    let nack = ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address);
    let script = [
        get(LSM, 0x0F, &[0x6C]),
        put(LSM, 0x12, 0x05),
        get(LSM, 0x12, &[0x04]),
        put(LSM, 0x12, 0x44),
        put(LSM, 0x18, 0xE2),
        put(LSM, 0x13, 0x00),
        put(LSM, 0x15, 0x00),
        put(LSM, 0x17, 0x00),
        put(LSM, 0x10, 0x58), // 208 Hz, 4 g
        put(LSM, 0x11, 0x54), // 208 Hz, 500 dps
        get(LIS, 0x4F, &[0x40]),
        put(LIS, 0x60, 0x20),
        get(LIS, 0x60, &[0x03]),
        put(LIS, 0x62, 0x10),
        put(LIS, 0x61, 0x02),
        put(LIS, 0x60, 0x8C),
        get(LSM, 0x1E, &inertial),
        get(LIS, 0x67, &magnetic),
        get(LSM, 0x1E, &inertial),
        get(LIS, 0x67, &magnetic).with_error(nack),
        get(LSM, 0x10, &[0x58, 0x54, 0x44, 0x00]),
        get(LIS, 0x60, &[0x8C, 0x02, 0x10]),
        get(LSM, 0x1E, &inertial).with_error(nack),
    ];
    let config = lsm6dso::LsmConfig {
        rate_hz: 120.0,
        canary_every: 2,
        ..Default::default()
    };
    let mut bus = Mock::new(&script);
    let mut imu = Lsm6dsoLis2mdl::new(bus.clone(), &config, lsm6dso::Variant::Dso).unwrap();
    let id = imu.init(&mut NoopDelay::new()).unwrap();
    assert_eq!(id.rate_hz, 208.0);
    let raw = imu.read().unwrap();
    assert_eq!(
        (raw.gyro, raw.acc, raw.temp, raw.fresh),
        ([10, -20, 30], [1, -2, 8196], 256, true)
    );
    assert_eq!((raw.mag, raw.mag_fault), (Some([100, -200, 300]), None));
    let raw = imu.read().unwrap();
    let fault = ImuError::Nack(Chip {
        part: Part::Lis2mdl,
        address: LIS,
    });
    assert_eq!(
        (raw.acc, raw.mag, raw.mag_fault),
        ([1, -2, 8196], None, Some(fault)),
        "six axes are kept"
    );
    assert_eq!(imu.read().unwrap_err().fault(), ReadFault::Nack);
    bus.done();
}

// ------------------------------------------------------------------------------------ fakes

/// A motion with a different value on every axis.
fn odd_motion() -> Motion {
    Motion {
        acc_m_s2: Vector3::new(1.25, -3.5, 8.9),
        gyro_rad_s: Vector3::new(0.5, -1.0, 1.75),
        mag_ut: Vector3::new(18.0, -7.5, -44.1),
        temp_c: 31.0,
    }
}

fn icm_bus(noise: Noise) -> FakeBus {
    let bus = FakeBus::new();
    bus.machine().attach(FakeIcm20948::new(ICM, 11));
    bus.machine().set_noise(noise);
    bus
}

fn lsm_bus(noise: Noise, axes: Axes) -> FakeBus {
    let bus = FakeBus::new();
    bus.machine().attach(FakeLsm6dso::new(LSM, 12));
    bus.machine().attach(FakeLis2mdl::mounted(axes, 13));
    bus.machine().set_noise(noise);
    bus
}

/// The bus of a configuration.
fn bus_of(config: &ChipConfig, noise: Noise) -> FakeBus {
    match config {
        ChipConfig::Icm20948(_) => icm_bus(noise),
        ChipConfig::Lsm6dsoLis2mdl(_) => lsm_bus(noise, Axes::ALIGNED),
        ChipConfig::Lsm6dsv16xLis2mdl(_) => {
            let bus = FakeBus::new();
            bus.machine()
                .attach(FakeLsm6dso::of(lsm6dso::Variant::Dsv16x, LSM, 12));
            bus.machine()
                .attach(FakeLis2mdl::mounted(Axes::ALIGNED, 13));
            bus.machine().set_noise(noise);
            bus
        }
    }
}

/// Every range of all parts, with the smallest count of each.
fn all_configs() -> Vec<(ChipConfig, f64, f64)> {
    let mut all = Vec::new();
    for acc_range_g in [2, 4, 8, 16] {
        for gyro_range_dps in [125, 250, 500, 1000, 2000] {
            let rate_hz = 200.0;
            let gyro = f64::from(gyro_range_dps).to_radians() / 28_000.0;
            let acc = f64::from(acc_range_g) * 9.81 / 32_000.0;
            let lsm = lsm6dso::LsmConfig {
                acc_range_g,
                gyro_range_dps,
                rate_hz,
                ..Default::default()
            };
            all.push((ChipConfig::Lsm6dsoLis2mdl(lsm.clone()), gyro, acc));
            all.push((ChipConfig::Lsm6dsv16xLis2mdl(lsm), gyro, acc));
            if gyro_range_dps > 125 {
                let icm = icm20948::IcmConfig {
                    acc_range_g,
                    gyro_range_dps,
                    rate_hz,
                    ..Default::default()
                };
                all.push((ChipConfig::Icm20948(icm), gyro, acc));
            }
        }
    }
    all
}

#[test]
fn every_range_measures_the_true_motion() {
    let motion = odd_motion();
    for (config, gyro_lsb, acc_lsb) in all_configs() {
        let bus = bus_of(&config, Noise::NONE);
        let mut imu = open(&config, bus.clone()).unwrap();
        imu.init(&mut bus.delay()).unwrap();
        bus.machine().set_motion(&motion);
        let mut mag = None;
        let mut last = None;
        for n in 1..=40 {
            bus.machine().advance(0.005);
            let raw = imu.read().unwrap();
            let sample = imu.scale().sample(&raw, Seconds(f64::from(n) * 0.005));
            mag = sample.mag_ut.or(mag);
            last = Some((raw, sample));
        }
        let (raw, sample) = last.unwrap();
        assert!(
            (sample.gyro_rad_s - motion.gyro_rad_s).amax() <= 0.5 * gyro_lsb,
            "{config:?}"
        );
        assert!(
            (sample.acc_m_s2 - motion.acc_m_s2).amax() <= 0.5 * acc_lsb,
            "{config:?}"
        );
        assert!(
            (mag.unwrap() - motion.mag_ut).amax() <= 0.0751,
            "{config:?} {mag:?}"
        );
        assert!((imu.scale().temperature_c(&raw) - motion.temp_c).abs() < 0.01);
    }
}

#[test]
fn a_rotated_magnetometer_is_corrected() {
    let axes = Axes([Axis::MinusZ, Axis::PlusX, Axis::MinusY]);
    let bus = lsm_bus(Noise::NONE, axes);
    let config = lsm6dso::LsmConfig {
        mag_axes: axes,
        rate_hz: 100.0,
        ..Default::default()
    };
    let mut imu = Lsm6dsoLis2mdl::new(bus.clone(), &config, lsm6dso::Variant::Dso).unwrap();
    imu.init(&mut bus.delay()).unwrap();
    bus.machine().set_motion(&odd_motion());
    bus.machine().advance(0.011);
    let _ = imu.read().unwrap();
    bus.machine().advance(0.011);
    let field = imu
        .scale()
        .sample(&imu.read().unwrap(), Seconds(0.0))
        .mag_ut
        .unwrap();
    assert!((field - odd_motion().mag_ut).amax() <= 0.0751, "{field}");
}

#[test]
fn a_second_sensor_shares_the_bus() {
    let bus = icm_bus(Noise::NONE);
    bus.machine().attach(FakeIcm20948::new(0x69, 99));
    let mut tip = Icm20948::new(bus.clone(), &icm20948::IcmConfig::default()).unwrap();
    let mut base = Icm20948::new(
        bus.clone(),
        &icm20948::IcmConfig {
            address: 0x69,
            ..Default::default()
        },
    )
    .unwrap();
    tip.init(&mut bus.delay()).unwrap();
    assert_eq!(base.init(&mut bus.delay()).unwrap().inertial.address, 0x69);
    bus.machine()
        .device(0x69)
        .unwrap()
        .set_motion(&odd_motion());
    bus.machine().advance(0.01);
    assert_eq!(tip.read().unwrap().gyro, [0, 0, 0]);
    assert_ne!(base.read().unwrap().gyro, [0, 0, 0]);
}

#[test]
fn the_magnetometer_is_read_once_per_measurement_at_500_hz() {
    for config in [
        ChipConfig::default(),
        ChipConfig::Lsm6dsoLis2mdl(lsm6dso::LsmConfig::default()),
        ChipConfig::Lsm6dsv16xLis2mdl(lsm6dso::LsmConfig::default()),
    ] {
        let bus = bus_of(&config, Noise::TYPICAL);
        let mut imu = open(&config, bus.clone()).unwrap();
        imu.init(&mut bus.delay()).unwrap();
        let mut fresh = 0;
        for _ in 0..5000 {
            bus.machine().advance(0.002);
            fresh += u32::from(imu.read().unwrap().mag.is_some());
        }
        assert!(
            (990..=1010).contains(&fresh),
            "ten seconds at 100 Hz gave {fresh} ({config:?})"
        );
    }
}

#[test]
fn bus_time_of_a_reading_is_as_documented() {
    let per_reading = |bus: &FakeBus, imu: &mut dyn Imu, n: u32| {
        let before = bus.machine().bus_time_s(400e3);
        for _ in 0..n {
            bus.machine().advance(0.002);
            imu.read().unwrap();
        }
        (bus.machine().bus_time_s(400e3) - before) / f64::from(n)
    };
    let bus = icm_bus(Noise::TYPICAL);
    let config = icm20948::IcmConfig {
        canary_every: 0,
        ..Default::default()
    };
    let mut icm = Icm20948::new(bus.clone(), &config).unwrap();
    icm.init(&mut bus.delay()).unwrap();
    let t = per_reading(&bus, &mut icm, 100);
    assert!(
        (t - 595e-6).abs() < 1e-6,
        "ICM-20948 without canary: {:.1} us",
        t * 1e6
    );
    let mut icm = Icm20948::new(bus.clone(), &icm20948::IcmConfig::default()).unwrap();
    icm.init(&mut bus.delay()).unwrap();
    let t = per_reading(&bus, &mut icm, 1000);
    println!("ICM-20948 mean reading with canary: {:.1} us", t * 1e6);
    assert!(t < 605e-6);
    let bus = lsm_bus(Noise::TYPICAL, Axes::ALIGNED);
    let mut lsm = Lsm6dsoLis2mdl::new(
        bus.clone(),
        &lsm6dso::LsmConfig::default(),
        lsm6dso::Variant::Dso,
    )
    .unwrap();
    lsm.init(&mut bus.delay()).unwrap();
    let t = per_reading(&bus, &mut lsm, 1000);
    println!("LSM6DSO + LIS2MDL mean reading: {:.1} us", t * 1e6);
    assert!(t < 510e-6);
}

/// The successor keeps its settings in other registers; each is noticed if it changes, and its predecessor is another part.
#[test]
fn the_lsm6dsv16x_notices_each_of_its_settings_that_changes() {
    let config = ChipConfig::Lsm6dsv16xLis2mdl(lsm6dso::LsmConfig {
        canary_every: 1,
        gyro_filter: Some(3),
        ..Default::default()
    });
    for (register, value) in [
        (0x10, 0x08),
        (0x11, 0x00),
        (0x12, 0x04),
        (0x15, 0x01),
        (0x16, 0x00),
        (0x17, 0x03),
    ] {
        let bus = bus_of(&config, Noise::TYPICAL);
        let mut imu = open(&config, bus.clone()).unwrap();
        let id = imu.init(&mut bus.delay()).unwrap();
        assert_eq!((id.inertial.part, id.rate_hz), (Part::Lsm6dsv16x, 960.0));
        next(&bus, &mut *imu).unwrap();
        bus.machine().write(LSM, &[register, value]).unwrap();
        let error = next(&bus, &mut *imu).unwrap_err();
        assert!(
            matches!(error, ImuError::ResetToDefaults { register: r, .. } if r == register),
            "{error}"
        );
    }
    let bus = lsm_bus(Noise::TYPICAL, Axes::ALIGNED);
    let error = open(&config, bus.clone())
        .unwrap()
        .init(&mut bus.delay())
        .unwrap_err();
    assert!(
        matches!(
            error,
            ImuError::WrongId {
                have: 0x6C,
                want: 0x70,
                ..
            }
        ),
        "{error}"
    );
}

// ------------------------------------------------------------------------------------ faults

/// Whatever answers in the place of the part: the advice names what can be done about it.
#[test]
fn each_wrong_identity_has_an_advice_that_can_be_followed() {
    for (have, words) in [
        (Some(0x00), "short to ground"),
        (Some(0xFF), "nobody drives the data line"),
        (Some(0x70), "MPU-6000"),
        (Some(0x71), "MPU-6000"),
        (Some(0xE1), "imu.chip.part"),
        (None, "i2cdetect"),
    ] {
        for two in [false, true] {
            let (bus, mut imu): (_, Box<dyn Imu>) = if two {
                let bus = lsm_bus(Noise::TYPICAL, Axes::ALIGNED);
                let imu = Lsm6dsoLis2mdl::new(
                    bus.clone(),
                    &lsm6dso::LsmConfig::default(),
                    lsm6dso::Variant::Dso,
                )
                .unwrap();
                (bus, Box::new(imu))
            } else {
                let bus = icm_bus(Noise::TYPICAL);
                let imu = Icm20948::new(bus.clone(), &icm20948::IcmConfig::default()).unwrap();
                (bus, Box::new(imu))
            };
            let address = if two { LSM } else { ICM };
            match have {
                Some(id) => bus.machine().spoil(address, |q| q.wrong_id = Some(id)),
                None => bus.machine().nack(address, 1000),
            }
            let message = imu.init(&mut bus.delay()).unwrap_err().to_string();
            assert!(message.contains(words), "{have:?}: {message}");
            if let Some(read) = have {
                let (part, own) = if two {
                    ("LSM6DSO", 0x6C)
                } else {
                    ("ICM-20948", 0xEA)
                };
                let ids = format!(
                    "WHO_AM_I at {address:#04x} is {read:#04x}, that of the {part} is {own:#04x}"
                );
                assert!(message.contains(&ids), "{message}");
            }
        }
    }
    // another part at the address of the separate magnetometer
    let bus = lsm_bus(Noise::TYPICAL, Axes::ALIGNED);
    bus.machine().spoil(LIS, |q| q.wrong_id = Some(0x3D));
    let mut lsm = Lsm6dsoLis2mdl::new(
        bus.clone(),
        &lsm6dso::LsmConfig::default(),
        lsm6dso::Variant::Dso,
    )
    .unwrap();
    let error = lsm.init(&mut bus.delay()).unwrap_err();
    let chip = Chip {
        part: Part::Lis2mdl,
        address: LIS,
    };
    assert_eq!(
        error,
        ImuError::WrongId {
            chip,
            have: 0x3D,
            want: 0x40
        }
    );
    let ids = "WHO_AM_I at 0x1e is 0x3d, that of the LIS2MDL is 0x40";
    assert!(error.to_string().contains(ids), "{error}");
    // the magnetometer inside the chip is dead, or a separate one does not answer
    let bus = icm_bus(Noise::TYPICAL);
    bus.machine().spoil(ICM, |q| q.mag_dead = true);
    let mut icm = Icm20948::new(bus.clone(), &icm20948::IcmConfig::default()).unwrap();
    let message = icm.init(&mut bus.delay()).unwrap_err().to_string();
    assert!(
        message.contains("AK09916") && message.contains("fit another"),
        "{message}"
    );
    let bus = lsm_bus(Noise::TYPICAL, Axes::ALIGNED);
    bus.machine().nack(LIS, 1000);
    let mut lsm = Lsm6dsoLis2mdl::new(
        bus.clone(),
        &lsm6dso::LsmConfig::default(),
        lsm6dso::Variant::Dso,
    )
    .unwrap();
    let message = lsm.init(&mut bus.delay()).unwrap_err().to_string();
    assert!(
        message.contains("LIS2MDL") && message.contains("i2cdetect"),
        "{message}"
    );
}

fn running_icm() -> (FakeBus, Icm20948<FakeBus>) {
    let bus = icm_bus(Noise::TYPICAL);
    let mut imu = Icm20948::new(bus.clone(), &icm20948::IcmConfig::default()).unwrap();
    imu.init(&mut bus.delay()).unwrap();
    (bus, imu)
}

fn next(bus: &FakeBus, imu: &mut dyn Imu) -> Result<RawImu, ImuError> {
    bus.machine().advance(0.002);
    imu.read()
}

#[test]
fn a_sleeping_chip_has_no_fresh_reading() {
    let bus = icm_bus(Noise::TYPICAL);
    bus.machine().advance(1.0);
    let mut b = [0; 14];
    bus.machine().write(ICM, &[0x2D]).unwrap();
    bus.machine().read(ICM, &mut b).unwrap();
    assert_eq!(b, [0; 14], "asleep after power-up");
}

#[test]
fn readings_continue_after_missing_acknowledges() {
    let (bus, mut imu) = running_icm();
    bus.machine().nack(ICM, 3);
    let faults: Vec<bool> = (0..5).map(|_| next(&bus, &mut imu).is_err()).collect();
    assert_eq!(faults, [true, true, true, false, false]);
}

#[test]
fn a_fault_in_another_bank_does_not_falsify_the_next_reading() {
    let script_end = vec![
        get(ICM, 0x2D, &burst(0, [0; 3], 0)),
        get(ICM, 0x03, &[0x20, 0, 0, 0x01, 0]),
        get(ICM, 0x2D, &burst(0, [0; 3], 0)),
        put(ICM, 0x7F, 0x20),
        get(ICM, 0x00, &[0x01, 0x13]).with_error(ErrorKind::ArbitrationLoss),
        put(ICM, 0x7F, 0x00), // the data bank is selected again first
        get(ICM, 0x2D, &burst(0, [0; 3], 0)),
        get(ICM, 0x17, &[0x00]),
        put(ICM, 0x7F, 0x30), // asks for the mode of the magnetometer
        put(ICM, 0x13, 0x8C),
        put(ICM, 0x14, 0x31),
        put(ICM, 0x16, 0x00),
        put(ICM, 0x15, 0x80),
        put(ICM, 0x7F, 0x00),
    ];
    let r = scripted_icm(script_end, 1, 3);
    assert!(r[0].is_ok() && r[1].is_err() && r[2].is_ok());
}

#[test]
fn a_stuck_bus_is_not_a_missing_chip() {
    let (bus, mut imu) = running_icm();
    bus.machine().stuck = true;
    let error = next(&bus, &mut imu).unwrap_err();
    assert_eq!(
        (error.fault(), matches!(error, ImuError::Bus(..))),
        (ReadFault::Bus, true)
    );
    bus.machine().stuck = false;
    assert!(next(&bus, &mut imu).is_ok());
}

#[test]
fn a_brown_out_is_detected_at_once_and_repaired_by_init() {
    let (bus, mut imu) = running_icm();
    for _ in 0..7 {
        next(&bus, &mut imu).unwrap();
    }
    bus.machine().brown_out();
    let error = next(&bus, &mut imu).unwrap_err();
    assert!(
        matches!(
            error,
            ImuError::ResetToDefaults {
                register: 0x03,
                have: 0x00,
                want: 0x20,
                ..
            }
        ),
        "{error}"
    );
    assert_eq!(
        next(&bus, &mut imu).unwrap_err().fault(),
        ReadFault::BrownOut
    );
    imu.init(&mut bus.delay()).unwrap();
    assert!(next(&bus, &mut imu).unwrap().mag.is_some());
}

#[test]
fn a_changed_range_is_detected_by_the_check_of_settings() {
    let (bus, mut imu) = running_icm();
    bus.machine().write(ICM, &[0x7F, 0x20]).unwrap();
    bus.machine().write(ICM, &[0x01, 0x11]).unwrap(); // 250 dps: every rate doubles silently
    bus.machine().write(ICM, &[0x7F, 0x00]).unwrap();
    let found = (1..=200)
        .find(|_| next(&bus, &mut imu).is_err())
        .expect("found");
    assert!(found <= 100, "two canary periods at most: {found}");
}

#[test]
fn lsm_brown_out_and_dead_magnetometer() {
    let bus = lsm_bus(Noise::TYPICAL, Axes::ALIGNED);
    let mut imu = Lsm6dsoLis2mdl::new(
        bus.clone(),
        &lsm6dso::LsmConfig::default(),
        lsm6dso::Variant::Dso,
    )
    .unwrap();
    imu.init(&mut bus.delay()).unwrap();
    bus.machine().nack(LIS, u32::MAX);
    for _ in 0..200 {
        let raw = next(&bus, &mut imu).unwrap();
        assert!(raw.mag.is_none() && raw.gyro != [0; 3]);
    }
    bus.machine().nack(LIS, 0);
    bus.machine().brown_out();
    let found = (1..=100)
        .find(|_| next(&bus, &mut imu).is_err())
        .expect("found");
    assert!(found <= 50, "{found}");
    imu.init(&mut bus.delay()).unwrap();
    assert!(next(&bus, &mut imu).is_ok());
}

#[test]
fn init_reports_another_part_or_a_dead_magnetometer() {
    let (bus, mut imu) = running_icm();
    bus.machine().spoil(ICM, |q| q.wrong_id = Some(0x12));
    assert_eq!(
        imu.init(&mut bus.delay()).unwrap_err().fault(),
        ReadFault::WrongId
    );
    bus.machine()
        .spoil(ICM, |q| (q.wrong_id, q.mag_dead) = (None, true));
    let error = imu.init(&mut bus.delay()).unwrap_err();
    assert_eq!(
        error,
        ImuError::Nack(Chip {
            part: Part::Ak09916,
            address: 0x0C
        })
    );
    bus.machine().spoil(ICM, |q| q.mag_dead = false);
    imu.init(&mut bus.delay()).unwrap();
}

#[test]
fn a_magnetometer_that_another_program_configured_is_taken_over() {
    let (bus, mut imu) = running_icm();
    next(&bus, &mut imu).unwrap();
    let slow = icm20948::IcmConfig {
        mag_rate_hz: 10,
        rate_hz: 200.0,
        ..Default::default()
    };
    let mut second = Icm20948::new(bus.clone(), &slow).unwrap();
    second.init(&mut bus.delay()).unwrap();
    let mut fresh = 0;
    for _ in 0..400 {
        bus.machine().advance(0.005);
        fresh += u32::from(second.read().unwrap().mag.is_some());
    }
    assert!((18..=22).contains(&fresh), "two seconds at 10 Hz: {fresh}");
}

#[test]
fn bypass_connects_the_magnetometer_to_the_bus() {
    let bus = icm_bus(Noise::NONE);
    let mut id = [0];
    assert!(bus.machine().write(0x0C, &[0x01]).is_err(), "hidden");
    bus.machine().write(ICM, &[0x0F, 0x02]).unwrap();
    bus.machine().write(0x0C, &[0x01]).unwrap();
    bus.machine().read(0x0C, &mut id).unwrap();
    assert_eq!(id, [0x09]);
}

// ------------------------------------------------- from a faulty chip to the health monitor

/// The causes that the health monitor raises within a second of a fault of the chip or the bus.
fn seen_after(spoil: impl Fn(&FakeBus)) -> Vec<HealthCause> {
    let (bus, mut imu) = running_icm();
    let (config, mut monitor) = (Default::default(), SensorMonitor::default());
    let rest = Motion::default();
    let rest = Alignment {
        acc_rest_m_s2: rest.acc_m_s2,
        mag_rest_ut: Some(rest.mag_ut),
        ..Alignment::default()
    };
    monitor.set_known(KnownErrors::default(), &rest);
    let mut seen = Vec::new();
    for n in 1..=1000_u32 {
        if n == 500 {
            assert!(seen.is_empty(), "false alarm: {seen:?}");
            spoil(&bus);
        }
        let now = Seconds(f64::from(n) * 0.002);
        let reading = match next(&bus, &mut imu) {
            Ok(raw) => ImuReading::Sample(imu.scale().sample(&raw, now), raw.quality()),
            Err(error) => ImuReading::Failed(error.fault()),
        };
        seen.extend(monitor.assess(&config, now, &reading).raised.iter());
    }
    seen
}

#[test]
fn every_fault_of_a_chip_is_named_by_the_health_monitor() {
    use HealthCause::*;
    assert_eq!(seen_after(|_| ()), []);
    assert_eq!(seen_after(|b| b.machine().nack(ICM, 5)), [Nack]);
    assert_eq!(
        seen_after(|b| b.machine().nack(ICM, u32::MAX)),
        [Nack, StuckBus]
    );
    assert_eq!(seen_after(|b| b.machine().stuck = true), [Nack, StuckBus]);
    assert_eq!(seen_after(|b| b.machine().shorten(ICM, 9)), [ShortRead]);
    assert_eq!(seen_after(|b| b.machine().brown_out()), [BrownOut]);
    assert_eq!(
        seen_after(|b| b.machine().spoil(ICM, |q| q.frozen = true)),
        [Frozen, MagSilent]
    );
    assert_eq!(
        seen_after(|b| b.machine().spoil(ICM, |q| q.mag_dead = true)),
        [MagSilent]
    );
    assert_eq!(
        seen_after(|b| b.machine().spoil(ICM, |q| q.mag_overflow = true)),
        [MagOverflow]
    );
    let saturated = seen_after(|b| b.machine().spoil(ICM, |q| q.saturate = true));
    assert!(
        saturated.contains(&Saturated) && saturated.contains(&AccelDisturbed),
        "{saturated:?}"
    );
    let spike = seen_after(|b| b.machine().spoil(ICM, |q| q.spike = Some(20_000)));
    assert_eq!(spike, [Spike, AccelDisturbed]);
    let bent = Motion {
        mag_ut: Vector3::new(60.0, 10.0, -45.0),
        ..Motion::default()
    };
    assert_eq!(
        seen_after(move |b| b.machine().set_motion(&bent)),
        [FieldDisturbed]
    );
    let pushed = Motion {
        acc_m_s2: Vector3::new(6.0, 0.0, 9.81),
        ..Motion::default()
    };
    assert_eq!(
        seen_after(move |b| b.machine().set_motion(&pushed))[0],
        AccelDisturbed
    );
}

// --------------------------------------------------------------------------- calibration chain

/// A sensor with errors rests and is tumbled; the calibration from these recordings corrects it.
#[test]
fn a_sensor_with_errors_is_calibrated_through_the_driver() {
    let hard_ut = Vector3::new(-120.0, 80.0, 160.0);
    let soft = Matrix3::new(1.08, 0.03, 0.0, 0.03, 0.94, -0.02, 0.0, -0.02, 1.0);
    let gyro_bias = Vector3::new(0.02, -0.03, 0.01);
    let flawed = |attitude: &Rotation3<f64>, rate: Vector3<f64>| Motion {
        acc_m_s2: attitude.inverse() * Vector3::new(0.0, 0.0, 9.81),
        gyro_rad_s: rate + gyro_bias,
        mag_ut: soft * (attitude.inverse() * Vector3::new(20.0, 0.0, -45.0)) + hard_ut,
        temp_c: 25.0,
    };
    let (bus, mut imu) = running_icm();
    let mut record = |n: u32, rate: &dyn Fn(f64) -> Vector3<f64>| {
        let mut attitude = Rotation3::identity();
        let mut samples = Vec::new();
        for k in 1..=n {
            let t = f64::from(k) * 0.002;
            attitude *= Rotation3::new(rate(t) * 0.002);
            bus.machine().set_motion(&flawed(&attitude, rate(t)));
            let raw = next(&bus, &mut imu).unwrap();
            samples.push(imu.scale().sample(&raw, Seconds(t)));
        }
        samples
    };
    let rest = record(1500, &|_| Vector3::zeros());
    let tumble = record(20_000, &|t| {
        Vector3::new(1.1, 0.9 * (0.31 * t).sin(), 0.8 * (0.17 * t).cos())
    });

    let from = Pedigree {
        date: "2025-01-31",
        source: "fake",
    };
    let mut calibration = ImuCalibration::default();
    calibration.set_gyro(&imu_calibration::gyro::at_rest(&rest).unwrap(), from);
    let field: Vec<_> = tumble.iter().filter_map(|s| s.mag_ut).collect();
    calibration.set_mag(&imu_calibration::mag::ellipsoid(&field).unwrap(), from);
    let text = toml::to_string(&calibration).unwrap();
    let correction = toml::from_str::<ImuCalibration>(&text)
        .unwrap()
        .correction();

    let norm_spread = |samples: &mut dyn Iterator<Item = Vector3<f64>>| {
        let norms: Vec<f64> = samples.map(|m| m.norm()).collect();
        let mean = norms.iter().sum::<f64>() / norms.len() as f64;
        (norms.iter().map(|n| (n / mean - 1.0).powi(2)).sum::<f64>() / norms.len() as f64).sqrt()
    };
    let before = norm_spread(&mut field.iter().copied());
    let after = norm_spread(&mut tumble.iter().filter_map(|s| correction.apply(s).mag_ut));
    assert!(
        before > 0.1 && after < 0.012,
        "{before} {after}: what remains is the noise of 0.5 of 49 uT"
    );
    assert!((correction.gyro.bias - gyro_bias).amax() < 4e-4);
    assert!(
        (correction.mag.bias - hard_ut).amax() < 0.2,
        "{}",
        correction.mag.bias
    );
    let still: Vec<_> = rest
        .iter()
        .filter_map(|s| correction.apply(s).mag_ut)
        .collect();
    let mean = still.iter().sum::<Vector3<f64>>() / still.len() as f64;
    let angle = mean.angle(&Vector3::new(20.0, 0.0, -45.0)).to_degrees();
    // 0.29° to 0.45° over 18 seeds of the noise
    assert!(
        angle < 0.6,
        "direction of the field restored, axes and all: {angle} deg off"
    );
}

// --------------------------------------------------------------------------------- pressure

#[test]
fn pressure_sensors_send_the_bytes_of_their_data_sheets() {
    // 90 % of the counts are the upper end of the range, half of them its middle
    let at = |counts: u32, status: u8| {
        let [_, high, middle, low] = counts.to_be_bytes();
        [
            Transaction::write(0x28, vec![0xAA, 0x00, 0x00]),
            Transaction::read(0x28, vec![status, high, middle, low]),
        ]
    };
    let script = [
        at(15_099_494, 0x40),
        at(8_388_608, 0x40),
        at(8_388_608, 0x60),
        at(8_388_608, 0x44),
        at(8_388_608, 0x00),
    ]
    .concat();
    let mut bus = Mock::new(&script);
    let mut sensor = PressureSensor::new(bus.clone(), &PressureSection::default(), 1);
    let mut read = || {
        sensor.start().unwrap();
        sensor.fetch()
    };
    assert!((read().unwrap() - 100.0).abs() < 1e-9 && read().unwrap().abs() < 1e-4);
    for status in [0x60, 0x44, 0x00] {
        assert_eq!(
            read(),
            Err(PressureError::Status(0x28, status)),
            "busy, memory error, no power"
        );
    }
    bus.done();
}

#[test]
fn pressure_sensors_measure_either_sign_and_tell_a_fault_from_a_missing_part() {
    let bus = FakeBus::new();
    bus.machine().attach(FakePressure::new(0x18).at(41.3));
    bus.machine()
        .attach(FakePressure::new(0x28).at(-38.5).with_fault(0x00));
    bus.machine()
        .attach(FakePressure::new(0x38).with_fault(0x04));
    let read = |channel| {
        let mut sensor = PressureSensor::new(bus.clone(), &PressureSection::default(), channel);
        sensor.start()?;
        let early = sensor.fetch();
        assert!(
            matches!(early, Err(PressureError::Status(..))),
            "a conversion takes 5 ms: {early:?}"
        );
        bus.machine().advance(0.006);
        sensor.fetch()
    };
    assert!((read(0).unwrap() - 41.3).abs() < 1e-4 && (read(1).unwrap() + 38.5).abs() < 1e-4);
    assert_eq!(read(2), Err(PressureError::Status(0x38, 0x44)));
    bus.machine().nack(0x18, 1);
    assert_eq!(read(0), Err(PressureError::Bus(0x18)));
}

// ----------------------------------------------------------------------------------- oracle

/// The bus and its clock for a driver that awaits; no future of theirs is ever pending.
struct Awaited<T>(T);

impl embedded_hal_async::i2c::ErrorType for Awaited<FakeBus> {
    type Error = FakeBusError;
}

impl embedded_hal_async::i2c::I2c for Awaited<FakeBus> {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), FakeBusError> {
        let [Operation::Write(register), Operation::Write(data)] = operations else {
            return self.0.transaction(address, operations);
        };
        // one write on the wire, without a restart
        self.0.write(address, &[*register, *data].concat())
    }
}

impl embedded_hal_async::delay::DelayNs for Awaited<FakeDelay> {
    async fn delay_ns(&mut self, ns: u32) {
        self.0.delay_ns(ns);
    }
}

fn finished<T>(future: impl Future<Output = T>) -> T {
    let mut waker = Context::from_waker(Waker::noop());
    match pin!(future).poll(&mut waker) {
        Poll::Ready(result) => result,
        Poll::Pending => unreachable!("nothing here waits"),
    }
}

/// The published driver and ours read one fake each, in the same motion.
#[test]
fn a_published_driver_reads_the_same_numbers() {
    use icm20948_async::{AccRange, AccUnit, GyrRange, GyrUnit, IcmBuilder};
    let acc_ranges = [AccRange::Gs2, AccRange::Gs4, AccRange::Gs8, AccRange::Gs16];
    let gyro_ranges = [
        GyrRange::Dps250,
        GyrRange::Dps500,
        GyrRange::Dps1000,
        GyrRange::Dps2000,
    ];
    let motion = odd_motion();
    for (i, (acc_range, gyro_range)) in acc_ranges.into_iter().zip(gyro_ranges).enumerate() {
        let bus = icm_bus(Noise::NONE);
        bus.machine().set_motion(&motion);
        let theirs = IcmBuilder::new_i2c(Awaited(bus.clone()), Awaited(bus.delay()))
            .set_address(ICM)
            .acc_range(acc_range)
            .acc_unit(AccUnit::Gs)
            .gyr_range(gyro_range)
            .gyr_unit(GyrUnit::Rps);
        let mut theirs = finished(theirs.initialize_9dof()).unwrap();
        bus.machine().advance(0.1);
        let read = finished(theirs.read_9dof_unscaled()).unwrap();

        let bus = icm_bus(Noise::NONE);
        bus.machine().set_motion(&motion);
        let config = icm20948::IcmConfig {
            acc_range_g: 2 << i,
            gyro_range_dps: 250 << i,
            ..Default::default()
        };
        let mut ours = Icm20948::new(bus.clone(), &config).unwrap();
        ours.init(&mut bus.delay()).unwrap();
        bus.machine().advance(0.1);
        let raw = ours.read().unwrap();
        let s = ours.scale().sample(&raw, Seconds(0.0));

        // counts per g and per °/s as the data sheet lists them; the magnetometer has 0.15 µT a count
        let (per_g, per_dps) = (16_384.0 / f64::from(1 << i), [131.0, 65.5, 32.8, 16.4][i]);
        let counts = |v: [i16; 3]| Vector3::from(v).map(f64::from);
        let theirs_acc = counts(read.acc) * STANDARD_GRAVITY_M_S2 / per_g;
        let theirs_gyro = counts(read.gyr) * 1_f64.to_radians() / per_dps;
        let theirs_mag = counts(read.mag) * 0.15; // they leave it in its own axes
        let t = f64::from(read.tmp) / 333.87 + 21.0;
        assert!(
            (s.acc_m_s2 - theirs_acc).amax() < 1e-12,
            "{} {theirs_acc}",
            s.acc_m_s2
        );
        assert!(
            (s.gyro_rad_s - theirs_gyro).amax() < 1e-12,
            "{} {theirs_gyro}",
            s.gyro_rad_s
        );
        let ours_mag = s.mag_ut.unwrap();
        assert!(
            (ours_mag - Axes::AK09916.to_frame(&theirs_mag)).amax() < 1e-4,
            "{ours_mag} {theirs_mag}"
        );
        assert!((ours.scale().temperature_c(&raw) - t).abs() < 1e-3);
    }
}
