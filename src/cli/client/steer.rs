//! `steer`: bends the tip by hand with a joystick, the arrow keys, or a recorded list of stick movements: from the stick to the bend, with
//! a dead zone, a progressive response, and limits of bend and speed.

mod input;

use super::connection::{At, Connection, ask, connect, halted, report, status};
use crate::cli::{Refused, Unreachable, inputs, within};
use crate::model::Bend;
use crate::service::protocol::Request;
use input::{Event, Input};
use miette::Result;
use nalgebra::Vector2;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

/// Period of the set-points, s.
const PERIOD_S: f64 = 0.02;
/// Set-points between two readings of the status.
const STATUS_EVERY: u32 = 10;
/// Time after a release in which a set-point may be refused, because the tip brakes.
const BRAKES: Duration = Duration::from_secs(1);

/// Arguments of `steer`.
#[derive(Debug, clap::Args)]
pub struct SteerArgs {
    #[command(flatten)]
    at: At,
    /// Joystick, for example /dev/input/js0. Default: the first one; without any, the arrow keys of the terminal.
    #[arg(long, value_name = "DEVICE")]
    device: Option<PathBuf>,
    /// Dead-man button of the joystick, counted from 0. Default: any button.
    #[arg(long, value_parser = clap::value_parser!(u8).range(0..32))]
    button: Option<u8>,
    /// Time without any event after which a joystick counts as out of range, and the tip holds, s. A larger value allows a longer steady
    /// deflection.
    #[arg(long, default_value_t = 3.0, value_parser = within(0.2..=3600.0, "s"))]
    silence: f64,
    /// Steer by a table `t_s,x,y,held` of stick movements.
    #[arg(long, value_name = "FILE.csv", conflicts_with_all = ["device", "button"])]
    replay: Option<PathBuf>,
    #[command(flatten)]
    law: Law,
}

/// Steers until the operator ends. The tip moves while the dead-man button is held, and holds when it is released.
///
/// # Errors
/// A report about the input, or with the service's message; a device that is gone counts as unreachable.
pub fn steer(args: &SteerArgs) -> Result<()> {
    let input = open(args)?;
    let mut steering = Steering {
        connection: connect(&args.at)?,
        law: args.law,
        at: Vector2::zeros(),
        moving: false,
        released: None,
        began: Instant::now(),
        last: Instant::now(),
        cycles: 0,
        warned: None,
    };
    if let Some(why) = steering.ready()? {
        let why = format!("steering moves the tip, so it must be armed: {why}");
        return Err(Refused::report(why));
    }
    let ended = inputs::ended()?;
    let (mut stick, mut held, mut since_s) = (Vector2::zeros(), false, PERIOD_S);
    let mut heard = Instant::now();
    loop {
        for event in input.events.try_iter() {
            heard = Instant::now();
            match event {
                Event::X(x) => stick.x = x,
                Event::Y(y) => stick.y = y,
                Event::Held(now) => held = now,
                Event::End => ended.store(true, Relaxed),
                Event::Gone(why) => {
                    steering.release()?;
                    return Err(Unreachable::report("the joystick", why + ": holding"));
                }
            }
        }
        let is_over = |silence: &Duration| held && heard.elapsed() > *silence;
        if let Some(silence) = input.silence.filter(is_over) {
            let silence_s = silence.as_secs_f64();
            held = false;
            eprintln!(
                "\x07warning: the joystick has said nothing for {silence_s} s, so it may be out of range: holding; release the button and press it again"
            );
        }
        let over = ended.load(Relaxed);
        if held && !over {
            steering.step(&stick, since_s)?
        } else {
            steering.release()?
        }
        if over {
            return Ok(());
        }
        since_s = steering.wait();
    }
}

fn open(args: &SteerArgs) -> Result<Input> {
    if let Some(file) = &args.replay {
        return Input::table(file);
    }
    if let Some(device) = args.device.clone().or_else(input::first_joystick) {
        let button = args.button.map(|b| format!("button {b}"));
        let button = button.unwrap_or("any button".to_owned());
        eprintln!("{}: hold {button} and move the stick", device.display());
        let silence = Duration::from_secs_f64(args.silence);
        return Input::joystick(&device, args.button, silence);
    }
    if std::io::stdin().is_terminal() {
        eprintln!("arrow keys bend, the space bar holds, q ends");
    }
    Input::keyboard()
}

/// The bend under way.
struct Steering {
    connection: Connection,
    law: Law,
    /// Last bend that was accepted, rad.
    at: Vector2<f64>,
    moving: bool,
    released: Option<Instant>,
    began: Instant,
    /// When the last set-point was due.
    last: Instant,
    cycles: u32,
    warned: Option<String>,
}

impl Steering {
    /// Starts from the present target; says why the tip cannot be steered.
    fn ready(&mut self) -> Result<Option<String>> {
        let s = status(&mut self.connection)?;
        self.at = s.target.unwrap_or_default().bend().0;
        Ok(halted(&s))
    }

    /// One set-point. It is an error if the service no longer moves. A pause of this process or of the service is not made up for.
    fn step(&mut self, stick: &Vector2<f64>, since_s: f64) -> Result<()> {
        let next = self.law.next(&self.at, stick, since_s);
        let bend = Bend(next);
        let (bend_deg, dir_deg) = (bend.beta().to_degrees(), bend.delta().to_degrees());
        let t_s = self.began.elapsed().as_secs_f64();
        let request = Request::stream(bend_deg, dir_deg, Some(t_s));
        match self.connection.request(&request) {
            Ok(_) => (self.at, self.moving) = (next, true),
            Err(f) if f.code == 1 => {
                if let Some(why) = halted(&status(&mut self.connection)?) {
                    return Err(Refused(format!("steering ended: {why}")).into());
                }
                if self.released.is_none_or(|at| at.elapsed() > BRAKES) {
                    self.warn(Some(f.message));
                }
            }
            Err(f) => return Err(report(f)),
        }
        if self.cycles.is_multiple_of(STATUS_EVERY) && self.moving {
            let shortfall = status(&mut self.connection)?.shortfall;
            self.warn(shortfall);
        }
        Ok(())
    }

    /// The tip holds where it is.
    fn release(&mut self) -> Result<()> {
        if std::mem::take(&mut self.moving) {
            self.released = Some(Instant::now());
            ask(&mut self.connection, &Request::Hold {})?;
            self.ready()?;
        }
        Ok(())
    }

    /// Prints a warning once.
    fn warn(&mut self, warning: Option<String>) {
        if let Some(text) = warning.as_ref().filter(|_| warning != self.warned) {
            eprintln!("\x07warning: {text}");
        }
        self.warned = warning;
    }

    /// Waits for the next set-point; the time since the last, s, of which a longer pause counts as two periods.
    fn wait(&mut self) -> f64 {
        self.cycles = self.cycles.wrapping_add(1);
        let period = Duration::from_secs_f64(PERIOD_S);
        std::thread::sleep(period.saturating_sub(self.last.elapsed()));
        let since = std::mem::replace(&mut self.last, Instant::now()).elapsed();
        since.as_secs_f64().min(2.0 * PERIOD_S)
    }
}

/// What the stick commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Mode {
    /// The speed of the bend: the tip stays where it is when the stick returns.
    Rate,
    /// The bend itself: the tip is straight when the stick returns.
    Position,
}

/// The law. Bend vectors in rad, b = β (cos δ, sin δ); stick vectors with the length 1 at the rim.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Law {
    /// What the stick commands: the speed of the bend, or the bend itself.
    #[arg(long, value_enum, default_value = "rate")]
    mode: Mode,
    /// Largest bend, degrees. A larger value reaches further.
    #[arg(long, default_value_t = 60.0, value_parser = within(1.0..=135.0, "degrees"))]
    bend_max: f64,
    /// Largest speed, °/s. A larger value is quicker and less precise.
    #[arg(long, default_value_t = 40.0, value_parser = within(1.0..=180.0, "°/s"))]
    speed: f64,
    /// Deflection below which the stick counts as released, of 1. A larger value tolerates a worn stick.
    #[arg(long, default_value_t = 0.12, value_parser = within(0.0..=0.9, ""))]
    dead_zone: f64,
    /// Share of a cubic response, 0 to 1. A larger value makes the centre finer.
    #[arg(long, default_value_t = 0.5, value_parser = within(0.0..=1.0, ""))]
    expo: f64,
}

impl Law {
    /// The next bend after a time, s.
    pub fn next(&self, at: &Vector2<f64>, stick: &Vector2<f64>, dt_s: f64) -> Vector2<f64> {
        let [bend_max, speed] = [self.bend_max, self.speed].map(f64::to_radians);
        let shaped = self.shaped(stick);
        let step = match self.mode {
            Mode::Rate => shaped * speed * dt_s,
            Mode::Position => (shaped * bend_max - at).cap_magnitude(speed * dt_s),
        };
        (at + step).cap_magnitude(bend_max)
    }

    /// The deflection beyond the dead zone, with the cubic response: the centre is finer than the rim.
    fn shaped(&self, stick: &Vector2<f64>) -> Vector2<f64> {
        let size = stick.norm();
        if size <= self.dead_zone {
            return Vector2::zeros();
        }
        let x = ((size - self.dead_zone) / (1.0 - self.dead_zone)).min(1.0);
        stick * (((1.0 - self.expo) * x + self.expo * x.powi(3)) / size)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAW: Law = Law {
        mode: Mode::Rate,
        dead_zone: 0.1,
        expo: 0.5,
        bend_max: 1.0_f64.to_degrees(),
        speed: 0.5_f64.to_degrees(),
    };

    #[test]
    fn the_response_is_zero_in_the_dead_zone_fine_beside_it_and_full_at_the_rim() {
        let shaped = |x: f64| LAW.shaped(&Vector2::new(x, 0.0)).x;
        assert_eq!((shaped(0.0), shaped(0.1)), (0.0, 0.0));
        assert!(
            (shaped(1.0) - 1.0).abs() < 1e-12
                && (shaped(-1.0) + 1.0).abs() < 1e-12
                && (shaped(3.0) - 1.0).abs() < 1e-12
        );
        let slope = |x: f64| (shaped(x + 1e-6) - shaped(x)) / 1e-6;
        assert!(
            slope(0.15) < 0.6 && slope(0.95) > 1.5,
            "{} {}",
            slope(0.15),
            slope(0.95)
        );
    }

    #[test]
    fn a_rate_integrates_up_to_the_largest_bend_and_a_position_returns() {
        let full = Vector2::new(0.0, 1.0);
        let run = |law: Law, from: Vector2<f64>, stick: Vector2<f64>| {
            (0..100).fold(from, |at, _| law.next(&at, &stick, 0.02))
        };
        assert!(
            (run(LAW, Vector2::zeros(), full) - full).norm() < 1e-9,
            "0.5 rad/s for 2 s"
        );
        assert!((run(LAW, full * 0.8, full).norm() - 1.0).abs() < 1e-9);
        assert_eq!(run(LAW, full, Vector2::zeros()), full);
        let position = Law {
            mode: Mode::Position,
            ..LAW
        };
        assert!(run(position, full, Vector2::zeros()).norm() < 1e-9);
        assert!(
            (position.next(&full, &Vector2::zeros(), 0.02) - full).norm() < 0.5 * 0.02 + 1e-12,
            "limited in speed"
        );
    }
}
