//! `stream`: set-points from standard input, `BEND DIR` or `BEND DIR T` per line.

use super::connection::{At, connect, report, status};
use super::follow::{BEND_DEG, settle};
use crate::cli::{Refused, within};
use crate::model::Bend;
use crate::service::protocol::{DIR_DEG, Failure, Request};
use crate::supervisor::Mode;
use miette::{Result, miette};
use std::io::{BufRead, Read};
use std::time::{Duration, Instant};

/// Time by which a set-point with a time is sent ahead of it, s.
const SENT_AHEAD_S: f64 = 0.3;
/// Time by which the last set-point becomes the target ahead of its time, s: before the service takes the end of the stream for silence.
const END_AHEAD_S: f64 = 0.1;
/// Largest time, s: beyond those of a clock that counts from 1970.
const TIME_MAX_S: f64 = 1e10;

/// Longest line, bytes.
const LINE_MAX: u64 = 256;

/// Bend and direction in degrees, and the time in s.
type SetPoint = (f64, f64, Option<f64>);

/// Sends each line, one with a time when that is near. At the end of the input the tip comes to rest at the last set-point.
///
/// # Errors
/// A report that names the line, or with the service's message.
pub fn stream(at: &At) -> Result<bool> {
    let mut connection = connect(at)?;
    let (mut began, mut last) = (None, None);
    let mut sleep_until = |t_s: Option<f64>, ahead_s: f64| {
        let Some(t_s) = t_s else { return };
        let (start, from_s) = *began.get_or_insert_with(|| (Instant::now(), t_s));
        let left_s = t_s - from_s - ahead_s - start.elapsed().as_secs_f64();
        std::thread::sleep(Duration::try_from_secs_f64(left_s).unwrap_or_default());
    };
    let mut input = std::io::stdin().lock();
    for k in 1_u64.. {
        let place = format!("standard input, line {k}");
        let Some(line) = bounded_line(&mut input).map_err(|why| miette!("{place}: {why}"))? else {
            break;
        };
        let (bend_deg, dir_deg, t_s) =
            set_point(&line, last).map_err(|why| miette!("{place}: {why}"))?;
        sleep_until(t_s, SENT_AHEAD_S);
        let request = Request::stream(bend_deg, dir_deg, t_s);
        connection.request(&request).map_err(|f| {
            let message = format!("{place}: {}", f.message);
            report(Failure { message, ..f })
        })?;
        last = Some((bend_deg, dir_deg, t_s));
    }
    let Some((bend_deg, dir_deg, t_s)) = last else {
        return Ok(true);
    };
    sleep_until(t_s, END_AHEAD_S);
    if status(&mut connection)?.mode != Some(Mode::Tracking) {
        let why = "the tip stopped before the end of the stream: by another command, or because of a pause longer than `service.dead_man_s`";
        return Err(Refused(why.to_owned()).into());
    }
    let request = Request::bend(bend_deg, dir_deg, None, None);
    settle(&mut connection, &request, Bend::from_deg(bend_deg, dir_deg))
}

/// The next line, which is no longer than a set-point can be.
fn bounded_line(input: &mut impl BufRead) -> std::result::Result<Option<String>, String> {
    let mut line = Vec::new();
    let read = input.take(LINE_MAX + 1).read_until(b'\n', &mut line);
    match read.map_err(|e| e.to_string())? {
        0 => Ok(None),
        n if n as u64 > LINE_MAX => Err(format!(
            "a line of more than {LINE_MAX} bytes; expected BEND DIR or BEND DIR T"
        )),
        _ => String::from_utf8(line)
            .map(|line| Some(line.trim_end().to_owned()))
            .map_err(|_| "not UTF-8 text; expected BEND DIR or BEND DIR T".to_owned()),
    }
}

/// The set-point of a line. All lines have a time, which increases, or none has.
fn set_point(line: &str, before: Option<SetPoint>) -> std::result::Result<SetPoint, String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let timed = words.len() == 3;
    if !(2..=3).contains(&words.len()) || before.is_some_and(|(.., t_s)| t_s.is_some() != timed) {
        return Err(format!(
            "`{line}`: expected BEND DIR, or in all lines BEND DIR T, numbers in degrees and seconds"
        ));
    }
    let number = |k: usize, name: &str, allowed, unit| {
        let text = words[k];
        within(allowed, unit)(text).map_err(|expected| format!("{name} `{text}`: {expected}"))
    };
    let bend_deg = number(0, "BEND", BEND_DEG, "degrees")?;
    let dir_deg = number(1, "DIR", DIR_DEG, "degrees")?;
    // the service refuses a time that is the same again
    let least_s = before.and_then(|(.., t_s)| t_s).unwrap_or(0.0);
    let t_s = timed.then(|| number(2, "T", least_s..=TIME_MAX_S, "s"));
    Ok((bend_deg, dir_deg, t_s.transpose()?))
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
            ("30", None, "expected BEND DIR, or in all lines BEND DIR T"),
            ("30 4", timed, "in all lines"),
            ("30 4 1", untimed, "in all lines"),
            (
                "30 nan",
                None,
                "DIR `nan`: expected a number from -36000 to 36000 degrees",
            ),
            (
                "136 0",
                None,
                "BEND `136`: expected a number from -135 to 135 degrees",
            ),
            ("30 0 -inf", None, "T `-inf`: expected a number from 0 to"),
            ("30 0 0.4", timed, "T `0.4`: expected a number from 0.5 to"),
        ] {
            let why = set_point(line, before).unwrap_err();
            assert!(why.contains(part), "{line}: {why}");
        }
    }
}
