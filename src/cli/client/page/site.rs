//! What all connections of the page share: the token, what the service sends, and the pages that are open.
//!
//! A page that bends the tip attends the motion: its last bend keeps a connection to the service, which holds the tip when that
//! closes. It closes with the page's stream of frames, or with this process.

use crate::service::client::Client;
use crate::service::protocol::{Failure, Request};
use hyper::body::Bytes;
use serde_json::Value;
use std::collections::HashMap;
use std::path::PathBuf;
use std::time::Duration;
use tokio::sync::{Mutex, watch};

/// Open pages at a time.
const PAGES_MAX: usize = 16;
/// Longest wait for the service.
const ANSWER_MAX: Duration = Duration::from_secs(3);
/// Age of a bend before its connection may close, so that the service regards it as attended (`service.attended_s`).
const ATTENDED: Duration = Duration::from_millis(500);

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
            return Err(Failure::refused(
                "the connection of this page was lost in the meantime; nothing was sent",
            ));
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
