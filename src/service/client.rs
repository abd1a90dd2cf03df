//! A client of the service: what the command line is.

use crate::service::protocol::{Failure, Request, request_line};
use serde_json::Value;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(10);

/// A connection.
#[derive(Debug)]
pub struct Client {
    reader: BufReader<UnixStream>,
    writer: UnixStream,
    next: u64,
}

impl Client {
    /// Connects.
    ///
    /// # Errors
    /// [`Failure`] with code 3: nothing answers there.
    pub fn connect(path: &Path) -> Result<Self, Failure> {
        let gone = |e: std::io::Error| Failure {
            code: 3,
            words: format!("{}: {e}; is `retroflex run` running, and are you in the socket's group?", path.display()),
        };
        let writer = UnixStream::connect(path).map_err(gone)?;
        writer.set_read_timeout(Some(PATIENCE)).map_err(gone)?;
        writer.set_write_timeout(Some(PATIENCE)).map_err(gone)?;
        let reader = BufReader::new(writer.try_clone().map_err(gone)?);
        Ok(Self { reader, writer, next: 1 })
    }

    /// Asks and waits for the answer; events that come in between are skipped.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn ask(&mut self, request: &Request) -> Result<Value, Failure> {
        let id = self.next;
        self.next += 1;
        self.writer.write_all(request_line(id, request).as_bytes()).map_err(|e| lost(&e))?;
        loop {
            let value = self.line()?;
            if value["id"] != id {
                continue;
            }
            if value["ok"] == true {
                return Ok(value["result"].clone());
            }
            let code = value["code"].as_u64().and_then(|c| u8::try_from(c).ok()).unwrap_or(2);
            return Err(Failure { code, words: value["error"].as_str().unwrap_or("refused without a reason").to_owned() });
        }
    }

    /// The next line, whatever it is.
    ///
    /// # Errors
    /// [`Failure`] with code 3 when the service is gone or silent.
    pub fn line(&mut self) -> Result<Value, Failure> {
        let mut line = String::new();
        match self.reader.read_line(&mut line) {
            Ok(0) => Err(Failure { code: 3, words: "the service closed the connection".to_owned() }),
            Ok(_) => {
                serde_json::from_str(&line).map_err(|e| Failure { code: 3, words: format!("the service said `{}`: {e}", line.trim()) })
            }
            Err(e) => Err(lost(&e)),
        }
    }
}

fn lost(e: &std::io::Error) -> Failure {
    Failure { code: 3, words: format!("the service does not answer: {e}") }
}
