//! The built-in plant as a program of its own, behind the plant link on standard input and output.
//!
//! ```text
//! retroflex evaluate --plant 'exec:target/release/examples/plant_server --unit 3 --condition line_lag_s=0.6'
//! ```
//!
//! Units and conditions are those of `retroflex evaluate --sweep`. One line of the link is one period of the IMU; within it
//! the plant takes its own smaller steps with the counts held.

use clap::Parser;
use retroflex::config::board::Board;
use retroflex::config::source;
use retroflex::experiment::sweep::CONDITIONS;
use retroflex::primitives::sample::ImuSample;
use retroflex::primitives::units::Steps;
use retroflex::simulation::plant::PlantConfig;
use retroflex::simulation::sim::Sim;
use retroflex::simulation::world::{Reply, World};
use serde::Deserialize;
use std::error::Error;
use std::io::{BufRead, BufWriter, Write};

/// Angle between the directions of successive units in a condition, degrees, as in the sweep.
const TURN_DEG: f64 = 137.5;

#[derive(Parser)]
struct Args {
    /// Unit: 0 is the paper twin itself, every other number draws a unit from its spread.
    #[arg(long, default_value_t = 0)]
    unit: u64,
    /// Condition of the sweep with its value, such as `line_lag_s=0.6`.
    #[arg(long, value_name = "NAME=VALUE")]
    condition: Option<String>,
    /// Seed of the noise.
    #[arg(long, default_value_t = 0)]
    noise: u64,
}

#[derive(Deserialize)]
struct Request {
    t: f64,
    steps: [i32; 3],
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    let board: Board = source::parse("boards/sim.toml", include_str!("../../boards/sim.toml"))?;
    let twin = board.plant.ok_or("the board of the twin has no plant")?;
    let unit = unit(&args, &twin)?;
    let world = Sim::new(&unit, 0, args.noise, unit.period_s)?;
    let inner = ((unit.imu.period_s / unit.period_s).round() as usize).max(1);
    serve(world, inner, unit.imu.period_s, unit.base.imu)
}

/// The plant that the arguments describe.
fn unit(args: &Args, twin: &PlantConfig) -> Result<PlantConfig, Box<dyn Error>> {
    let make = twin.clone();
    let mut unit = if args.unit == 0 {
        make
    } else {
        make.drawn(args.unit)
    };
    if let Some(text) = &args.condition {
        let (name, value) = text
            .split_once('=')
            .ok_or_else(|| format!("--condition {text}: expected NAME=VALUE"))?;
        let known = || CONDITIONS.map(|c| c.name).join(", ");
        let condition = CONDITIONS
            .iter()
            .find(|c| c.name == name)
            .ok_or_else(|| format!("no condition {name}; there are {}", known()))?;
        (condition.apply)(
            &mut unit,
            value.parse()?,
            TURN_DEG * args.unit.saturating_sub(1) as f64 % 360.0,
        );
    }
    unit.validate()?;
    Ok(unit)
}

/// Greets, then answers every request until end of file.
fn serve(
    mut world: Sim,
    inner: usize,
    period_s: f64,
    base_imu: bool,
) -> Result<(), Box<dyn Error>> {
    let mut out = BufWriter::new(std::io::stdout().lock());
    let info = world.info();
    let (step_mm, rest_mm) = (info.step_mm, info.rest_length_mm);
    writeln!(
        out,
        "{{\"plant\":\"twin\",\"protocol\":1,\"imu_period_s\":{period_s},\"step_mm\":{step_mm},\"rest_length_mm\":{rest_mm},\"base_imu\":{base_imu}}}"
    )?;
    out.flush()?;
    for line in std::io::stdin().lock().lines() {
        let request: Request = serde_json::from_str(&line?)?;
        let (mut imu, mut base, mut truth) = (None, None, None);
        for _ in 0..inner {
            let reply: Reply = world.step(&Steps(request.steps))?;
            imu = reply.imu.or(imu);
            base = reply.base_imu.or(base);
            truth = reply.truth;
        }
        write!(
            out,
            "{{\"t\":{},\"imu\":{}",
            request.t,
            sample(imu.as_ref())
        )?;
        if base_imu {
            write!(out, ",\"base\":{}", sample(base.as_ref()))?;
        }
        if let Some(truth) = truth {
            let q = truth.quat();
            write!(
                out,
                ",\"ref\":{{\"quat\":[{},{},{},{}]}}",
                q.w, q.i, q.j, q.k
            )?;
        }
        writeln!(out, "}}")?;
        out.flush()?;
    }
    Ok(())
}

/// A sample as JSON.
fn sample(sample: Option<&ImuSample>) -> String {
    let vector = |v: &nalgebra::Vector3<f64>| format!("[{},{},{}]", v.x, v.y, v.z);
    sample.map_or("null".to_owned(), |s| {
        let mag = s.mag_ut.as_ref().map_or("null".to_owned(), vector);
        format!(
            "{{\"acc\":{},\"gyr\":{},\"mag\":{mag}}}",
            vector(&s.acc_m_s2),
            vector(&s.gyro_rad_s)
        )
    })
}
