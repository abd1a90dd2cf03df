//! One listening socket and its clients.
//!
//! Every operation is non-blocking and every resource is bounded: the length of a line, the bytes queued for a client,
//! the number of clients, the lines of one client per round and its unanswered requests. A client that sends too fast is
//! slowed down by its own socket buffer; one that does not read is disconnected. The command socket and the status
//! socket are separate servers, so clients that only read cannot take the places of clients that command.

#![allow(unsafe_code)]

use crate::service::error::ServiceError;
use crate::service::protocol::LINE_MAX;
use std::io::{ErrorKind, Read, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Clients at a time on one socket.
const CLIENTS_MAX: usize = 32;
/// Lines accepted from one client per round.
const LINES_PER_ROUND: usize = 16;
/// Requests of one client that may be unanswered at a time. Further lines wait in its socket buffer.
const UNANSWERED_MAX: usize = 16;
/// Largest amount of data queued for one client, bytes.
const OUTPUT_MAX: usize = 512 * 1024;
/// Longest time between the first byte of a line and its end, s.
const LINE_MAX_S: f64 = 3.0;

/// One line of a client.
#[derive(Debug)]
pub struct Line {
    /// Number of the client.
    pub client: u64,
    /// The line without its end, or why it was not accepted.
    pub text: Result<String, &'static str>,
}

/// Ends the wait of a [`Server::round`] from another thread.
#[derive(Debug)]
pub struct Waker(UnixStream);

impl Waker {
    /// Wakes the server. A full pipe means that it is about to wake anyway.
    pub fn wake(&self) {
        let _ = (&self.0).write(&[0]);
    }
}

/// A listening socket and its clients.
#[derive(Debug)]
pub struct Server {
    listener: UnixListener,
    path: PathBuf,
    wake: UnixStream,
    clients: Vec<Client>,
    next: u64,
    /// Clients disconnected since this list was last taken, with the reason.
    pub dropped: Vec<(u64, &'static str)>,
}

impl Server {
    /// Creates the socket with the given permission bits. A stale socket file is replaced; a live one is an error.
    /// Clients are numbered `first`, `first` + 2, …, so that two servers never share a number.
    ///
    /// # Errors
    /// [`ServiceError::Socket`].
    pub fn bind(path: &Path, mode: u32, first: u64) -> Result<(Self, Waker), ServiceError> {
        let fail = |source| ServiceError::Socket { path: path.display().to_string(), source };
        if path.exists() {
            if UnixStream::connect(path).is_ok() {
                return Err(fail(std::io::Error::other("another service already answers on this socket")));
            }
            std::fs::remove_file(path).map_err(fail)?;
        }
        let listener = UnixListener::bind(path).map_err(fail)?;
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).map_err(fail)?;
        listener.set_nonblocking(true).map_err(fail)?;
        let (wake, waker) = UnixStream::pair().map_err(fail)?;
        wake.set_nonblocking(true).map_err(fail)?;
        waker.set_nonblocking(true).map_err(fail)?;
        let server = Self { listener, path: path.to_owned(), wake, clients: Vec::new(), next: first, dropped: Vec::new() };
        Ok((server, Waker(waker)))
    }

    /// Number of connected clients.
    #[must_use]
    pub fn clients(&self) -> usize {
        self.clients.len()
    }

    /// Waits at most `wait` for input, then returns the complete lines of all clients.
    pub fn round(&mut self, wait: Duration) -> Vec<Line> {
        self.poll(wait);
        self.accept();
        let mut lines = Vec::new();
        for client in &mut self.clients {
            client.read();
            client.take_lines(&mut lines);
            client.write();
        }
        let dropped = &mut self.dropped;
        self.clients.retain(|c| {
            let reason = c.reason_to_drop();
            dropped.extend(reason.map(|why| (c.number, why)));
            reason.is_none()
        });
        lines
    }

    /// Queues the reply to one line of a client.
    pub fn reply(&mut self, number: u64, line: &str) {
        if let Some(client) = self.client(number) {
            client.unanswered = client.unanswered.saturating_sub(1);
            client.send(line);
        }
    }

    /// Queues a line that is not a reply.
    pub fn send(&mut self, number: u64, line: &str) {
        if let Some(client) = self.client(number) {
            client.send(line);
        }
    }

    /// Accepts no further line of a client and disconnects it once it has read its replies.
    pub fn close(&mut self, number: u64) {
        if let Some(client) = self.client(number) {
            client.closing = true;
        }
    }

    fn client(&mut self, number: u64) -> Option<&mut Client> {
        self.clients.iter_mut().find(|c| c.number == number)
    }

    fn poll(&mut self, wait: Duration) {
        let entry = |fd, events| libc::pollfd { fd, events, revents: 0 };
        let mut set = vec![entry(self.listener.as_raw_fd(), libc::POLLIN), entry(self.wake.as_raw_fd(), libc::POLLIN)];
        for c in &self.clients {
            let reads = if c.wants_input() { libc::POLLIN } else { 0 };
            let writes = if c.output.is_empty() { 0 } else { libc::POLLOUT };
            set.push(entry(c.stream.as_raw_fd(), reads | writes));
        }
        let ms = i32::try_from(wait.as_millis()).unwrap_or(i32::MAX);
        // SAFETY: `set` is a live array of the given length; after a failure the round merely starts early
        unsafe { libc::poll(set.as_mut_ptr(), set.len() as libc::nfds_t, ms) };
        while self.wake.read(&mut [0; 64]).is_ok_and(|n| n > 0) {}
    }

    fn accept(&mut self) {
        while let Ok((stream, _)) = self.listener.accept() {
            if self.clients.len() >= CLIENTS_MAX || stream.set_nonblocking(true).is_err() {
                self.dropped.push((0, "too many clients"));
                continue;
            }
            self.clients.push(Client::new(self.next, stream));
            self.next += 2;
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // the file may be gone already
        let _ = std::fs::remove_file(&self.path);
    }
}

#[derive(Debug)]
struct Client {
    number: u64,
    stream: UnixStream,
    input: Vec<u8>,
    line_started: Instant,
    output: Vec<u8>,
    unanswered: usize,
    closing: bool,
}

impl Client {
    fn new(number: u64, stream: UnixStream) -> Self {
        Self { number, stream, input: Vec::new(), line_started: Instant::now(), output: Vec::new(), unanswered: 0, closing: false }
    }

    fn wants_input(&self) -> bool {
        !self.closing && self.input.len() <= LINE_MAX && self.unanswered < UNANSWERED_MAX
    }

    fn read(&mut self) {
        let mut chunk = [0u8; 8192];
        while self.wants_input() {
            match self.stream.read(&mut chunk) {
                Ok(0) => {
                    self.closing = true;
                    // a line without an end is discarded
                    let complete = self.input.iter().rposition(|b| *b == b'\n').map_or(0, |n| n + 1);
                    self.input.truncate(complete);
                }
                Ok(n) => {
                    if self.input.is_empty() {
                        self.line_started = Instant::now();
                    }
                    self.input.extend_from_slice(&chunk[..n]);
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => return,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(_) => self.closing = true,
            }
        }
    }

    fn take_lines(&mut self, lines: &mut Vec<Line>) {
        let mut taken = 0;
        for _ in 0..LINES_PER_ROUND.min(UNANSWERED_MAX.saturating_sub(self.unanswered)) {
            let Some(end) = self.input[taken..].iter().position(|b| *b == b'\n') else { break };
            let text = match std::str::from_utf8(&self.input[taken..taken + end]) {
                Ok(text) => Ok(text.trim().to_owned()),
                Err(_) => Err("a line must be UTF-8 text"),
            };
            taken += end + 1;
            if text.as_ref().is_ok_and(String::is_empty) {
                continue;
            }
            self.unanswered += 1;
            lines.push(Line { client: self.number, text });
        }
        self.input.drain(..taken);
        if taken > 0 {
            self.line_started = Instant::now();
        }
        if self.input.len() > LINE_MAX && !self.input.contains(&b'\n') {
            lines.push(Line { client: self.number, text: Err("a line must not be longer than 16 KiB") });
            self.input.clear();
            self.closing = true;
        }
    }

    fn send(&mut self, line: &str) {
        self.output.extend_from_slice(line.as_bytes());
        self.write();
    }

    fn write(&mut self) {
        while !self.output.is_empty() {
            match self.stream.write(&self.output) {
                Ok(0) => break,
                Ok(n) => {
                    self.output.drain(..n);
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

    fn reason_to_drop(&self) -> Option<&'static str> {
        let complete = self.input.contains(&b'\n');
        if self.closing && self.output.is_empty() && self.input.is_empty() && self.unanswered == 0 {
            Some("disconnected")
        } else if self.output.len() > OUTPUT_MAX {
            Some("it does not read")
        } else if !self.input.is_empty() && !complete && self.line_started.elapsed().as_secs_f64() > LINE_MAX_S {
            Some("it did not end its line")
        } else {
            None
        }
    }
}
