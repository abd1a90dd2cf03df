//! The thread that serves the command socket.
//!
//! It parses the lines of all clients. `stop` goes straight to the loop from here and is answered from here, so neither
//! the hub, nor a disk, nor another client can delay it. Everything else goes to the hub, whose replies this thread
//! writes.

use crate::service::protocol::{Failure, Request, parse, reply_line};
use crate::service::rt_loop::Shared;
use crate::service::server::{Line, Server, Waker};
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, Sender, channel};
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

impl Incoming {
    /// Parses a line of a client.
    #[must_use]
    pub fn new(line: Line, stops: u64) -> Self {
        let client = line.client;
        match line.text {
            Err(reason) => Self { client, id: Value::Null, request: Err(Failure::bad(reason)), close: true, stops },
            Ok(text) => {
                let (id, request) = parse(&text);
                Self { client, id, request, close: false, stops }
            }
        }
    }
}

/// Something to write to a client of the command socket.
#[derive(Debug)]
enum Outgoing {
    Reply(u64, String),
    Event(u64, String),
    Close(u64),
}

/// Longest wait of a round. Input and the hub's replies end it early.
const ROUND: Duration = Duration::from_millis(50);
/// Wait of a round while a stop is under way.
const STOP_ROUND: Duration = Duration::from_millis(1);
/// The loop must carry out a stop within this time.
const STOP_MAX: Duration = Duration::from_millis(150);

/// The hub's handle of the thread.
#[derive(Debug)]
pub struct ControlPort {
    /// Parsed lines, all but `stop`. Bounded by the unanswered requests per client.
    pub incoming: Receiver<Incoming>,
    /// Clients that were disconnected, with the reason.
    pub dropped: Receiver<(u64, &'static str)>,
    outgoing: Sender<Outgoing>,
    waker: Waker,
    clients: Arc<AtomicUsize>,
}

impl ControlPort {
    /// Starts the thread. It ends with [`Shared::quit`]. `hub` wakes the hub.
    ///
    /// # Errors
    /// The operating system's.
    pub fn start(server: Server, waker: Waker, hub: Waker, shared: Arc<Shared>) -> std::io::Result<Self> {
        let (incoming_in, incoming) = channel();
        let (dropped_in, dropped) = channel();
        let (outgoing, outgoing_out) = channel();
        let clients = Arc::new(AtomicUsize::new(0));
        let mut port = Port {
            server,
            shared,
            hub,
            incoming: incoming_in,
            dropped: dropped_in,
            outgoing: outgoing_out,
            clients: Arc::clone(&clients),
            stops: Vec::new(),
        };
        std::thread::Builder::new().name("control".into()).spawn(move || while port.round() {})?;
        Ok(Self { incoming, dropped, outgoing, waker, clients })
    }

    /// Number of connected clients.
    #[must_use]
    pub fn clients(&self) -> usize {
        self.clients.load(Relaxed)
    }

    /// Sends the reply to one line.
    pub fn reply(&self, client: u64, line: String) {
        self.put(Outgoing::Reply(client, line));
    }

    /// Sends an event line.
    pub fn send(&self, client: u64, line: String) {
        self.put(Outgoing::Event(client, line));
    }

    /// Disconnects a client once it has read its replies.
    pub fn close(&self, client: u64) {
        self.put(Outgoing::Close(client));
    }

    fn put(&self, outgoing: Outgoing) {
        // the thread is gone only when the service ends
        let _ = self.outgoing.send(outgoing);
        self.waker.wake();
    }
}

/// A stop that the loop has not carried out yet.
struct PendingStop {
    client: u64,
    id: Value,
    number: u64,
    since: Instant,
}

/// What the thread owns.
struct Port {
    server: Server,
    shared: Arc<Shared>,
    hub: Waker,
    incoming: Sender<Incoming>,
    dropped: Sender<(u64, &'static str)>,
    outgoing: Receiver<Outgoing>,
    clients: Arc<AtomicUsize>,
    stops: Vec<PendingStop>,
}

impl Port {
    /// One round; false when the service ends.
    fn round(&mut self) -> bool {
        let lines = self.server.round(if self.stops.is_empty() { ROUND } else { STOP_ROUND });
        self.clients.store(self.server.clients(), Relaxed);
        let mut wake = !lines.is_empty() || !self.server.dropped.is_empty();
        for line in lines {
            let incoming = Incoming::new(line, self.shared.stop.requested());
            if incoming.request == Ok(Request::Stop {}) {
                let number = self.shared.stop.request();
                self.stops.push(PendingStop { client: incoming.client, id: incoming.id, number, since: Instant::now() });
            } else {
                wake &= self.incoming.send(incoming).is_ok();
            }
        }
        for dropped in self.server.dropped.drain(..) {
            wake &= self.dropped.send(dropped).is_ok();
        }
        if wake {
            self.hub.wake();
        }
        self.answer_stops();
        for outgoing in self.outgoing.try_iter() {
            match outgoing {
                Outgoing::Reply(client, line) => self.server.reply(client, &line),
                Outgoing::Event(client, line) => self.server.send(client, &line),
                Outgoing::Close(client) => self.server.close(client),
            }
        }
        !self.shared.is_quitting()
    }

    fn answer_stops(&mut self) {
        let completed = self.shared.stop.completed();
        let server = &mut self.server;
        self.stops.retain(|stop| {
            let reply = if stop.number <= completed {
                Ok(json!({}))
            } else if stop.since.elapsed() > STOP_MAX {
                Err(Failure { code: 3, message: "the loop does not respond".to_owned() })
            } else {
                return true;
            };
            server.reply(stop.client, &reply_line(&stop.id, &reply));
            false
        });
    }
}
