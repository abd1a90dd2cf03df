//! Commissioning and homing on simulated machines with wrong wiring, leaks, or home switches.

use crate::common::plant;
use nalgebra::{UnitQuaternion, Vector3};
use retroflex::motion::lines::Inputs;
use retroflex::motion::machine::{Machine, MachineError, MachineInfo, Sensed};
use retroflex::primitives::ImuReading;
use retroflex::primitives::units::{Seconds, Steps};
use retroflex::simulation::lockstep::Lockstep;
use retroflex::simulation::plant::PlantConfig;
use retroflex::simulation::sim::Sim;
use retroflex::supervisor::commission::homing::{self, Homed, HomingConfig, HomingError};
use retroflex::supervisor::commission::manual_motion::{ManualMotion, ManualMotionError};
use retroflex::supervisor::commission::trial::{self, Findings, TrialConfig, TrialError};

/// A simulated machine with exchanged lines, inverted motors, a rotated sensor or a cut line.
struct Miswired {
    inner: Lockstep<Sim>,
    reaches: [usize; 3],
    inverted: [bool; 3],
    turned_rad: f64,
    cut: Option<usize>,
    pressed_after_s: f64,
}

fn machine(change: impl FnOnce(&mut PlantConfig)) -> Miswired {
    let section = plant();
    let mut make = section.clone();
    change(&mut make);
    let inner = Lockstep::new(
        Sim::new(&make, 0, 7, section.period_s).unwrap(),
        &crate::common::twin().drive_limits(),
    );
    Miswired {
        inner,
        reaches: [0, 1, 2],
        inverted: [false; 3],
        turned_rad: 0.0,
        cut: None,
        pressed_after_s: f64::MAX,
    }
}

impl Machine for Miswired {
    fn info(&self) -> &MachineInfo {
        self.inner.info()
    }
    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, MachineError> {
        let mut there = [0; 3];
        for i in 0..3 {
            let n = if self.inverted[i] {
                -wanted.0[i]
            } else {
                wanted.0[i]
            };
            there[self.reaches[i]] = if self.cut == Some(i) { 0 } else { n };
        }
        let mut sensed = self.inner.turn(now, &Steps(there))?;
        // the steps that were made, whatever they caused
        sensed.counted = *wanted;
        if let ImuReading::Sample(s, _) = &mut sensed.imu {
            let r = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -self.turned_rad);
            (s.gyro_rad_s, s.acc_m_s2) = (r * s.gyro_rad_s, r * s.acc_m_s2);
        }
        sensed.inputs.emergency_stop = now.0 > self.pressed_after_s;
        Ok(sensed)
    }
    fn energise(&mut self, on: bool) {
        self.inner.energise(on);
    }
    fn recount(&mut self, counted: &Steps) {
        self.inner.recount(counted);
    }
    fn clear(&mut self) {}
    fn is_simulated(&self) -> bool {
        true
    }
    fn remarks(&self) -> Vec<String> {
        vec![]
    }
}

fn commission(mut m: Miswired, hold_s: f64) -> Result<Findings, TrialError> {
    let geometry = crate::common::twin().geometry.law();
    let mut wait = |next| Some(next);
    trial::run(
        &mut ManualMotion::new(&mut m, &mut wait),
        &TrialConfig {
            geometry,
            stroke_mm: 3.0,
            hold_s,
        },
        &mut |_| (),
    )
}

#[test]
fn a_machine_wired_according_to_the_board_file_passes() {
    let f = commission(machine(|_| ()), 10.0).unwrap();
    println!("{}", f.report());
    assert!(f.is_good(), "{}", f.report());
}

#[test]
fn wrong_wiring_is_identified() {
    type Spoil = fn(&mut Miswired);
    let cases: [(Spoil, &str); 5] = [
        (
            |m| m.reaches = [0, 2, 1],
            "line 2 reaches bellow 3; line 3 reaches bellow 2",
        ),
        (
            |m| m.inverted = [false, false, true],
            "motor 3 turns in the wrong direction",
        ),
        (
            |m| (m.reaches, m.inverted) = ([1, 0, 2], [true, false, false]),
            "line 1 reaches bellow 2; line 2 reaches bellow 1; motor 1 turns in the wrong direction",
        ),
        (|m| m.reaches = [1, 2, 0], "line 1 reaches bellow 2"),
        (|m| m.turned_rad = -0.8, "the sensor is turned by -4"),
    ];
    for (spoil, words) in cases {
        let mut m = machine(|_| ());
        spoil(&mut m);
        let f = commission(m, 0.0).unwrap();
        assert!(
            !f.is_good() && f.report().contains(words),
            "`{words}` is not in:\n{}",
            f.report()
        );
    }
    let cut = Miswired {
        cut: Some(1),
        ..machine(|_| ())
    };
    let f = commission(cut, 0.0).unwrap();
    assert!(
        f.report().contains("channel 2: NO MOTION") && f.wirings.is_empty(),
        "{}",
        f.report()
    );
}

#[test]
fn a_leak_is_attributed_to_its_line_only() {
    for (channel, rate) in [(0, 0.02), (2, 0.05)] {
        let m = machine(|c| c.effects.leak.as_mut().unwrap().rate_per_s[channel] = rate);
        let f = commission(m, 10.0).unwrap();
        assert_eq!(f.leaks(), [0, 1, 2].map(|i| i == channel), "{}", f.report());
        let found = f.leak_per_s[channel].unwrap();
        assert!(
            found > 0.3 * rate && found < 1.5 * rate,
            "{rate} per second, measured {found}"
        );
    }
}

#[test]
fn the_emergency_stop_and_the_caller_can_end_a_move() {
    let m = Miswired {
        pressed_after_s: 1.5,
        ..machine(|_| ())
    };
    assert!(matches!(
        commission(m, 0.0),
        Err(TrialError::Motion(ManualMotionError::EmergencyStop))
    ));
    let mut m = machine(|_| ());
    let mut wait = |next: Seconds| (next.0 < 0.5).then_some(next);
    let mut hand = ManualMotion::new(&mut m, &mut wait);
    hand.energise(true).unwrap();
    assert!(matches!(
        hand.go([5.0; 3], 1.0, &mut |_| false),
        Err(ManualMotionError::Cancelled)
    ));
    assert!(hand.stands_mm()[0] < 0.6, "half a second at 1 mm/s");
}

/// Three racks with home switches. The counts do not contain the initial positions.
struct Racks {
    info: MachineInfo,
    start_mm: [f64; 3],
    zero: [i32; 3],
    counted: [i32; 3],
    on: bool,
    /// Position at which the switches close, mm; every second closing differs by `play_mm`.
    closes_mm: f64,
    play_mm: f64,
    closings: u32,
    closed: [bool; 3],
    stuck: bool,
}

impl Racks {
    fn new(start_mm: [f64; 3]) -> Self {
        let info = MachineInfo {
            name: "racks".into(),
            period_s: 0.002,
            step_mm: 0.029_452,
            rest_length_mm: 20.0,
        };
        Self {
            info,
            start_mm,
            zero: [0; 3],
            counted: [0; 3],
            on: false,
            closes_mm: -30.0,
            play_mm: 0.0,
            closings: 0,
            closed: [false; 3],
            stuck: false,
        }
    }
    fn stands_mm(&self) -> [f64; 3] {
        [0, 1, 2].map(|i| {
            self.start_mm[i] + f64::from(self.counted[i] - self.zero[i]) * self.info.step_mm
        })
    }
}

impl Machine for Racks {
    fn info(&self) -> &MachineInfo {
        &self.info
    }
    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, MachineError> {
        if self.on {
            // at most 30 mm/s, like real hardware
            for i in 0..3 {
                self.counted[i] += (wanted.0[i] - self.counted[i]).clamp(-2, 2);
            }
        }
        let home = [0, 1, 2].map(|i| {
            let edge = self.closes_mm
                + if self.closings % 2 == 1 {
                    self.play_mm
                } else {
                    0.0
                };
            let closed = self.stuck || self.stands_mm()[i] <= edge;
            self.closings += u32::from(closed && !self.closed[i]);
            self.closed[i] = closed;
            closed
        });
        let inputs = Inputs {
            emergency_stop: false,
            home,
        };
        let (counted, energised) = (Steps(self.counted), self.on);
        Ok(Sensed {
            t: now,
            imu: ImuReading::Nothing,
            base_imu: None,
            counted,
            counted_age_s: 0.0,
            energised,
            inputs,
            alarm: None,
            gauges: Default::default(),
            truth: None,
        })
    }
    fn energise(&mut self, on: bool) {
        self.on = on;
    }
    fn recount(&mut self, counted: &Steps) {
        for i in 0..3 {
            self.zero[i] += counted.0[i] - self.counted[i];
            self.counted[i] = counted.0[i];
        }
    }
    fn clear(&mut self) {}
    fn is_simulated(&self) -> bool {
        true
    }
    fn remarks(&self) -> Vec<String> {
        vec![]
    }
}

fn home(racks: &mut Racks) -> Result<Homed, HomingError> {
    let config = HomingConfig {
        speed_mm_s: 4.0,
        back_off_mm: 2.0,
        repeat_max_mm: 0.09,
        at_mm: [-30.0; 3],
        ..HomingConfig::default()
    };
    let mut wait = |next| Some(next);
    let mut hand = ManualMotion::new(racks, &mut wait);
    hand.energise(true).unwrap();
    homing::with_switches(&mut hand, &config, 62.0)
}

#[test]
fn homing_finds_zero_from_any_position() {
    for start_mm in [
        [0.0, 3.0, -12.0],
        [25.0, -30.5, 30.0],
        [-29.99, -31.0, 7.77],
    ] {
        let mut racks = Racks::new(start_mm);
        let homed = home(&mut racks).unwrap();
        for i in 0..3 {
            assert!(
                racks.stands_mm()[i].abs() < 0.06,
                "{start_mm:?}: at {:?}",
                racks.stands_mm()
            );
            assert!(
                (homed.moved_mm[i] - start_mm[i]).abs() < 0.06 && homed.repeat_mm[i] < 0.04,
                "{homed:?}"
            );
            assert_eq!(racks.counted[i], 0);
        }
    }
}

#[test]
fn faulty_switches_are_identified() {
    let mut never = Racks {
        closes_mm: -200.0,
        ..Racks::new([0.0; 3])
    };
    assert!(
        home(&mut never)
            .unwrap_err()
            .to_string()
            .contains("channel 1 did not close within 62 mm")
    );
    let mut stuck = Racks {
        stuck: true,
        ..Racks::new([0.0; 3])
    };
    assert!(
        home(&mut stuck)
            .unwrap_err()
            .to_string()
            .contains("channel 1 stays closed")
    );
    let mut loose = Racks {
        play_mm: 0.4,
        ..Racks::new([0.0; 3])
    };
    let words = home(&mut loose).unwrap_err().to_string();
    assert!(
        words.contains("mm apart") && words.contains("repeat_max_mm"),
        "{words}"
    );
}
