//! The port of the page: bounded connections of one request each, who may enter, and what is answered.
//!
//! A new connection always finds a place. When all are taken, the oldest one that has not yet shown that it may enter is closed; so
//! neither silent connections nor half-sent or oversized requests keep a `stop` out.

use super::site::{Site, event};
use crate::service::protocol::{Request as Command, reply_line};
use http_body_util::channel::{Channel, Sender};
use http_body_util::{BodyExt, Either, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{self, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use serde_json::Value;
use socket2::SockRef;
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
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

/// Longest body of a command, bytes.
const BODY_MAX: usize = 4096;
/// Header that every command carries, the number of its page. Another site cannot send it.
const PAGE: &str = "x-retroflex-page";
/// The cookie that keeps the token, so that it leaves the address.
const COOKIE: &str = "retroflex=";
/// Nothing is loaded from elsewhere, and no other page shows this one in a frame.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";

/// Serves pages for ever.
///
/// # Errors
/// The operating system's, at the start.
pub fn run(listener: std::net::TcpListener, site: Site) -> std::io::Result<()> {
    SockRef::from(&listener).listen(BACKLOG)?;
    listener.set_nonblocking(true)?;
    let site = Arc::new(site);
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    runtime.enable_all().build()?.block_on(async {
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
                let mut all = places.iter();
                let outside = all.position(|(_, entered)| !entered.load(Relaxed));
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
    let answer = move |request| answer(Arc::clone(&site), Arc::clone(&entered), request);
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new())
        .header_read_timeout(HEAD_MAX)
        .max_buf_size(BUFFER_MAX)
        .keep_alive(false);
    // a connection that fails concerns nobody else
    let _ = http
        .serve_connection(TokioIo::new(stream), service_fn(answer))
        .await;
}

type Body = Either<Full<Bytes>, Channel<Bytes>>;

/// Answers a request. `entered` becomes true once the request is complete and may be answered.
async fn answer(
    site: Arc<Site>,
    entered: Arc<AtomicBool>,
    request: Request<Incoming>,
) -> Result<Response<Body>, Infallible> {
    if let Some(status) = refusal(&site, &request) {
        return Ok(plain(status, ""));
    }
    Ok(match (request.method().as_str(), request.uri().path()) {
        ("GET", "/") => {
            let mut response = text("text/html; charset=utf-8", include_str!("page.html"));
            let cookie = |token| format!("{COOKIE}{token}; HttpOnly; SameSite=Lax; Path=/");
            if let Some(Ok(cookie)) = site.token.as_ref().map(|token| cookie(token).parse()) {
                response.headers_mut().insert(header::SET_COOKIE, cookie);
            }
            response
        }
        ("GET", "/page.js") => text("text/javascript; charset=utf-8", include_str!("page.js")),
        ("GET", "/page.css") => text("text/css; charset=utf-8", include_str!("page.css")),
        ("GET", "/diagnosis") => text("application/json", site.diagnosis.borrow().clone()),
        ("GET", "/frames") => {
            let Some(page) = site.open().await else {
                return Ok(plain(503, ""));
            };
            entered.store(true, Relaxed);
            let (sender, body) = Channel::new(1);
            tokio::spawn(async move {
                send_events(site.latest.clone(), page, sender).await;
                site.close(page).await;
            });
            with_type("text/event-stream", Either::Right(body))
        }
        ("POST", "/stop") => forward(site, &entered, 0, Command::Stop {}).await,
        ("POST", "/command") => match read_command(request).await {
            Some((page, command)) => forward(site, &entered, page, command).await,
            None => plain(400, ""),
        },
        _ => plain(404, ""),
    })
}

fn field<'a>(request: &'a Request<Incoming>, name: &str) -> Option<&'a str> {
    request.headers().get(name)?.to_str().ok()
}

/// Refuses who does not know the token, what another site sends, and without a token every foreign name of this address.
fn refusal(site: &Site, request: &Request<Incoming>) -> Option<u16> {
    let [host, origin, cookies, bearer] =
        ["host", "origin", "cookie", "authorization"].map(|name| field(request, name));
    if let Some(token) = &site.token {
        let query = request.uri().query();
        let in_address = query.and_then(|query| query.strip_prefix("token="));
        let mut cookies = cookies.into_iter().flat_map(|all| all.split("; "));
        let in_cookie = cookies.find_map(|text| text.strip_prefix(COOKIE));
        let in_header = bearer.and_then(|text| text.strip_prefix("Bearer "));
        let mut shown = [in_address, in_cookie, in_header].into_iter().flatten();
        if !shown.any(|one| is_same(one, token)) {
            return Some(401);
        }
    }
    let host = host.unwrap_or_default();
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
    let foreign_host = site.token.is_none() && !["localhost", "127.0.0.1", "[::1]"].contains(&name);
    let foreign = origin.is_some_and(|origin| !origin.ends_with(&format!("//{host}")));
    let unmarked = request.method() != "GET" && field(request, PAGE).is_none();
    (foreign_host || foreign || unmarked).then_some(403)
}

/// Compares in a time that does not depend on where the two differ.
fn is_same(shown: &str, token: &str) -> bool {
    let differ = std::iter::zip(shown.bytes(), token.bytes()).fold(0, |all, (a, b)| all | (a ^ b));
    shown.len() == token.len() && differ == 0
}

/// Sends a command in a thread of its own, so that none waits for another.
async fn forward(
    site: Arc<Site>,
    entered: &AtomicBool,
    page: u64,
    command: Command,
) -> Response<Body> {
    entered.store(true, Relaxed);
    match tokio::task::spawn_blocking(move || site.send(page, &command)).await {
        Ok(result) => text("application/json", reply_line(&Value::Null, &result)),
        Err(e) => plain(500, e.to_string()),
    }
}

/// The number of a page, and its command; `None` for what no page sends.
async fn read_command(request: Request<Incoming>) -> Option<(u64, Command)> {
    let page = field(&request, PAGE)?.parse().ok()?;
    let body = Limited::new(request.into_body(), BODY_MAX).collect().await;
    let command: Command = serde_json::from_slice(&body.ok()?.to_bytes()).ok()?;
    let allowed = ["bend", "hold", "arm", "disarm", "relax", "reset-fault"];
    let is_allowed = allowed.contains(&command.name().as_str());
    is_allowed.then_some((page, command))
}

/// Sends the number of the page, then what the service sends. A slow browser misses frames, and receives no old ones.
async fn send_events(mut latest: watch::Receiver<Bytes>, page: u64, mut sender: Sender<Bytes>) {
    let mut text = event("hello", &page.to_string().into()).into();
    while sender.send_data(text).await.is_ok() && latest.changed().await.is_ok() {
        text = latest.borrow_and_update().clone();
    }
}

fn plain(status: u16, words: impl Into<Bytes>) -> Response<Body> {
    let mut response = text("text/plain", words);
    *response.status_mut() = StatusCode::from_u16(status).unwrap_or_default();
    response
}

fn text(media: &'static str, text: impl Into<Bytes>) -> Response<Body> {
    with_type(media, Either::Left(Full::new(text.into())))
}

fn with_type(media: &'static str, body: Body) -> Response<Body> {
    let mut response = Response::new(body);
    for (name, value) in [
        (header::CONTENT_TYPE, media),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::CACHE_CONTROL, "no-store"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ] {
        let value = HeaderValue::from_static(value);
        response.headers_mut().insert(name, value);
    }
    response
}
