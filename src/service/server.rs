//! The sockets: many clients, none of whom can hold anybody up.
//!
//! Everything is non-blocking and bounded: a line, what waits to be written, how many clients there
//! are, how many lines of one client are taken in a round. A client that floods is read no faster than
//! the hub goes round, and its own socket buffer makes it wait; one that does not read is dropped.

#![allow(unsafe_code)]

use crate::config::service::ServiceSection;
use crate::service::ServiceError;
use crate::service::protocol::LINE_MAX;
use std::io::{ErrorKind, Read, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Clients at a time.
const CLIENTS_MAX: usize = 64;
/// Lines of one client in one round.
const LINES_PER_ROUND: usize = 16;
/// Most that waits to be written to one client, bytes.
const OUT_MAX: usize = 512 * 1024;
/// A line that was begun must be ended within this time, s.
const LINE_MAX_S: f64 = 3.0;

/// A client.
#[derive(Debug)]
struct Client {
    number: u64,
    stream: UnixStream,
    commands: bool,
    inward: Vec<u8>,
    begun: Instant,
    outward: Vec<u8>,
    closing: bool,
}

/// One line of a client.
#[derive(Debug)]
pub struct Line {
    /// Whose.
    pub client: u64,
    /// It came by the command socket.
    pub commands: bool,
    /// The line, or what is wrong with it.
    pub text: Result<String, &'static str>,
}

/// Both sockets and everybody on them.
#[derive(Debug)]
pub struct Server {
    listeners: [(UnixListener, bool, PathBuf); 2],
    clients: Vec<Client>,
    next: u64,
    /// Clients dropped, with the reason, since last asked.
    pub dropped: Vec<(u64, &'static str)>,
}

impl Server {
    /// Makes both sockets with their permissions; a stale one is replaced, a live one is an error.
    ///
    /// # Errors
    /// [`ServiceError::Socket`].
    pub fn bind(service: &ServiceSection) -> Result<Self, ServiceError> {
        let command = bind(&service.socket, service.socket_mode)?;
        let status = bind(&service.status_socket, service.status_mode)?;
        let listeners = [(command, true, service.socket.clone()), (status, false, service.status_socket.clone())];
        Ok(Self { listeners, clients: Vec::new(), next: 1, dropped: Vec::new() })
    }

    /// How many are connected.
    #[must_use]
    pub fn clients(&self) -> usize {
        self.clients.len()
    }

    /// Waits for something to do, at most this long, then takes in what there is.
    pub fn round(&mut self, wait: Duration) -> Vec<Line> {
        self.wait(wait);
        self.accept();
        let mut lines = Vec::new();
        for client in &mut self.clients {
            client.read();
            client.lines(&mut lines);
            client.write();
        }
        let dropped = &mut self.dropped;
        self.clients.retain(|c| {
            let why = c.verdict();
            if let Some(why) = why {
                dropped.push((c.number, why));
            }
            why.is_none()
        });
        lines
    }

    /// Queues a line for a client; one that is gone does not get it.
    pub fn send(&mut self, number: u64, line: &str) {
        if let Some(client) = self.clients.iter_mut().find(|c| c.number == number) {
            client.outward.extend_from_slice(line.as_bytes());
            client.write();
        }
    }

    /// Takes no further line of a client; it is dropped once it has read its answer.
    pub fn close(&mut self, number: u64) {
        if let Some(client) = self.clients.iter_mut().find(|c| c.number == number) {
            client.closing = true;
        }
    }

    /// True for a client that is still there.
    #[must_use]
    pub fn knows(&self, number: u64) -> bool {
        self.clients.iter().any(|c| c.number == number)
    }

    fn wait(&self, wait: Duration) {
        let of = |fd, events| libc::pollfd { fd, events, revents: 0 };
        let mut set: Vec<libc::pollfd> = self.listeners.iter().map(|(l, ..)| of(l.as_raw_fd(), libc::POLLIN)).collect();
        for c in &self.clients {
            let reads = if !c.closing && c.inward.len() < LINE_MAX { libc::POLLIN } else { 0 };
            let writes = if c.outward.is_empty() { 0 } else { libc::POLLOUT };
            set.push(of(c.stream.as_raw_fd(), reads | writes));
        }
        let ms = i32::try_from(wait.as_millis()).unwrap_or(i32::MAX);
        // SAFETY: `set` is a live array of as many pollfd as is said; a failure leaves nothing but an early return
        unsafe { libc::poll(set.as_mut_ptr(), set.len() as libc::nfds_t, ms) };
    }

    fn accept(&mut self) {
        for (listener, commands, _) in &self.listeners {
            while let Ok((stream, _)) = listener.accept() {
                if self.clients.len() >= CLIENTS_MAX || stream.set_nonblocking(true).is_err() {
                    self.dropped.push((0, "too many clients"));
                    continue;
                }
                let number = self.next;
                self.next += 1;
                let (inward, outward) = (Vec::new(), Vec::new());
                self.clients.push(Client { number, stream, commands: *commands, inward, begun: Instant::now(), outward, closing: false });
            }
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        for (.., path) in &self.listeners {
            // another service may have taken its place; then there is nothing of ours to remove
            let _ = std::fs::remove_file(path);
        }
    }
}

impl Client {
    fn read(&mut self) {
        let mut chunk = [0u8; 8192];
        while !self.closing && self.inward.len() <= LINE_MAX {
            match self.stream.read(&mut chunk) {
                Ok(0) => {
                    self.closing = true;
                    // what is not ended by now never will be
                    if !self.inward.ends_with(b"\n") {
                        let whole = self.inward.iter().rposition(|b| *b == b'\n').map_or(0, |n| n + 1);
                        self.inward.truncate(whole);
                    }
                }
                Ok(n) => {
                    if self.inward.is_empty() {
                        self.begun = Instant::now();
                    }
                    self.inward.extend_from_slice(&chunk[..n]);
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => return,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(_) => self.closing = true,
            }
        }
    }

    fn lines(&mut self, into: &mut Vec<Line>) {
        let mut taken = 0;
        for _ in 0..LINES_PER_ROUND {
            let Some(end) = self.inward[taken..].iter().position(|b| *b == b'\n') else { break };
            let bytes = &self.inward[taken..taken + end];
            taken += end + 1;
            let text = match std::str::from_utf8(bytes) {
                Ok(text) if text.trim().is_empty() => continue,
                Ok(text) => Ok(text.trim().to_owned()),
                Err(_) => Err("a line is UTF-8 text"),
            };
            into.push(Line { client: self.number, commands: self.commands, text });
        }
        self.inward.drain(..taken);
        if taken > 0 {
            self.begun = Instant::now();
        }
        if self.inward.len() > LINE_MAX && !self.inward.contains(&b'\n') {
            into.push(Line { client: self.number, commands: self.commands, text: Err("a line is at most 16 KiB long") });
            self.inward.clear();
            self.closing = true;
        }
    }

    fn write(&mut self) {
        while !self.outward.is_empty() {
            match self.stream.write(&self.outward) {
                Ok(0) => break,
                Ok(n) => {
                    self.outward.drain(..n);
                }
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                Err(_) => {
                    self.closing = true;
                    self.outward.clear();
                }
            }
        }
    }

    /// Why it must go, if it must.
    fn verdict(&self) -> Option<&'static str> {
        if self.closing && self.outward.is_empty() && self.inward.is_empty() {
            Some("gone")
        } else if self.outward.len() > OUT_MAX {
            Some("does not read")
        } else if !self.inward.is_empty() && !self.inward.contains(&b'\n') && self.begun.elapsed().as_secs_f64() > LINE_MAX_S {
            Some("does not end its line")
        } else {
            None
        }
    }
}

fn bind(path: &Path, mode: u32) -> Result<UnixListener, ServiceError> {
    let fail = |source| ServiceError::Socket { path: path.display().to_string(), source };
    if path.exists() {
        if UnixStream::connect(path).is_ok() {
            return Err(fail(std::io::Error::other("a service answers there already")));
        }
        std::fs::remove_file(path).map_err(fail)?;
    }
    let listener = UnixListener::bind(path).map_err(fail)?;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).map_err(fail)?;
    listener.set_nonblocking(true).map_err(fail)?;
    Ok(listener)
}
