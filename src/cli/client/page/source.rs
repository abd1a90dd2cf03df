//! The one subscription that all pages share.

use crate::service::client::Client;
use crate::service::paths;
use crate::service::protocol::{Failure, Request};
use hyper::body::Bytes;
use serde_json::{Value, json};
use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::sync::watch;

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

/// Reads a file of JSON now and then in a thread of its own, so that nobody waits for a file that does not answer.
pub fn read_again(file: Option<PathBuf>) -> watch::Receiver<Bytes> {
    let (sender, latest) = watch::channel(Bytes::from_static(b"null"));
    if let Some(file) = file {
        std::thread::spawn(move || {
            while !sender.is_closed() {
                let text = crate::log::table::text(&file);
                sender.send_replace(text.map_or(Bytes::from_static(b"null"), Bytes::from));
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
