//! One connection of a client: bounded reading, splitting into lines, and bounded writing.

use crate::service::protocol::{LINE_MAX, says_stop};
use nix::sys::socket::UnixCredentials;
use std::borrow::Cow;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

/// Bytes read from one client per round.
const READ_PER_ROUND: usize = 2 * LINE_MAX;
/// Requests of one client that may be unanswered at a time. Further ones are refused, except `stop`.
pub const UNANSWERED_MAX: usize = 16;
/// Largest amount of data queued for one client, bytes.
const OUTPUT_MAX: usize = 512 * 1024;
/// Longest time between the first byte of a line and its end, s.
const LINE_MAX_S: f64 = 3.0;

/// One line of a client.
#[derive(Debug)]
pub struct Line {
    /// Number of the client.
    pub client: u64,
    /// The line without its end, or why it was not accepted; then the client is disconnected once it has read the reply.
    pub text: Result<String, &'static str>,
    /// The client already has as many unanswered requests as it may.
    pub surplus: bool,
}

/// A client.
#[derive(Debug)]
pub(super) struct Client {
    pub(super) number: u64,
    /// Who is at the other end.
    pub(super) peer: UnixCredentials,
    pub(super) stream: UnixStream,
    pub(super) input: Vec<u8>,
    line_started: Instant,
    /// When the last line came, or the connection.
    pub(super) last_line: Instant,
    /// When anything was last received or written.
    active: Instant,
    /// It has sent a line.
    pub(super) spoke: bool,
    pub(super) output: Vec<u8>,
    pub(super) unanswered: usize,
    /// It keeps its place until it has its next reply.
    pub(super) protected: bool,
    pub(super) closing: bool,
}

impl Client {
    pub(super) fn new(number: u64, peer: UnixCredentials, stream: UnixStream) -> Self {
        let now = Instant::now();
        Self {
            number,
            peer,
            stream,
            input: Vec::new(),
            line_started: now,
            last_line: now,
            active: now,
            spoke: false,
            output: Vec::new(),
            unanswered: 0,
            protected: false,
            closing: false,
        }
    }

    pub(super) fn wants_input(&self) -> bool {
        !self.closing && self.input.len() <= LINE_MAX
    }

    pub(super) fn read(&mut self) {
        let mut chunk = [0u8; 8192];
        let mut total = 0;
        while self.wants_input() && total < READ_PER_ROUND {
            match self.stream.read(&mut chunk) {
                Ok(0) => self.closing = true,
                Ok(n) => {
                    total += n;
                    self.active = Instant::now();
                    if self.input.is_empty() {
                        self.line_started = self.active;
                    }
                    self.input.extend_from_slice(&chunk[..n]);
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => return,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(_) => self.closing = true,
            }
        }
    }

    /// Takes at most `most` complete lines.
    pub(super) fn take_lines(&mut self, lines: &mut Vec<Line>, most: usize) {
        let mut taken = 0;
        for _ in 0..most {
            let Some(end) = self.input[taken..].iter().position(|b| *b == b'\n') else {
                break;
            };
            let text = String::from_utf8_lossy(&self.input[taken..taken + end]);
            // what is no text may say `stop` all the same
            let text = if matches!(text, Cow::Borrowed(_)) || says_stop(&text) {
                Ok(text.trim().to_owned())
            } else {
                self.closing = true;
                Err("a line must be UTF-8 text")
            };
            taken += end + 1;
            if text.as_ref().is_ok_and(String::is_empty) {
                continue;
            }
            let surplus = self.unanswered >= UNANSWERED_MAX;
            self.unanswered += 1;
            lines.push(Line {
                client: self.number,
                text,
                surplus,
            });
        }
        self.input.drain(..taken);
        if taken > 0 {
            let now = Instant::now();
            (self.line_started, self.last_line, self.spoke) = (now, now, true);
        }
        if self.input.len() > LINE_MAX && !self.input.contains(&b'\n') {
            self.unanswered += 1;
            lines.push(Line {
                client: self.number,
                text: Err("a line must not be longer than 16 KiB"),
                surplus: false,
            });
            self.input.clear();
            self.closing = true;
        }
    }

    pub(super) fn send(&mut self, line: &str) {
        self.output.extend_from_slice(line.as_bytes());
    }

    pub(super) fn write(&mut self) {
        while !self.output.is_empty() {
            match self.stream.write(&self.output) {
                Ok(0) => break,
                Ok(n) => {
                    self.output.drain(..n);
                    self.active = Instant::now();
                }
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                Err(_) => {
                    self.closing = true;
                    self.output.clear();
                }
            }
        }
    }

    pub(super) fn reason_to_drop(&self, idle_max: Duration) -> Option<&'static str> {
        let complete = self.input.contains(&b'\n');
        // a line that will not end is discarded
        if self.closing && !complete && self.output.is_empty() && self.unanswered == 0 {
            Some("disconnected")
        } else if self.output.len() > OUTPUT_MAX {
            Some("it does not read")
        } else if !self.closing
            && !self.input.is_empty()
            && !complete
            && self.line_started.elapsed().as_secs_f64() > LINE_MAX_S
        {
            Some("it did not end its line")
        } else if self.unanswered == 0 && self.active.elapsed() > idle_max {
            Some("it was idle")
        } else {
            None
        }
    }
}
