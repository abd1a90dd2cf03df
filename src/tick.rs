//! ★ The whole loop on one page: `tick(&Config, &mut State, &Input) -> Frame`.
//!
//! ```text
//! ImuSample ─ fuse ─▶ felt bend ─┐
//! set-point ─ profile ─▶ wanted bend ─▶ error ─ PI ─▶ bend command ─ arc ─▶ bellow lengths
//!                                                   ─ transmission⁻¹ ─▶ piston targets ─ limits, pace ─▶ microsteps
//! microsteps ─ play, 1/(1+k_ε) ─▶ bend the pistons should give ─▶ reference for the error, rows for k_ε
//! ```
//!
//! Nothing here allocates, locks, blocks or asks for the time: the same function runs on hardware, in
//! simulation and in replay, bit for bit.

use crate::calib_imu::Correction;
use crate::calib_imu::motor::MotorField;
use crate::control::follow::{Follower, Pace};
use crate::control::limit::{Cut, Limits};
use crate::control::pi::{Dynamics, PiGains, PiState, ReferenceModel};
use crate::control::reach::{Patience, Reach};
use crate::control::rest::{RestConfig, RestState};
use crate::control::spent::{Spent, SpentState};
use crate::control::wall::{WallConfig, WallState};
use crate::fuse::health::{Action, CauseSet, Outcome as Reading};
use crate::fuse::tip::{Felt, FuseConfig, Fusion, Told};
use crate::fuse::watch::{Seen, Watch};
use crate::model::arc::{Geometry, Shape};
use crate::model::bend::Bend;
use crate::model::drive::Drive;
use crate::model::transmission::{Line, Side, SideState, Wanted, realised};
use crate::refine::dynamics::DynamicsBank;
use crate::refine::online::{RefineConfig, RefineState};
use crate::sample::ImuSample;
use crate::units::{Mm, Seconds, Steps};
use nalgebra::{Vector1, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Everything that does not change while the loop runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Bellows and backbone.
    pub geometry: Geometry,
    /// Rack and pinion.
    pub drive: Drive,
    /// Calibrated transmission: feedforward at start and prior of the refinement.
    pub lines: [Line; 3],
    /// Lag and dead time at start.
    pub dynamics: Dynamics,
    /// How the backlash compensation changes sides.
    pub side: Side,
    /// Pace of the bend set-point, rad/s and rad/s².
    pub bend_pace: Pace,
    /// Pace of the centre length, mm/s and mm/s².
    pub length_pace: Pace,
    /// Pace of each piston, mm/s and mm/s².
    pub piston_pace: Pace,
    /// Static limits.
    pub limits: Limits,
    /// The outer loop; `None` runs open loop.
    pub feedback: Option<FeedbackConfig>,
    /// Online refinement of k_ε.
    pub refine: RefineConfig,
    /// Orientation estimation.
    pub fuse: FuseConfig,
    /// The tip IMU's own errors, taken off every sample.
    pub imu: Correction,
    /// Fields of the motors' coils, taken off the magnetometer, where they have been calibrated.
    pub motors: Option<MotorField>,
    /// A driver idles this long after its last step, s.
    pub motors_idle_after_s: f64,
}

/// The outer loop's settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeedbackConfig {
    /// Closed-loop time constant τ_c, s.
    pub tau_c_s: f64,
    /// Cap of K_p.
    pub kp_max: f64,
    /// Bound of the integrator, rad.
    pub integral_max_rad: f64,
    /// Share of the lag that the feedforward leads by, 0..=1.
    pub lead: f64,
    /// Learn lag and dead time while running.
    pub learn_dynamics: bool,
    /// The rest latch.
    pub rest: RestConfig,
    /// The watch for a tip that is held.
    pub wall: WallConfig,
}

/// Where the tip shall go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// Wanted bend.
    pub bend: Bend,
    /// Wanted centre length.
    pub length: Mm,
}

/// What one tick is told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Input {
    /// Time of the tick.
    pub t: Seconds,
    /// Time since the last tick, s.
    pub dt_s: f64,
    /// What came from the tip's IMU: a sample, a failed transfer or nothing.
    pub imu: Reading,
    /// A sample of the base's IMU, where there is one.
    pub base_imu: Option<ImuSample>,
    /// A new target, if one came.
    pub command: Option<Command>,
    /// Microsteps that were pulsed by now.
    pub steps: Steps,
    /// Take the next still stretch for the rest again: the base was turned.
    pub realign: bool,
}

impl Default for Input {
    /// Nothing came yet, on a loop of 1 kHz.
    fn default() -> Self {
        Self { t: Seconds(0.0), dt_s: 1e-3, imu: Reading::Nothing, base_imu: None, command: None, steps: Steps::default(), realign: false }
    }
}

/// State of the senses, for the status and the record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Senses {
    /// The harshest thing the judge of readings asks for.
    pub action: Action,
    /// What is counted against the sensor.
    pub in_force: CauseSet,
    /// The pistons are held because of it.
    pub held: bool,
    /// The second opinion has differed for long.
    pub disagrees: bool,
}

/// What the loop is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Waiting for a still tip; pistons stay.
    Aligning,
    /// The set-point moves.
    Tracking,
    /// The set-point rests.
    Holding,
}

/// Every intermediate of one tick: the tick's output, the log record, the gap engine's input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Time of the tick.
    pub t: Seconds,
    /// What the loop was doing.
    pub mode: Mode,
    /// The target as commanded.
    pub target: Shape,
    /// The set-point on its way to the target.
    pub setpoint: Shape,
    /// Felt orientation, once aligned.
    pub felt: Option<Felt>,
    /// Bend that the pistons as they stand should give, rad.
    pub pistons_give: Bend,
    /// Error that the PI acted on, rad.
    pub error: Vector2<f64>,
    /// Feedback in the command, rad.
    pub feedback: Vector2<f64>,
    /// Commanded bellow length change q, mm.
    pub bellow_mm: Vector3<f64>,
    /// Piston targets q̃ after limits, mm.
    pub piston_target_mm: Vector3<f64>,
    /// Microsteps to pulse until the next tick.
    pub steps: Steps,
    /// k_ε in use.
    pub k_epsilon: [f64; 3],
    /// Lag and dead time in use.
    pub dynamics: Dynamics,
    /// What cut the request.
    pub cut: Cut,
    /// Held by the rest latch.
    pub at_rest: bool,
    /// Pushed without coming.
    pub blocked: bool,
    /// The controller has done what it may, and the tip is still off.
    pub spent: Spent,
    /// How the sensors are.
    pub senses: Senses,
    /// The base has turned: the integrator is frozen until a re-alignment.
    pub base_moved: bool,
    /// The tip twists against its mechanism: the base may have turned slowly. The loop goes on.
    pub base_doubted: bool,
}

/// What the loop remembers from tick to tick.
#[derive(Debug, Clone)]
pub struct State {
    /// Orientation estimation.
    pub fusion: Fusion,
    target: Shape,
    bend: Follower<2>,
    length: Follower<1>,
    pistons: [Follower<1>; 3],
    lines: [Line; 3],
    dynamics: Dynamics,
    sides: [SideState; 3],
    slack_mm: Vector3<f64>,
    realised_mm: Vector3<f64>,
    model: ReferenceModel,
    pi: PiState,
    rest: RestState,
    rested_s: f64,
    wall: WallState,
    /// The integrator is at its bound.
    full: bool,
    spent: SpentState,
    reach: Reach,
    refine: RefineState,
    bank: DynamicsBank,
    last_steps: Steps,
    /// Time since each motor's last step, s.
    idle_s: [f64; 3],
    still_s: f64,
    watch: Watch,
    /// What stood when all was quiet last: integral, felt bend, bend that the pistons gave by the play.
    quiet: [Vector2<f64>; 3],
    base_moved: bool,
    held: Option<Held>,
    /// What a release from a hold still keeps the targets off by, mm.
    ease_mm: Vector3<f64>,
    easing: bool,
}

/// Pistons that are being stopped or stand.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Held {
    /// Where each comes to a stop, mm.
    stop_mm: Vector3<f64>,
}

/// What outlives a restart of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kept {
    /// Microsteps counted since zero.
    pub steps: Steps,
    /// Felt bend vector, rad.
    pub bend_rad: [f64; 2],
    /// Far ends of the plays, mm of piston.
    pub slack_mm: [f64; 3],
    /// Refined extension gains.
    pub k_epsilon: [f64; 3],
    /// Backlash half-widths, mm.
    pub k_lambda_mm: [f64; 3],
    /// Learnt lag, s.
    pub lag_s: f64,
    /// Learnt dead time, s.
    pub delay_s: f64,
    /// The rest, once it was found.
    pub rest: Option<KeptRest>,
}

/// The rest as alignment found it, in the base frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeptRest {
    /// Mean specific force, m/s².
    pub acc_m_s2: [f64; 3],
    /// Mean field, µT, where there was a magnetometer.
    pub mag_ut: Option<[f64; 3]>,
    /// Gyroscope bias, rad/s.
    pub gyro_bias_rad_s: [f64; 3],
}

/// Pistons must have rested this long before the tip counts as still, s.
const STILL_AFTER_S: f64 = 0.5;
/// Time constant with which targets leave a hold, s.
const EASE_S: f64 = 0.15;
/// The rest latch must have been closed this long before a pose teaches k_ε, s.
const LEARN_AFTER_S: f64 = 0.15;

impl State {
    /// At rest, pistons at zero, straight, not aligned.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        let rest = Shape { bend: Bend::STRAIGHT, length: Mm(config.geometry.rest_length_mm) };
        Self {
            fusion: Fusion::default(),
            target: rest,
            bend: Follower::resting(Vector2::zeros()),
            length: Follower::resting(Vector1::new(config.geometry.rest_length_mm)),
            pistons: [Follower::resting(Vector1::zeros()); 3],
            lines: config.lines,
            dynamics: config.dynamics,
            sides: [SideState::default(); 3],
            slack_mm: Vector3::zeros(),
            realised_mm: Vector3::zeros(),
            model: ReferenceModel::default(),
            pi: PiState::default(),
            rest: RestState::default(),
            rested_s: 0.0,
            wall: WallState::default(),
            full: false,
            spent: SpentState::default(),
            reach: Reach::default(),
            refine: RefineState::new(&config.lines),
            bank: DynamicsBank::default(),
            last_steps: Steps::default(),
            idle_s: [f64::INFINITY; 3],
            still_s: 0.0,
            watch: Watch::default(),
            quiet: [Vector2::zeros(); 3],
            base_moved: false,
            held: None,
            ease_mm: Vector3::zeros(),
            easing: false,
        }
    }

    /// Transmission gains in use.
    #[must_use]
    pub fn lines(&self) -> &[Line; 3] {
        &self.lines
    }

    /// Replaces the transmission gains, as a new calibration does.
    pub fn set_lines(&mut self, lines: [Line; 3]) {
        self.lines = lines;
    }

    /// The pistons rest at these counts, wherever they were led from, and the tip is to stay at `at`:
    /// what feedback is in the pistons becomes the integral part, so that nothing moves by itself.
    pub fn stand(&mut self, config: &Config, steps: &Steps, at: Bend) {
        let piston_mm = config.drive.piston_mm(steps);
        for i in 0..3 {
            let line = &self.lines[i];
            let w_mm = line.play(self.slack_mm[i], piston_mm[i]);
            let side = if line.k_lambda_mm > 0.0 { ((piston_mm[i] - w_mm) / line.k_lambda_mm).clamp(-1.0, 1.0) } else { 0.0 };
            self.slack_mm[i] = w_mm;
            self.realised_mm[i] = w_mm;
            self.sides[i] = SideState { w_mm, side, way: if side == 0.0 { 0.0 } else { side.signum() } };
            self.pistons[i] = Follower::resting(Vector1::new(piston_mm[i]));
        }
        let given = config.geometry.shape(&bellows_of(&self.lines, &self.realised_mm));
        let length = given.length.0.clamp(0.5 * config.geometry.rest_length_mm, 2.0 * config.geometry.rest_length_mm);
        self.target = Shape { bend: at, length: Mm(length) };
        self.bend = Follower::resting(at.0);
        self.length = Follower::resting(Vector1::new(length));
        let feedback = given.bend.0 - at.0;
        self.pi = PiState { integral: feedback, feedback };
        self.model = ReferenceModel::resting(at.0);
        (self.rest, self.rested_s, self.wall) = (RestState::default(), 0.0, WallState::default());
        (self.full, self.spent) = (false, SpentState::default());
        (self.held, self.ease_mm, self.easing) = (None, Vector3::zeros(), false);
        self.last_steps = *steps;
        self.reach.forget();
    }

    /// Takes the feedback out of the command, as an open loop needs it.
    pub fn forget_feedback(&mut self) {
        self.pi = PiState::default();
        (self.full, self.spent) = (false, SpentState::default());
    }

    /// What is worth keeping over a restart, with the pistons at these counts.
    #[must_use]
    pub fn keep(&self, steps: &Steps) -> Kept {
        let rest = self.fusion.rest().map(|r| KeptRest {
            acc_m_s2: r.acc_rest_m_s2.into(),
            mag_ut: r.mag_rest_ut.map(Into::into),
            gyro_bias_rad_s: r.gyro_bias_rad_s.into(),
        });
        Kept {
            steps: *steps,
            bend_rad: self.fusion.felt().map_or([0.0; 2], |f| f.bend.0.into()),
            slack_mm: self.slack_mm.into(),
            k_epsilon: self.lines.map(|l| l.k_epsilon),
            k_lambda_mm: self.lines.map(|l| l.k_lambda_mm),
            lag_s: self.dynamics.lag_s,
            delay_s: self.dynamics.delay_s,
            rest,
        }
    }

    /// Takes up what was kept before alignment: where the pistons stand and what was learnt.
    pub fn take_up(&mut self, config: &Config, kept: &Kept) {
        self.lines = [0, 1, 2].map(|i: usize| Line { k_epsilon: kept.k_epsilon[i], k_lambda_mm: kept.k_lambda_mm[i] });
        self.dynamics = Dynamics { lag_s: kept.lag_s, delay_s: kept.delay_s };
        self.slack_mm = kept.slack_mm.into();
        self.stand(config, &kept.steps, Bend(kept.bend_rad.into()));
    }
}

/// One turn of the loop.
pub fn tick(config: &Config, state: &mut State, input: &Input) -> Frame {
    feel(config, state, input);
    let given = pistons_give(config, state, input);
    let felt = state.fusion.felt();
    let Some(felt_bend) = felt.map(|f| f.bend) else {
        return frame(config, state, input, None, given, Outcome::resting(state));
    };
    if let Some(command) = input.command {
        state.target = Shape { bend: command.bend, length: command.length };
    }
    let holding = hold(config, state);
    let cut_setpoint = if holding { Cut::None } else { advance_setpoint(config, state, input.dt_s) };
    let moving = !state.bend.arrived(&state.target.bend.0);
    let should = state.model.step(given.0 - state.pi.feedback, &state.dynamics, input.dt_s);
    watch_base(config, state, input, should, felt_bend);
    let error = feed_back(config, state, should, felt_bend, moving || holding, input.dt_s);
    if config.feedback.is_some() && !holding && !state.base_moved {
        learn(config, state, given, felt_bend, input.dt_s);
    }
    let mut outcome = command_pistons(config, state, felt_bend, moving, input.dt_s);
    outcome.error = error;
    if let Some(f) = &config.feedback {
        let off = !state.rest.closed && (state.target.bend.0 - felt_bend.0).norm() > f.wall.error_rad;
        state.spent.step(moving || holding, off, state.full, outcome.cut, input.dt_s);
    }
    if outcome.cut == Cut::None {
        outcome.cut = cut_setpoint;
    }
    frame(config, state, input, felt, given, outcome)
}

/// Fusion, told whether the pistons have rested.
fn feel(config: &Config, state: &mut State, input: &Input) {
    state.still_s = if input.steps == state.last_steps { state.still_s + input.dt_s } else { 0.0 };
    for (idle_s, (now, before)) in state.idle_s.iter_mut().zip(input.steps.0.iter().zip(state.last_steps.0)) {
        *idle_s = if *now == before { *idle_s + input.dt_s } else { 0.0 };
    }
    state.last_steps = input.steps;
    let energised = state.idle_s.map(|s| s < config.motors_idle_after_s);
    let coils_ut = config.motors.as_ref().map_or_else(Vector3::zeros, |m| m.at(&input.steps.0, &energised));
    let tip = match input.imu {
        Reading::Sample(sample, quality) => Reading::Sample(config.imu.apply(&sample), quality),
        other => other,
    };
    let still = state.still_s >= STILL_AFTER_S;
    state.fusion.update(&config.fuse, &Told { now: input.t, tip, base: input.base_imu, coils_ut, still });
}

/// Whether the pistons must stand: the closed loop does not move blindly, nor while it aligns again.
/// Entering a hold brakes each piston at its pace; leaving it, the targets start from where they stand.
fn hold(config: &Config, state: &mut State) -> bool {
    let blind = state.fusion.hold() && config.feedback.is_some();
    if !blind && !state.fusion.realigning() {
        state.held = None;
        return false;
    }
    if state.held.is_none() {
        let stop_mm = Vector3::from_fn(|i, _| {
            let (at, v) = (state.pistons[i].at.x, state.pistons[i].velocity.x);
            at + v * v.abs() / (2.0 * config.piston_pace.acceleration)
        });
        state.held = Some(Held { stop_mm });
        state.bend = Follower::resting(state.bend.at);
        state.length = Follower::resting(state.length.at);
    }
    true
}

/// The watch for a base that turns, where no base IMU tells; and the request to align again.
fn watch_base(config: &Config, state: &mut State, input: &Input, should: Vector2<f64>, felt: Bend) {
    // by the play, not as the inverse meant it: what was answered before the flag is taken back through
    // the gap, and need not end where it began
    let played = config.geometry.shape(&bellows_of(&state.lines, &state.slack_mm)).bend.0;
    let quiet_bend = Bend(state.quiet[1] + played - state.quiet[2]);
    if input.realign {
        state.fusion.realign(if state.base_moved { quiet_bend } else { felt });
        return;
    }
    if state.fusion.realigning() {
        (state.base_moved, state.watch) = (false, Watch::default());
        return;
    }
    let Some(rate_rad_s) = state.fusion.rate_rad_s().filter(|_| !state.base_moved && !state.fusion.follows_base()) else {
        return;
    };
    let seen = Seen {
        rate_rad_s,
        felt: felt.0,
        model: should + state.pi.feedback,
        setpoint: state.bend.at,
        to_go: state.target.bend.0 - felt.0,
        still_s: state.still_s,
        answer_s: state.dynamics.lag_s + state.dynamics.delay_s,
        twists: state.fusion.twists(),
        dt_s: input.dt_s,
    };
    state.base_moved = state.watch.step(&config.fuse.watch, &seen);
    if state.base_moved {
        // back to what was right before it turned
        (state.pi.integral, state.pi.feedback) = (state.quiet[0], state.quiet[0]);
    } else if state.watch.quiet() {
        state.quiet = [state.pi.integral, felt.0, played];
        state.fusion.remember(input.t);
    }
}

/// What the pulses so far have done: the slack by the play operator, which teaches k_ε, and the slack
/// as the inverse meant it, which the error is taken against. They differ while a nudge has jumped
/// only a share of the gap, and then it is the meant one that the integrator must push on.
fn pistons_give(config: &Config, state: &mut State, input: &Input) -> Bend {
    let piston_mm = config.drive.piston_mm(&input.steps);
    for i in 0..3 {
        state.slack_mm[i] = state.lines[i].play(state.slack_mm[i], piston_mm[i]);
        state.realised_mm[i] = realised(&state.lines[i], &state.sides[i], state.realised_mm[i], piston_mm[i]);
    }
    config.geometry.shape(&bellows_of(&state.lines, &state.realised_mm)).bend
}

fn bellows_of(lines: &[Line; 3], slack_mm: &Vector3<f64>) -> Vector3<f64> {
    Vector3::from_fn(|i, _| lines[i].bellow_mm(slack_mm[i]))
}

/// Moves the set-point towards the target, both kept within what the bellows can be.
fn advance_setpoint(config: &Config, state: &mut State, dt_s: f64) -> Cut {
    let (q, cut) = config.limits.bellows(&config.geometry.lengths(&state.target), config.geometry.rest_length_mm);
    if cut != Cut::None {
        state.target = config.geometry.shape(&q);
    }
    let mut pace = config.bend_pace;
    if let Some(f) = &config.feedback {
        // a slow line must be led by τ r̈; softer starts keep that within the pistons' pace
        pace.acceleration = pace.acceleration.min(pace.speed / (f.lead * state.dynamics.lag_s).max(1e-3));
    }
    state.bend.step(&state.target.bend.0, &pace, dt_s);
    state.length.step(&Vector1::new(state.target.length.0), &config.length_pace, dt_s);
    cut
}

/// PI on the bend vector against what the model says should be felt by now. With a base that has
/// moved the error means nothing, and the integrator keeps what it had.
fn feed_back(config: &Config, state: &mut State, should: Vector2<f64>, felt: Bend, moving: bool, dt_s: f64) -> Vector2<f64> {
    let error = should - felt.0;
    let Some(f) = &config.feedback else {
        return error;
    };
    let to_go = state.target.bend.0 - felt.0;
    if state.base_moved {
        state.rest = RestState::default();
        state.pi.feedback = state.pi.integral;
        return error;
    }
    state.rest.step(&f.rest, to_go, moving, dt_s);
    state.rested_s = if state.rest.closed { state.rested_s + dt_s } else { 0.0 };
    let feedback = state.pi.feedback;
    state.wall.step(&f.wall, moving, &feedback, &felt.0, &to_go);
    if !state.rest.closed && !state.wall.blocked && state.held.is_none() {
        let gains = PiGains::skogestad(&state.dynamics, f.tau_c_s, f.kp_max);
        state.full = state.pi.step(error, &gains, f.integral_max_rad, dt_s);
    }
    error
}

/// Online learners: dynamics while it moves, k_ε from every new held pose.
fn learn(config: &Config, state: &mut State, given: Bend, felt: Bend, dt_s: f64) {
    let learns_dynamics = config.feedback.is_some_and(|f| f.learn_dynamics);
    if learns_dynamics {
        state.bank.step(given.0, felt.0, dt_s);
    }
    let just_settled = state.rested_s >= LEARN_AFTER_S && state.rested_s - dt_s < LEARN_AFTER_S;
    if !just_settled {
        return;
    }
    if let (true, Some(better)) = (learns_dynamics, state.bank.best(&state.dynamics)) {
        state.dynamics = better;
    }
    let q = config.geometry.lengths(&Shape { bend: felt, length: Mm(state.length.at.x) });
    let learned = state.refine.learn(&config.refine, &state.lines, &felt.0, &state.slack_mm, &q);
    if let Some(next) = learned {
        // bumpless: the pistons stay, so the same slack now means another bend command
        let was = config.geometry.shape(&bellows_of(&state.lines, &state.realised_mm)).bend;
        let is = config.geometry.shape(&bellows_of(&next, &state.realised_mm)).bend;
        state.pi.hand_over(is.0 - was.0);
        state.lines = next;
    }
}

/// What the command path of one tick came to.
struct Outcome {
    error: Vector2<f64>,
    bellow_mm: Vector3<f64>,
    piston_target_mm: Vector3<f64>,
    cut: Cut,
}

impl Outcome {
    fn resting(state: &State) -> Self {
        Self {
            error: Vector2::zeros(),
            bellow_mm: Vector3::zeros(),
            piston_target_mm: Vector3::from_fn(|i, _| state.pistons[i].at.x),
            cut: Cut::None,
        }
    }
}

/// Bend command → bellow lengths → transmission inverse → limits → paced pistons.
fn command_pistons(config: &Config, state: &mut State, felt: Bend, moving: bool, dt_s: f64) -> Outcome {
    let lead_s = config.feedback.map_or(0.0, |f| f.lead * state.dynamics.lag_s);
    let bend = Bend(state.bend.at + state.bend.velocity * lead_s + state.pi.feedback);
    let length = Mm(state.length.at.x);
    let wanted_mm = config.geometry.lengths(&Shape { bend, length });
    let bellow_mm = wanted_mm.add_scalar(config.limits.relief(&wanted_mm, &state.lines));
    let piston_mm = if let Some(held) = state.held {
        held.stop_mm
    } else if state.rest.closed {
        Vector3::from_fn(|i, _| state.pistons[i].at.x)
    } else {
        invert_transmission(config, state, &bellow_mm, felt, moving, dt_s)
    };
    let felt_mm = config.geometry.lengths(&Shape { bend: felt, length });
    let (allowed_mm, cut) = config.limits.pistons(&piston_mm, &felt_mm);
    let piston_target_mm = eased(state, allowed_mm, dt_s);
    for i in 0..3 {
        state.pistons[i].step(&Vector1::new(piston_target_mm[i]), &config.piston_pace, dt_s);
    }
    Outcome { error: Vector2::zeros(), bellow_mm, piston_target_mm, cut }
}

/// After a hold the targets leave where the pistons stand without a jump.
fn eased(state: &mut State, target_mm: Vector3<f64>, dt_s: f64) -> Vector3<f64> {
    if let Some(held) = state.held {
        state.ease_mm = held.stop_mm;
        state.easing = true;
        return held.stop_mm;
    }
    if state.easing {
        // the first tick after it: what was a place becomes a difference
        (state.ease_mm, state.easing) = (state.ease_mm - target_mm, false);
    }
    state.ease_mm *= (-dt_s / EASE_S).exp();
    target_mm + state.ease_mm
}

/// Eq. 16 per channel; a reversal asked for by feedback alone jumps the learned share of the gap.
fn invert_transmission(config: &Config, state: &mut State, bellow_mm: &Vector3<f64>, felt: Bend, moving: bool, dt_s: f64) -> Vector3<f64> {
    let nudging = config.feedback.is_some() && !moving;
    let mut turned = [false; 3];
    let piston_mm = Vector3::from_fn(|i, _| {
        let reach = if nudging { state.reach.share(i) } else { 1.0 };
        let wanted = Wanted { q_mm: bellow_mm[i], dt_s, reach };
        let (u, next) = config.side.invert(&state.lines[i], state.sides[i], &wanted);
        turned[i] = next.way != state.sides[i].way;
        state.sides[i] = next;
        u
    });
    if nudging {
        let answer_s = state.dynamics.delay_s + 3.0 * state.dynamics.lag_s + 0.08;
        let worth_rad = config.feedback.map_or(0.0, |f| f.rest.open_rad);
        let bites = state.reach.step(turned, &(state.target.bend.0 - felt.0), &Patience { answer_s, worth_rad }, dt_s);
        for (side, bite) in state.sides.iter_mut().zip(bites) {
            side.side = (side.side + 2.0 * bite * side.way).clamp(-1.0, 1.0);
        }
    } else {
        state.reach.forget();
    }
    piston_mm
}

fn frame(config: &Config, state: &State, input: &Input, felt: Option<Felt>, given: Bend, outcome: Outcome) -> Frame {
    let mode = match felt {
        None => Mode::Aligning,
        Some(_) if state.bend.arrived(&state.target.bend.0) => Mode::Holding,
        Some(_) => Mode::Tracking,
    };
    Frame {
        t: input.t,
        mode,
        target: state.target,
        setpoint: Shape { bend: Bend(state.bend.at), length: Mm(state.length.at.x) },
        felt,
        pistons_give: given,
        error: outcome.error,
        feedback: state.pi.feedback,
        bellow_mm: outcome.bellow_mm,
        piston_target_mm: outcome.piston_target_mm,
        steps: config.drive.steps(&Vector3::from_fn(|i, _| state.pistons[i].at.x)),
        k_epsilon: state.lines.map(|l| l.k_epsilon),
        dynamics: state.dynamics,
        cut: outcome.cut,
        at_rest: state.rest.closed,
        blocked: state.wall.blocked,
        spent: state.spent.now(),
        senses: Senses {
            action: state.fusion.verdict().map_or(Action::Use, |v| v.action()),
            in_force: state.fusion.in_force(),
            held: state.held.is_some(),
            disagrees: felt.is_some_and(|f| f.disagrees),
        },
        base_moved: state.base_moved,
        base_doubted: state.fusion.doubts_base(&config.fuse),
    }
}
