//! A client of the service, as the command line uses it.

use crate::service::paths;
use crate::service::protocol::{Failure, Request, request_line};
use serde_json::Value;
use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

/// Longest wait for a reply.
const TIMEOUT: Duration = Duration::from_secs(10);
/// Longest wait for the answer of the socket of `stop`; five times as long for that of the command socket after it.
const STOP_TIMEOUT: Duration = Duration::from_millis(200);

/// A connection to a service.
#[derive(Debug)]
pub struct Client {
    reader: BufReader<UnixStream>,
    writer: UnixStream,
    next_id: u64,
}

fn unreachable(message: String) -> Failure {
    Failure { code: 3, message }
}

impl Client {
    /// Connects to a socket.
    ///
    /// # Errors
    /// [`Failure`] with code 3 if no service listens there.
    pub fn connect(path: &Path) -> Result<Self, Failure> {
        Self::connect_for(path, TIMEOUT)
    }

    /// As [`connect`](Self::connect), with this longest wait for each reply.
    ///
    /// # Errors
    /// As for [`connect`](Self::connect).
    pub fn connect_for(path: &Path, timeout: Duration) -> Result<Self, Failure> {
        let connect = || -> std::io::Result<Self> {
            let writer = UnixStream::connect(path)?;
            writer.set_read_timeout(Some(timeout))?;
            writer.set_write_timeout(Some(timeout))?;
            Ok(Self {
                reader: BufReader::new(writer.try_clone()?),
                writer,
                next_id: 1,
            })
        };
        connect().map_err(|e| {
            unreachable(format!(
                "{}: {e}; is `retroflex run` running, and are you in the group of the socket?",
                path.display()
            ))
        })
    }

    /// Stops the tip of the service with this command socket: through the socket of `stop`, or if that does not answer,
    /// through the command socket.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn stop(control: &Path) -> Result<Value, Failure> {
        let direct = Self::connect_for(&paths::stop_socket(control), STOP_TIMEOUT)
            .and_then(|mut client| result(&client.read()?));
        direct.or_else(|_| Self::connect_for(control, 5 * STOP_TIMEOUT)?.request(&Request::Stop {}))
    }

    /// Sends a request and waits for its reply. Events that arrive in between are skipped.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn request(&mut self, request: &Request) -> Result<Value, Failure> {
        let id = self.next_id;
        self.next_id += 1;
        self.writer
            .write_all(request_line(id, request).as_bytes())
            .map_err(|e| no_reply(&e))?;
        loop {
            let value = self.read()?;
            if value["id"] != id {
                continue;
            }
            return result(&value);
        }
    }

    /// Reads the next line, reply or event.
    ///
    /// # Errors
    /// [`Failure`] with code 3 if the service is gone or silent.
    pub fn read(&mut self) -> Result<Value, Failure> {
        let mut line = String::new();
        match self.reader.read_line(&mut line) {
            Ok(0) => Err(unreachable("the service closed the connection".to_owned())),
            Ok(_) => serde_json::from_str(&line)
                .map_err(|e| unreachable(format!("the service sent `{}`: {e}", line.trim()))),
            Err(e) => Err(no_reply(&e)),
        }
    }
}

/// What a reply says.
fn result(reply: &Value) -> Result<Value, Failure> {
    if reply["ok"] == true {
        return Ok(reply["result"].clone());
    }
    let code = reply["code"]
        .as_u64()
        .and_then(|c| u8::try_from(c).ok())
        .unwrap_or(2);
    Err(Failure {
        code,
        message: reply["error"]
            .as_str()
            .unwrap_or("no reason given")
            .to_owned(),
    })
}

fn no_reply(e: &std::io::Error) -> Failure {
    match e.kind() {
        ErrorKind::WouldBlock => {
            unreachable("it does not answer: it hangs, or its computer is overloaded".to_owned())
        }
        _ => unreachable(format!("it does not answer: {e}")),
    }
}
