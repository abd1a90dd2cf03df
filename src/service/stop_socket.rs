//! The socket of `stop`. Whoever connects to it stops the tip, and reads the answer. It has no clients, no requests and no
//! places: a flood of connections is a flood of stops, so there is nothing that an attacker could take away.

use crate::hardware::rt::{self, RtRequest};
use crate::service::listener::{self, Listener};
use crate::service::protocol::reply_line;
use crate::service::shared::{Shared, Watched};
use serde_json::Value;
use std::io::Write;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest wait of a round.
const ROUND: Duration = Duration::from_millis(50);
/// Period at which the end of a stop is looked for.
const LOOK: Duration = Duration::from_micros(250);
/// Connections answered together.
const TOGETHER: usize = 64;

/// Starts the thread. It ends with [`Shared::quit`].
///
/// # Errors
/// The operating system's.
pub fn start(
    socket: Listener,
    shared: Arc<Shared>,
    wish: RtRequest,
) -> std::io::Result<JoinHandle<()>> {
    std::thread::Builder::new()
        .name(Watched::Stop.name().into())
        .spawn(move || {
            let (_, _guard) = rt::enter(&wish);
            while !shared.is_quitting() {
                shared.progress(Watched::Stop);
                listener::wait(&mut [socket.entry()], ROUND);
                let Some(first) = socket.accept() else {
                    continue;
                };
                let callers: Vec<_> = std::iter::once(first)
                    .chain(std::iter::from_fn(|| socket.accept()).take(TOGETHER))
                    .collect();
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
        })
}
