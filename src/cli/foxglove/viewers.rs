//! Those who watch: the Foxglove WebSocket protocol, version 1 (github.com/foxglove/ws-protocol), for reading.
//!
//! Each viewer has a thread and a bounded queue. One that does not keep up misses messages and delays nobody.

use crate::service::flight::file::TOPICS as EXACT;
use crate::service::flight::schema::{self, ENCODING};
use data_encoding::BASE64;
use mcap::Message as Logged;
use serde::Deserialize;
use serde_json::json;
use std::collections::HashMap;
use std::io::{self, ErrorKind};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;
use tungstenite::handshake::server::{ErrorResponse, Request, Response};
use tungstenite::http::{HeaderValue, StatusCode, header::SEC_WEBSOCKET_PROTOCOL};
use tungstenite::protocol::WebSocketConfig;
use tungstenite::{Error, Message, WebSocket, accept_hdr_with_config};

/// Names of the protocol, today's and that of older viewers.
const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// Most viewers at a time.
const VIEWERS_MAX: usize = 16;
/// Messages that wait for a viewer: some seconds of all topics.
const QUEUE: usize = 2048;
/// Longest request of a viewer, bytes.
const REQUEST_MAX: usize = 64 * 1024;
/// A viewer that takes nothing, or does not introduce itself, for this long is gone.
const GONE: Duration = Duration::from_secs(2);
/// Time for which a request is waited for before the queue is looked at again.
const TURN: Duration = Duration::from_millis(10);

/// A message: number of its topic, time, ns since 1970, and content.
type Shown = Arc<(usize, u64, Vec<u8>)>;

/// The queues of the viewers, and what each topic has shown last.
#[derive(Default)]
struct Shared {
    /// The queue of each viewer, which its thread keeps for as long as it attends it.
    queues: Vec<Weak<SyncSender<Shown>>>,
    last: HashMap<usize, Shown>,
}

fn lock(shared: &Mutex<Shared>) -> MutexGuard<'_, Shared> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// All viewers.
pub struct Viewers(Arc<Mutex<Shared>>);

impl Viewers {
    /// Waits for viewers in a thread of its own.
    ///
    /// # Errors
    /// The operating system's, if there is no thread.
    pub fn start(listener: TcpListener) -> io::Result<Self> {
        let shared = Arc::new(Mutex::new(Shared::default()));
        let own = Arc::clone(&shared);
        std::thread::Builder::new().spawn(move || {
            for stream in listener.incoming().flatten() {
                let mut all = lock(&own);
                all.queues.retain(|queue| queue.strong_count() > 0);
                if all.queues.len() < VIEWERS_MAX {
                    let (sender, queue) = sync_channel(QUEUE);
                    let (sender, shared) = (Arc::new(sender), Arc::clone(&own));
                    all.queues.push(Arc::downgrade(&sender));
                    // without a thread there is no viewer
                    let _ = std::thread::Builder::new().spawn(move || {
                        attend(stream, &queue, &shared);
                        drop(sender);
                    });
                }
            }
        })?;
        Ok(Self(shared))
    }

    /// Keeps a message for those who come later, and shows it if it is `live`. Only a replay reads the exact cycles.
    pub fn show(&self, message: &Logged<'_>, live: bool) {
        let topic = message.channel.topic.as_str();
        let Some(number) = schema::TOPICS.iter().position(|(name, _)| *name == topic) else {
            return;
        };
        // an older program wrote other messages
        if topic == EXACT[0] || *message.channel.message_encoding != *ENCODING {
            return;
        }
        let shown = Arc::new((number, message.log_time, message.data.to_vec()));
        let mut all = lock(&self.0);
        for queue in all.queues.iter().filter_map(Weak::upgrade).filter(|_| live) {
            // one that does not keep up misses it
            let _ = queue.try_send(Arc::clone(&shown));
        }
        all.last.insert(number, shown);
    }
}

/// Agrees on the protocol.
#[allow(clippy::result_large_err, reason = "`tungstenite` defines the type")]
fn agree(request: &Request, mut response: Response) -> Result<Response, ErrorResponse> {
    let offers = request.headers().get_all(SEC_WEBSOCKET_PROTOCOL).iter();
    let offered: Vec<&str> = offers
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(',').map(str::trim))
        .collect();
    let Some(protocol) = PROTOCOLS.into_iter().find(|name| offered.contains(name)) else {
        let why = format!("offer the protocol {}\n", PROTOCOLS[0]);
        let mut refusal = ErrorResponse::new(Some(why));
        *refusal.status_mut() = StatusCode::BAD_REQUEST;
        return Err(refusal);
    };
    let headers = response.headers_mut();
    headers.insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(protocol));
    Ok(response)
}

/// What a viewer asks for. What is not for reading is left out.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
enum Asked {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: usize,
}

/// Serves one viewer until it leaves. Its end is nobody's business.
fn attend(stream: TcpStream, queue: &Receiver<Shown>, shared: &Mutex<Shared>) {
    let _ = stream.set_nodelay(true);
    let bounded = stream
        .set_read_timeout(Some(GONE))
        .and_then(|()| stream.set_write_timeout(Some(GONE)));
    let limits = WebSocketConfig::default()
        .max_message_size(Some(REQUEST_MAX))
        .max_frame_size(Some(REQUEST_MAX));
    if bounded.is_ok()
        && let Ok(socket) = accept_hdr_with_config(stream, agree, Some(limits))
    {
        let _ = converse(socket, queue, shared);
    }
}

fn converse(
    mut socket: WebSocket<TcpStream>,
    queue: &Receiver<Shown>,
    shared: &Mutex<Shared>,
) -> Result<(), Error> {
    socket.get_ref().set_read_timeout(Some(TURN))?;
    let info = json!({"op": "serverInfo", "name": "retroflex", "capabilities": [], "supportedEncodings": [ENCODING]});
    socket.send(Message::text(info.to_string()))?;
    socket.send(Message::text(channels()?))?;
    let mut subscribed: HashMap<u32, usize> = HashMap::new();
    loop {
        let request = match socket.read() {
            Ok(Message::Text(text)) => serde_json::from_str(&text).unwrap_or(Asked::Other),
            Ok(_) => Asked::Other,
            Err(Error::Io(e))
                if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) =>
            {
                Asked::Other
            }
            Err(e) => return Err(e),
        };
        match request {
            Asked::Subscribe { subscriptions } => {
                for Subscription { id, channel_id } in subscriptions {
                    subscribed.retain(|_, channel| *channel != channel_id);
                    subscribed.insert(id, channel_id);
                    let last = lock(shared).last.get(&channel_id).cloned();
                    if let Some(shown) = last {
                        socket.send(data(id, &shown))?;
                    }
                }
                // nobody needs more subscriptions than there are topics
                if subscribed.len() > schema::TOPICS.len() {
                    return Ok(());
                }
            }
            Asked::Unsubscribe { subscription_ids } => {
                subscribed.retain(|id, _| !subscription_ids.contains(id));
            }
            Asked::Other => {}
        }
        for shown in queue.try_iter() {
            let is_of = |(_, channel): &(&u32, &usize)| **channel == shown.0;
            for (id, _) in subscribed.iter().filter(is_of) {
                socket.write(data(*id, &shown))?;
            }
        }
        socket.flush()?;
    }
}

/// The channels, whose numbers are those of their topics.
fn channels() -> io::Result<String> {
    let mut all = Vec::new();
    for (id, (topic, name)) in schema::TOPICS.iter().enumerate() {
        if *topic != EXACT[0] {
            let description = BASE64.encode(&schema::description(topic)?);
            all.push(json!({"id": id, "topic": topic, "encoding": ENCODING, "schemaName": name, "schemaEncoding": ENCODING, "schema": description}));
        }
    }
    Ok(json!({"op": "advertise", "channels": all}).to_string())
}

/// A message for a subscription.
fn data(subscription: u32, shown: &Shown) -> Message {
    let mut bytes = vec![1];
    bytes.extend(subscription.to_le_bytes());
    bytes.extend(shown.1.to_le_bytes());
    bytes.extend(&shown.2);
    Message::binary(bytes)
}
