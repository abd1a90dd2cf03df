//! `retroflex jog`: moves one piston slowly over a short distance and back. It returns because the drivers are released at the
//! end, and pressure would then push the piston.

use crate::cli::{manual_motion, output, within};
use crate::supervisor::commission::manual_motion::ManualMotion;
use miette::Result;
use std::path::PathBuf;

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
    #[arg(long, allow_negative_numbers = true, value_parser = within(-10.0..=10.0, "mm"))]
    mm: f64,
    /// Speed, mm/s, at most 10.
    #[arg(long, default_value_t = 2.0, value_parser = within(0.01..=10.0, "mm/s"))]
    speed: f64,
    /// Time to hold there, s.
    #[arg(long, default_value_t = 1.0, value_parser = within(0.0..=60.0, "s"))]
    hold: f64,
}

/// Runs the command.
///
/// # Errors
/// A report: bad input, hardware that does not answer, or the reason that ended the motion.
pub fn run(args: &Args) -> Result<()> {
    let (_, mut machine) = manual_motion::open(&args.board, manual_motion::without_sensors)?;
    let channel = usize::from(args.channel) - 1;
    let stroke = |hand: &mut ManualMotion<'_>| {
        hand.energise(true)?;
        let mut target = [0.0; 3];
        target[channel] = args.mm;
        hand.go(target, args.speed, &mut |_| false)?;
        let out = hand.stands_mm()[channel];
        hand.stand(args.hold, &mut |_| ())?;
        hand.go([0.0; 3], args.speed, &mut |_| false)?;
        hand.energise(false)?;
        Ok((out, hand.stands_mm()[channel]))
    };
    let report = manual_motion::motion_error;
    let (out, back) = manual_motion::with_manual_control(machine.as_mut(), report, stroke)?;
    let (channel, step_mm) = (args.channel, machine.info().step_mm);
    let [out, back] = [out, back].map(|mm| format!("{mm:.3} mm ({:.0} steps)", mm / step_mm));
    output::print(format!(
        "channel {channel}: reached {out}, now at {back}, drivers released\n"
    ));
    Ok(())
}
