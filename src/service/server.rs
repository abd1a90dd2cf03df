//! One listening socket and its clients.
//!
//! Every operation is non-blocking and every resource is bounded: the connections accepted per round, the number of
//! clients, the length of a line, the lines of one client per round, its unanswered requests and the bytes queued for it.
//! A new connection always finds a place: when all are taken, the user who has the most loses the connection that has
//! been silent for longest. A client that does not read, does not end its line or is idle for too long is disconnected.

#![allow(unsafe_code)]

use crate::service::connection::{Client, Line};
use crate::service::error::ServiceError;
use std::io::{Read, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Clients at a time on one socket.
pub const CLIENTS_MAX: usize = 32;
/// Lines accepted per round, shared by the clients that send; each of them is granted the smaller number.
const LINES_PER_ROUND: usize = 64;
const LINES_MIN: usize = 2;
/// Connections that wait to be accepted: no longer than two rounds.
const BACKLOG: i32 = 64;
/// Connections accepted per round, so that a flood of them does not keep clients from being read.
const ACCEPTED_PER_ROUND: usize = CLIENTS_MAX;
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
    /// Device and inode of the socket file: a file that another service has put there is left alone.
    inode: (u64, u64),
    wake: UnixStream,
    clients: Vec<Client>,
    next: u64,
    /// Longest silence of a client without an open request or subscription.
    idle_max: Duration,
    /// Clients disconnected since this list was last taken, with the reason, unless they never sent a line.
    pub gone: Vec<(u64, &'static str)>,
}

impl Server {
    /// Creates the socket with the given permission bits. A stale socket file is replaced; a live one is an error.
    /// Clients are numbered `first`, `first` + 2, …, so that two servers never share a number.
    ///
    /// # Errors
    /// [`ServiceError::Socket`].
    pub fn bind(path: &Path, mode: u32, first: u64, idle_max: Duration) -> Result<(Self, Waker), ServiceError> {
        let fail = |source| ServiceError::Socket { path: path.display().to_string(), source };
        if path.exists() {
            if UnixStream::connect(path).is_ok() {
                return Err(fail(std::io::Error::other("another service already answers on this socket")));
            }
            std::fs::remove_file(path).map_err(fail)?;
        }
        // nobody but the owner may connect before the permissions are set
        // SAFETY: umask takes and returns an integer; no other thread creates files at this time
        let umask = unsafe { libc::umask(0o177) };
        let bound = UnixListener::bind(path);
        // SAFETY: as above
        unsafe { libc::umask(umask) };
        let listener = bound.map_err(fail)?;
        // SAFETY: the descriptor is a bound socket; a second listen(2) changes the length of its queue
        unsafe { libc::listen(listener.as_raw_fd(), BACKLOG) };
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).map_err(fail)?;
        let inode = inode(path).map_err(fail)?;
        listener.set_nonblocking(true).map_err(fail)?;
        let (wake, waker) = UnixStream::pair().map_err(fail)?;
        wake.set_nonblocking(true).map_err(fail)?;
        waker.set_nonblocking(true).map_err(fail)?;
        let server = Self { listener, path: path.to_owned(), inode, wake, clients: Vec::new(), next: first, idle_max, gone: Vec::new() };
        Ok((server, Waker(waker)))
    }

    /// Number of connected clients.
    #[must_use]
    pub fn clients(&self) -> usize {
        self.clients.len()
    }

    /// Waits at most `wait` for input, then returns the complete lines of all clients.
    pub fn round(&mut self, wait: Duration) -> Vec<Line> {
        let waiting = self.clients.iter().any(|c| c.input.contains(&b'\n'));
        self.poll(if waiting { Duration::ZERO } else { wait });
        let mut lines = Vec::new();
        self.accept(&mut lines);
        self.clients.iter_mut().for_each(Client::read);
        // one client that floods alone is served quickly, so that a stop at the end of its own flood is found soon
        let talking = self.clients.iter().filter(|c| !c.input.is_empty()).count();
        let share = (LINES_PER_ROUND / talking.max(1)).max(LINES_MIN);
        self.clients.iter_mut().for_each(|c| c.take_lines(&mut lines, share));
        let (gone, idle_max) = (&mut self.gone, self.idle_max);
        self.clients.retain(|c| {
            let reason = c.reason_to_drop(idle_max);
            gone.extend(reason.filter(|_| c.spoke).map(|why| (c.number, why)));
            reason.is_none()
        });
        lines
    }

    /// Queues the reply to one line of a client.
    pub fn reply(&mut self, number: u64, line: &str) {
        if let Some(client) = self.client(number) {
            client.unanswered = client.unanswered.saturating_sub(1);
            client.protected = false;
            client.send(line);
        }
    }

    /// Queues a line that is not a reply.
    pub fn send(&mut self, number: u64, line: &str) {
        if let Some(client) = self.client(number) {
            client.send(line);
        }
    }

    /// Writes what is queued, as far as the clients read it.
    pub fn flush(&mut self) {
        self.clients.iter_mut().for_each(Client::write);
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

    /// Accepts connections and reads their first lines at once: what a new client has sent is not lost with its place.
    fn accept(&mut self, lines: &mut Vec<Line>) {
        for _ in 0..ACCEPTED_PER_ROUND {
            let Ok((stream, _)) = self.listener.accept() else { return };
            let (Ok(()), Some(user)) = (stream.set_nonblocking(true), peer(&stream)) else { continue };
            if self.clients.len() >= CLIENTS_MAX && !self.make_room() {
                continue;
            }
            let mut client = Client::new(self.next, user, stream);
            client.read();
            client.take_lines(lines, 1);
            self.clients.push(client);
            self.next += 2;
        }
    }

    /// Keeps the place of a client until it has its next reply.
    pub fn protect(&mut self, number: u64) {
        if let Some(client) = self.client(number) {
            client.protected = true;
        }
    }

    /// Disconnects, of the user with the most clients, the one whose last line is oldest; clients that wait for an answer go
    /// last, and protected ones stay. False if nobody could be disconnected.
    fn make_room(&mut self) -> bool {
        let share = |user: u32| self.clients.iter().filter(|c| c.user == user).count();
        let most = self.clients.iter().map(|c| share(c.user)).max().unwrap_or(0);
        let of_user = self.clients.iter().enumerate().filter(|(_, c)| share(c.user) == most);
        let candidates = of_user.filter(|(_, c)| !c.protected);
        let Some((n, _)) = candidates.min_by_key(|(_, c)| (c.unanswered > 0, c.last_line)) else { return false };
        let client = self.clients.remove(n);
        if client.spoke {
            self.gone.push((client.number, "its place was needed"));
        }
        true
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if inode(&self.path).is_ok_and(|there| there == self.inode) {
            // the file may be gone already
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

fn inode(path: &Path) -> std::io::Result<(u64, u64)> {
    std::fs::symlink_metadata(path).map(|m| (m.dev(), m.ino()))
}

/// The user at the other end of a connection.
fn peer(stream: &UnixStream) -> Option<u32> {
    let mut who = libc::ucred { pid: 0, uid: 0, gid: 0 };
    let mut size = size_of::<libc::ucred>() as libc::socklen_t;
    // SAFETY: `who` and `size` are live and of the stated size
    let result = unsafe { libc::getsockopt(stream.as_raw_fd(), libc::SOL_SOCKET, libc::SO_PEERCRED, (&raw mut who).cast(), &raw mut size) };
    (result == 0).then_some(who.uid)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::connection::UNANSWERED_MAX;

    fn server(folder: &Path, idle_max: Duration) -> Server {
        Server::bind(&folder.join("socket"), 0o600, 1, idle_max).unwrap().0
    }

    /// Rounds until nothing is left to accept or to read.
    fn rounds(server: &mut Server) -> Vec<Line> {
        (0..8).flat_map(|_| server.round(Duration::from_millis(5))).collect()
    }

    #[test]
    fn silent_connections_do_not_keep_a_new_one_out() {
        let folder = tempfile::tempdir().unwrap();
        let mut server = server(folder.path(), Duration::from_secs(60));
        let connect = || UnixStream::connect(folder.path().join("socket")).unwrap();
        let mut speaker = connect();
        speaker.write_all(b"one\n").unwrap();
        assert_eq!(rounds(&mut server).len(), 1);
        let silent: Vec<_> = (0..2 * CLIENTS_MAX)
            .map(|_| {
                let c = connect();
                rounds(&mut server);
                c
            })
            .collect();
        assert_eq!(server.clients(), CLIENTS_MAX);
        let mut late = connect();
        late.write_all(b"stop\n").unwrap();
        let lines = rounds(&mut server);
        assert_eq!(lines.iter().filter_map(|l| l.text.as_deref().ok()).collect::<Vec<_>>(), ["stop"]);
        // the speaker waits for its answer, so the silent ones went first
        assert!(server.gone.is_empty(), "{:?}", server.gone);
        drop(silent);
    }

    #[test]
    fn lines_beyond_the_unanswered_ones_are_marked_and_idle_clients_go() {
        let folder = tempfile::tempdir().unwrap();
        let mut server = server(folder.path(), Duration::from_millis(50));
        let mut client = UnixStream::connect(folder.path().join("socket")).unwrap();
        client.write_all("x\n".repeat(UNANSWERED_MAX + 3).as_bytes()).unwrap();
        let lines = rounds(&mut server);
        assert_eq!((lines.len(), lines.iter().filter(|l| l.surplus).count()), (UNANSWERED_MAX + 3, 3));
        std::thread::sleep(Duration::from_millis(60));
        rounds(&mut server);
        assert_eq!(server.clients(), 1, "it waits for answers");
        (0..lines.len()).for_each(|_| server.reply(1, "y\n"));
        server.flush();
        std::thread::sleep(Duration::from_millis(60));
        rounds(&mut server);
        assert_eq!((server.clients(), server.gone.as_slice()), (0, [(1, "it was idle")].as_slice()));
    }

    #[test]
    fn a_socket_that_another_service_has_replaced_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        let first = server(folder.path(), Duration::from_secs(60));
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        std::fs::remove_file(&path).unwrap();
        let second = server(folder.path(), Duration::from_secs(60));
        drop(first);
        assert!(path.exists());
        drop(second);
        assert!(!path.exists());
    }
}
