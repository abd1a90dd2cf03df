//! The port of the page: bounded connections of one request each.
//!
//! A new connection always finds a place. When all are taken, the oldest one that has not yet shown that it may enter is closed; so
//! neither silent connections nor half-sent or oversized requests keep a `stop` out.

use super::answer::answer;
use super::site::Site;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use socket2::SockRef;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::AbortHandle;

/// Connections at a time.
const CONNECTIONS_MAX: usize = 256;
/// Connections that wait to be accepted. One beyond them would try again after a second only.
const BACKLOG: i32 = 4096;
/// Time for the head of a request.
const HEAD_MAX: Duration = Duration::from_secs(2);
/// Longest head of a request, bytes.
const BUFFER_MAX: usize = 16 * 1024;
/// Bytes that the kernel keeps for a slow browser: about half a second of frames.
const SEND_BUFFER: usize = 16 * 1024;
/// A browser that does not acknowledge what was sent for this long is gone.
const GONE: Duration = Duration::from_secs(1);

/// Serves pages for ever.
///
/// # Errors
/// The operating system's, at the start.
pub fn run(listener: std::net::TcpListener, site: Site) -> std::io::Result<()> {
    SockRef::from(&listener).listen(BACKLOG)?;
    listener.set_nonblocking(true)?;
    let site = Arc::new(site);
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?
        .block_on(async {
            let listener = TcpListener::from_std(listener)?;
            let mut places: Vec<(AbortHandle, Arc<AtomicBool>)> = Vec::new();
            loop {
                let Ok((stream, _)) = listener.accept().await else {
                    // out of descriptors or memory: those in use are returned soon
                    tokio::time::sleep(Duration::from_millis(5)).await;
                    continue;
                };
                places.retain(|(task, _)| !task.is_finished());
                if places.len() >= CONNECTIONS_MAX {
                    let outside = places
                        .iter()
                        .position(|(_, entered)| !entered.load(Relaxed));
                    places.remove(outside.unwrap_or(0)).0.abort();
                }
                let entered = Arc::new(AtomicBool::new(false));
                let task = tokio::spawn(serve(stream, Arc::clone(&site), Arc::clone(&entered)));
                places.push((task.abort_handle(), entered));
                // a request that has come with its connection is answered before a flood of others can take its place
                tokio::task::yield_now().await;
            }
        })
}

async fn serve(stream: TcpStream, site: Arc<Site>, entered: Arc<AtomicBool>) {
    let socket = SockRef::from(&stream);
    // without these options the connection works, and ends later if its other end is gone
    let _ = socket.set_tcp_user_timeout(Some(GONE));
    let _ = socket.set_send_buffer_size(SEND_BUFFER);
    let _ = socket.set_tcp_nodelay(true);
    let service =
        service_fn(move |request| answer(Arc::clone(&site), Arc::clone(&entered), request));
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new())
        .header_read_timeout(HEAD_MAX)
        .max_buf_size(BUFFER_MAX)
        .keep_alive(false);
    // a connection that fails concerns nobody else
    let _ = http.serve_connection(TokioIo::new(stream), service).await;
}
