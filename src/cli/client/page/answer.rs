//! Who may enter, and what is answered.

use super::site::Site;
use super::source::event;
use crate::service::protocol::{Request as Command, reply_line};
use http_body_util::channel::{Channel, Sender};
use http_body_util::{BodyExt, Either, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{self, HeaderValue};
use hyper::{Request, Response, StatusCode};
use serde_json::Value;
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use tokio::sync::watch;

/// Longest body of a command, bytes.
const BODY_MAX: usize = 4096;
/// Header that every command carries, the number of its page. Another site cannot send it.
const PAGE: &str = "x-retroflex-page";
/// The cookie that keeps the token, so that it leaves the address.
const COOKIE: &str = "retroflex=";
/// Nothing is loaded from elsewhere, and no other page shows this one in a frame.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";
const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";
const JSON: &str = "application/json";
const EVENTS: &str = "text/event-stream";

type Body = Either<Full<Bytes>, Channel<Bytes>>;

/// Answers a request. `entered` becomes true once the request is complete and may be answered.
pub async fn answer(
    site: Arc<Site>,
    entered: Arc<AtomicBool>,
    request: Request<Incoming>,
) -> Result<Response<Body>, Infallible> {
    Ok(match refusal(&site, &request) {
        Some(status) => plain(status, ""),
        None => route(site, &entered, request).await,
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
        let in_address = request
            .uri()
            .query()
            .and_then(|query| query.strip_prefix("token="));
        let in_cookie =
            cookies.and_then(|all| all.split("; ").find_map(|text| text.strip_prefix(COOKIE)));
        let shown = [
            in_address,
            in_cookie,
            bearer.and_then(|text| text.strip_prefix("Bearer ")),
        ];
        if !shown.into_iter().flatten().any(|one| is_same(one, token)) {
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

async fn route(
    site: Arc<Site>,
    entered: &AtomicBool,
    request: Request<Incoming>,
) -> Response<Body> {
    match (request.method().as_str(), request.uri().path()) {
        ("GET", "/") => {
            let mut response = text(HTML, include_str!("page.html"));
            let cookie = site
                .token
                .as_ref()
                .map(|token| format!("{COOKIE}{token}; HttpOnly; SameSite=Lax; Path=/"));
            let cookie = cookie.and_then(|cookie| cookie.parse().ok());
            response
                .headers_mut()
                .extend(cookie.map(|cookie| (header::SET_COOKIE, cookie)));
            response
        }
        ("GET", "/page.js") => text(SCRIPT, include_str!("page.js")),
        ("GET", "/page.css") => text(STYLE, include_str!("page.css")),
        ("GET", "/diagnosis") => {
            let found = site.diagnosis.borrow().clone();
            text(JSON, found)
        }
        ("GET", "/frames") => {
            let Some(page) = site.open().await else {
                return plain(503, "");
            };
            entered.store(true, Relaxed);
            let (sender, body) = Channel::new(1);
            tokio::spawn(async move {
                send_events(site.latest.clone(), page, sender).await;
                site.close(page).await;
            });
            with_type(EVENTS, Either::Right(body))
        }
        ("POST", "/stop") => forward(site, entered, 0, Command::Stop {}).await,
        ("POST", "/command") => match read_command(request).await {
            Some((page, command)) => forward(site, entered, page, command).await,
            None => plain(400, ""),
        },
        _ => plain(404, ""),
    }
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
        Ok(result) => text(JSON, reply_line(&Value::Null, &result)),
        Err(e) => plain(500, e.to_string()),
    }
}

/// The number of a page, and its command; `None` for what no page sends.
async fn read_command(request: Request<Incoming>) -> Option<(u64, Command)> {
    let page = field(&request, PAGE)?.parse().ok()?;
    let body = Limited::new(request.into_body(), BODY_MAX)
        .collect()
        .await
        .ok()?;
    let command: Command = serde_json::from_slice(&body.to_bytes()).ok()?;
    ["bend", "hold", "arm", "disarm", "relax", "reset-fault"]
        .contains(&command.name().as_str())
        .then_some((page, command))
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
        response
            .headers_mut()
            .insert(name, HeaderValue::from_static(value));
    }
    response
}
