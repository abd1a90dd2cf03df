//! The time of a control tick, and how often a loop misses its deadline; one JSON object on standard output.
//!
//! ```text
//! peer_tick record > inputs.csv                       the inputs, for stacks in other languages
//! peer_tick time --stack retroflex --ticks 1000000    the time of each tick
//! peer_tick late --stack ahrs --rate 1000 --seconds 20 --priority 80
//! ```
//!
//! The inputs are one minute of the paper's experiment on the paper twin, a sample of the IMU every 2 ms. `retroflex` is its
//! whole tick, from fusion to microsteps. `ahrs` is what one writes first with the crate of that name: Madgwick's filter, a
//! PI loop, the inverse of the arc and of the transmission.

use ahrs::{Ahrs, Madgwick};
use clap::{Parser, Subcommand, ValueEnum};
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use retroflex::config::assemble;
use retroflex::config::board::{Board, PlantSection};
use retroflex::config::calib::Calibration;
use retroflex::config::gains::Gains;
use retroflex::config::source;
use retroflex::control::tick::{Input, LoopConfig, LoopState, tick};
use retroflex::experiment::evaluation::for_world;
use retroflex::experiment::schedule::{HOLD_S, paper};
use retroflex::hardware::rt::{self, RtRequest, monotonic_ns, sleep_until_ns};
use retroflex::model::Shape;
use retroflex::model::bend::Bend;
use retroflex::motion::machine::Machine;
use retroflex::primitives::ImuReading;
use retroflex::primitives::sample::ImuSample;
use retroflex::primitives::units::{Mm, Seconds};
use retroflex::simulation::lockstep::Lockstep;
use retroflex::simulation::sim::Sim;
use retroflex::simulation::world::World;
use serde_json::json;
use std::error::Error;
use std::hint::black_box;
use std::io::{BufWriter, Write};

/// Time of a tick, s.
const PERIOD_S: f64 = 0.002;
/// Length of the inputs, s, with the rest before the first pose.
const LENGTH_S: f64 = 60.0;
const REST_S: f64 = 3.0;

#[derive(Parser)]
struct Args {
    #[command(subcommand)]
    command: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Write the inputs as CSV.
    Record,
    /// Time every tick.
    Time {
        #[arg(long)]
        stack: Stack,
        #[arg(long, default_value_t = 1_000_000)]
        ticks: usize,
    },
    /// Run ticks at absolute times and count those that end after the next one is due.
    Late {
        #[arg(long)]
        stack: Stack,
        #[arg(long, default_value_t = 1000.0)]
        rate: f64,
        #[arg(long, default_value_t = 10.0)]
        seconds: f64,
        /// Priority of SCHED_FIFO; 0 stays in the ordinary class.
        #[arg(long, default_value_t = 0)]
        priority: i32,
    },
}

#[derive(Clone, Copy, ValueEnum)]
enum Stack {
    Retroflex,
    Ahrs,
}

fn main() -> Result<(), Box<dyn Error>> {
    let config = config()?;
    let inputs = inputs(&config)?;
    match Args::parse().command {
        Task::Record => record(&inputs)?,
        Task::Time { stack, ticks } => {
            println!("{}", time(&mut runner(stack, &config, &inputs), ticks))
        }
        Task::Late {
            stack,
            rate,
            seconds,
            priority,
        } => {
            println!(
                "{}",
                late(
                    &mut runner(stack, &config, &inputs),
                    rate,
                    seconds,
                    priority
                )
            )
        }
    }
    Ok(())
}

fn board() -> Result<Board, Box<dyn Error>> {
    Ok(source::parse(
        "boards/sim.toml",
        include_str!("../../boards/sim.toml"),
    )?)
}

fn sim() -> Result<Sim, Box<dyn Error>> {
    let plant: PlantSection = board()?.plant.ok_or("the board of the twin has no plant")?;
    Ok(Sim::new(&plant, 1, 1, PERIOD_S)?)
}

fn config() -> Result<LoopConfig, Box<dyn Error>> {
    let calib: Calibration =
        source::parse("calib/paper.toml", include_str!("../../calib/paper.toml"))?;
    Ok(for_world(
        &assemble(&board()?, &calib, &Gains::default()),
        &sim()?,
    ))
}

/// The inputs of the loop while it drives the experiment.
fn inputs(config: &LoopConfig) -> Result<Vec<Input>, Box<dyn Error>> {
    let world = sim()?;
    let dt_s = world.info().period_s;
    let (mut machine, mut state) = (Lockstep::new(world, &config.motion), LoopState::new(config));
    machine.energise(true);
    let mut input = Input {
        dt_s,
        ..Input::default()
    };
    let mut poses = paper().into_iter();
    let (rest, hold) = ((REST_S / dt_s) as usize, (HOLD_S / dt_s) as usize);
    let mut all = Vec::new();
    for k in 0..(LENGTH_S / dt_s) as usize {
        if k >= rest && (k - rest).is_multiple_of(hold) {
            input.command = poses.next().map(|p| Shape {
                bend: p.bend(),
                length: Mm(config.geometry.rest_length_mm),
            });
        }
        all.push(input);
        let frame = tick(config, &mut state, &input);
        let t = Seconds((k + 1) as f64 * dt_s);
        let sensed = machine.turn(t, &frame.steps)?;
        input = Input {
            t,
            imu: sensed.imu,
            steps: sensed.counted,
            command: None,
            ..input
        };
    }
    Ok(all)
}

/// The sample of an input.
fn sample(input: &Input) -> Option<&ImuSample> {
    match &input.imu {
        ImuReading::Sample(sample, _) => Some(sample),
        _ => None,
    }
}

/// Samples and targets; the field is the last one that was read.
fn record(inputs: &[Input]) -> std::io::Result<()> {
    let mut out = BufWriter::new(std::io::stdout().lock());
    writeln!(
        out,
        "gyr_x,gyr_y,gyr_z,acc_x,acc_y,acc_z,mag_x,mag_y,mag_z,bend_x,bend_y"
    )?;
    let (mut mag, mut target) = (None, Bend::STRAIGHT);
    for input in inputs {
        target = input.command.map_or(target, |c| c.bend);
        let Some(s) = sample(input) else { continue };
        mag = s.mag_ut.or(mag);
        let Some(mag) = mag else { continue };
        let columns = [s.gyro_rad_s, s.acc_m_s2, mag];
        let columns: Vec<String> = columns
            .iter()
            .flatten()
            .chain(&target.0)
            .map(f64::to_string)
            .collect();
        writeln!(out, "{}", columns.join(","))?;
    }
    out.flush()
}

/// A stack that runs one tick a call, over the inputs again and again.
fn runner<'a>(stack: Stack, config: &'a LoopConfig, inputs: &'a [Input]) -> Box<dyn FnMut() + 'a> {
    let mut at = 0;
    match stack {
        Stack::Retroflex => {
            let mut state = LoopState::new(config);
            Box::new(move || {
                if at == inputs.len() {
                    (at, state) = (0, LoopState::new(config));
                }
                black_box(tick(config, &mut state, black_box(&inputs[at])));
                at += 1;
            })
        }
        Stack::Ahrs => {
            let mut naive = Naive::new(config);
            Box::new(move || {
                if at == inputs.len() {
                    (at, naive) = (0, Naive::new(config));
                }
                black_box(naive.tick(black_box(&inputs[at])));
                at += 1;
            })
        }
    }
}

/// Madgwick's filter with the least that makes a loop of it.
struct Naive<'a> {
    config: &'a LoopConfig,
    filter: Madgwick<f64>,
    mag: Vector3<f64>,
    rest: Option<UnitQuaternion<f64>>,
    target: Vector2<f64>,
    integral: Vector2<f64>,
    q_mm: [f64; 3],
    side: [f64; 3],
}

impl<'a> Naive<'a> {
    fn new(config: &'a LoopConfig) -> Self {
        Self {
            config,
            filter: Madgwick::new(PERIOD_S, 0.1),
            mag: Vector3::x(),
            rest: None,
            target: Vector2::zeros(),
            integral: Vector2::zeros(),
            q_mm: [0.0; 3],
            side: [0.0; 3],
        }
    }

    fn tick(&mut self, input: &Input) -> [i32; 3] {
        if let Some(s) = sample(input) {
            self.mag = s.mag_ut.unwrap_or(self.mag);
            // a sample that the filter refuses is left out
            let _ = self.filter.update(&s.gyro_rad_s, &s.acc_m_s2, &self.mag);
        }
        if let Some(command) = input.command {
            self.target = command.bend.0;
            self.rest.get_or_insert(self.filter.quat);
        }
        let Some(rest) = self.rest else { return [0; 3] };
        let tip = rest.inverse() * self.filter.quat;
        let turn = tip.scaled_axis();
        let error = self.target - Vector2::new(turn.y, turn.x);
        self.integral += error * (0.8 * PERIOD_S);
        let bend = self.target + error * 0.1 + self.integral;
        let r_mm = self.config.geometry.r_mm;
        std::array::from_fn(|i| {
            let (sin, cos) = (std::f64::consts::TAU / 3.0 * i as f64).sin_cos();
            let q_mm = -r_mm * (bend.x * cos - bend.y * sin);
            if (q_mm - self.q_mm[i]).abs() > 1e-3 {
                self.side[i] = (q_mm - self.q_mm[i]).signum();
                self.q_mm[i] = q_mm;
            }
            let line = &self.config.lines[i];
            let piston_mm = (1.0 + line.k_epsilon) * q_mm + line.k_lambda_mm * self.side[i];
            (piston_mm / self.config.drive.step_mm).round() as i32
        })
    }
}

/// Times `ticks` ticks one by one, after one pass over the inputs to warm up.
fn time(run: &mut dyn FnMut(), ticks: usize) -> serde_json::Value {
    (0..(LENGTH_S / PERIOD_S) as usize).for_each(|_| run());
    let mut each: Vec<u64> = Vec::with_capacity(ticks);
    for _ in 0..ticks {
        let from = monotonic_ns();
        run();
        each.push(monotonic_ns() - from);
    }
    each.sort_unstable();
    let at = |share: f64| each[((share * ticks as f64) as usize).min(ticks - 1)];
    json!({ "ticks": ticks, "median_ns": at(0.5), "p999_ns": at(0.999), "worst_ns": at(1.0) })
}

/// Runs ticks at absolute times. Late is a tick that ends after the next one is due; those that are due by then are skipped
/// and late too.
fn late(run: &mut dyn FnMut(), rate: f64, seconds: f64, priority: i32) -> serde_json::Value {
    let (status, _guard) = rt::enter(&RtRequest {
        priority,
        cpu: None,
    });
    let period_ns = (1e9 / rate) as u64;
    let ticks = (seconds * rate) as u64;
    let start = monotonic_ns() + 100_000_000;
    let (mut late, mut worst_ns, mut k) = (0, 0, 0);
    while k < ticks {
        let due = start + k * period_ns;
        sleep_until_ns(due);
        run();
        let took_ns = monotonic_ns() - due;
        worst_ns = worst_ns.max(took_ns);
        let missed = took_ns / period_ns;
        late += missed.min(ticks - k);
        k += missed.max(1);
    }
    json!({ "ticks": ticks, "late": late, "worst_ns": worst_ns, "scheduling": status[0].1.to_string() })
}
