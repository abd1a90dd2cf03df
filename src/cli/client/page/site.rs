//! What all connections of the page share: the token, what the service sends to its one subscription, and the pages that are open.
//!
//! A page that bends the tip attends the motion: its last bend keeps a connection to the service, which holds the tip when that
//! closes. It closes with the page's stream of frames, or with this process.

use crate::primitives::file::text;
use crate::service::client::Client;
use crate::service::{Failure, Request, paths};
use hyper::body::Bytes;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::sync::{Mutex, watch};

/// Open pages at a time.
const PAGES_MAX: usize = 16;
/// Longest wait for the service.
const ANSWER_MAX: Duration = Duration::from_secs(3);
/// Age of a bend before its connection may close, so that the service regards it as attended (`service.attended_s`).
const ATTENDED: Duration = Duration::from_millis(500);

/// Frames per second.
const RATE_HZ: f64 = 20.0;
/// Frames between two readings of status and reach.
const STATUS_EVERY: u32 = 10;
/// A service that sends nothing for this long counts as gone.
const SILENCE_MAX: Duration = Duration::from_secs(1);
/// Time until a file is read again.
const READ_AGAIN: Duration = Duration::from_secs(2);
/// Time until the next attempt to reach a service that is gone.
const RETRY: Duration = Duration::from_millis(500);

/// What all connections share.
pub struct Site {
    /// The command socket.
    pub socket: PathBuf,
    /// What a browser must show, if anything.
    pub token: Option<String>,
    /// The last diagnosis as it was last read, or `null`.
    pub diagnosis: watch::Receiver<Bytes>,
    /// What the service has sent last.
    pub latest: watch::Receiver<Bytes>,
    /// The open pages by their number, with the connection of the last bend of each.
    pub pages: Mutex<HashMap<u64, Option<Client>>>,
}

impl Site {
    /// Registers a page under a number that nobody has had or can guess. `None`: too many are open.
    pub async fn open(&self) -> Option<u64> {
        let (number, mut pages) = (rand::random(), self.pages.lock().await);
        (pages.len() < PAGES_MAX && pages.insert(number, None).is_none()).then_some(number)
    }

    /// Stops the tip, or sends a command of a page, unless that was closed or lost before the command came.
    pub fn send(&self, page: u64, request: &Request) -> Result<Value, Failure> {
        if *request == (Request::Stop {}) {
            return Client::stop(&self.socket);
        }
        let mut client = Client::connect_for(&self.socket, ANSWER_MAX)?;
        if !self.pages.blocking_lock().contains_key(&page) {
            let why = "the connection of this page was lost in the meantime; nothing was sent";
            return Err(Failure::refused(why));
        }
        let result = client.request(request)?;
        if matches!(request, Request::Bend { .. }) {
            match self.pages.blocking_lock().get_mut(&page) {
                Some(attending) => *attending = Some(client),
                // lost while the service answered
                None => return client.request(&Request::Hold {}),
            }
        }
        Ok(result)
    }

    /// Forgets a page that was closed or lost. A motion that it attends ends.
    pub async fn close(&self, page: u64) {
        let attending = self.pages.lock().await.remove(&page);
        tokio::time::sleep(ATTENDED).await;
        drop(attending);
    }
}

/// Follows the service with this command socket for ever. What it sends becomes server-sent events: `frame`, `status`, `reach`, and
/// `gone` with the reason as long as there is no service.
pub fn follow(control: &Path, latest: &watch::Sender<Bytes>) {
    loop {
        let Err(failure) = follow_once(control, latest);
        latest.send_replace(event("gone", &json!(failure.message)).into());
        std::thread::sleep(RETRY);
    }
}

fn follow_once(control: &Path, latest: &watch::Sender<Bytes>) -> Result<Infallible, Failure> {
    // a reader takes no place from those who command, unless the board names another status socket
    let status_socket = Client::connect_for(&paths::status_socket(control), SILENCE_MAX);
    let mut client = status_socket.or_else(|_| Client::connect_for(control, SILENCE_MAX))?;
    client.request(&Request::Subscribe { rate_hz: RATE_HZ })?;
    loop {
        let mut text = event("status", &client.request(&Request::Status {})?);
        text += &event("reach", &client.request(&Request::Reach {})?);
        for _ in 0..STATUS_EVERY {
            text += &event("frame", &client.read()?);
            latest.send_replace(std::mem::take(&mut text).into());
        }
    }
}

/// Whether a text is what `gap diagnose --json` writes: a verdict with its names, and a gap.
pub fn is_diagnosis(text: &str) -> bool {
    let found: Option<Value> = serde_json::from_str(text).ok();
    found.is_some_and(|found| found["verdict"]["names"].is_array() && found["gap"].is_object())
}

/// Reads a diagnosis now and then in a thread of its own, so that nobody waits for a file that does not answer. Anything else is nothing.
pub fn read_again(file: Option<PathBuf>) -> watch::Receiver<Bytes> {
    const NOTHING: Bytes = Bytes::from_static(b"null");
    let (sender, latest) = watch::channel(NOTHING);
    if let Some(file) = file {
        std::thread::spawn(move || {
            while !sender.is_closed() {
                let found = text(&file).ok().filter(|text| is_diagnosis(text));
                sender.send_replace(found.map_or(NOTHING, Bytes::from));
                std::thread::sleep(READ_AGAIN);
            }
        });
    }
    latest
}

/// A server-sent event.
pub fn event(name: &str, data: &Value) -> String {
    format!("event: {name}\ndata: {data}\n\n")
}
