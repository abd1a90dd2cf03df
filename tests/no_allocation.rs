//! A tick does not allocate: a counting allocator checks it.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![allow(
    unsafe_code,
    reason = "a global allocator is unsafe to implement; this one only counts and forwards"
)]

mod common;

use common::{described, uncalibrated, unit};
use nalgebra::Vector2;
use retroflex::control::tick::{Input, LoopConfig, LoopState, Reference, tick};
use retroflex::experiment::evaluation::for_world;
use retroflex::experiment::schedule::paper;
use retroflex::model::arc::Shape;
use retroflex::model::bend::Bend;
use retroflex::model::transmission::Line;
use retroflex::motion::machine::Machine;
use retroflex::primitives::units::{Mm, Rad, Seconds};
use retroflex::simulation::lockstep::Lockstep;
use retroflex::simulation::world::World;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

struct Counting;

thread_local! {
    /// Allocations of this thread; the test harness has others.
    static TAKEN: Cell<u64> = const { Cell::new(0) };
}

fn count() {
    // a thread that is ending has no counter and runs no tick
    let _ = TAKEN.try_with(|n| n.set(n.get() + 1));
}

fn taken() -> u64 {
    TAKEN.with(Cell::get)
}

// SAFETY: every call forwards the caller's arguments unchanged to the system allocator, which has the same contract
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: forwarded unchanged
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: forwarded unchanged
        unsafe { System.dealloc(at, layout) }
    }
    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: forwarded unchanged
        unsafe { System.realloc(at, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A circle of 30° in 5 s.
fn on_a_circle(t: f64) -> Reference {
    let rate = std::f64::consts::TAU / 5.0;
    let at = Bend::from_polar(Rad(0.5), Rad(rate * t)).0;
    let shape = Shape {
        bend: Bend(at),
        length: Mm(20.0),
    };
    Reference {
        shape,
        rate: Vector2::new(-at.y, at.x) * rate,
        acceleration: -at * rate * rate,
    }
}

/// Allocations during the ticks of an alignment, moves and holds in closed loop with all functions enabled.
fn during_ticks(config: &LoopConfig, world: &mut dyn World) -> u64 {
    let mut state = LoopState::new(config);
    let mut input = Input {
        dt_s: world.info().period_s,
        ..Input::default()
    };
    let mut machine = Lockstep::new(world, &config.motion);
    machine.energise(true);
    let mut poses = paper().into_iter().step_by(7).cycle();
    let mut during = 0;
    for k in 0..40_000 {
        if k > 3000 && k % 1500 == 0 {
            input.command = poses.next().map(|p| Shape {
                bend: p.bend(),
                length: Mm(config.geometry.rest_length_mm),
            });
        }
        // the last quarter follows a path
        input.reference = (k >= 30_000).then(|| on_a_circle(f64::from(k) * input.dt_s));
        let before = taken();
        let frame = tick(config, &mut state, &input);
        during += taken() - before;
        let t = Seconds(f64::from(k + 1) * input.dt_s);
        let sensed = machine.turn(t, &frame.steps).unwrap();
        input = Input {
            t,
            imu: sensed.imu,
            steps: sensed.counted,
            command: None,
            ..input
        };
    }
    assert!(
        state.fusion.estimate().is_some_and(|f| f.bend.beta() > 0.1),
        "the tip must have moved"
    );
    during
}

#[test]
fn a_tick_does_not_allocate() {
    let mut world = unit(1, 1);
    let lines = [2.2, 2.5, 2.2].map(|k_epsilon| Line {
        k_epsilon,
        k_lambda_mm: 0.85,
    });
    let config = LoopConfig {
        lines,
        ..for_world(&uncalibrated(), &world)
    };
    let before = taken();
    drop(std::hint::black_box(vec![1u8; 64]));
    assert!(taken() > before, "the counter must count");
    assert_eq!(during_ticks(&config, &mut world), 0);
    let fed_forward = config.fed_forward(std::sync::Arc::new(described()));
    assert_eq!(
        during_ticks(&fed_forward, &mut unit(1, 2)),
        0,
        "with a feedforward through a described machine"
    );
}
