//! The threads that serve the sockets, one each, so that readers cannot delay commands.
//!
//! A thread parses the lines of its clients. On the command socket `stop` goes straight to the loop from here and is
//! answered from here, so neither the hub, nor a disk, nor another client can delay it. Everything else goes to the hub,
//! whose replies this thread writes. Every queue is bounded: the requests and replies by the number of clients and their
//! unanswered requests, the events by a capacity beyond which they are discarded.

use crate::hardware::rt::{self, RtRequest};
use crate::service::connection::Line;
use crate::service::listener::Listener;
use crate::service::protocol::{Failure, Request, parse, reply_line};
use crate::service::server::{Server, Waker};
use crate::service::shared::{Shared, Watched};
use serde_json::Value;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A parsed line.
#[derive(Debug)]
pub struct Incoming {
    /// Number of the client.
    pub client: u64,
    /// Id for the reply.
    pub id: Value,
    /// The request, or why there is none.
    pub request: Result<Request, Failure>,
    /// The connection must be closed after the reply.
    pub close: bool,
    /// Number of stops requested when the line was received.
    pub stops: u64,
}

/// A message to the hub.
#[derive(Debug)]
pub enum FromPort {
    /// A line of a client, any request but `stop`.
    Incoming(Incoming),
    /// A client that has sent a request was disconnected, with the reason.
    Gone(u64, &'static str),
}

/// Something to write to a client.
#[derive(Debug)]
enum Outgoing {
    Reply(u64, String),
    Event(u64, String),
    Close(u64),
}

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
/// Events that wait for the thread; further ones are discarded.
const EVENTS_MAX: usize = 1024;

/// The hub's handle of a thread.
#[derive(Debug)]
pub struct Port {
    /// From the thread to the hub.
    pub messages: Receiver<FromPort>,
    replies: Sender<Outgoing>,
    events: SyncSender<Outgoing>,
    waker: Waker,
    clients: Arc<AtomicUsize>,
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
        let (first, idle_max) = if which == Watched::Control {
            (1, CONTROL_IDLE_MAX)
        } else {
            (2, STATUS_IDLE_MAX)
        };
        let (server, waker) = Server::new(socket, first, idle_max)?;
        let (messages_in, messages) = channel();
        let (replies, replies_out) = channel();
        let (events, events_out) = sync_channel(EVENTS_MAX);
        let clients = Arc::new(AtomicUsize::new(0));
        let mut port = PortThread {
            server,
            shared,
            which,
            messages: messages_in,
            replies: replies_out,
            events: events_out,
            clients: Arc::clone(&clients),
            stops: Vec::new(),
        };
        let thread = std::thread::Builder::new()
            .name(which.name().into())
            .spawn(move || {
                let (_, _guard) = rt::enter(&wish);
                while port.round() {}
            })?;
        Ok(Self {
            messages,
            replies,
            events,
            waker,
            clients,
            thread,
        })
    }

    /// Number of connected clients.
    pub fn clients(&self) -> usize {
        self.clients.load(Relaxed)
    }

    /// Sends the reply to one line.
    pub fn reply(&self, client: u64, line: String) {
        self.put(Outgoing::Reply(client, line));
    }

    /// Queues an event line for the next [`Port::wake`], unless too many are waiting.
    pub fn send(&self, client: u64, line: String) {
        // a reader that is served too slowly misses events
        let _ = self.events.try_send(Outgoing::Event(client, line));
    }

    /// Ends the present round of the thread.
    pub fn wake(&self) {
        self.waker.wake();
    }

    /// Disconnects a client once it has read its replies.
    pub fn close(&self, client: u64) {
        self.put(Outgoing::Close(client));
    }

    fn put(&self, outgoing: Outgoing) {
        // the thread is gone only when the service ends
        let _ = self.replies.send(outgoing);
        self.waker.wake();
    }

    /// Waits for the end of the thread, which [`Shared::quit`] has requested.
    pub fn join(self) {
        self.waker.wake();
        // a thread that panicked has nothing left to do either
        let _ = self.thread.join();
    }
}

#[cfg(test)]
impl Port {
    /// A port without a socket, and what the hub has sent to its clients.
    pub(super) fn detached() -> (Self, impl Fn() -> Option<(u64, String)>) {
        let ((replies, out), (events, _)) = (channel(), sync_channel(0));
        let (waker, _) = std::os::unix::net::UnixStream::pair().unwrap();
        waker.set_nonblocking(true).unwrap();
        let port = Self {
            messages: channel().1,
            replies,
            events,
            waker: Waker::of(waker),
            clients: Arc::default(),
            thread: std::thread::spawn(|| {}),
        };
        let sent = move || loop {
            if let Outgoing::Reply(client, line) = out.try_recv().ok()? {
                return Some((client, line));
            }
        };
        (port, sent)
    }
}

/// A stop that the loop has not carried out yet.
struct PendingStop {
    client: u64,
    id: Value,
    number: u64,
    since: Instant,
}

/// What a thread owns.
struct PortThread {
    server: Server,
    shared: Arc<Shared>,
    which: Watched,
    messages: Sender<FromPort>,
    replies: Receiver<Outgoing>,
    events: Receiver<Outgoing>,
    clients: Arc<AtomicUsize>,
    stops: Vec<PendingStop>,
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
        self.clients.store(self.server.clients(), Relaxed);
        for line in lines {
            self.take(line);
        }
        for (client, reason) in self.server.gone.drain(..) {
            // the hub is gone only when the service ends
            let _ = self.messages.send(FromPort::Gone(client, reason));
        }
        self.answer_stops();
        for outgoing in self
            .replies
            .try_iter()
            .chain(self.events.try_iter().take(EVENTS_MAX))
        {
            match outgoing {
                Outgoing::Reply(client, line) => self.server.reply(client, &line),
                Outgoing::Event(client, line) => self.server.send(client, &line),
                Outgoing::Close(client) => self.server.close(client),
            }
        }
        self.server.flush();
        // rounds that follow each other without a wait leave half of the processor to the other threads, also to the loop
        std::thread::sleep((PACE + began.elapsed()).min(PACE_MAX));
        !self.shared.is_quitting()
    }

    /// Parses one line. A stop is never refused for the number of unanswered requests.
    fn take(&mut self, line: Line) {
        let (client, stops) = (line.client, self.shared.stop.requested());
        let (id, request, close) = match line.text {
            Err(reason) => (Value::Null, Err(Failure::bad(reason)), true),
            Ok(text) => {
                let (id, request) = parse(&text);
                (id, request, false)
            }
        };
        if self.which == Watched::Control && request == Ok(Request::Stop {}) {
            let number = self.shared.stop.request();
            self.server.protect(client);
            self.stops.push(PendingStop {
                client,
                id,
                number,
                since: Instant::now(),
            });
        } else if line.surplus {
            let refusal = Failure::refused("too many unanswered requests; wait for their answers");
            self.server.reply(client, &reply_line(&id, &Err(refusal)));
        } else {
            // the hub is gone only when the service ends
            let _ = self.messages.send(FromPort::Incoming(Incoming {
                client,
                id,
                request,
                close,
                stops,
            }));
        }
    }

    fn answer_stops(&mut self) {
        let (server, signal) = (&mut self.server, &self.shared.stop);
        self.stops
            .retain(|stop| match signal.answer(stop.number, stop.since) {
                Some(answer) => {
                    server.reply(stop.client, &reply_line(&stop.id, &answer));
                    false
                }
                None => true,
            });
    }
}
