//! One listening socket and its clients.
//!
//! Every operation is non-blocking and every resource is bounded: the connections accepted per round, the number of
//! clients, the length of a line, the lines of one client per round, its unanswered requests and the bytes queued for it.
//! A new connection always finds a place: when all are taken, the process with the most connections, of the user with the
//! most, loses the one that has been silent for longest. A client that does not read, does not end its line or is idle for
//! too long is disconnected.

use crate::service::Listener;
use crate::service::connection::{Client, Line};
use crate::service::listener;
use nix::poll::{PollFd, PollFlags};
use nix::sys::socket::{getsockopt, sockopt::PeerCredentials};
use std::cmp::Reverse;
use std::io::Read;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::time::Duration;

/// Clients at a time on one socket.
pub const CLIENTS_MAX: usize = 32;
/// Lines accepted per round, shared by the clients that send; each of them is granted the smaller number.
const LINES_PER_ROUND: usize = 64;
const LINES_MIN: usize = 2;
/// Connections accepted per round, so that a flood of them does not keep clients from being read.
const ACCEPTED_PER_ROUND: usize = CLIENTS_MAX;

/// A listening socket and its clients.
#[derive(Debug)]
pub struct Server {
    listener: Listener,
    wake: UnixStream,
    pub(super) clients: Vec<Client>,
    next: u64,
    /// Longest silence of a client without an open request or subscription.
    idle_max: Duration,
    /// Clients disconnected since this list was last taken, with the reason, unless they never sent a line.
    pub gone: Vec<(u64, &'static str)>,
}

impl Server {
    /// A server of this socket, and the pipe whose bytes end the wait of a [`Server::round`] from another thread. Clients are
    /// numbered `first`, `first` + 2, …, so that two servers never share a number.
    ///
    /// # Errors
    /// The operating system's.
    pub fn new(
        listener: Listener,
        first: u64,
        idle_max: Duration,
    ) -> std::io::Result<(Self, UnixStream)> {
        let (wake, waker) = UnixStream::pair()?;
        wake.set_nonblocking(true)?;
        waker.set_nonblocking(true)?;
        let server = Self {
            listener,
            wake,
            clients: Vec::new(),
            next: first,
            idle_max,
            gone: Vec::new(),
        };
        Ok((server, waker))
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
        for client in &mut self.clients {
            client.take_lines(&mut lines, share);
        }
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

    /// Writes what is queued, as far as the clients read it.
    pub fn flush(&mut self) {
        self.clients.iter_mut().for_each(Client::write);
    }

    /// The client of this number, if it is still connected.
    pub(super) fn client(&mut self, number: u64) -> Option<&mut Client> {
        self.clients.iter_mut().find(|c| c.number == number)
    }

    fn poll(&mut self, wait: Duration) {
        let wake = PollFd::new(self.wake.as_fd(), PollFlags::POLLIN);
        let mut set = vec![self.listener.entry(), wake];
        for c in &self.clients {
            let mut events = PollFlags::empty();
            events.set(PollFlags::POLLIN, c.wants_input());
            events.set(PollFlags::POLLOUT, !c.output.is_empty());
            set.push(PollFd::new(c.stream.as_fd(), events));
        }
        listener::wait(&mut set, wait);
        while self.wake.read(&mut [0; 64]).is_ok_and(|n| n > 0) {}
    }

    /// Accepts connections and reads their first lines at once: what a new client has sent is not lost with its place.
    fn accept(&mut self, lines: &mut Vec<Line>) {
        for _ in 0..ACCEPTED_PER_ROUND {
            let Some(stream) = self.listener.accept() else {
                return;
            };
            let Ok(peer) = getsockopt(&stream, PeerCredentials) else {
                continue;
            };
            if self.clients.len() >= CLIENTS_MAX && !self.make_room() {
                continue;
            }
            let mut client = Client::new(self.next, peer, stream);
            client.read();
            client.take_lines(lines, 1);
            self.clients.push(client);
            self.next += 2;
        }
    }

    /// Disconnects the client whose last line is oldest, of the process with the most clients, of the user with the most. Clients
    /// that wait for an answer go last, and protected ones stay. False if nobody could be disconnected.
    fn make_room(&mut self) -> bool {
        let peers = || self.clients.iter().map(|c| c.peer);
        let key = |c: &Client| {
            let of_user = peers().filter(|p| p.uid() == c.peer.uid()).count();
            let of_process = peers().filter(|p| *p == c.peer).count();
            let shares = Reverse((of_user, of_process));
            (shares, c.unanswered > 0, c.last_line)
        };
        let all = self.clients.iter().enumerate();
        let candidates = all.filter(|(_, c)| !c.protected);
        let Some((n, _)) = candidates.min_by_key(|(_, c)| key(c)) else {
            return false;
        };
        let client = self.clients.remove(n);
        if client.spoke {
            self.gone.push((client.number, "its place was needed"));
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::connection::UNANSWERED_MAX;
    use std::io::Write;
    use std::path::Path;

    fn server(folder: &Path, idle_max: Duration) -> Server {
        Server::new(
            Listener::bind(&folder.join("socket"), 0o600).unwrap(),
            1,
            idle_max,
        )
        .unwrap()
        .0
    }

    /// Rounds until nothing is left to accept or to read.
    fn rounds(server: &mut Server) -> Vec<Line> {
        (0..8)
            .flat_map(|_| server.round(Duration::from_millis(5)))
            .collect()
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
        assert_eq!(server.clients.len(), CLIENTS_MAX);
        let mut late = connect();
        late.write_all(b"stop\n").unwrap();
        let lines = rounds(&mut server);
        assert_eq!(
            lines
                .iter()
                .filter_map(|l| l.text.as_deref().ok())
                .collect::<Vec<_>>(),
            ["stop"]
        );
        // the speaker waits for its answer, so the silent ones went first
        assert!(server.gone.is_empty(), "{:?}", server.gone);
        drop(silent);
    }

    #[test]
    fn a_client_whose_line_is_not_text_goes_with_its_replies() {
        let folder = tempfile::tempdir().unwrap();
        let mut server = server(folder.path(), Duration::from_secs(60));
        let mut client = UnixStream::connect(folder.path().join("socket")).unwrap();
        client.write_all(b"one\n\xff\xfe\ntwo\nthree").unwrap();
        let lines = rounds(&mut server);
        let texts: Vec<_> = lines.iter().map(|l| l.text.as_deref()).collect();
        let refused = Err(&"a line must be UTF-8 text");
        assert_eq!(texts, [Ok("one"), refused, Ok("two")]);
        (0..2).for_each(|_| server.reply(1, "y\n"));
        rounds(&mut server);
        assert_eq!(server.clients.len(), 1, "it waits for an answer");
        server.reply(1, "y\n");
        server.flush();
        rounds(&mut server);
        assert_eq!(server.gone, [(1, "disconnected")]);
    }

    #[test]
    fn a_line_that_is_no_text_may_say_stop() {
        let folder = tempfile::tempdir().unwrap();
        let mut server = server(folder.path(), Duration::from_secs(60));
        let mut client = UnixStream::connect(folder.path().join("socket")).unwrap();
        for line in [
            &b"{\"cmd\" : \"stop\",\"x\":\"\xff\"}\n"[..],
            b"\xe9{\"cmd\":\"stop\"\n",
        ] {
            client.write_all(line).unwrap();
            let lines = rounds(&mut server);
            let text = lines[0].text.as_deref().unwrap();
            let stop = Ok(crate::service::Request::Stop {});
            assert_eq!(crate::service::protocol::parse(text).1, stop);
        }
    }

    #[test]
    fn lines_beyond_the_unanswered_ones_are_marked_and_idle_clients_go() {
        let folder = tempfile::tempdir().unwrap();
        let mut server = server(folder.path(), Duration::from_millis(50));
        let mut client = UnixStream::connect(folder.path().join("socket")).unwrap();
        client
            .write_all("x\n".repeat(UNANSWERED_MAX + 3).as_bytes())
            .unwrap();
        let lines = rounds(&mut server);
        assert_eq!(
            (lines.len(), lines.iter().filter(|l| l.surplus).count()),
            (UNANSWERED_MAX + 3, 3)
        );
        std::thread::sleep(Duration::from_millis(60));
        rounds(&mut server);
        assert_eq!(server.clients.len(), 1, "it waits for answers");
        (0..lines.len()).for_each(|_| server.reply(1, "y\n"));
        server.flush();
        std::thread::sleep(Duration::from_millis(60));
        rounds(&mut server);
        assert_eq!(
            (server.clients.len(), server.gone.as_slice()),
            (0, [(1, "it was idle")].as_slice())
        );
    }
}
