//! `stream`: set-points from standard input, `BEND DIR` or `BEND DIR T` per line.

use super::args::{BEND_DEG, DIR_DEG};
use super::connection::{At, answered, ask, connect};
use super::follow::settled;
use super::play::halted;
use crate::cli::CommandOutcome::{self, Good, NotGoodEnough};
use crate::cli::inputs::within;
use crate::model::Bend;
use crate::service::protocol::{Failure, Request};
use miette::{Result, miette};
use std::io::BufRead;
use std::ops::RangeInclusive;
use std::time::{Duration, Instant};

/// Time by which a set-point with a time is sent ahead of it, s.
const SENT_AHEAD_S: f64 = 0.3;
/// Time by which the last set-point becomes the target ahead of its time, s: before the service takes the end of the stream for silence.
const END_AHEAD_S: f64 = 0.1;
/// Times that are accepted, s: also those of a clock that counts from 1970.
const TIME_S: RangeInclusive<f64> = 0.0..=1e10;

/// Bend and direction in degrees, and the time in s.
type SetPoint = (f64, f64, Option<f64>);

/// Sends each line, one with a time when that is near. At the end of the input the tip comes to rest at the last set-point.
///
/// # Errors
/// A report that names the line, or with the service's message.
pub fn stream(at: &At) -> Result<CommandOutcome> {
    let mut connection = connect(at)?;
    let (mut began, mut last) = (None, None);
    let mut sleep_until = |t_s: f64, ahead_s: f64| {
        let (start, from_s) = *began.get_or_insert_with(|| (Instant::now(), t_s));
        let left_s = t_s - from_s - ahead_s - start.elapsed().as_secs_f64();
        std::thread::sleep(Duration::try_from_secs_f64(left_s).unwrap_or_default());
    };
    for (k, line) in std::io::stdin().lock().lines().enumerate() {
        let place = format!("standard input, line {}", k + 1);
        let line = line.map_err(|e| miette!("{place}: {e}"))?;
        let (bend_deg, dir_deg, t_s) = set_point(&line, last).map_err(|why| miette!("{place}: {why}"))?;
        if let Some(t_s) = t_s {
            sleep_until(t_s, SENT_AHEAD_S);
        }
        let answer = connection.request(&Request::Stream { bend_deg, dir_deg, length_mm: None, t_s });
        if answered(answer.map_err(|f| Failure { message: format!("{place}: {}", f.message), ..f }))?.is_none() {
            return Ok(NotGoodEnough);
        }
        last = Some((bend_deg, dir_deg, t_s));
    }
    let Some((bend_deg, dir_deg, t_s)) = last else { return Ok(Good) };
    if let Some(t_s) = t_s {
        sleep_until(t_s, END_AHEAD_S);
    }
    let Some(s) = ask(&mut connection, &Request::Status {})? else { return Ok(NotGoodEnough) };
    if s["mode"] != "tracking" {
        let why = halted(&s).unwrap_or_else(|| "the stream paused for longer than `service.dead_man_s`".to_owned());
        eprintln!("the tip has stopped before the end of the stream: {why}");
        return Ok(NotGoodEnough);
    }
    match ask(&mut connection, &Request::bend(bend_deg, dir_deg, None))? {
        Some(_) => settled(&mut connection, Bend::from_deg(bend_deg, dir_deg)),
        None => Ok(NotGoodEnough),
    }
}

/// The set-point of a line. All lines have a time, which increases, or none has.
fn set_point(line: &str, before: Option<SetPoint>) -> std::result::Result<SetPoint, String> {
    let number = |name: &str, text: &str, allowed: RangeInclusive<f64>, unit| {
        within(allowed, unit)(text).map_err(|expected| format!("{name} `{text}`: {expected}"))
    };
    let timed = before.map(|(.., t_s)| t_s.is_some());
    let words: Vec<&str> = line.split_whitespace().collect();
    let (bend, dir, time) = match words[..] {
        [bend, dir] if timed != Some(true) => (bend, dir, None),
        [bend, dir, time] if timed != Some(false) => (bend, dir, Some(time)),
        _ => {
            let expected = match timed {
                None => "BEND DIR or BEND DIR T, numbers in degrees and seconds",
                Some(false) => "BEND DIR in degrees, without a time as in the lines before",
                Some(true) => "BEND DIR T in degrees and seconds, with a time as in the lines before",
            };
            return Err(format!("`{line}`: expected {expected}"));
        }
    };
    let t_s = time.map(|time| number("T", time, TIME_S, "s")).transpose()?;
    if let (Some(t_s), Some((.., Some(before_s)))) = (t_s, before)
        && t_s <= before_s
    {
        return Err(format!("T `{t_s}`: expected a time later than that of the line before, {before_s} s"));
    }
    Ok((number("BEND", bend, BEND_DEG, "degrees")?, number("DIR", dir, DIR_DEG, "degrees")?, t_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_understood_or_refused_with_the_mend() {
        let (timed, untimed) = (Some((30.0, 0.0, Some(0.5))), Some((30.0, 0.0, None)));
        assert_eq!(set_point("30 -4 0.52", timed), Ok((30.0, -4.0, Some(0.52))));
        assert_eq!(set_point(" 30\t4 ", untimed), Ok((30.0, 4.0, None)));
        for (line, before, part) in [
            ("30", None, "expected BEND DIR or BEND DIR T"),
            ("30 4", timed, "with a time"),
            ("30 4 1", untimed, "without a time"),
            ("30 nan", None, "DIR `nan`: expected a number from -360 to 360 degrees"),
            ("136 0", None, "BEND `136`: expected a number from -135 to 135 degrees"),
            ("30 0 -inf", None, "T `-inf`: expected a number from 0"),
            ("30 0 -0.1", timed, "T `-0.1`: expected a number from 0"),
            ("30 0 0.5", timed, "later than that of the line before, 0.5 s"),
        ] {
            let why = set_point(line, before).unwrap_err();
            assert!(why.contains(part), "{line}: {why}");
        }
    }
}
