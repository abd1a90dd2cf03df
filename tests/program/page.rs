//! `retroflex page` on a service that runs in real time: what it shows, what it commands, who may enter, and attacks on its port.

use retroflex::drill::process::Daemon;
use retroflex::service::protocol::Request;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The tests run one by one, because they measure times and flood ports.
static ALONE: Mutex<()> = Mutex::new(());
/// A stop is answered within this time, s.
const STOPPED_MAX_S: f64 = 0.2;
/// The same under a flood, in which the connection of a page may be refused and made again, s.
const FLOODED_MAX_S: f64 = 3.0;
/// Braking distance of a piston that crosses its backlash with 30 mm/s and brakes with 600 mm/s², 0.75 mm, and what it travels
/// until the brake acts (`DriveLimits::react_s`, 14 ms) and the cycle of the status ends, 2 ms: 1.23 mm at 34 microsteps/mm.
const BRAKING_MICROSTEPS: i64 = 42;
/// Time after which pistons have braked, s: 0.05 s for 30 mm/s with 600 mm/s², and a status that a loaded computer delays.
const BRAKED_S: f64 = 0.4;
/// The same for the command line, whose program must start.
const LINE_MAX_S: f64 = 0.5;

fn program() -> &'static Path {
    Path::new(env!("CARGO_BIN_EXE_retroflex"))
}

/// A page that serves this service.
struct Page {
    child: Child,
    address: String,
}

impl Page {
    fn start(daemon: &Daemon, options: &[&str]) -> Self {
        let mut command = Command::new(program());
        command
            .args(["page", "--listen", "127.0.0.1:0", "--socket"])
            .arg(&daemon.sockets()[0])
            .args(options);
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap())
            .read_line(&mut line)
            .unwrap();
        let address = line
            .trim()
            .strip_prefix("http://")
            .unwrap()
            .split('/')
            .next()
            .unwrap()
            .to_owned();
        Self { child, address }
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(&self.address).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(10)))
            .unwrap();
        stream
    }

    /// Status, head and body of the answer to a request; `head` is its lines after the first.
    fn ask(&self, first: &str, head: &str, body: &str) -> (u16, String, String) {
        self.attempt(first, head, body).unwrap()
    }

    /// As `ask`; an error if the connection ends without an answer.
    fn attempt(
        &self,
        first: &str,
        head: &str,
        body: &str,
    ) -> std::io::Result<(u16, String, String)> {
        let mut stream = self.connect();
        let host = if head.contains("Host:") {
            String::new()
        } else {
            format!("Host: {}\r\n", self.address)
        };
        let length = if body.is_empty() {
            String::new()
        } else {
            format!("Content-Length: {}\r\n", body.len())
        };
        write!(stream, "{first} HTTP/1.1\r\n{host}{length}{head}\r\n{body}")?;
        let mut text = String::new();
        stream.read_to_string(&mut text)?;
        let (head, body) = text
            .split_once("\r\n\r\n")
            .ok_or(std::io::ErrorKind::UnexpectedEof)?;
        Ok((
            head.split(' ').nth(1).unwrap().parse().unwrap(),
            head.to_owned(),
            body.to_owned(),
        ))
    }

    fn get(&self, path: &str) -> (u16, String, String) {
        self.ask(&format!("GET {path}"), "", "")
    }

    /// The answer to a command of a page.
    fn command(&self, page: &str, command: &Value) -> Value {
        let (status, _, body) = self.ask(
            "POST /command",
            &format!("X-Retroflex-Page: {page}\r\n"),
            &command.to_string(),
        );
        assert_eq!(status, 200, "{command}: {body}");
        serde_json::from_str(&body).unwrap()
    }

    /// Stops the tip, with as many attempts as the page makes; returns the time that the answer took, s.
    fn stop(&self) -> f64 {
        self.stop_with("X-Retroflex-Page: 0\r\n")
    }

    fn stop_with(&self, head: &str) -> f64 {
        let since = Instant::now();
        let attempt = |_| {
            self.attempt("POST /stop", head, "")
                .map_err(|_| std::thread::sleep(Duration::from_millis(100)))
                .ok()
        };
        let (status, _, body) = (0..20).find_map(attempt).unwrap();
        assert!(
            status == 200 && body.contains("\"ok\":true"),
            "{status} {body}"
        );
        since.elapsed().as_secs_f64()
    }

    fn open(&self) -> Stream {
        let mut stream = self.connect();
        write!(
            stream,
            "GET /frames HTTP/1.1\r\nHost: {}\r\n\r\n",
            self.address
        )
        .unwrap();
        let mut stream = Stream {
            lines: BufReader::new(stream),
            page: String::new(),
        };
        stream.page = stream.next("hello").as_str().unwrap().to_owned();
        stream
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        // it may have ended already
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The events of an open page.
struct Stream {
    lines: BufReader<TcpStream>,
    page: String,
}

impl Stream {
    /// The next event of this name.
    fn next(&mut self, name: &str) -> Value {
        let mut event = false;
        loop {
            let mut line = String::new();
            assert!(
                self.lines.read_line(&mut line).unwrap() > 0,
                "the stream ended before `{name}`"
            );
            if let Some(data) = line.strip_prefix("data: ").filter(|_| event) {
                return serde_json::from_str(data).unwrap();
            }
            event = line.trim() == format!("event: {name}");
        }
    }

    /// The first frame that `holds`, within a time, s.
    fn until(&mut self, seconds: f64, what: &str, holds: impl Fn(&Value) -> bool) -> Value {
        let since = Instant::now();
        loop {
            let frame = self.next("frame");
            if holds(&frame) {
                return frame;
            }
            assert!(
                since.elapsed().as_secs_f64() < seconds,
                "{what} did not come: {frame}"
            );
        }
    }
}

fn service(folder: &Path) -> Daemon {
    let daemon = Daemon::start(program(), folder).unwrap();
    daemon
        .until(15.0, "alignment", |s| s["mode"] == "disarmed")
        .unwrap();
    daemon
}

fn ask(daemon: &Daemon, request: &Request) -> Value {
    daemon.client().unwrap().request(request).unwrap()
}

fn bend_of(value: &Value, key: &str) -> f64 {
    value[key]["bend_deg"].as_f64().unwrap_or(f64::NAN)
}

#[test]
fn the_page_needs_nothing_else_follows_a_move_and_commands_a_bend() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let daemon = service(folder.path());
    let page = Page::start(&daemon, &[]);
    for (path, media) in [
        ("/", "text/html"),
        ("/page.js", "text/javascript"),
        ("/page.css", "text/css"),
    ] {
        let (status, head, body) = page.get(path);
        assert!(
            status == 200 && head.contains(media) && head.contains("default-src 'none'"),
            "{path}: {head}"
        );
        assert!(
            body.len() > 1000 && !body.contains("http://") && !body.contains("https://"),
            "{path} refers to another place"
        );
    }
    assert_eq!(page.get("/favicon.ico").0, 404);
    let taken = Command::new(program())
        .args(["page", "--listen", &page.address, "--socket", "none"])
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&taken.stderr).into_owned();
    assert!(
        taken.status.code() == Some(2) && message.contains("address in use"),
        "{message}"
    );
    assert_eq!(page.get("/diagnosis").2, "null");

    let mut open = page.open();
    assert_eq!(open.next("status")["mode"], "disarmed");
    let reach = open.next("reach");
    let largest: Vec<f64> = reach["bend_deg"]
        .as_array()
        .unwrap()
        .iter()
        .map(|b| b.as_f64().unwrap())
        .collect();
    assert_eq!(largest.len(), 72);

    // a refusal is in the words of the service, and the edge of the region is where the service refuses
    let bend = |bend_deg: f64| json!({"cmd": "bend", "bend_deg": bend_deg, "dir_deg": 60});
    let number = open.page.clone();
    assert!(
        page.command(&number, &bend(30.0))["error"]
            .as_str()
            .unwrap()
            .contains("retroflex arm")
    );
    assert_eq!(page.command(&number, &json!({"cmd": "arm"}))["ok"], true);
    open.until(5.0, "the hold", |f| f["mode"] == "holding");
    assert_eq!(page.command(&number, &bend(largest[12] + 0.2))["code"], 2);
    assert_eq!(page.command(&number, &bend(30.0))["ok"], true);
    let passed = open.until(10.0, "half of the way", |f| bend_of(f, "estimate") > 15.0);
    assert!(
        bend_of(&passed, "estimate") < 29.0,
        "the picture jumped: {passed}"
    );
    open.until(10.0, "the bend", |f| {
        (bend_of(f, "estimate") - 30.0).abs() < 1.0
    });
    assert_eq!(page.command(&number, &bend(largest[12] - 0.2))["ok"], true);

    // what no page sends, and what no open page has sent
    for command in [
        json!({"cmd": "calibrate", "action": "full"}),
        json!({"cmd": "stream", "bend_deg": 1}),
        json!("bend"),
    ] {
        let (status, ..) = page.ask(
            "POST /command",
            &format!("X-Retroflex-Page: {number}\r\n"),
            &command.to_string(),
        );
        assert_eq!(status, 400, "{command}");
    }
    assert!(
        page.command("1", &bend(10.0))["error"]
            .as_str()
            .unwrap()
            .contains("lost")
    );
    page.stop();
    assert_eq!(
        daemon
            .until(2.0, "the stop", |s| s["stopped"] == true)
            .unwrap()["mode"],
        "holding"
    );
    assert_eq!(page.command(&number, &bend(10.0))["ok"], false);

    // a service that ends is gone, and comes back
    daemon.kill();
    // the first message tells of the connection, those after it of each attempt to make another
    assert!((0..3).any(|_| {
        open.next("gone")
            .as_str()
            .unwrap()
            .contains("retroflex run")
    }));
    let daemon = Daemon::start(program(), folder.path()).unwrap();
    open.next("frame");
    drop(daemon);
}

#[test]
fn a_motion_ends_with_the_page_that_attends_it() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let daemon = service(folder.path());
    let page = Page::start(&daemon, &[]);
    let (mut other, open) = (page.open(), page.open());
    ask(&daemon, &Request::Arm {});
    daemon
        .until(5.0, "the hold", |s| s["mode"] == "holding")
        .unwrap();
    let slow = json!({"cmd": "bend", "bend_deg": 60, "dir_deg": 0, "speed_deg_s": 10});
    assert_eq!(page.command(&open.page, &slow)["ok"], true);
    other.until(5.0, "the motion", |f| bend_of(f, "estimate") > 5.0);
    drop(open);
    let held = other.until(4.0, "the hold", |f| f["mode"] == "holding");
    assert!(
        bend_of(&held, "estimate") < 50.0,
        "the tip moved on: {held}"
    );

    // the motion of another client is none of its business
    let open = page.open();
    assert_eq!(
        page.command(&open.page, &json!({"cmd": "bend", "bend_deg": 5}))["ok"],
        true
    );
    ask(&daemon, &Request::bend(20.0, 90.0, None, None));
    drop(open);
    other.until(10.0, "the bend of another client", |f| {
        (bend_of(f, "estimate") - 20.0).abs() < 1.0
    });
}

#[test]
fn who_has_no_token_or_comes_from_elsewhere_gets_nothing() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let daemon = service(folder.path());
    let file = folder.path().join("page.token");
    let page = Page::start(&daemon, &["--token-file", file.to_str().unwrap()]);
    let token = std::fs::read_to_string(&file).unwrap().trim().to_owned();
    assert!(
        token.len() == 32
            && std::fs::metadata(&file).unwrap().permissions().mode() & 0o777 == 0o600
    );

    let wrong = token
        .replace(|c: char| c.is_ascii_digit(), "a")
        .replace('b', "c");
    for path in ["/", "/page.js", "/frames", "/diagnosis", "/none"] {
        for (query, head) in [
            (String::new(), String::new()),
            (format!("?token={wrong}"), String::new()),
            (format!("?token={}", &token[..31]), String::new()),
            ("?token=".to_owned(), String::new()),
            (String::new(), format!("Cookie: retroflex={wrong}\r\n")),
            (String::new(), format!("Authorization: Bearer {wrong}0\r\n")),
        ] {
            let (status, head, body) = page.ask(&format!("GET {path}{query}"), &head, "");
            assert!(
                status == 401 && body.is_empty() && !head.contains("set-cookie"),
                "{path}{query}: {head}"
            );
        }
    }
    let mark = "X-Retroflex-Page: 1\r\n";
    for path in ["/stop", "/command"] {
        let (status, _, body) = page.ask(&format!("POST {path}"), mark, r#"{"cmd":"arm"}"#);
        assert!(status == 401 && body.is_empty(), "{path}");
    }
    assert_eq!(
        daemon.until(2.0, "status", |_| true).unwrap()["stopped"],
        false
    );

    // the token once in the address, then the cookie
    let (status, head, _) = page.get(&format!("/?token={token}"));
    assert!(
        status == 200
            && head.contains(&format!(
                "set-cookie: retroflex={token}; HttpOnly; SameSite=Lax"
            )),
        "{head}"
    );
    let cookie = format!("Cookie: a=b; retroflex={token}\r\n");
    assert_eq!(page.ask("GET /", &cookie, "").0, 200);
    assert_eq!(
        page.ask("GET /", &format!("Authorization: Bearer {token}\r\n"), "")
            .0,
        200
    );

    // another site that the same browser shows
    assert_eq!(
        page.ask(
            "GET /frames",
            &format!("{cookie}Origin: http://elsewhere.example\r\n"),
            ""
        )
        .0,
        403
    );
    assert_eq!(
        page.ask("POST /stop", &format!("{cookie}{mark}Origin: null\r\n"), "")
            .0,
        403
    );
    assert_eq!(page.ask("POST /stop", &cookie, "").0, 403);
    assert_eq!(page.ask("OPTIONS /command", &cookie, "").0, 403);
    let own = format!("{cookie}{mark}Origin: http://{}\r\n", page.address);
    assert_eq!(page.ask("POST /stop", &own, "").0, 200);

    // without a token, a name of another site that leads to this computer
    let open = Page::start(&daemon, &[]);
    for host in [
        "elsewhere.example",
        "elsewhere.example:8088",
        "127.0.0.1.elsewhere.example",
        "localhost.example",
        "",
    ] {
        assert_eq!(
            open.ask("GET /", &format!("Host: {host}\r\n"), "").0,
            403,
            "{host}"
        );
    }
    assert_eq!(open.ask("GET /", "Host: localhost:9000\r\n", "").0, 200);
}

/// Attackers of a page, until they are dropped.
struct Attackers {
    done: Arc<AtomicBool>,
    threads: Vec<std::thread::JoinHandle<()>>,
    kept: Vec<TcpStream>,
}

impl Attackers {
    /// So many connections that send this text and never read.
    fn keep(address: &str, connections: usize, text: &str) -> Self {
        let connect = |_| {
            let mut stream = TcpStream::connect(address).ok()?;
            stream.set_nonblocking(true).ok()?;
            // a connection that was closed already attacks no more
            let _ = stream.write(text.as_bytes());
            Some(stream)
        };
        let kept = (0..connections).filter_map(connect).collect();
        Self {
            done: Arc::default(),
            threads: Vec::new(),
            kept,
        }
    }

    /// Four threads that connect as fast as they can, send this text and read nothing.
    fn flood(address: &str, text: &str) -> Self {
        let done = Arc::new(AtomicBool::new(false));
        let attack = |_| {
            let (address, text, done) = (address.to_owned(), text.to_owned(), Arc::clone(&done));
            std::thread::spawn(move || {
                while !done.load(Relaxed) {
                    if let Ok(mut stream) = TcpStream::connect(&address) {
                        let _ = stream.write(text.as_bytes());
                    }
                }
            })
        };
        let threads = (0..4).map(attack).collect();
        Self {
            done,
            threads,
            kept: Vec::new(),
        }
    }
}

impl Drop for Attackers {
    fn drop(&mut self) {
        self.done.store(true, Relaxed);
        self.kept.clear();
        self.threads
            .drain(..)
            .for_each(|thread| drop(thread.join()));
    }
}

#[test]
fn a_stop_is_answered_under_every_attack_on_the_port_of_the_page() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let daemon = service(folder.path());
    let file = folder.path().join("page.token");
    std::fs::write(&file, "anattackerdoesnotknowthis\n").unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).unwrap();
    let (guarded, page) = (
        Page::start(&daemon, &["--token-file", file.to_str().unwrap()]),
        Page::start(&daemon, &[]),
    );
    let head = |first: &str, rest: &str| {
        format!("{first} HTTP/1.1\r\nHost: localhost\r\nX-Retroflex-Page: 1\r\n{rest}")
    };
    let half_body = head("POST /command", "Content-Length: 100\r\n\r\n{\"cmd\"");
    let frames = head("GET /frames", "\r\n");
    let large = head(
        "POST /command",
        &format!("Content-Length: 10000000\r\n\r\n{}", "x".repeat(100_000)),
    );
    let long_head = head("GET /", &"X-A: b\r\n".repeat(10_000));
    let script = head("GET /page.js", "\r\n");
    type Attack<'a> = &'a dyn Fn(&str) -> Attackers;
    let attacks: [(&str, Attack<'_>); 9] = [
        ("silent connections", &|to| Attackers::keep(to, 400, "")),
        ("half of a head", &|to| {
            Attackers::keep(to, 400, "GET / HTTP/1.1\r\nHost: loc")
        }),
        ("half of a body", &|to| Attackers::keep(to, 400, &half_body)),
        ("garbage", &|to| {
            Attackers::keep(to, 400, "\0\x01\u{7f} garbage\r\n\r\n\r\n")
        }),
        ("pages that are not read", &|to| {
            Attackers::keep(to, 400, &frames)
        }),
        ("scripts that are not read", &|to| {
            Attackers::keep(to, 400, &script)
        }),
        ("a flood of connections", &|to| Attackers::flood(to, "")),
        ("a flood of large bodies", &|to| {
            Attackers::flood(to, &large)
        }),
        ("a flood of long heads", &|to| {
            Attackers::flood(to, &long_head)
        }),
    ];
    let cookie = "Cookie: retroflex=anattackerdoesnotknowthis\r\nX-Retroflex-Page: 0\r\n";
    for (name, attack) in attacks {
        ask(&daemon, &Request::Arm {});
        daemon
            .until(5.0, "the hold", |s| {
                s["mode"] == "holding" && s["stopped"] == false
            })
            .unwrap();
        ask(&daemon, &Request::bend(60.0, 30.0, None, Some(10.0)));
        let attackers = [attack(&page.address), attack(&guarded.address)];
        std::thread::sleep(Duration::from_millis(300));
        let of_page_s = (0..5).map(|_| page.stop()).fold(0.0, f64::max);
        let of_guarded_s = guarded.stop_with(cookie);
        let since = Instant::now();
        daemon.command("stop").unwrap();
        let of_line_s = since.elapsed().as_secs_f64();
        eprintln!(
            "{name}: page {of_page_s:.3} s, with token {of_guarded_s:.3} s, command line {of_line_s:.3} s"
        );
        let most_s = if name.contains("flood") {
            FLOODED_MAX_S
        } else {
            STOPPED_MAX_S
        };
        assert!(
            of_page_s.max(of_guarded_s) < most_s,
            "{name}: {of_page_s} s, {of_guarded_s} s"
        );
        assert!(of_line_s < LINE_MAX_S, "{name}: {of_line_s} s");
        let counted = |s: &Value| [0, 1, 2].map(|i| s["counted"][i].as_i64().unwrap());
        let stopped = counted(
            &daemon
                .until(2.0, "the stop", |s| {
                    s["stopped"] == true && s["mode"] == "holding"
                })
                .unwrap(),
        );
        std::thread::sleep(Duration::from_secs_f64(BRAKED_S));
        let braked = counted(&daemon.until(2.0, "status", |_| true).unwrap());
        let braking = stopped
            .iter()
            .zip(braked)
            .map(|(a, b)| (a - b).abs())
            .max()
            .unwrap();
        assert!(
            braking <= BRAKING_MICROSTEPS,
            "{name}: {braking} microsteps to brake"
        );
        std::thread::sleep(Duration::from_millis(1000));
        let later = daemon.until(2.0, "status", |_| true).unwrap();
        assert!(
            later["stopped"] == true && counted(&later) == braked,
            "{name}: moves after the stop from {braked:?}: {later}"
        );
        drop(attackers);
        // whoever comes after the attack is served
        assert_eq!(page.get("/").0, 200);
    }
    // places are returned: the port serves a page again
    std::thread::sleep(Duration::from_millis(1500));
    page.open().next("frame");
}

/// A file that is no diagnosis is refused at the start and not shown later; one that is written later is shown.
#[test]
fn only_a_diagnosis_is_shown_as_one() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let daemon = service(folder.path());
    let file = folder.path().join("found.json");
    let others = [
        "time_s,piston1_mm\n0,0\n",
        "[]\n",
        "{\"verdict\": \"none\", \"gap\": {}}\n",
        "{\"verdict\": {\"names\": []}}\n",
        "<!DOCTYPE html>\n",
    ];
    for other in others {
        std::fs::write(&file, other).unwrap();
        let refused = Command::new(program())
            .args(["page", "--listen", "127.0.0.1:0", "--socket", "none"])
            .arg("--diagnosis")
            .arg(&file)
            .output()
            .unwrap();
        let message = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(
            refused.status.code() == Some(2) && message.contains("no diagnosis"),
            "{other}: {message}"
        );
    }
    std::fs::remove_file(&file).unwrap();
    let page = Page::start(&daemon, &["--diagnosis", file.to_str().unwrap()]);
    assert_eq!(page.get("/diagnosis").2, "null");
    let found = json!({"verdict": {"kind": "none", "names": []}, "gap": {"recalibrated_deg": 0.1}});
    for text in [found.to_string(), others[0].to_owned()] {
        std::fs::write(&file, &text).unwrap();
        let shown = if text == others[0] { "null" } else { &text };
        let since = Instant::now();
        while page.get("/diagnosis").2 != shown {
            assert!(since.elapsed() < Duration::from_secs(10), "{text}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

/// Files that never answer: a pipe without a writer, and one whose writer writes nothing.
#[test]
fn a_diagnosis_that_does_not_answer_keeps_nobody_waiting() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let daemon = service(folder.path());
    let pipe = folder.path().join("pipe");
    assert!(
        Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap()
            .success()
    );
    for written in [false, true] {
        // opened for both, so that it has a writer
        let both = || {
            std::fs::File::options()
                .read(true)
                .write(true)
                .open(&pipe)
                .unwrap()
        };
        let _writer = written.then(both);
        let page = Page::start(&daemon, &["--diagnosis", pipe.to_str().unwrap()]);
        std::thread::scope(|scope| {
            for _ in 0..20 {
                scope.spawn(|| assert_eq!(page.get("/diagnosis").2, "null"));
            }
            for path in ["/", "/page.js", "/diagnosis"] {
                let since = Instant::now();
                assert_eq!(page.get(path).0, 200);
                assert!(
                    since.elapsed() < Duration::from_secs(1),
                    "{path}: {:?}",
                    since.elapsed()
                );
            }
            let since = Instant::now();
            let (code, _, body) = page.ask("POST /stop", "x-retroflex-page: 0\r\n", "");
            let took_s = since.elapsed().as_secs_f64();
            assert!(code == 200 && body.contains("true"), "{code} {body}");
            assert!(took_s < STOPPED_MAX_S, "stopped after {took_s:.2} s");
        });
    }
}

/// Chromium, if there is one.
fn chromium() -> Option<PathBuf> {
    let named = std::env::var_os("RETROFLEX_CHROMIUM").map(PathBuf::from);
    let folders = std::env::var_os("PATH").unwrap_or_default();
    named.or_else(|| {
        std::env::split_paths(&folders)
            .map(|folder| folder.join("chromium"))
            .find(|file| file.exists())
    })
}

#[test]
fn a_browser_shows_the_move_bends_stops_and_notices_a_lost_connection() {
    let Some(chromium) = chromium() else {
        eprintln!("skipped: no Chromium; install it, or name it in RETROFLEX_CHROMIUM");
        return;
    };
    if Command::new("python3")
        .arg("--version")
        .stdout(Stdio::null())
        .status()
        .is_err()
    {
        eprintln!("skipped: no python3");
        return;
    }
    let shots = Path::new(env!("CARGO_TARGET_TMPDIR")).with_file_name("page");
    std::fs::create_dir_all(&shots).unwrap();
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let passes = (0..2).any(|attempt| {
        if attempt > 0 {
            eprintln!("once more with another service: a browser on a computer that stalls notices a loss too late");
        }
        browse(&chromium, &shots)
    });
    assert!(
        passes,
        "see the messages above, and the pictures in {}",
        shots.display()
    );
}

/// Runs the script of the browser on a service of its own.
fn browse(chromium: &Path, shots: &Path) -> bool {
    let folder = tempfile::tempdir().unwrap();
    let daemon = service(folder.path());
    let file = folder.path().join("page.token");
    let diagnosis = folder.path().join("diagnosis.json");
    let found = json!({"verdict": {"kind": "effects", "names": ["leak"]}, "gap": {"recalibrated_deg": 3.1, "explained_deg": 0.4},
        "effects": [{"name": "leak", "probability": 0.97, "params": [{"name": "rate", "channel": 2}]}]});
    std::fs::write(&diagnosis, found.to_string()).unwrap();
    let page = Page::start(&daemon, &["--diagnosis", diagnosis.to_str().unwrap()]);
    let guarded = Page::start(&daemon, &["--token-file", file.to_str().unwrap()]);
    let token = std::fs::read_to_string(&file).unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    Command::new("python3")
        .arg(root.join("tests/page/browser.py"))
        .args([chromium, &daemon.sockets()[0], shots])
        .args([
            &page.address,
            &page.child.id().to_string(),
            &guarded.address,
            token.trim(),
        ])
        .status()
        .unwrap()
        .success()
}
