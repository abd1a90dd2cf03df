//! `retroflex jog`: moves one piston slowly over a short distance and back. It returns because the drivers are released at the
//! end, and pressure would then push the piston.

use crate::cli::{manual_motion, output, within};
use crate::supervisor::commission::manual_motion::ManualMotion;
use miette::{Result, bail};
use std::path::PathBuf;

/// Longest jog, mm: about a third of the travel.
const DISTANCE_MAX_MM: f64 = 10.0;
/// Highest speed, mm/s.
const SPEED_MAX_MM_S: f64 = 10.0;

/// Arguments of `jog`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Board file.
    #[arg(long)]
    board: PathBuf,
    /// Channel, 1 to 3.
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=3))]
    channel: u8,
    /// Distance, mm, at most 10; positive elongates the bellow.
    #[arg(long, allow_negative_numbers = true, value_parser = within(-DISTANCE_MAX_MM..=DISTANCE_MAX_MM, "mm"))]
    mm: f64,
    /// Speed, mm/s, at most 10.
    #[arg(long, default_value_t = 2.0, value_parser = within(0.01..=SPEED_MAX_MM_S, "mm/s"))]
    speed: f64,
    /// Time to hold there, s.
    #[arg(long, default_value_t = 1.0, value_parser = within(0.0..=60.0, "s"))]
    hold: f64,
    /// Stay there instead of returning. The drivers are released, so pressure will push the piston.
    #[arg(long)]
    stay: bool,
    /// Number of strokes.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    times: u32,
}

/// Runs the command.
///
/// # Errors
/// A report: bad input, hardware that does not answer, or the reason that ended the motion.
pub fn run(args: &Args) -> Result<()> {
    if args.stay && args.times != 1 {
        let times = args.times;
        bail!("--stay and --times {times} contradict each other; omit one of them");
    }
    let (_, mut machine) = manual_motion::open(&args.board, manual_motion::without_sensors)?;
    let channel = usize::from(args.channel) - 1;
    let stroke = |hand: &mut ManualMotion<'_>| {
        hand.energise(true)?;
        let (mut target, mut out) = ([0.0; 3], 0.0);
        target[channel] = args.mm;
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
    let report = manual_motion::motion_error;
    let (out, back) = manual_motion::with_manual_control(machine.as_mut(), report, stroke)?;
    let (channel, step_mm) = (args.channel, machine.info().step_mm);
    let shown = |mm: f64| format!("{mm:.3} mm ({:.0} steps)", mm / step_mm);
    let (out, back) = (shown(out), shown(back));
    output::print(format!(
        "channel {channel}: reached {out}, now at {back}, drivers released\n"
    ));
    Ok(())
}
