//! A client of the service, as the command line uses it.
//!
//! Whatever listens on the socket, every call ends in time: a connection waits no longer than a reply, a reply has a deadline however
//! much comes in between, and a line has a largest length.

use crate::service::protocol::request_line;
use crate::service::{Failure, Request, paths};
use serde_json::Value;
use socket2::{Domain, SockAddr, Socket, Type};
use std::io::{ErrorKind, Read, Result as IoResult, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::{Duration, Instant};

/// Longest wait for a reply.
const TIMEOUT: Duration = Duration::from_secs(10);
/// Longest wait of a stop for the answer of each socket; the time in which it is tried again, and the pause before that. Together they end
/// within a second.
const STOP_TIMEOUT: Duration = Duration::from_millis(200);
const STOP_TRIES: Duration = Duration::from_millis(500);
const STOP_PAUSE: Duration = Duration::from_millis(10);
/// Longest line of a service, bytes: several times that of its longest status.
const LINE_MAX: usize = 1 << 20;
/// Bytes read at a time.
const CHUNK: usize = 16 * 1024;

/// Connects to a socket within a time, also to one whose service no longer accepts. A write waits for as long.
///
/// # Errors
/// The operating system's; [`ErrorKind::WouldBlock`] if the service does not accept.
pub fn connect_within(path: &Path, time: Duration) -> IoResult<UnixStream> {
    let socket = Socket::new(Domain::UNIX, Type::STREAM, None)?;
    socket.set_write_timeout(Some(time))?;
    socket.connect(&SockAddr::unix(path)?)?;
    Ok(socket.into())
}

/// A connection to a service.
#[derive(Debug)]
pub struct Client {
    stream: UnixStream,
    /// What has arrived of the next lines.
    input: Vec<u8>,
    timeout: Duration,
    next_id: u64,
}

impl Client {
    /// Connects to a socket.
    ///
    /// # Errors
    /// [`Failure`] with code 3 if no service listens there.
    pub fn connect(path: &Path) -> Result<Self, Failure> {
        Self::connect_for(path, TIMEOUT)
    }

    /// As [`connect`](Self::connect), with this longest wait for the connection and for each reply.
    ///
    /// # Errors
    /// As for [`connect`](Self::connect).
    pub fn connect_for(path: &Path, timeout: Duration) -> Result<Self, Failure> {
        let stream = connect_within(path, timeout).map_err(|e| {
            let why = match e.kind() {
                ErrorKind::WouldBlock => no_reply(&e).message,
                _ => format!(
                    "{e}; is `retroflex run` running, and are you in the group of the socket?"
                ),
            };
            Failure::unreachable(format!("{}: {why}", path.display()))
        })?;
        Ok(Self {
            stream,
            input: Vec::new(),
            timeout,
            next_id: 1,
        })
    }

    /// Stops the tip of the service with this command socket: through the socket of `stop`, or if that does not answer,
    /// through the command socket.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn stop(control: &Path) -> Result<Value, Failure> {
        let (direct, began) = (paths::stop_socket(control), Instant::now());
        loop {
            let answer = Self::connect_for(&direct, STOP_TIMEOUT)
                .and_then(|mut client| result(&client.read()?))
                .or_else(|_| Self::connect_for(control, STOP_TIMEOUT)?.request(&Request::Stop {}));
            // who crowds the sockets out does so for a moment only
            let unanswered = matches!(&answer, Err(failure) if failure.code == 3);
            if !unanswered || !control.exists() || began.elapsed() > STOP_TRIES {
                return answer;
            }
            std::thread::sleep(STOP_PAUSE);
        }
    }

    /// Sends a request and waits for its reply. Events that arrive in between are skipped.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn request(&mut self, request: &Request) -> Result<Value, Failure> {
        let (id, deadline) = (self.next_id, Instant::now() + self.timeout);
        self.next_id += 1;
        let sent = self.stream.write_all(request_line(id, request).as_bytes());
        sent.map_err(|e| no_reply(&e))?;
        loop {
            let value = self.read_until(deadline)?;
            if value["id"] == id {
                return result(&value);
            }
        }
    }

    /// Reads the next line, reply or event.
    ///
    /// # Errors
    /// [`Failure`] with code 3 if the service is gone or silent.
    pub fn read(&mut self) -> Result<Value, Failure> {
        self.read_until(Instant::now() + self.timeout)
    }

    fn read_until(&mut self, deadline: Instant) -> Result<Value, Failure> {
        let mut searched = 0;
        loop {
            let end = self.input[searched..].iter().position(|b| *b == b'\n');
            if let Some(end) = end.map(|end| searched + end) {
                let line: Vec<u8> = self.input.drain(..=end).collect();
                return serde_json::from_slice(&line).map_err(|e| {
                    let start = String::from_utf8_lossy(&line[..end.min(200)]);
                    let sent = start.escape_debug();
                    Failure::unreachable(format!("the service sent `{sent}`: {e}"))
                });
            }
            searched = self.input.len();
            if searched > LINE_MAX {
                return Err(Failure::unreachable(format!(
                    "it sends a line of more than {} KiB, so it is no service of retroflex",
                    LINE_MAX / 1024
                )));
            }
            self.receive(deadline)?;
        }
    }

    /// Appends what arrives until the deadline to the input.
    fn receive(&mut self, deadline: Instant) -> Result<(), Failure> {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(no_reply(&ErrorKind::WouldBlock.into()));
        }
        let mut chunk = [0; CHUNK];
        let ready = self.stream.set_read_timeout(Some(left));
        match ready.and_then(|()| self.stream.read(&mut chunk)) {
            Ok(0) => Err(Failure::unreachable("the service closed the connection")),
            Ok(n) => {
                self.input.extend_from_slice(&chunk[..n]);
                Ok(())
            }
            Err(e) if e.kind() == ErrorKind::Interrupted => Ok(()),
            Err(e) => Err(no_reply(&e)),
        }
    }
}

/// What a reply says.
fn result(reply: &Value) -> Result<Value, Failure> {
    if reply["ok"] == true {
        return Ok(reply["result"].clone());
    }
    let code = reply["code"].as_u64().and_then(|c| u8::try_from(c).ok());
    let why = reply["error"].as_str().unwrap_or("no reason given");
    Err(Failure::new(code.unwrap_or(2), why))
}

fn no_reply(e: &std::io::Error) -> Failure {
    Failure::unreachable(match e.kind() {
        ErrorKind::WouldBlock => {
            "it does not answer: it hangs, or its computer is overloaded".to_owned()
        }
        _ => format!("it does not answer: {e}"),
    })
}
