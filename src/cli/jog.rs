//! `retroflex jog`: one piston, slowly, a little; and back, for pressure must not be left on a motor
//! without current.

use crate::cli::{CommandOutcome, manual_motion, output};
use miette::{Result, miette};
use std::path::PathBuf;

/// Farthest that a jog goes, mm.
const FAR_MM: f64 = 10.0;
/// Fastest that it goes, mm/s.
const FAST_MM_S: f64 = 10.0;

/// Arguments of `jog`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Board file.
    #[arg(long)]
    board: PathBuf,
    /// Channel, 1 to 3.
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=3))]
    channel: u8,
    /// How far, mm; + elongates the bellow. At most 10.
    #[arg(long, allow_negative_numbers = true)]
    mm: f64,
    /// How fast, mm/s. At most 10.
    #[arg(long, default_value_t = 2.0)]
    speed: f64,
    /// How long to stand there, s.
    #[arg(long, default_value_t = 1.0)]
    hold: f64,
    /// Stay there instead of going back; the drivers are released, and pressure will push the piston.
    #[arg(long)]
    stay: bool,
    /// Go out and back this many times.
    #[arg(long, default_value_t = 1)]
    times: u32,
}

/// Runs the command.
///
/// # Errors
/// A report: bad input, hardware that does not answer, or what ended the move.
pub fn run(args: &Args) -> Result<CommandOutcome> {
    if !(args.mm.abs() <= FAR_MM && args.speed > 0.0 && args.speed <= FAST_MM_S && (0.0..=60.0).contains(&args.hold)) {
        return Err(miette!(
            "--mm {} --speed {} --hold {}: a jog goes at most {FAR_MM} mm at most {FAST_MM_S} mm/s and holds at most 60 s",
            args.mm,
            args.speed,
            args.hold
        ));
    }
    if args.stay && args.times != 1 {
        return Err(miette!("--stay and --times {} contradict each other; leave one out", args.times));
    }
    let (_, mut machine) = manual_motion::open(&args.board, |config| {
        // no sensor is needed to turn a motor
        (config.imu, config.base_imu) = (None, None);
    })?;
    let channel = usize::from(args.channel) - 1;
    let (out, back) = manual_motion::at_hand(machine.as_mut(), |hand| {
        let mut all = || {
            hand.energise(true)?;
            let mut target = [0.0; 3];
            target[channel] = args.mm;
            let mut out = 0.0;
            for _ in 0..args.times {
                hand.go(target, args.speed, &mut |_| false)?;
                out = hand.stands_mm()[channel];
                hand.stand(args.hold, &mut |_| ())?;
                if !args.stay {
                    hand.go([0.0; 3], args.speed, &mut |_| false)?;
                }
            }
            hand.energise(false)?;
            Ok((out, hand.stands_mm()[channel]))
        };
        all().map_err(manual_motion::ended)
    })?;
    let step_mm = machine.info().step_mm;
    let text = format!(
        "channel {}: out to {out:.3} mm ({:.0} steps), now at {back:.3} mm ({:.0} steps), drivers released\n",
        args.channel,
        out / step_mm,
        back / step_mm
    );
    output::print(&text);
    Ok(CommandOutcome::Good)
}
