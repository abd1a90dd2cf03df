//! The threads that serve the sockets, one each, so that readers cannot delay commands, and nobody a stop.
//!
//! The thread of the command socket, and that of the status socket, parses the lines of its clients. On the command socket `stop`
//! goes straight to the loop from here and is answered from here, so neither the hub, nor a disk, nor another client can delay it.
//! Everything else goes to the hub, whose replies this thread writes. Every queue is bounded: the requests and replies by the number
//! of clients and their unanswered requests, the events by a capacity beyond which they are discarded.

use crate::hardware::rt::{self, RtRequest};
use crate::service::connection::Line;
use crate::service::listener;
use crate::service::protocol::{parse, reply_line};
use crate::service::rt_loop::Precondition;
use crate::service::server::Server;
use crate::service::{Failure, Listener, Request, Shared, Watched};
use serde_json::Value;
use std::io::Write;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The reply address of a request, and when it came.
#[derive(Debug, Clone)]
pub struct Caller {
    /// Number of the client.
    pub client: u64,
    /// Id for the reply.
    pub id: Value,
    /// Name of the command, for the log of the hub.
    pub command: String,
    /// When the request came to the thread that answers it: that of its socket for a stop, else the hub; and the number of stops
    /// requested when the line was received, a stop itself included.
    pub then: Precondition,
}

/// A message to the hub.
#[derive(Debug)]
pub enum FromPort {
    /// A line of a client: any request but `stop`, or why it is none.
    Incoming(Caller, Result<Request, Failure>),
    /// A client that has sent a request was disconnected, with the reason.
    Gone(u64, &'static str),
}

/// A line to a client.
type Outgoing = (u64, String);

/// Longest silence of a client of the command socket that has no subscription.
const CONTROL_IDLE_MAX: Duration = Duration::from_secs(3600);
/// The same on the status socket.
const STATUS_IDLE_MAX: Duration = Duration::from_secs(60);
/// Longest wait of a round. Input and the hub's replies end it early.
const ROUND: Duration = Duration::from_millis(50);
/// Least wait after each round, beyond the time that it took, and the longest.
const PACE: Duration = Duration::from_micros(500);
const PACE_MAX: Duration = Duration::from_millis(5);
/// Wait of a round while a stop is under way.
const STOP_ROUND: Duration = Duration::from_micros(500);
/// Period at which the thread of `stop` looks for the end of a stop, and the connections that it answers together.
const LOOK: Duration = Duration::from_micros(250);
const TOGETHER: usize = 64;
/// Events that wait for the thread; further ones are discarded.
const EVENTS_MAX: usize = 1024;

/// The hub's handle of a thread.
#[derive(Debug)]
pub struct Port {
    /// From the thread to the hub.
    pub messages: Receiver<FromPort>,
    replies: Sender<Outgoing>,
    events: SyncSender<Outgoing>,
    waker: UnixStream,
    thread: JoinHandle<()>,
}

impl Port {
    /// Starts the thread of the command socket (`Watched::Control`), whose clients have odd numbers, or of the status socket. It
    /// ends with [`Shared::quit`].
    ///
    /// # Errors
    /// The operating system's.
    pub fn start(
        socket: Listener,
        shared: Arc<Shared>,
        which: Watched,
        wish: RtRequest,
    ) -> std::io::Result<Self> {
        let (first, idle_max) = match which {
            Watched::Control => (1, CONTROL_IDLE_MAX),
            _ => (2, STATUS_IDLE_MAX),
        };
        let (server, waker) = Server::new(socket, first, idle_max)?;
        let (messages_in, messages) = channel();
        let (replies, replies_out) = channel();
        let (events, events_out) = sync_channel(EVENTS_MAX);
        let mut port = PortThread {
            server,
            shared,
            which,
            messages: messages_in,
            replies: replies_out,
            events: events_out,
            stops: Vec::new(),
        };
        let (thread, _) = rt::start(which.name(), wish, move || while port.round() {})?;
        Ok(Self {
            messages,
            replies,
            events,
            waker,
            thread,
        })
    }

    /// Sends the reply to one line.
    pub fn reply(&self, client: u64, line: String) {
        // the thread is gone only when the service ends
        let _ = self.replies.send((client, line));
        self.wake();
    }

    /// Queues an event line for the next [`Port::wake`], unless too many are waiting.
    pub fn send(&self, client: u64, line: String) {
        // a reader that is served too slowly misses events
        let _ = self.events.try_send((client, line));
    }

    /// Ends the present round of the thread.
    pub fn wake(&self) {
        // a full pipe means that it is about to wake anyway
        let _ = (&self.waker).write(&[0]);
    }

    /// Waits for the end of the thread, which [`Shared::quit`] has requested.
    pub fn join(self) {
        self.wake();
        // a thread that panicked has nothing left to do either
        let _ = self.thread.join();
    }
}

/// Starts the thread of the socket of `stop`. Whoever connects to it stops the tip, and reads the answer. It has no clients, no
/// requests and no places: a flood of connections is a flood of stops, so there is nothing that an attacker could take away. It
/// ends with [`Shared::quit`].
///
/// # Errors
/// The operating system's.
pub fn start_stop(
    socket: Listener,
    shared: Arc<Shared>,
    wish: RtRequest,
) -> std::io::Result<JoinHandle<()>> {
    let work = move || {
        while !shared.is_quitting() {
            shared.progress(Watched::Stop);
            listener::wait(&mut [socket.entry()], ROUND);
            let Some(first) = socket.accept() else {
                continue;
            };
            let mut callers = vec![first];
            callers.extend(std::iter::from_fn(|| socket.accept()).take(TOGETHER));
            let (number, since) = (shared.stop.request(), Instant::now());
            let answer = loop {
                match shared.stop.answer(number, since) {
                    Some(answer) => break reply_line(&Value::Null, &answer),
                    None => std::thread::sleep(LOOK),
                }
            };
            for mut caller in callers {
                // whoever has gone needs no answer
                let _ = caller.write(answer.as_bytes());
            }
        }
    };
    rt::start(Watched::Stop.name(), wish, work).map(|(thread, _)| thread)
}

/// What a thread owns.
struct PortThread {
    server: Server,
    shared: Arc<Shared>,
    which: Watched,
    messages: Sender<FromPort>,
    replies: Receiver<Outgoing>,
    events: Receiver<Outgoing>,
    /// Who waits for a stop that the loop has not carried out yet.
    stops: Vec<Caller>,
}

impl PortThread {
    /// One round; false when the service ends.
    fn round(&mut self) -> bool {
        self.shared.progress(self.which);
        let lines = self.server.round(if self.stops.is_empty() {
            ROUND
        } else {
            STOP_ROUND
        });
        let began = Instant::now();
        self.shared.clients[self.which as usize].store(self.server.clients.len(), Relaxed);
        for line in lines {
            self.take(line);
        }
        for (client, reason) in self.server.gone.drain(..) {
            // the hub is gone only when the service ends
            let _ = self.messages.send(FromPort::Gone(client, reason));
        }
        self.answer_stops();
        for (client, line) in self.replies.try_iter() {
            self.server.reply(client, &line);
        }
        for (client, line) in self.events.try_iter().take(EVENTS_MAX) {
            if let Some(client) = self.server.client(client) {
                client.send(&line);
            }
        }
        self.server.flush();
        // rounds that follow each other without a wait leave half of the processor to the other threads, also to the loop
        std::thread::sleep((PACE + began.elapsed()).min(PACE_MAX));
        !self.shared.is_quitting()
    }

    /// Parses one line. A stop is never refused for the number of unanswered requests.
    fn take(&mut self, line: Line) {
        let (stops, since, mode) = (self.shared.stop.requested(), Instant::now(), None);
        let client = line.client;
        let (id, request) = match line.text {
            Err(reason) => (Value::Null, Err(Failure::bad(reason))),
            Ok(text) => parse(&text),
        };
        let mut caller = Caller {
            client,
            id,
            command: String::new(),
            then: Precondition { stops, since, mode },
        };
        if self.which == Watched::Control && request == Ok(Request::Stop {}) {
            caller.then.stops = self.shared.stop.request();
            if let Some(client) = self.server.client(client) {
                client.protected = true;
            }
            self.stops.push(caller);
        } else if line.surplus {
            let refusal = Failure::refused("too many unanswered requests; wait for their answers");
            let refusal = reply_line(&caller.id, &Err(refusal));
            self.server.reply(client, &refusal);
        } else {
            // the hub is gone only when the service ends
            let _ = self.messages.send(FromPort::Incoming(caller, request));
        }
    }

    fn answer_stops(&mut self) {
        let (server, signal) = (&mut self.server, &self.shared.stop);
        self.stops.retain(|stop| {
            let answer = signal.answer(stop.then.stops, stop.then.since);
            if let Some(answer) = &answer {
                server.reply(stop.client, &reply_line(&stop.id, answer));
            }
            answer.is_none()
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Port {
        /// A port without a socket, and what the hub has sent to its clients.
        pub(in crate::service) fn detached() -> (Self, Receiver<Outgoing>) {
            let ((replies, sent), (events, _)) = (channel(), sync_channel(0));
            let (waker, _) = UnixStream::pair().unwrap();
            waker.set_nonblocking(true).unwrap();
            let port = Self {
                messages: channel().1,
                replies,
                events,
                waker,
                thread: std::thread::spawn(|| {}),
            };
            (port, sent)
        }
    }
}
