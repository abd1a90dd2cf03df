//! Sources of stick movements: a joystick device, the keys of a terminal, or a table. Each is a thread that sends events.

use super::super::keys::{Key, keys};
use crate::log::table::{Schema, Table};
use miette::{IntoDiagnostic, Result, miette};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};

/// Time for which a key acts, s: longer than a terminal takes to repeat it, so that a held key moves the tip evenly once the repetition
/// has begun, and a key that is only pressed is a small step.
const KEY_S: f64 = 0.15;
/// Types of a joystick event (Linux, `Documentation/input/joydev/joystick-api.rst`). The first events, which
/// describe the state when the device was opened, have a further bit.
const BUTTON: u8 = 1;
const AXIS: u8 = 2;
const INITIAL: u8 = 0x80;

/// A change of the stick.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// Deflection to the right, −1 to 1.
    X(f64),
    /// Deflection away from the operator, −1 to 1.
    Y(f64),
    /// Whether the dead-man button is held.
    Held(bool),
    /// The operator, or the table, ends.
    End,
    /// The device is gone.
    Gone(String),
}

/// A stick that sends events; restores the terminal when dropped.
pub struct Input {
    /// The events.
    pub events: Receiver<Event>,
    /// Time without any event after which the device counts as out of range.
    pub silence: Option<Duration>,
    terminal: Option<String>,
}

impl Drop for Input {
    fn drop(&mut self) {
        if let Some(settings) = &self.terminal {
            // a terminal that is gone needs no settings
            let _ = stty(&[settings]);
        }
    }
}

impl Input {
    /// The joystick of a device file; `button` counts from 0, any button if none is named. It is neutral until the operator moves it: what
    /// is deflected or held when the device is opened does not count.
    ///
    /// # Errors
    /// A report that names the device.
    pub fn joystick(device: &Path, button: Option<u8>, silence: Duration) -> Result<Self> {
        let name = device.display().to_string();
        let mut file = File::open(device)
            .map_err(|e| miette!("{name}: {e}; `ls /dev/input/js*` lists the joysticks"))?;
        let mut input = Self::of(move |send| {
            let (mut event, mut pressed) = ([0; 8], 0u32);
            loop {
                if let Err(e) = file.read_exact(&mut event) {
                    let _ = send.send(Event::Gone(format!("{name}: {e}")));
                    return;
                }
                let value = i16::from_ne_bytes([event[4], event[5]]);
                let deflection = f64::from(value) / f64::from(i16::MAX);
                if event[6] & INITIAL != 0 {
                    continue;
                }
                let known = match (event[6], event[7]) {
                    (AXIS, 0) => Event::X(deflection),
                    (AXIS, 1) => Event::Y(-deflection),
                    (BUTTON, n) if button.is_none_or(|b| b == n) && n < 32 => {
                        pressed = pressed & !(1 << n) | u32::from(value != 0) << n;
                        Event::Held(pressed != 0)
                    }
                    _ => continue,
                };
                if send.send(known).is_err() {
                    return;
                }
            }
        });
        input.silence = Some(silence);
        Ok(input)
    }

    /// The arrow keys of the terminal. A held key deflects the stick fully; the space bar releases it, and `q` ends.
    ///
    /// # Errors
    /// A report if standard input is no terminal.
    pub fn keyboard() -> Result<Self> {
        let no_terminal =
            |e| miette!("standard input is no terminal ({e}): name a joystick with --device");
        let settings = stty(&["-g"]).map_err(no_terminal)?;
        stty(&["-icanon", "-echo", "min", "0", "time", "1"])?;
        let mut input = Self::of(|send| {
            let (mut bytes, mut acts_until, mut known) = ([0; 64], None::<Instant>, Vec::new());
            loop {
                let Ok(n) = std::io::stdin().lock().read(&mut bytes) else {
                    return;
                };
                known.extend(keys(&bytes[..n]).into_iter().flat_map(events));
                if known.contains(&Event::Held(true)) {
                    acts_until = Some(Instant::now() + Duration::from_secs_f64(KEY_S));
                } else if acts_until.is_some_and(|until| Instant::now() > until) {
                    acts_until = None;
                    known.push(Event::Held(false));
                }
                if known.drain(..).any(|event| send.send(event).is_err()) {
                    return;
                }
            }
        });
        input.terminal = Some(settings);
        Ok(input)
    }

    /// A table `t_s,x,y,held` of deflections and of the dead-man button, 0 or 1.
    ///
    /// # Errors
    /// A report that names file, line and column.
    pub fn table(file: &Path) -> Result<Self> {
        let columns = ["t_s", "x", "y", "held"];
        let schema = Schema {
            required: &columns,
            known: &|name| columns.contains(&name),
            rows_min: 1,
        };
        let table = Table::open(file, &schema).into_diagnostic()?;
        let column = |name: &str, least: f64| -> Result<Vec<f64>> {
            let column = table.complete(name).into_diagnostic()?;
            if let Some(row) = column.iter().position(|v| !(least..=1.0).contains(v)) {
                let (given, expected) = (column[row].to_string(), format!("within {least} to 1"));
                return Err(table.refuse(row, name, &given, &expected)).into_diagnostic();
            }
            Ok(column.to_vec())
        };
        let t_s = table.clock("t_s").into_diagnostic()?.to_vec();
        let (x, y, held) = (column("x", -1.0)?, column("y", -1.0)?, column("held", 0.0)?);
        Ok(Self::of(move |send| {
            let began = Instant::now();
            for k in 0..t_s.len() {
                let due = Duration::from_secs_f64((t_s[k] - t_s[0]).max(0.0));
                sleep(due.saturating_sub(began.elapsed()));
                let events = [Event::X(x[k]), Event::Y(y[k]), Event::Held(held[k] > 0.5)];
                if events.into_iter().any(|event| send.send(event).is_err()) {
                    return;
                }
            }
            let _ = send.send(Event::End);
        }))
    }

    fn of(work: impl FnOnce(Sender<Event>) + Send + 'static) -> Self {
        let (send, events) = channel();
        spawn(move || work(send));
        Self {
            events,
            silence: None,
            terminal: None,
        }
    }
}

/// The first joystick of this computer.
pub fn first_joystick() -> Option<PathBuf> {
    let mut all = (0..32).map(|n| PathBuf::from(format!("/dev/input/js{n}")));
    all.find(|path| path.exists())
}

/// The events of a key.
fn events(key: Key) -> Vec<Event> {
    let at = |x: f64, y: f64| vec![Event::X(x), Event::Y(y), Event::Held(true)];
    match key {
        Key::Up => at(0.0, 1.0),
        Key::Down => at(0.0, -1.0),
        Key::Right => at(1.0, 0.0),
        Key::Left => at(-1.0, 0.0),
        Key::Char(' ') => vec![Event::Held(false)],
        Key::Char('q') => vec![Event::End],
        _ => vec![],
    }
}

/// Runs `stty` on the terminal of standard input; returns what it prints.
fn stty(arguments: &[&str]) -> Result<String> {
    let mut command = Command::new("stty");
    let out = command.args(arguments).stdin(Stdio::inherit()).output();
    let out = out.map_err(|e| miette!("stty: {e}"))?;
    let said = |bytes| String::from_utf8_lossy(bytes).trim().to_owned();
    if out.status.success() {
        Ok(said(&out.stdout))
    } else {
        Err(miette!("{}", said(&out.stderr)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Drawn states of a joystick at the opening, and then what the operator does.
    #[test]
    fn what_is_deflected_or_held_at_the_beginning_does_not_count() {
        let event = |kind: u8, number: u8, value: i16| {
            let mut event = [0; 8];
            event[4..6].copy_from_slice(&value.to_ne_bytes());
            (event[6], event[7]) = (kind, number);
            event
        };
        let folder = tempfile::tempdir().unwrap();
        for (axis, held, value) in [(0, 0, 32767), (1, 3, -20000), (0, 31, 1)] {
            let device = folder.path().join("js");
            let initial = [
                event(AXIS | INITIAL, axis, value),
                event(BUTTON | INITIAL, held, 1),
            ];
            // the button must be released and pressed again
            let then = [event(BUTTON, held, 0), event(BUTTON, held, 1)];
            std::fs::write(&device, [initial, then].concat().concat()).unwrap();
            let input = Input::joystick(&device, None, Duration::from_secs(1)).unwrap();
            let all: Vec<Event> = input.events.iter().take(2).collect();
            assert_eq!(all, [Event::Held(false), Event::Held(true)]);
        }
    }

    #[test]
    fn keys_deflect_release_and_end() {
        assert_eq!(
            events(Key::Up),
            [Event::X(0.0), Event::Y(1.0), Event::Held(true)]
        );
        assert_eq!(
            [events(Key::Char(' ')), events(Key::Char('q'))],
            [[Event::Held(false)], [Event::End]]
        );
    }
}
