//! `foxglove`: what a viewer sees of a running service is what its flight log holds.

use data_encoding::BASE64;
use retroflex::drill::process::daemon::Daemon;
use retroflex::service::flight::schema;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest;
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

const PROGRAM: &str = env!("CARGO_BIN_EXE_retroflex");

/// A server of the topics in this folder.
struct Server(Child, String);

impl Server {
    fn start(flights: &Path) -> Self {
        let mut command = Command::new(PROGRAM);
        command
            .args(["foxglove", "--listen", "127.0.0.1:0", "--flights"])
            .arg(flights);
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        let out = child.stdout.take().unwrap();
        BufReader::new(out).read_line(&mut line).unwrap();
        Self(child, line.trim().to_owned())
    }

    fn address(&self) -> &str {
        self.1.strip_prefix("ws://").unwrap()
    }

    fn join(&self, protocol: &str) -> Viewer {
        let mut request = self.1.as_str().into_client_request().unwrap();
        let name = "Sec-WebSocket-Protocol";
        request
            .headers_mut()
            .insert(name, protocol.parse().unwrap());
        let (socket, response) = tungstenite::connect(request).unwrap();
        assert_eq!(response.headers()[name], protocol);
        let MaybeTlsStream::Plain(stream) = socket.get_ref() else {
            unreachable!("the address is ws://");
        };
        stream
            .set_read_timeout(Some(Duration::from_secs(10)))
            .unwrap();
        let mut viewer = Viewer {
            socket,
            topics: BTreeMap::new(),
        };
        assert_eq!(viewer.said()["op"], "serverInfo");
        let advertised = viewer.said();
        for channel in advertised["channels"].as_array().unwrap() {
            let text = |key: &str| channel[key].as_str().unwrap().to_owned();
            let topic = text("topic");
            let description = BASE64.decode(text("schema").as_bytes()).unwrap();
            assert_eq!(description, schema::description(&topic).unwrap());
            assert_eq!(
                (text("encoding"), text("schemaEncoding")),
                ("protobuf".into(), "protobuf".into())
            );
            viewer
                .topics
                .insert(channel["id"].as_u64().unwrap() as u32, topic);
        }
        viewer
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

struct Viewer {
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    /// Topics by the number of their channel.
    topics: BTreeMap<u32, String>,
}

impl Viewer {
    fn said(&mut self) -> Value {
        match self.socket.read().unwrap() {
            Message::Text(text) => serde_json::from_str(&text).unwrap(),
            other => panic!("{other:?}"),
        }
    }

    fn ask(&mut self, request: &Value) {
        self.socket
            .send(Message::text(request.to_string()))
            .unwrap();
    }

    /// Subscribes to all topics; a subscription has the number of its channel and 100.
    fn subscribe(&mut self) {
        let ids = self.topics.keys();
        let all: Vec<Value> = ids
            .map(|id| json!({"id": id + 100, "channelId": id}))
            .collect();
        self.ask(&json!({"op": "subscribe", "subscriptions": all}));
    }

    /// Topic, time in s, and fields of the next message.
    fn next(&mut self) -> (String, f64, Value) {
        let Message::Binary(bytes) = self.socket.read().unwrap() else {
            panic!("no message of a topic");
        };
        assert_eq!(bytes[0], 1);
        let id = u32::from_le_bytes(bytes[1..5].try_into().unwrap()) - 100;
        let time_ns = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
        let topic = self.topics[&id].clone();
        let fields = schema::decode(&topic, &bytes[13..]).unwrap();
        (topic, time_ns as f64 * 1e-9, fields)
    }

    /// The messages of each topic until one of them is as wanted.
    fn until(
        &mut self,
        is_wanted: impl Fn(&str, &Value) -> bool,
    ) -> BTreeMap<String, Vec<(f64, Value)>> {
        let (mut all, began) = (BTreeMap::<String, Vec<_>>::new(), Instant::now());
        loop {
            assert!(
                began.elapsed() < Duration::from_secs(20),
                "{:?}",
                all.keys()
            );
            let (topic, time_s, fields) = self.next();
            let wanted = is_wanted(&topic, &fields);
            all.entry(topic).or_default().push((time_s, fields));
            if wanted {
                return all;
            }
        }
    }
}

#[test]
fn a_viewer_sees_what_the_flight_log_holds() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(Path::new(PROGRAM), folder.path()).unwrap();
    daemon.take_off().unwrap();
    let flights = folder.path().join("state/flights");
    let server = Server::start(&flights);
    let mut viewer = server.join("foxglove.sdk.v1");
    let topics: BTreeSet<&str> = viewer.topics.values().map(String::as_str).collect();
    let declared = schema::TOPICS.iter().map(|(topic, _)| *topic);
    assert_eq!(
        topics,
        declared.filter(|topic| *topic != "/cycles").collect()
    );

    // who comes late is shown the last of what seldom changes
    std::thread::sleep(Duration::from_millis(1500));
    viewer.subscribe();
    let all = viewer.until(|topic, _| topic == "/scene");
    for topic in ["/mode", "/gains", "/tf"] {
        assert!(
            all.contains_key(topic),
            "{topic} is not among {:?}",
            all.keys()
        );
    }
    // a motion is followed, in its own time
    let bent = Command::new(PROGRAM)
        .args(["bend", "20", "--toward", "180", "--socket"])
        .arg(&daemon.sockets()[0])
        .status();
    assert!(bent.unwrap().success());
    let reached = |topic: &str, fields: &Value| {
        let dir_deg = fields["estimate"]["dir_deg"].as_f64();
        topic == "/angles" && dir_deg.is_some_and(|deg| deg.abs() > 170.0)
    };
    let all = viewer.until(reached);
    let counts: BTreeMap<&str, usize> = all.iter().map(|(t, m)| (t.as_str(), m.len())).collect();
    assert!(counts["/imu"] > 20 && counts["/tf"] > 10, "{counts:?}");
    for (topic, messages) in &all {
        let times = messages.windows(2).all(|pair| pair[1].0 >= pair[0].0);
        assert!(times, "{topic} is not in the order of time");
    }

    // hostile and clumsy viewers disturb nobody
    let mut silent = TcpStream::connect(server.address()).unwrap();
    silent.write_all(b"GET / HTTP/1.1\r\n").unwrap();
    let mut deaf = server.join("foxglove.websocket.v1");
    deaf.subscribe();
    let mut clumsy = server.join("foxglove.websocket.v1");
    for text in [
        "{",
        "[]",
        "{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":-1}]}",
        "{\"op\":\"advertise\"}",
    ] {
        clumsy.socket.send(Message::text(text)).unwrap();
    }
    clumsy.ask(&json!({"op": "subscribe", "subscriptions": [{"id": 100, "channelId": 4_000_000}]}));
    clumsy.subscribe();
    let ids: Vec<u32> = clumsy.topics.keys().map(|id| id + 100).collect();
    clumsy.until(|topic, _| topic == "/tf");
    clumsy.ask(&json!({"op": "unsubscribe", "subscriptionIds": ids}));
    let _ = clumsy.socket.send(Message::binary(vec![0; 1 << 20]));
    drop(clumsy);
    viewer.until(|topic, _| topic == "/tf");
    assert!(
        tungstenite::connect(server.1.as_str()).is_err(),
        "another protocol is refused"
    );
    let mut late = server.join("foxglove.sdk.v1");
    late.subscribe();
    late.until(|topic, _| topic == "/tf");

    // the next run of the service is followed too
    daemon.kill();
    let daemon = Daemon::start(Path::new(PROGRAM), folder.path()).unwrap();
    let fresh = |topic: &str, fields: &Value| topic == "/mode" && fields["mode"] == "aligning";
    viewer.until(fresh);
    daemon.end().unwrap();
}
