//! Faults of the process, put into real ones: children of this very program are killed, stopped,
//! robbed of their disk and beset by clients.

mod clients;
mod disk;
mod restart;

pub use disk::{Harm, exercise};

use crate::drill::Row;
use crate::drill::bench::Make;
use crate::service::client::Client;
use crate::service::protocol::Request;
use serde_json::Value;
use std::io;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Every row about the process. `program` is this program, `scratch` an empty folder of ours, `kills`
/// how often it is killed.
///
/// # Errors
/// What keeps a row from being tried at all.
pub fn rows(make: &Make, program: &Path, scratch: &Path, kills: u32) -> io::Result<Vec<Row>> {
    let of = |row: io::Result<Row>, name: &str| {
        row.unwrap_or_else(|e| {
            let mut row = Row::process(name, None, "none", String::new());
            row.fail(format!("could not be tried: {e}"));
            row
        })
    };
    let mut rows = vec![
        of(restart::killed(make, program, &scratch.join("kill"), kills), "sigkill"),
        of(restart::stopped(program, &scratch.join("stop")), "sigstop"),
        of(disk::full(program, &scratch.join("full")), "disk_full"),
        of(disk::read_only(program, &scratch.join("readonly")), "read_only_fs"),
        of(restart::while_bent(make), "restart_while_bent"),
        of(restart::stale_calibration(program, &scratch.join("stale")), "stale_calibration"),
        of(restart::wrong_board(program, &scratch.join("board")), "wrong_board_file"),
    ];
    rows.extend(clients::rows(program, &scratch.join("clients"))?);
    Ok(rows)
}

/// A service as a child, with us in the place of the service manager.
pub struct Daemon {
    child: Child,
    notify: UnixDatagram,
    socket: PathBuf,
}

/// Time the watchdog gives, s.
const WATCHDOG_S: f64 = 1.0;
/// Longest start, s.
const START_MAX_S: f64 = 20.0;

impl Daemon {
    /// Starts it on the built-in plant in `folder` and waits until it is ready.
    ///
    /// # Errors
    /// The system's, or that it did not get ready.
    pub fn start(program: &Path, folder: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        let at = folder.join("notify");
        // left over by the one before
        let _ = std::fs::remove_file(&at);
        let notify = UnixDatagram::bind(&at)?;
        notify.set_read_timeout(Some(Duration::from_millis(50)))?;
        let socket = folder.join("control.sock");
        let child = Command::new(program)
            .args(["run", "--socket"])
            .arg(&socket)
            .arg("--state")
            .arg(folder.join("state"))
            .env("NOTIFY_SOCKET", &at)
            .env("WATCHDOG_USEC", format!("{:.0}", WATCHDOG_S * 1e6))
            .env_remove("WATCHDOG_PID")
            .env_remove("JOURNAL_STREAM")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(std::fs::File::create(folder.join("log"))?)
            .spawn()?;
        let mut daemon = Self { child, notify, socket };
        let begun = Instant::now();
        while begun.elapsed().as_secs_f64() < START_MAX_S {
            if daemon.heard().is_some_and(|said| said.contains("READY=1")) {
                return Ok(daemon);
            }
            if let Some(status) = daemon.child.try_wait()? {
                let log = std::fs::read_to_string(folder.join("log")).unwrap_or_default();
                return Err(io::Error::other(format!("the service ended at once ({status}): {}", log.trim())));
            }
        }
        Err(io::Error::other("the service did not get ready"))
    }

    /// What it told its manager next, within 50 ms.
    pub fn heard(&self) -> Option<String> {
        let mut buffer = [0u8; 1024];
        let n = self.notify.recv(&mut buffer).ok()?;
        Some(String::from_utf8_lossy(&buffer[..n]).into_owned())
    }

    /// A client of it.
    ///
    /// # Errors
    /// That it does not answer.
    pub fn client(&self) -> io::Result<Client> {
        Client::connect(&self.socket).map_err(|f| io::Error::other(f.words))
    }

    /// Its command socket.
    #[must_use]
    pub fn socket(&self) -> &Path {
        &self.socket
    }

    /// Asks for the status until something holds, at most so long.
    ///
    /// # Errors
    /// That it does not answer, or that it never came to hold.
    pub fn until(&self, seconds: f64, what: &str, holds: impl Fn(&Value) -> bool) -> io::Result<Value> {
        let mut client = self.client()?;
        let begun = Instant::now();
        loop {
            let status = ask(&mut client, &Request::Status {})?;
            if holds(&status) {
                return Ok(status);
            }
            if begun.elapsed().as_secs_f64() > seconds {
                return Err(io::Error::other(format!("{what} did not come within {seconds} s; mode {}", status["mode"])));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Aligned, armed and bent.
    ///
    /// # Errors
    /// That something was refused.
    pub fn take_off(&self) -> io::Result<()> {
        self.until(15.0, "alignment", |s| s["mode"] == "disarmed")?;
        let mut client = self.client()?;
        ask(&mut client, &Request::Arm {})?;
        self.until(5.0, "power", |s| s["energised"] == true)?;
        ask(&mut client, &Request::Bend { bend_deg: 40.0, dir_deg: 30.0, length_mm: None, speed_deg_s: None })?;
        Ok(())
    }

    /// Sends it a signal.
    pub fn signal(&self, signal: i32) {
        signal_to(self.child.id(), signal);
    }

    /// Kills it, as a power cut would.
    pub fn kill(mut self) {
        // it may be gone already, which is what is wanted
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Tells it to end and waits; whether it ended well, and how long it took, s.
    ///
    /// # Errors
    /// The system's.
    pub fn end(mut self) -> io::Result<(bool, f64)> {
        self.signal(libc::SIGTERM);
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_secs(40) {
            if let Some(status) = self.child.try_wait()? {
                return Ok((status.success(), begun.elapsed().as_secs_f64()));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok((false, begun.elapsed().as_secs_f64()))
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // only one that was neither killed nor ended is still there
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Asks; a refusal is an error.
pub(super) fn ask(client: &mut Client, request: &Request) -> io::Result<Value> {
    client.ask(request).map_err(|f| io::Error::other(format!("{}: {}", request.name(), f.words)))
}

#[allow(unsafe_code)]
fn signal_to(pid: u32, signal: i32) {
    let Ok(pid) = libc::pid_t::try_from(pid) else { return };
    // SAFETY: kill takes two integers; the child has not been waited for, so the number is still its own
    unsafe { libc::kill(pid, signal) };
}
