//! `steer`: bends the tip by hand with a joystick, the arrow keys, or a recorded list of stick movements.

mod input;
mod law;

use super::connection::{At, ask, connect, report, status};
use super::play::halted;
use crate::cli::inputs::{self, within};
use crate::cli::{Refused, Unreachable};
use crate::model::Bend;
use crate::service::client::Client as Connection;
use crate::service::protocol::Request;
use input::{Event, Input};
use law::Law;
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
    let mut steering = Steering::new(args, connect(&args.at)?);
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
        if let Some(silence_s) = input
            .silence
            .filter(is_over)
            .map(|silence| silence.as_secs_f64())
        {
            held = false;
            eprintln!(
                "\x07warning: the joystick has said nothing for {silence_s} s, so it may be out of range: holding; release the button and press it again"
            );
        }
        let over = ended.load(Relaxed);
        match held && !over {
            true => steering.step(&stick, since_s)?,
            false => steering.release()?,
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
    fn new(args: &SteerArgs, connection: Connection) -> Self {
        let began = Instant::now();
        Self {
            connection,
            law: args.law,
            at: Vector2::zeros(),
            moving: false,
            released: None,
            began,
            last: began,
            cycles: 0,
            warned: None,
        }
    }

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
        let request = Request::Stream {
            bend_deg,
            dir_deg,
            length_mm: None,
            t_s: Some(self.began.elapsed().as_secs_f64()),
        };
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
