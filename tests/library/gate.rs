//! The safety gate: each limit is tested just inside and just outside, so that every change of the gate fails a test
//! (`.ci/mutants` checks this).

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use retroflex::primitives::units::Steps;
use retroflex::supervisor::gate::{
    Following, Gate, GateInput, GateLimits, GateOutput, SafeState, SafeStates, TripCause,
};
use std::ops::{Deref, DerefMut};

const DT: f64 = 1e-3;

fn limits() -> GateLimits {
    GateLimits {
        step_mm: 0.03,
        tick_s: DT,
        travel_mm: 30.0,
        speed_mm_s: 34.5,
        acceleration_mm_s2: 1200.0,
        squeeze_mm: 29.5,
        following_rad: 0.35,
        following_s: 0.4,
        following_for_s: 0.5,
        stale_s: 0.5,
        late_s: 0.05,
        react_s: 0.0,
        rest_s: 0.0,
        brake_mm_s2: 600.0,
        relax_mm_s: 8.0,
        on: SafeStates::default(),
    }
}

fn request(wanted: [i32; 3]) -> GateInput {
    GateInput {
        dt_s: DT,
        wanted: Steps(wanted),
        counted: Steps::default(),
        counted_age_s: 0.0,
        armed: true,
        estimated_bellow_mm: None,
        following: None,
        stale_s: 0.0,
        disagree: false,
        emergency_stop: false,
        alarm: false,
        overpressure: false,
        hot: false,
    }
}

/// A gate and a machine that has counted what was sent by the next tick.
struct Follower {
    gate: Gate,
    counted: Steps,
}

impl Follower {
    /// With the pistons at rest at these counts.
    fn new(limits: &GateLimits, at: &Steps) -> Self {
        Self {
            gate: Gate::new(limits, at),
            counted: *at,
        }
    }

    fn pass(&mut self, t: &GateInput) -> GateOutput {
        let output = self.gate.pass(&GateInput {
            counted: self.counted,
            ..*t
        });
        self.counted = output.steps;
        output
    }
}

impl Deref for Follower {
    type Target = Gate;
    fn deref(&self) -> &Gate {
        &self.gate
    }
}

impl DerefMut for Follower {
    fn deref_mut(&mut self) -> &mut Gate {
        &mut self.gate
    }
}

/// Pistons at rest at these counts.
fn at(counts: i32) -> Follower {
    Follower::new(&limits(), &Steps([counts; 3]))
}

fn trips(gate: &mut Follower, t: &GateInput) -> Option<TripCause> {
    gate.pass(t).tripped
}

/// Moves channel `i` with a constant speed (mm/s) after a slow start; returns the first trip.
fn steady(gate: &mut Follower, i: usize, speed_mm_s: f64, seconds: f64) -> Option<TripCause> {
    let (mut mm, mut v) = (0.0, 0.0f64);
    for _ in 0..(seconds / DT) as usize {
        v = (v + 500.0 * DT).min(speed_mm_s);
        mm += v * DT;
        let mut wanted = [0; 3];
        wanted[i] = (mm / 0.03f64).round() as i32;
        if let Some(cause) = trips(gate, &request(wanted)) {
            return Some(cause);
        }
    }
    None
}

/// A gate whose pistons move at 20 mm/s, and their counts.
fn moving() -> (Follower, i32) {
    let mut gate = at(0);
    assert_eq!(steady(&mut gate, 0, 20.0, 0.3), None);
    let counts = gate.pass(&request([188, 0, 0]));
    assert_eq!(counts.tripped, None);
    (gate, 188)
}

#[test]
fn requests_within_all_limits_pass_unchanged() {
    let mut gate = at(0);
    let output = gate.pass(&request([0, 0, 0]));
    assert_eq!(
        output,
        GateOutput {
            steps: Steps([0; 3]),
            energise: true,
            tripped: None,
            rested: false
        }
    );
    for i in 0..3 {
        let mut gate = at(0);
        assert_eq!(steady(&mut gate, i, 30.0, 0.6), None);
        assert!(!gate.is_busy() && gate.latched().is_none());
    }
}

#[test]
fn travel_trips_beyond_the_limit_on_every_channel_and_side() {
    for i in 0..3 {
        for side in [-1, 1] {
            let mut counts = [0; 3];
            counts[i] = side * 999;
            let mut gate = Follower::new(&limits(), &Steps(counts));
            counts[i] = side * 1000;
            assert_eq!(
                trips(&mut gate, &request(counts)),
                None,
                "30.0 mm is permitted"
            );
            counts[i] = side * 1001;
            let output = gate.pass(&request(counts));
            assert_eq!(output.tripped, Some(TripCause::Travel));
            assert_eq!(
                output.steps.0[i],
                side * 1000,
                "the violating counts are not sent"
            );
        }
    }
}

#[test]
fn speed_trips_above_its_limit_plus_one_step_of_resolution() {
    // the limit is 18.4 steps per window of 16 ms, plus one step of resolution
    assert_eq!(steady(&mut at(0), 1, 34.4, 0.5), None);
    assert_eq!(steady(&mut at(0), 2, 38.5, 0.5), Some(TripCause::Rate));
    let mut gate = at(0);
    assert_eq!(
        trips(&mut gate, &request([0, 0, 14])),
        None,
        "a request is not a motion yet"
    );
    assert_eq!(
        trips(&mut gate, &request([0, 0, 14])),
        Some(TripCause::Acceleration),
        "a jump first exceeds the acceleration"
    );
}

#[test]
fn speed_uses_the_true_duration_of_the_window() {
    // counts spread over slow ticks are slow: 64 ticks of 2 ms with 1 step each
    let mut gate = at(0);
    for k in 1..=64 {
        let t = GateInput {
            dt_s: 2.0 * DT,
            ..request([k, 0, 0])
        };
        assert_eq!(trips(&mut gate, &t), None, "tick {k}");
    }
    // the same counts in half the time exceed a limit
    let mut gate = at(0);
    let first = (1..=64).find_map(|k| {
        trips(
            &mut gate,
            &GateInput {
                dt_s: DT / 2.0,
                ..request([k, 0, 0])
            },
        )
    });
    assert!(first.is_some());
}

/// A long tick at a constant speed is not an acceleration, neither within the two windows nor after it has left them.
#[test]
fn a_long_tick_at_a_constant_speed_is_not_an_acceleration() {
    let mut gate = Gate::new(
        &GateLimits {
            acceleration_mm_s2: 300.0,
            ..limits()
        },
        &Steps([0; 3]),
    );
    let (mut mm, mut v) = (0.0, 0.0f64);
    for tick in 0..400 {
        let dt_s = if tick == 250 { 0.045 } else { DT };
        v = (v + 200.0 * dt_s).min(30.0);
        mm += v * dt_s;
        // the counts of this very tick
        let counts = [(mm / 0.03f64).round() as i32, 0, 0];
        let t = GateInput {
            dt_s,
            counted: Steps(counts),
            ..request(counts)
        };
        assert_eq!(gate.pass(&t).tripped, None, "tick {tick}");
    }
}

/// The step thread stands still for 14 ms and then catches up at the speed of its shortest interval.
#[test]
fn a_step_thread_that_catches_up_is_not_fast() {
    const TOP_MM_S: f64 = 30.0;
    let stall = |age_is_known: bool| {
        let mut gate = Gate::new(
            &GateLimits {
                acceleration_mm_s2: 300.0,
                ..limits()
            },
            &Steps([0; 3]),
        );
        // plan and what is made of it, as times on the plan; the thread is 14 ms behind and gains a quarter of each tick
        let (mut planned_s, mut made_s) = (0.0f64, 0.0f64);
        (0..600).find_map(|tick| {
            planned_s += DT;
            made_s = if (300..314).contains(&tick) {
                made_s
            } else {
                (made_s + 1.25 * DT).min(planned_s)
            };
            let speeding_s = TOP_MM_S / 200.0;
            let travelled_mm = if made_s < speeding_s {
                100.0 * made_s * made_s
            } else {
                TOP_MM_S * (made_s - speeding_s / 2.0)
            };
            let counts = [(travelled_mm / 0.03).floor() as i32, 0, 0];
            let counted_age_s = if age_is_known {
                planned_s - made_s
            } else {
                0.0
            };
            gate.pass(&GateInput {
                counted: Steps(counts),
                counted_age_s,
                ..request(counts)
            })
            .tripped
        })
    };
    assert_eq!(stall(true), None);
    assert_eq!(
        stall(false),
        Some(TripCause::Acceleration),
        "the age makes the difference"
    );
}

/// A jump of the counts is fast, whatever age they claim.
#[test]
fn a_jump_of_old_counts_trips() {
    for age_s in [0.0, 0.004, -0.0005] {
        let mut gate = at(0);
        let first = (1..=40).find_map(|k| {
            let counts = if k > 20 { [60, 0, 0] } else { [0; 3] };
            gate.pass(&GateInput {
                counted: Steps(counts),
                counted_age_s: age_s,
                ..request(counts)
            })
            .tripped
        });
        assert!(first.is_some(), "age {age_s} s");
    }
}

#[test]
fn acceleration_trips_at_a_start_and_at_a_reversal() {
    // from rest, n steps within a window are n·0.03/0.016² mm/s², minus two steps of resolution
    let push = |n: i32| {
        let mut gate = at(0);
        (1..=17).find_map(|k| trips(&mut gate, &request([n * k.min(16) / 16, 0, 0])))
    };
    assert_eq!(push(11), None);
    assert_eq!(push(13), Some(TripCause::Acceleration));
    let (mut gate, mut counts) = moving();
    let reversal = (0..40).find_map(|k| {
        counts -= i32::from(k % 2 == 0);
        trips(&mut gate, &request([counts, 0, 0]))
    });
    assert_eq!(reversal, Some(TripCause::Acceleration));
}

#[test]
fn pressure_trips_on_motion_only() {
    let estimate = |mm: f64| Some([0.0, mm, 0.0]);
    for (side, channel) in [(1, 1usize), (-1, 1)] {
        let mut gate = Follower::new(&limits(), &Steps([0, side * 900, 0]));
        let mut counts = [0, side * 900, 0];
        let t = GateInput {
            estimated_bellow_mm: estimate(-2.6 * f64::from(side)),
            ..request(counts)
        };
        assert_eq!(
            trips(&mut gate, &t),
            None,
            "an existing 29.6 mm does not trip"
        );
        counts[channel] += side;
        let t = GateInput {
            estimated_bellow_mm: estimate(-2.4 * f64::from(side)),
            ..request(counts)
        };
        assert_eq!(trips(&mut gate, &t), None, "29.43 mm is permitted");
        counts[channel] += side;
        let t = GateInput {
            estimated_bellow_mm: estimate(-2.5 * f64::from(side)),
            ..request(counts)
        };
        assert_eq!(trips(&mut gate, &t), Some(TripCause::Pressure));
    }
}

#[test]
fn pressure_relaxes_and_releases_at_zero() {
    let mut gate = at(100);
    let t = GateInput {
        estimated_bellow_mm: Some([-40.0, 3.0, 3.0]),
        ..request([101, 100, 100])
    };
    let output = gate.pass(&t);
    assert_eq!(
        (output.tripped, output.energise),
        (Some(TripCause::Pressure), true)
    );
    assert!(gate.is_busy());
    let ticks = (0..10_000)
        .find(|_| gate.pass(&request([0; 3])).rested)
        .unwrap();
    // 3 mm at 8 mm/s, braking on √(600 s): between 0.37 and 0.6 s
    assert!((370..600).contains(&ticks), "{ticks}");
    let output = gate.pass(&request([50; 3]));
    assert_eq!(
        (output.steps, output.energise, output.rested),
        (Steps([0; 3]), false, false)
    );
    assert_eq!(gate.latched(), Some(TripCause::Pressure));
    assert!(!gate.is_busy());
}

#[test]
fn lateness_trips_above_its_limit_and_on_nan() {
    for (dt_s, cause) in [
        (0.05, None),
        (0.0501, Some(TripCause::Late)),
        (f64::NAN, Some(TripCause::Late)),
    ] {
        let mut gate = at(5);
        let output = gate.pass(&GateInput {
            dt_s,
            ..request([5; 3])
        });
        assert_eq!(
            (output.tripped, output.steps),
            (cause, Steps([5; 3])),
            "{dt_s}"
        );
        let next = gate.pass(&request([5; 3]));
        assert_eq!((next.tripped, next.steps), (None, Steps([5; 3])));
    }
}

#[test]
fn unarmed_motion_trips() {
    for i in 0..3 {
        let mut gate = at(7);
        assert_eq!(
            trips(
                &mut gate,
                &GateInput {
                    armed: false,
                    ..request([7; 3])
                }
            ),
            None
        );
        let mut counts = [7; 3];
        counts[i] += 1;
        let output = gate.pass(&GateInput {
            armed: false,
            ..request(counts)
        });
        assert_eq!(
            (output.tripped, output.steps),
            (Some(TripCause::Unarmed), Steps([7; 3]))
        );
    }
}

#[test]
fn staleness_and_disagreement_trip_only_while_armed() {
    let cases: [(f64, bool, Option<TripCause>); 4] = [
        (0.5, false, None),
        (0.501, false, Some(TripCause::Stale)),
        (0.0, true, Some(TripCause::Disagreement)),
        (0.6, true, Some(TripCause::Stale)),
    ];
    for (stale_s, disagree, cause) in cases {
        assert_eq!(
            trips(
                &mut at(0),
                &GateInput {
                    stale_s,
                    disagree,
                    ..request([0; 3])
                }
            ),
            cause
        );
        assert_eq!(
            trips(
                &mut at(0),
                &GateInput {
                    stale_s,
                    disagree,
                    armed: false,
                    ..request([0; 3])
                }
            ),
            None
        );
    }
}

/// Ticks until the gate trips on an estimate with this error (rad), at most two seconds.
fn astray(gate: &mut Follower, off: [f64; 2], armed: bool) -> Option<(usize, TripCause)> {
    let following = Some(Following {
        setpoint: [0.5, -0.2],
        estimate: [0.5 + off[0], -0.2 + off[1]],
    });
    (1..=2000).find_map(|k| {
        trips(
            gate,
            &GateInput {
                following,
                armed,
                ..request([0; 3])
            },
        )
        .map(|c| (k, c))
    })
}

#[test]
fn following_trips_beyond_its_distance_after_its_time() {
    assert_eq!(astray(&mut at(0), [0.34, 0.0], true), None);
    assert_eq!(astray(&mut at(0), [0.0, -0.349], true), None);
    for off in [[0.36, 0.0], [0.0, -0.36], [0.26, 0.26]] {
        let (ticks, cause) = astray(&mut at(0), off, true).unwrap();
        assert_eq!(cause, TripCause::Following);
        assert!((500..=502).contains(&ticks), "{ticks}");
    }
    assert_eq!(astray(&mut at(0), [1.0, 0.0], false), None);
    let (_, cause) = astray(&mut at(0), [f64::NAN, 0.0], true).unwrap();
    assert_eq!(cause, TripCause::Following, "NaN does not follow");
}

#[test]
fn the_following_time_restarts_when_the_tip_follows_or_need_not_follow() {
    let off = Some(Following {
        setpoint: [0.0; 2],
        estimate: [0.4, 0.0],
    });
    let near = Some(Following {
        setpoint: [0.0; 2],
        estimate: [0.1, 0.0],
    });
    for relief in [near, None] {
        let mut gate = at(0);
        for k in 0..1500 {
            let following = if k % 450 == 449 { relief } else { off };
            assert_eq!(
                trips(
                    &mut gate,
                    &GateInput {
                        following,
                        ..request([0; 3])
                    }
                ),
                None,
                "tick {k}"
            );
        }
    }
}

#[test]
fn following_allows_for_the_speed_of_the_set_point() {
    // 1.5 rad/s permit 0.6 rad more, decaying with 0.4 s
    let moving = |off: f64, ticks: usize| {
        let mut gate = at(0);
        (0..ticks).find_map(|k| {
            let setpoint = [1.5 * DT * k as f64, 0.0];
            trips(
                &mut gate,
                &GateInput {
                    following: Some(Following {
                        setpoint,
                        estimate: [setpoint[0] - off, 0.0],
                    }),
                    ..request([0; 3])
                },
            )
        })
    };
    assert_eq!(moving(0.94, 2000), None);
    assert_eq!(moving(0.96, 2000), Some(TripCause::Following));
    let mut gate = at(0);
    let mut tripped_at = None;
    for k in 0..4000usize {
        let x = 1.5 * DT * k.min(1000) as f64;
        let following = Some(Following {
            setpoint: [x, 0.0],
            estimate: [x - 0.65, 0.0],
        });
        if trips(
            &mut gate,
            &GateInput {
                following,
                ..request([0; 3])
            },
        )
        .is_some()
        {
            tripped_at = Some(k);
            break;
        }
    }
    // 0.35 + 0.6 e^(−t/0.4) falls to 0.65 after 0.277 s, and the gate waits another 0.5 s
    let after_s = (tripped_at.unwrap() - 1000) as f64 * DT;
    assert!((0.75..0.81).contains(&after_s), "{after_s}");
}

#[test]
fn an_emergency_stop_releases_at_once_in_any_state() {
    let (mut gate, counts) = moving();
    let pressed = GateInput {
        emergency_stop: true,
        ..request([counts + 1, 0, 0])
    };
    let output = gate.pass(&pressed);
    assert_eq!(
        output,
        GateOutput {
            steps: Steps([counts, 0, 0]),
            energise: false,
            tripped: Some(TripCause::EmergencyStop),
            rested: false
        }
    );
    let output = gate.pass(&pressed);
    assert_eq!(
        (output.tripped, output.steps.0[0]),
        (None, counts),
        "it is reported once, and nothing moves"
    );
    assert!(!gate.is_busy());
    // during a return after another fault, and unarmed
    let mut gate = at(50);
    gate.pass(&GateInput {
        stale_s: 1.0,
        ..request([50; 3])
    });
    gate.relax();
    gate.pass(&request([50; 3]));
    let output = gate.pass(&GateInput {
        emergency_stop: true,
        armed: false,
        ..request([50; 3])
    });
    assert_eq!(
        (output.tripped, output.energise),
        (Some(TripCause::EmergencyStop), false)
    );
    assert_eq!(
        gate.latched(),
        Some(TripCause::Stale),
        "the first cause stays latched"
    );
}

#[test]
fn an_alarm_of_the_step_generator_trips_at_any_time() {
    assert_eq!(
        trips(
            &mut at(0),
            &GateInput {
                alarm: true,
                armed: false,
                ..request([0; 3])
            }
        ),
        Some(TripCause::StepGenerator)
    );
    assert_eq!(
        trips(
            &mut at(0),
            &GateInput {
                alarm: true,
                emergency_stop: true,
                ..request([0; 3])
            }
        ),
        Some(TripCause::EmergencyStop)
    );
    let mut gate = at(60);
    gate.relax();
    let output = gate.pass(&GateInput {
        alarm: true,
        ..request([60; 3])
    });
    assert_eq!(
        (output.tripped, output.energise),
        (Some(TripCause::StepGenerator), true)
    );
    let rest = gate.pass(&request([0; 3])).steps;
    for _ in 0..500 {
        assert_eq!(
            gate.pass(&request([0; 3])).steps,
            rest,
            "the return has ended"
        );
    }
}

/// The sensors count whether the tip is armed or not.
#[test]
fn measured_pressure_and_temperature_trip_at_any_time() {
    let (pressed, hot) = (
        GateInput {
            overpressure: true,
            ..request([0; 3])
        },
        GateInput {
            hot: true,
            ..request([0; 3])
        },
    );
    for armed in [true, false] {
        assert_eq!(
            trips(&mut at(0), &GateInput { armed, ..pressed }),
            Some(TripCause::Pressure)
        );
        assert_eq!(
            trips(&mut at(0), &GateInput { armed, ..hot }),
            Some(TripCause::Temperature)
        );
    }
    // pressure ends a hold with a return to rest, and heat does not end a return
    let mut gate = at(60);
    gate.stand();
    assert_eq!(
        trips(
            &mut gate,
            &GateInput {
                overpressure: true,
                ..request([60; 3])
            }
        ),
        Some(TripCause::Pressure)
    );
    let arrived = (0..2000).any(|_| {
        gate.pass(&GateInput {
            overpressure: true,
            hot: true,
            ..request([60; 3])
        })
        .rested
    });
    assert!(arrived, "the return ends at rest");
}

/// A lasting cause is reported once, whatever is latched; a new occurrence is reported again.
#[test]
fn a_second_cause_is_reported_once_per_occurrence() {
    for (second, cause) in [
        (
            GateInput {
                alarm: true,
                ..request([50; 3])
            },
            TripCause::StepGenerator,
        ),
        (
            GateInput {
                emergency_stop: true,
                ..request([50; 3])
            },
            TripCause::EmergencyStop,
        ),
        (
            GateInput {
                overpressure: true,
                ..request([50; 3])
            },
            TripCause::Pressure,
        ),
    ] {
        let mut gate = at(50);
        gate.pass(&GateInput {
            stale_s: 1.0,
            ..request([50; 3])
        });
        for _ in 0..2 {
            assert_eq!(trips(&mut gate, &second), Some(cause));
            assert_eq!(
                (0..50).find_map(|_| trips(&mut gate, &second)),
                None,
                "{cause:?} is reported once"
            );
            assert_eq!(trips(&mut gate, &request([50; 3])), None);
        }
        assert_eq!(gate.latched(), Some(TripCause::Stale));
    }
    // the same cause again, pressed again during the return
    let mut gate = at(50);
    gate.pass(&GateInput {
        emergency_stop: true,
        ..request([50; 3])
    });
    gate.pass(&request([50; 3]));
    gate.relax();
    assert!(gate.pass(&request([50; 3])).energise);
    let output = gate.pass(&GateInput {
        emergency_stop: true,
        ..request([50; 3])
    });
    assert_eq!(
        (output.tripped, output.energise),
        (Some(TripCause::EmergencyStop), false)
    );
}

#[test]
fn released_drivers_stay_off_when_a_milder_cause_follows() {
    let mut gate = at(50);
    gate.pass(&GateInput {
        emergency_stop: true,
        ..request([50; 3])
    });
    let output = gate.pass(&GateInput {
        emergency_stop: true,
        alarm: true,
        ..request([50; 3])
    });
    assert_eq!(
        (output.tripped, output.energise),
        (Some(TripCause::StepGenerator), false)
    );
    let on = SafeStates {
        step_generator: SafeState::Relax,
        ..SafeStates::default()
    };
    let mut gate = Follower::new(&GateLimits { on, ..limits() }, &Steps([50; 3]));
    gate.pass(&GateInput {
        emergency_stop: true,
        ..request([50; 3])
    });
    let output = gate.pass(&GateInput {
        alarm: true,
        ..request([50; 3])
    });
    assert_eq!(
        (output.tripped, output.energise, gate.is_returning()),
        (Some(TripCause::StepGenerator), false, false)
    );
}

/// A return begins where the step generator stopped, not at the counts sent.
#[test]
fn a_return_begins_at_the_counted_steps() {
    let (mut gate, counts) = moving();
    gate.pass(&GateInput {
        alarm: true,
        ..request([counts; 3])
    });
    gate.recount(&Steps([100, -40, 7]));
    assert_eq!(
        gate.latched(),
        Some(TripCause::StepGenerator),
        "the cause stays latched"
    );
    assert!(!gate.is_returning());
    gate.relax();
    assert!(gate.is_returning());
    let first = gate.pass(&request([0; 3])).steps.0;
    for (now, from) in first.iter().zip([100, -40, 7]) {
        assert!((now - from).abs() <= 1, "{first:?}");
    }
    let ticks = (0..10_000)
        .find(|_| gate.pass(&request([0; 3])).rested)
        .unwrap();
    assert!((370..600).contains(&ticks), "3 mm at 8 mm/s: {ticks}");
}

#[test]
fn after_a_trip_the_gate_brakes_and_stands() {
    let (mut gate, counts) = moving();
    let mut last = gate.pass(&GateInput {
        disagree: true,
        ..request([counts + 1, 0, 0])
    });
    assert_eq!(last.tripped, Some(TripCause::Disagreement));
    assert!(gate.is_busy());
    let mut ticks = 0;
    while gate.is_busy() {
        // the gate ignores the requests of the controller
        let output = gate.pass(&request([counts + 500, 300, -300]));
        let step = output.steps.0[0] - last.steps.0[0];
        assert!((0..=1).contains(&step) && output.steps.0[1..] == [0, 0] && output.energise);
        last = output;
        ticks += 1;
        assert!(ticks < 100);
    }
    // 20 mm/s at 600 mm/s²: 33 ms and 0.33 mm, 11 steps
    assert!((28..=38).contains(&ticks), "{ticks} ticks");
    assert!(
        (9..=14).contains(&(last.steps.0[0] - counts)),
        "{} steps",
        last.steps.0[0] - counts
    );
    let stood = gate.pass(&request([0; 3]));
    assert_eq!((stood.steps, stood.tripped), (last.steps, None));
}

#[test]
fn a_cause_stays_latched_until_the_reset() {
    let mut gate = at(40);
    assert_eq!(
        trips(
            &mut gate,
            &GateInput {
                stale_s: 1.0,
                ..request([40; 3])
            }
        ),
        Some(TripCause::Stale)
    );
    for _ in 0..100 {
        assert_eq!(
            gate.pass(&request([41; 3])),
            GateOutput {
                steps: Steps([40; 3]),
                energise: true,
                tripped: None,
                rested: false
            }
        );
    }
    gate.reset(&Steps([40; 3]));
    assert_eq!(gate.latched(), None);
    assert_eq!(gate.pass(&request([41; 3])).steps, Steps([41; 3]));
    // a reset clears the history: pistons at rest elsewhere are not a jump
    gate.reset(&Steps([-500; 3]));
    gate.counted = Steps([-500; 3]);
    for _ in 0..40 {
        assert_eq!(
            gate.pass(&request([-500; 3])),
            GateOutput {
                steps: Steps([-500; 3]),
                energise: true,
                tripped: None,
                rested: false
            }
        );
    }
}

/// The machine decides how it moves to a request; the gate judges how it does.
#[test]
fn a_request_far_away_passes_and_a_machine_that_moves_too_fast_trips() {
    let far = request([900; 3]);
    let mut gate = Gate::new(&limits(), &Steps([0; 3]));
    for _ in 0..100 {
        let output = gate.pass(&far);
        assert_eq!(
            (output.tripped, output.steps),
            (None, Steps([900; 3])),
            "a machine that does not move"
        );
    }
    for i in 0..3 {
        // nothing is requested, and the machine moves one channel at 45 mm/s all the same
        let mut gate = Gate::new(&limits(), &Steps([0; 3]));
        let runs = |k: i32| {
            let mut counted = [0; 3];
            counted[i] = (k - 20).max(0) * 3 / 2;
            GateInput {
                counted: Steps(counted),
                ..request([0; 3])
            }
        };
        let (tick, output) = (0..100)
            .map(|k| (k, gate.pass(&runs(k))))
            .find(|(_, output)| output.tripped.is_some())
            .unwrap();
        assert!(
            matches!(
                output.tripped,
                Some(TripCause::Acceleration | TripCause::Rate)
            ) && (26..40).contains(&tick),
            "{tick} {output:?}"
        );
    }
}

#[test]
fn counts_that_are_declared_anew_while_unarmed_are_not_a_motion() {
    let mut gate = Gate::new(&limits(), &Steps([0; 3]));
    for counted in [0, 0, 4000, 4000] {
        let t = GateInput {
            counted: Steps([counted; 3]),
            armed: false,
            ..request([0; 3])
        };
        assert_eq!(gate.pass(&t).tripped, None);
    }
    for _ in 0..40 {
        assert_eq!(
            gate.pass(&GateInput {
                counted: Steps([4000; 3]),
                ..request([0; 3])
            })
            .tripped,
            None
        );
    }
    gate.reset(&Steps([4000; 3]));
    let t = GateInput {
        counted: Steps([4000; 3]),
        armed: false,
        ..request([4000; 3])
    };
    assert_eq!(
        gate.pass(&t).tripped,
        None,
        "a reset declares the counts sent as well"
    );
    gate.reset(&Steps([400; 3]));
    for _ in 0..40 {
        let t = GateInput {
            counted: Steps([460; 3]),
            ..request([400; 3])
        };
        assert_eq!(
            gate.pass(&t).tripped,
            None,
            "pistons that lag the counts sent at a reset have not jumped"
        );
    }
}

/// A machine that lags its request brakes from where it is, and not from where it was asked to be.
#[test]
fn braking_begins_at_the_counted_position_and_speed() {
    for (react_s, way) in [(0.0, 9..=14), (0.02, 22..=28)] {
        let mut gate = Gate::new(
            &GateLimits {
                react_s,
                ..limits()
            },
            &Steps([0; 3]),
        );
        // 20 mm/s are two steps in three ticks
        let counted = |k: i32| Steps([0, -2 * (k - 20).max(0) / 3, 0]);
        for k in 0..120 {
            let t = GateInput {
                counted: counted(k),
                ..request([0, -900, 0])
            };
            assert_eq!(
                gate.pass(&GateInput {
                    dt_s: if k < 60 { 4.0 * DT } else { DT },
                    ..t
                })
                .tripped,
                None,
                "tick {k}"
            );
        }
        gate.brake();
        let mut last = Steps::default();
        for _ in 0..60 {
            last = gate
                .pass(&GateInput {
                    counted: counted(119),
                    ..request([0, -900, 0])
                })
                .steps;
        }
        let [one, two, three] = last.0;
        assert!(
            (one, three) == (0, 0) && way.contains(&(counted(119).0[1] - two)),
            "{react_s} s: {last:?} from {:?}",
            counted(119)
        );
        assert!(!gate.hand_over(), "the machine is still on its way");
        gate.pass(&GateInput {
            counted: last,
            ..request([0, -900, 0])
        });
        assert!(gate.hand_over());
    }
}

#[test]
fn released_drivers_leave_the_pistons_where_they_are_counted() {
    let mut gate = Gate::new(&limits(), &Steps([0; 3]));
    gate.pass(&request([300; 3]));
    for counted in [[7, 5, 3], [8, 5, 3]] {
        let output = gate.pass(&GateInput {
            emergency_stop: true,
            counted: Steps(counted),
            ..request([300; 3])
        });
        assert_eq!((output.steps, output.energise), (Steps(counted), false));
    }
}

#[test]
fn a_return_ends_when_all_steps_are_counted() {
    let mut gate = Gate::new(&limits(), &Steps([30; 3]));
    gate.relax();
    for _ in 0..2000 {
        let output = gate.pass(&GateInput {
            counted: Steps([0, 1, 0]),
            ..request([0; 3])
        });
        assert!(output.energise && !output.rested);
    }
    let output = gate.pass(&request([0; 3]));
    assert_eq!(
        (output.steps, output.energise, output.rested),
        (Steps([0; 3]), false, true)
    );
}

#[test]
fn a_return_is_slow_and_symmetric_and_ends_at_zero() {
    let mut gate = Follower::new(&limits(), &Steps([400, -400, 30]));
    gate.relax();
    assert!(gate.is_busy() && gate.latched().is_none());
    let (mut last, mut fastest) = (Steps([400, -400, 30]), 0);
    let mut window = std::collections::VecDeque::from(vec![last.0[0]; 100]);
    let mut ticks = 0;
    loop {
        let output = gate.pass(&request([0; 3]));
        ticks += 1;
        assert_eq!(output.steps.0[0], -output.steps.0[1]);
        assert!(
            output.steps.0[0] <= last.0[0]
                && output.steps.0[2] <= last.0[2]
                && output.steps.0[2] >= 0
        );
        window.push_back(output.steps.0[0]);
        fastest = fastest.max(window.pop_front().unwrap() - output.steps.0[0]);
        last = output.steps;
        if output.rested {
            break;
        }
        assert!(output.energise && ticks < 5000);
    }
    // 12 mm at 8 mm/s, plus the ramps
    assert!((1500..1700).contains(&ticks), "{ticks}");
    // 8 mm/s is 26.7 steps in 100 ms
    assert!((26..=27).contains(&fastest), "{fastest}");
    assert_eq!(last, Steps([0; 3]));
    assert!(!gate.pass(&request([0; 3])).rested, "it is reported once");
}

#[test]
fn a_return_that_begins_in_motion_brakes_first_and_can_be_stopped() {
    let (mut gate, counts) = moving();
    gate.relax();
    let output: Vec<i32> = (0..60)
        .map(|_| gate.pass(&request([0; 3])).steps.0[0])
        .collect();
    let top = *output.iter().max().unwrap();
    assert!(
        (9..=14).contains(&(top - counts)),
        "expected the braking distance: {}",
        top - counts
    );
    for _ in 0..200 {
        gate.pass(&request([0; 3]));
    }
    gate.stand();
    assert!(gate.is_busy());
    for _ in 0..40 {
        gate.pass(&request([0; 3]));
    }
    assert!(!gate.is_busy());
    let there = gate.pass(&request([0; 3])).steps;
    assert!(there.0[0] > 20 && there.0[0] < top - 20);
    assert_eq!(gate.pass(&request([5; 3])).steps, there);
}

#[test]
fn braking_hands_over_once_it_has_come_to_rest_and_all_steps_are_counted() {
    let (mut gate, counts) = moving();
    assert!(
        !gate.is_braking() && !gate.hand_over(),
        "a gate that passes does not hand over"
    );
    gate.brake();
    let mut ticks = 0;
    let mut last = Steps([counts, 0, 0]);
    while !gate.hand_over() {
        assert!(gate.is_braking() && gate.is_busy());
        last = gate.pass(&request([0; 3])).steps;
        let mut late = gate.gate.clone();
        late.pass(&GateInput {
            counted: Steps([last.0[0] - 1, 0, 0]),
            ..request([0; 3])
        });
        assert!(!late.hand_over(), "a step is not counted yet");
        ticks += 1;
        assert!(ticks < 100);
    }
    assert!(
        (28..=38).contains(&ticks),
        "20 mm/s at 600 mm/s²: {ticks} ticks"
    );
    assert!(!gate.is_braking() && !gate.is_busy());
    let next = Steps([last.0[0] + 1, 0, 0]);
    assert_eq!(
        gate.pass(&request(next.0)).steps,
        next,
        "the controller moves the pistons again"
    );
}

#[test]
fn counts_that_a_motion_has_not_reached_yet_are_no_rest() {
    let mut rng = StdRng::seed_from_u64(5);
    for _ in 0..50 {
        let (lead, ordered) = (rng.random_range(5..34), rng.random_range(1..5));
        for relaxes in [false, true] {
            let mut gate = Gate::new(
                &GateLimits {
                    rest_s: 0.035,
                    ..limits()
                },
                &Steps::default(),
            );
            // orders are on their way, and nothing of them is counted
            for k in 1..=ordered {
                gate.pass(&request([k, 0, 0]));
            }
            if relaxes {
                gate.relax();
            } else {
                gate.brake();
            }
            let over = |gate: &mut Gate, counts| {
                let output = gate.pass(&GateInput {
                    counted: Steps([counts, 0, 0]),
                    ..request([0; 3])
                });
                gate.hand_over() || output.rested
            };
            let still = (0..lead).any(|_| over(&mut gate, 0));
            let moved = (0..10).any(|_| over(&mut gate, 1));
            assert!(!still && !moved, "{lead} ticks, relaxes {relaxes}");
            let rested = (0..100).position(|_| over(&mut gate, 0));
            assert!(rested.is_some_and(|ticks| ticks >= 34), "{rested:?}");
        }
    }
}

#[test]
fn a_trip_or_another_motion_of_the_gate_cancels_the_hand_over() {
    let cancel: [fn(&mut Follower); 3] = [
        |gate| {
            assert_eq!(
                trips(
                    gate,
                    &GateInput {
                        alarm: true,
                        ..request([0; 3])
                    }
                ),
                Some(TripCause::StepGenerator)
            )
        },
        |gate| gate.relax(),
        |gate| gate.stand(),
    ];
    for cancel in cancel {
        let mut gate = at(40);
        gate.brake();
        cancel(&mut gate);
        let latched = gate.latched();
        assert!(!gate.is_braking() && !gate.hand_over());
        assert_eq!(gate.latched(), latched);
    }
}

#[test]
fn a_late_tick_does_not_cause_a_jump_during_a_return() {
    let mut gate = at(500);
    gate.relax();
    for _ in 0..200 {
        gate.pass(&request([0; 3]));
    }
    let before = gate.pass(&request([0; 3])).steps.0[0];
    let after = gate
        .pass(&GateInput {
            dt_s: 0.04,
            ..request([0; 3])
        })
        .steps
        .0[0];
    assert!(before - after <= 1, "{} steps at once", before - after);
    let frozen = gate
        .pass(&GateInput {
            dt_s: -1.0,
            ..request([0; 3])
        })
        .steps
        .0[0];
    assert_eq!(frozen, after, "a negative duration moves nothing");
}

#[test]
fn braking_does_not_leave_the_travel() {
    let near = (29.9f64 / 0.03) as i32;
    let mut gate = Follower::new(&limits(), &Steps([near - 194, 0, 0]));
    let (mut mm, mut v) = (0.0, 0.0f64);
    for _ in 0..300 {
        v = (v + 500.0 * DT).min(20.0);
        mm += v * DT;
        let wanted = near - 194 + (mm / 0.03f64).round() as i32;
        if gate
            .pass(&GateInput {
                disagree: wanted >= near - 1,
                ..request([wanted, 0, 0])
            })
            .tripped
            .is_some()
        {
            break;
        }
    }
    for _ in 0..100 {
        assert!(gate.pass(&request([2000, 0, 0])).steps.0[0] <= 1000);
    }
}

#[test]
fn every_cause_leads_to_its_configured_safe_state() {
    let pressure = GateInput {
        estimated_bellow_mm: Some([-40.0, 0.0, 0.0]),
        ..request([31, 30, 30])
    };
    type Case = (TripCause, GateInput, fn(&mut SafeStates, SafeState));
    let cases: [Case; 12] = [
        (
            TripCause::EmergencyStop,
            GateInput {
                emergency_stop: true,
                ..request([30; 3])
            },
            |on, s| on.emergency_stop = s,
        ),
        (
            TripCause::StepGenerator,
            GateInput {
                alarm: true,
                ..request([30; 3])
            },
            |on, s| on.step_generator = s,
        ),
        (
            TripCause::Late,
            GateInput {
                dt_s: 0.2,
                ..request([30; 3])
            },
            |on, s| on.late = s,
        ),
        (
            TripCause::Unarmed,
            GateInput {
                armed: false,
                ..request([31; 3])
            },
            |on, s| on.unarmed = s,
        ),
        (TripCause::Travel, request([3000; 3]), |on, s| on.travel = s),
        (TripCause::Acceleration, request([44; 3]), |on, s| {
            on.acceleration = s
        }),
        (TripCause::Pressure, pressure, |on, s| on.pressure = s),
        (
            TripCause::Pressure,
            GateInput {
                overpressure: true,
                ..request([30; 3])
            },
            |on, s| on.pressure = s,
        ),
        (
            TripCause::Temperature,
            GateInput {
                hot: true,
                ..request([30; 3])
            },
            |on, s| on.temperature = s,
        ),
        (
            TripCause::Stale,
            GateInput {
                stale_s: 9.0,
                ..request([30; 3])
            },
            |on, s| on.stale = s,
        ),
        (
            TripCause::Disagreement,
            GateInput {
                disagree: true,
                ..request([30; 3])
            },
            |on, s| on.disagreement = s,
        ),
        (
            TripCause::Following,
            GateInput {
                following: Some(Following {
                    setpoint: [0.0; 2],
                    estimate: [2.0, 0.0],
                }),
                ..request([30; 3])
            },
            |on, s| on.following = s,
        ),
    ];
    for (cause, t, set) in cases {
        for safe in [SafeState::Hold, SafeState::Relax, SafeState::Release] {
            // the other causes have another safe state, so that a mix-up is detected
            let other = if safe == SafeState::Hold {
                SafeState::Release
            } else {
                SafeState::Hold
            };
            let mut on = SafeStates {
                emergency_stop: other,
                step_generator: other,
                late: other,
                unarmed: other,
                travel: other,
                rate: other,
                acceleration: other,
                pressure: other,
                temperature: other,
                stale: other,
                disagreement: other,
                following: other,
            };
            set(&mut on, safe);
            let mut gate = Follower::new(&GateLimits { on, ..limits() }, &Steps([30; 3]));
            let tripped = (0..600).find_map(|_| trips(&mut gate, &t));
            assert_eq!(tripped, Some(cause));
            let output: Vec<GateOutput> = (0..1000).map(|_| gate.pass(&request([30; 3]))).collect();
            let last = output.last().unwrap();
            // only an acceleration is noticed after the machine has moved
            let (released, held) = if cause == TripCause::Acceleration {
                (44, 45..70)
            } else {
                (30, 30..31)
            };
            let (steps, energise) = match safe {
                SafeState::Hold => (held, true),
                SafeState::Relax => (0..1, false),
                SafeState::Release => (released..released + 1, false),
            };
            assert!(
                last.steps.0.iter().all(|n| steps.contains(n)) && last.energise == energise,
                "{cause:?} {safe:?} {last:?}"
            );
            assert_eq!(
                output.iter().filter(|p| p.rested).count(),
                usize::from(safe == SafeState::Relax)
            );
        }
    }
    // this cause takes time to occur
    let mut gate = Follower::new(
        &GateLimits {
            on: SafeStates {
                rate: SafeState::Release,
                ..SafeStates::default()
            },
            ..limits()
        },
        &Steps([0; 3]),
    );
    assert_eq!(steady(&mut gate, 0, 40.0, 0.5), Some(TripCause::Rate));
    assert!(!gate.pass(&request([0; 3])).energise);
}

#[test]
fn defaults_are_as_documented() {
    let on = SafeStates::default();
    let hold = [
        on.step_generator,
        on.late,
        on.unarmed,
        on.travel,
        on.rate,
        on.acceleration,
        on.stale,
        on.disagreement,
        on.following,
    ];
    assert_eq!(on.temperature, SafeState::Hold);
    assert!(hold.iter().all(|s| *s == SafeState::Hold));
    assert_eq!(
        (on.emergency_stop, on.pressure),
        (SafeState::Release, SafeState::Relax)
    );
}

/// Limits and times that are exact in binary, so that tests can reach a limit exactly.
fn exact() -> GateLimits {
    GateLimits {
        step_mm: 1.0 / 32.0,
        tick_s: 1.0 / 1024.0,
        travel_mm: 64.0,
        speed_mm_s: 34.0,
        acceleration_mm_s2: 1e9,
        squeeze_mm: 29.5,
        following_rad: 0.25,
        following_s: 0.5,
        following_for_s: 0.5,
        late_s: 0.5,
        ..limits()
    }
}

#[test]
fn values_at_the_limit_are_permitted() {
    let tick = GateInput {
        dt_s: 1.0 / 1024.0,
        ..request([0; 3])
    };
    // 18 steps in 16 ticks are 36 mm/s, with a resolution of 2 mm/s
    let run = |steps: i32| {
        let mut gate = Follower::new(&exact(), &Steps([0; 3]));
        (1..=17).find_map(|k| {
            trips(
                &mut gate,
                &GateInput {
                    wanted: Steps([steps * k.min(16) / 16, 0, 0]),
                    ..tick
                },
            )
        })
    };
    assert_eq!((run(18), run(19)), (None, Some(TripCause::Rate)));
    // 944 steps of a piston compress 29.5 mm of air
    let press = |steps: i32| {
        let mut gate = Follower::new(&exact(), &Steps([steps - 1, 0, 0]));
        trips(
            &mut gate,
            &GateInput {
                wanted: Steps([steps, 0, 0]),
                estimated_bellow_mm: Some([0.0; 3]),
                ..tick
            },
        )
    };
    assert_eq!((press(944), press(945)), (None, Some(TripCause::Pressure)));
    // an error of the permitted size, and one of the permitted duration
    let follow = |off: f64, ticks: usize| {
        let mut gate = Follower::new(&exact(), &Steps([0; 3]));
        let following = Some(Following {
            setpoint: [1.0, 0.0],
            estimate: [1.0 - off, 0.0],
        });
        (0..ticks).find_map(|_| {
            trips(
                &mut gate,
                &GateInput {
                    dt_s: 0.25,
                    following,
                    ..tick
                },
            )
        })
    };
    assert_eq!(
        (follow(0.25, 50), follow(0.5, 2), follow(0.5, 3)),
        (None, None, Some(TripCause::Following))
    );
    // a start at exactly the limit: n·4 mm/s over 1/64 s, minus twice the resolution of 4 mm/s
    let push = |steps: i32| {
        let limits = GateLimits {
            step_mm: 1.0 / 16.0,
            acceleration_mm_s2: 2048.0,
            speed_mm_s: 1e9,
            ..exact()
        };
        let mut gate = Follower::new(&limits, &Steps([0; 3]));
        (1..=17).find_map(|k| {
            trips(
                &mut gate,
                &GateInput {
                    wanted: Steps([steps * k.min(16) / 16, 0, 0]),
                    ..tick
                },
            )
        })
    };
    assert_eq!((push(10), push(11)), (None, Some(TripCause::Acceleration)));
    // a stop at exactly the limit
    let limits = GateLimits {
        step_mm: 1.0 / 16.0,
        acceleration_mm_s2: 2048.0,
        speed_mm_s: 1e9,
        ..exact()
    };
    let mut gate = Follower::new(&limits, &Steps([0; 3]));
    for k in 1..=64 {
        let steps = 10 * k.min(16) / 16;
        assert_eq!(
            trips(
                &mut gate,
                &GateInput {
                    wanted: Steps([steps, 0, 0]),
                    ..tick
                }
            ),
            None,
            "tick {k}"
        );
    }
}
