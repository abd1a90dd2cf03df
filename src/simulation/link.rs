//! A plant in another program, driven over the newline-delimited JSON of the plant link.
//!
//! The link is the program's stdin and stdout; its stderr goes to the terminal. A reader thread passes its lines
//! through a channel, so that a read can time out.

use crate::motion::{MachineError, MachineInfo};
use crate::primitives::{Base, ImuSample, Rotation, Seconds, Steps, Tip};
use crate::simulation::rate_check::RateCheck;
use crate::simulation::world::{Reply, World};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;
use serde::Deserialize;
use std::io::{BufRead, BufReader, BufWriter, Read, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

/// Longest time without an answer, and until the greeting, s: a simulator may have to be compiled.
const SILENCE_S: f64 = 5.0;
const GREETING_S: f64 = 120.0;
/// Time after which a wait for the greeting is told, s.
const TOLD_S: f64 = 2.0;
/// Longest line, bytes.
const LINE_MAX: u64 = 64 * 1024;

#[derive(Deserialize)]
struct Hello {
    plant: String,
    protocol: u32,
    imu_period_s: f64,
    step_mm: f64,
    rest_length_mm: f64,
}

#[derive(Deserialize)]
struct Answer {
    t: f64,
    imu: Option<Imu>,
    base: Option<Imu>,
    #[serde(rename = "ref")]
    reference: Option<Reference>,
}

#[derive(Deserialize)]
struct Imu {
    acc: [f64; 3],
    gyr: [f64; 3],
    mag: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct Reference {
    quat: [f64; 4],
}

/// A running plant program.
pub struct Link {
    child: Child,
    to: BufWriter<ChildStdin>,
    from: Receiver<std::io::Result<String>>,
    info: MachineInfo,
    n: u64,
    last: String,
    rates: RateCheck,
}

impl Link {
    /// Starts `program` with `args` and reads its greeting.
    ///
    /// # Errors
    /// [`MachineError`] if the program cannot be started or its greeting violates the protocol.
    pub fn start(program: &str, args: &[String]) -> Result<Self, MachineError> {
        let fail = |source| MachineError::Start {
            program: program.to_owned(),
            source,
        };
        let mut child = Command::new(program)
            .args(args)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .process_group(0)
            .spawn()
            .map_err(fail)?;
        let missing = || fail(std::io::Error::other("its pipes could not be opened"));
        let to = BufWriter::new(child.stdin.take().ok_or_else(missing)?);
        let from = read_lines(child.stdout.take().ok_or_else(missing)?);
        let mut link = Self {
            child,
            to,
            from,
            info: MachineInfo::default(),
            n: 0,
            last: "(nothing yet)".to_owned(),
            rates: RateCheck::default(),
        };
        let mut first = link.line(TOLD_S);
        if let Err(MachineError::Silent { .. }) = first {
            tracing::info!("waiting up to {GREETING_S} s for the greeting of {program}");
            first = link.line(GREETING_S - TOLD_S);
        }
        let first = first?;
        link.info = greeting(&first).map_err(|problem| malformed(&first, problem))?;
        Ok(link)
    }

    fn line(&mut self, seconds: f64) -> Result<String, MachineError> {
        match self.from.recv_timeout(Duration::from_secs_f64(seconds)) {
            Ok(Ok(line)) if !line.is_empty() => {
                line.trim_end().clone_into(&mut self.last);
                Ok(line)
            }
            Err(RecvTimeoutError::Timeout) => Err(MachineError::Silent {
                seconds,
                last: excerpt(&self.last),
            }),
            Ok(Err(e)) => {
                let problem = format!("then its output could not be read: {e}");
                Err(malformed(&self.last, problem))
            }
            Ok(Ok(_)) | Err(RecvTimeoutError::Disconnected) => Err(self.died()),
        }
    }

    fn died(&mut self) -> MachineError {
        // the output closes shortly before the process ends
        let ended = (0..50).find_map(|_| match self.child.try_wait() {
            Ok(None) => {
                std::thread::sleep(Duration::from_millis(10));
                None
            }
            known => Some(known.ok().flatten()),
        });
        let status = ended.flatten().map_or(String::new(), |s| format!(" ({s})"));
        MachineError::Died {
            last: excerpt(&self.last),
            status,
        }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        // a plant ends at end of file; one that does not is killed here, with what it has started. Both calls fail only if
        // the processes have already ended, which is the desired state
        let _ = killpg(
            Pid::from_raw(self.child.id().cast_signed()),
            Signal::SIGKILL,
        );
        let _ = self.child.wait();
    }
}

impl World for Link {
    fn info(&self) -> &MachineInfo {
        &self.info
    }

    fn step(&mut self, steps: &Steps) -> Result<Reply, MachineError> {
        self.n += 1;
        let t = self.n as f64 * self.info.period_s;
        let [a, b, c] = steps.0;
        let sent = writeln!(self.to, "{{\"t\":{t:.6},\"steps\":[{a},{b},{c}]}}")
            .and_then(|()| self.to.flush());
        if sent.is_err() {
            // the channel may still contain lines; the end of the process is the error
            return Err(self.died());
        }
        let line = self.line(SILENCE_S)?;
        let reply = reply(&line, t).map_err(|problem| malformed(&line, problem))?;
        if let (Some(imu), Some(truth)) = (&reply.imu, &reply.truth) {
            let wrong = self.rates.update(t, &truth.quat(), &imu.gyro_rad_s);
            wrong.into_iter().for_each(|why| tracing::warn!("{why}"));
        }
        Ok(reply)
    }
}

fn read_lines(out: ChildStdout) -> Receiver<std::io::Result<String>> {
    let (tx, rx) = sync_channel(4);
    std::thread::spawn(move || {
        let mut reader = BufReader::new(out);
        loop {
            let mut line = String::new();
            let read = reader
                .by_ref()
                .take(LINE_MAX)
                .read_line(&mut line)
                .map(|_| line);
            let end = !matches!(&read, Ok(l) if !l.is_empty());
            if tx.send(read).is_err() || end {
                return;
            }
        }
    });
    rx
}

fn excerpt(line: &str) -> String {
    let line = line.trim_end();
    let end = line.char_indices().nth(160).map(|(at, _)| at);
    end.map_or_else(|| line.to_owned(), |end| format!("{}…", &line[..end]))
}

fn malformed(line: &str, problem: String) -> MachineError {
    MachineError::Malformed {
        line: excerpt(line),
        problem,
    }
}

/// The machine that a line announces, or what is wrong with the line.
fn greeting(line: &str) -> Result<MachineInfo, String> {
    let not = |e| {
        format!(
            "not a greeting ({e}); expected {{\"plant\":…,\"protocol\":1,\"imu_period_s\":…,\"step_mm\":…,\"rest_length_mm\":…}}"
        )
    };
    let h: Hello = serde_json::from_str(line).map_err(not)?;
    if h.protocol != 1 {
        return Err(format!(
            "protocol {} is not supported, only 1 is",
            h.protocol
        ));
    }
    let ranges = [
        ("imu_period_s", h.imu_period_s, 0.0002, 0.05),
        ("step_mm", h.step_mm, 1e-4, 1.0),
        ("rest_length_mm", h.rest_length_mm, 5.0, 100.0),
    ];
    for (key, value, low, high) in ranges {
        if !(low..=high).contains(&value) {
            return Err(format!("{key} = {value} is outside {low} to {high}"));
        }
    }
    Ok(MachineInfo {
        name: h.plant,
        period_s: h.imu_period_s,
        step_mm: h.step_mm,
        rest_length_mm: h.rest_length_mm,
    })
}

/// Largest reading of any sensor, m/s², rad/s or µT.
const READING_MAX: f64 = 1e9;

/// The answer of a line for the time `t`, or what is wrong with the line.
fn reply(line: &str, t: f64) -> Result<Reply, String> {
    let not = |e| {
        format!(
            "not an answer ({e}); expected {{\"t\":…,\"imu\":{{…}} or null,\"ref\":{{\"quat\":[w,x,y,z]}}}}"
        )
    };
    let a: Answer = serde_json::from_str(line).map_err(not)?;
    if (a.t - t).abs() > 1e-4 {
        return Err(format!(
            "answers for t = {} s, the request was for {t:.6} s",
            a.t
        ));
    }
    let truth = a.reference.map(|r| {
        orientation(&r.quat).ok_or("ref.quat is not a unit quaternion [w,x,y,z]".to_owned())
    });
    let truth = truth.transpose()?;
    for imu in a.imu.iter().chain(&a.base) {
        let mut values = imu
            .acc
            .iter()
            .chain(&imu.gyr)
            .chain(imu.mag.iter().flatten());
        if let Some(value) = values.find(|x| x.abs() > READING_MAX) {
            return Err(format!(
                "a reading is {value:e}; expected at most {READING_MAX:e} in size"
            ));
        }
    }
    let sample = |i: Imu| ImuSample {
        t: Seconds(t),
        gyro_rad_s: Vector3::from(i.gyr),
        acc_m_s2: Vector3::from(i.acc),
        mag_ut: i.mag.map(Vector3::from),
    };
    Ok(Reply {
        imu: a.imu.map(sample),
        base_imu: a.base.map(sample),
        truth,
    })
}

fn orientation(q: &[f64; 4]) -> Option<Rotation<Base, Tip>> {
    let q = Quaternion::new(q[0], q[1], q[2], q[3]);
    ((q.norm() - 1.0).abs() < 1e-2)
        .then(|| Rotation::assert_frames(UnitQuaternion::from_quaternion(q)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_greetings_are_refused() {
        let good = r#"{"plant":"x","protocol":1,"imu_period_s":0.005,"step_mm":0.029452,"rest_length_mm":20.0}"#;
        assert_eq!(greeting(good).unwrap().period_s, 0.005);
        for (bad, text) in [
            (
                good.replace("\"protocol\":1", "\"protocol\":2"),
                "protocol 2",
            ),
            (good.replace("0.005", "5"), "imu_period_s = 5"),
            (good.replace("0.029452", "-1"), "step_mm = -1"),
            ("hello".to_owned(), "not a greeting"),
        ] {
            let why = malformed(&bad, greeting(&bad).unwrap_err()).to_string();
            assert!(why.contains(text) && why.contains(&excerpt(&bad)), "{why}");
        }
    }

    #[test]
    fn invalid_answers_are_refused() {
        let good = r#"{"t":0.005,"imu":{"acc":[0,0,9.8],"gyr":[0,0,0],"mag":null},"ref":{"quat":[1,0,0,0]}}"#;
        let r = reply(good, 0.005).unwrap();
        assert!(r.imu.unwrap().mag_ut.is_none() && r.truth.is_some());
        assert!(
            reply(r#"{"t":0.005,"imu":null}"#, 0.005)
                .unwrap()
                .imu
                .is_none()
        );
        let based = good.replace(
            r#","ref""#,
            r#","base":{"acc":[0,0,9.8],"gyr":[0,0.1,0],"mag":null},"ref""#,
        );
        assert_eq!(
            reply(&based, 0.005).unwrap().base_imu.unwrap().gyro_rad_s.y,
            0.1
        );
        for (bad, text) in [
            (good.replace("0.005", "0.010"), "answers for t = 0.01"),
            (good.replace("[1,0,0,0]", "[2,0,0,0]"), "unit quaternion"),
            (good.replace("[0,0,9.8]", "[0,0]"), "not an answer"),
            (
                good.replace("[0,0,9.8]", "[0,1e155,9.8]"),
                "a reading is 1e155",
            ),
            (
                based.replace("[0,0.1,0]", "[0,0.1,-1e10]"),
                "a reading is -1e10",
            ),
        ] {
            let why = reply(&bad, 0.005).unwrap_err();
            assert!(why.contains(text), "{why}");
        }
    }
}
