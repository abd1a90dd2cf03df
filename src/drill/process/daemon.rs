//! A service as a child process, with the test in the place of the service manager.

use crate::service::client::Client;
use crate::service::{Request, paths};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use std::io;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A running service.
pub struct Daemon {
    child: Child,
    notify: UnixDatagram,
    program: PathBuf,
    /// The command socket, the status socket and the socket of `stop`.
    sockets: [PathBuf; 3],
}

/// Time-out of the watchdog, s.
pub const WATCHDOG_S: f64 = 1.0;
/// Longest time until the service is ready, s.
const START_MAX_S: f64 = 20.0;

impl Daemon {
    /// Starts the service on the built-in plant, with its files in `folder`, and waits until it is ready.
    ///
    /// # Errors
    /// The operating system's, or a service that did not become ready.
    pub fn start(program: &Path, folder: &Path) -> io::Result<Self> {
        // not the board of this computer, which may be a real machine
        Self::start_with(program, folder, &["--board", "sim"])
    }

    /// As [`start`](Self::start), with further options of `run`.
    ///
    /// # Errors
    /// As for [`start`](Self::start).
    pub fn start_with(program: &Path, folder: &Path, options: &[&str]) -> io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        let notify_path = folder.join("notify");
        // left by a previous service in this folder
        let _ = std::fs::remove_file(&notify_path);
        let notify = UnixDatagram::bind(&notify_path)?;
        notify.set_read_timeout(Some(Duration::from_millis(50)))?;
        let socket = folder.join("control.sock");
        let sockets = [
            socket.clone(),
            folder.join("status.sock"),
            paths::stop_socket(&socket),
        ];
        let child = Command::new(program)
            .args(["run", "--socket"])
            .arg(&socket)
            .arg("--state")
            .arg(folder.join("state"))
            .args(options)
            .env("NOTIFY_SOCKET", &notify_path)
            .env("WATCHDOG_USEC", format!("{:.0}", WATCHDOG_S * 1e6))
            .env_remove("WATCHDOG_PID")
            .env_remove("JOURNAL_STREAM")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(std::fs::File::create(folder.join("log"))?)
            .spawn()?;
        let mut daemon = Self {
            child,
            notify,
            program: program.to_owned(),
            sockets,
        };
        let started = Instant::now();
        while started.elapsed().as_secs_f64() < START_MAX_S {
            if daemon.hears("READY=1") {
                return Ok(daemon);
            }
            if let Some(status) = daemon.child.try_wait()? {
                let log = std::fs::read_to_string(folder.join("log")).unwrap_or_default();
                let why = format!("the service ended immediately ({status}): {}", log.trim());
                return Err(io::Error::other(why));
            }
        }
        Err(io::Error::other("the service did not become ready"))
    }

    /// The next notification to the service manager within 50 ms.
    pub fn notification(&self) -> Option<String> {
        let mut buffer = [0u8; 1024];
        let n = self.notify.recv(&mut buffer).ok()?;
        Some(String::from_utf8_lossy(&buffer[..n]).into_owned())
    }

    /// Whether a notification comes within 50 ms that contains this text.
    pub fn hears(&self, text: &str) -> bool {
        self.notification().is_some_and(|said| said.contains(text))
    }

    /// A connection to its command socket.
    ///
    /// # Errors
    /// A service that does not answer.
    pub fn client(&self) -> io::Result<Client> {
        connect(&self.sockets[0])
    }

    /// Sends a request on a connection of its own.
    ///
    /// # Errors
    /// As for [`ask`].
    pub fn ask(&self, request: &Request) -> io::Result<Value> {
        ask(&mut self.client()?, request)
    }

    /// Number of its process.
    pub fn pid(&self) -> Pid {
        Pid::from_raw(self.child.id().cast_signed())
    }

    /// Paths of its command socket, its status socket and its socket of `stop`.
    pub fn sockets(&self) -> &[PathBuf; 3] {
        &self.sockets
    }

    /// Runs a command of the command line.
    ///
    /// # Errors
    /// An exit code other than 0.
    pub fn command(&self, name: &str) -> io::Result<()> {
        let out = Command::new(&self.program)
            .args([name, "--socket"])
            .arg(&self.sockets[0])
            .stdin(Stdio::null())
            .output()?;
        if out.status.success() {
            return Ok(());
        }
        let why = String::from_utf8_lossy(&out.stderr);
        Err(io::Error::other(why.trim().to_owned()))
    }

    /// Polls the status until `holds`, at most for a time, s. `what` names the condition in the error.
    ///
    /// # Errors
    /// A service that does not answer, or a condition that does not come to hold.
    pub fn until(
        &self,
        seconds: f64,
        what: &str,
        holds: impl Fn(&Value) -> bool,
    ) -> io::Result<Value> {
        let mut client = self.client()?;
        let started = Instant::now();
        loop {
            let status = ask(&mut client, &Request::Status {})?;
            if holds(&status) {
                return Ok(status);
            }
            if started.elapsed().as_secs_f64() > seconds {
                let mode = &status["mode"];
                let why = format!("{what}: not reached within {seconds} s; mode {mode}");
                return Err(io::Error::other(why));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits for the alignment, arms and starts a move.
    ///
    /// # Errors
    /// A command that is refused.
    pub fn take_off(&self) -> io::Result<()> {
        self.until(15.0, "alignment", |s| s["mode"] == "disarmed")?;
        let mut client = self.client()?;
        ask(&mut client, &Request::Arm {})?;
        self.until(5.0, "energised drivers", |s| s["energised"] == true)?;
        ask(&mut client, &Request::bend(40.0, 30.0, None, None))?;
        Ok(())
    }

    /// Sends a signal to the service.
    pub fn signal(&self, signal: Signal) {
        // the child has not been waited for, so the number is still that of the child
        let _ = kill(self.pid(), signal);
    }

    /// Kills the service, as a power cut would.
    pub fn kill(self) {
        drop(self);
    }

    /// Ends the service with SIGTERM. Returns whether it succeeded, and the time it took, s.
    ///
    /// # Errors
    /// The operating system's.
    pub fn end(self) -> io::Result<(bool, f64)> {
        self.end_by(Signal::SIGTERM)
    }

    /// As [`end`](Self::end), with another signal.
    ///
    /// # Errors
    /// The operating system's.
    pub fn end_by(mut self, signal: Signal) -> io::Result<(bool, f64)> {
        self.signal(signal);
        let started = Instant::now();
        while started.elapsed() < Duration::from_secs(40) {
            if let Some(status) = self.child.try_wait()? {
                return Ok((status.success(), started.elapsed().as_secs_f64()));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok((false, started.elapsed().as_secs_f64()))
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // it may have ended already
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Sends a request. A refusal is an error.
///
/// # Errors
/// The failure, with the name of the command.
pub fn ask(client: &mut Client, request: &Request) -> io::Result<Value> {
    client
        .request(request)
        .map_err(|f| io::Error::other(format!("{}: {}", request.name(), f.message)))
}

/// A client of the service at a socket.
///
/// # Errors
/// A service that does not answer.
pub fn connect(socket: &Path) -> io::Result<Client> {
    Client::connect(socket).map_err(|f| io::Error::other(f.message))
}

/// The mode in a status.
pub fn mode_of(status: &Value) -> String {
    status["mode"].as_str().unwrap_or_default().to_owned()
}

/// Repeats `work` until it succeeds, at most for a time, s: a tip that brakes refuses a motion, and attackers may take the place
/// of a client that waits.
pub fn insist<T>(seconds: f64, mut work: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    let started = Instant::now();
    loop {
        match work() {
            Err(_) if started.elapsed().as_secs_f64() < seconds => {
                std::thread::sleep(Duration::from_millis(10))
            }
            result => return result,
        }
    }
}
