//! Line protocol of the sockets: one JSON object per line, with a version number in both directions.
//!
//! ```text
//! → {"v":1,"id":7,"cmd":"bend","bend_deg":40,"dir_deg":30}
//! ← {"v":1,"id":7,"ok":true,"result":{}}
//! ← {"v":1,"id":7,"ok":false,"code":1,"error":"not while disarmed: `retroflex arm` first"}
//! ← {"v":1,"event":"frame", …}                     after `subscribe`
//! ```
//!
//! `code` is the exit code for the command line: 1 refused, 2 not understood, 3 not reachable.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::ops::RangeInclusive;

/// Version of the protocol.
pub const VERSION: u64 = 1;
/// Longest accepted line, bytes.
pub const LINE_MAX: usize = 16 * 1024;

/// A request of a client. Angles are in degrees, lengths in mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "cmd", rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// Energise the drivers and hold the present pose.
    Arm {},
    /// Accept no more motion.
    Disarm {},
    /// Move to a pose.
    Bend {
        /// Bend angle β, degrees.
        bend_deg: f64,
        /// Bend direction δ, degrees.
        #[serde(default)]
        dir_deg: f64,
        /// Length of the centre line, mm; defaults to the rest length.
        length_mm: Option<f64>,
        /// Speed of the set-point, °/s; defaults to that of the gains file.
        speed_deg_s: Option<f64>,
        /// Frame in which the tip keeps the orientation.
        #[serde(default)]
        frame: Frame,
    },
    /// One set-point of a stream. The tip stops when the stream pauses for longer than `service.dead_man_s`.
    Stream {
        /// Bend angle β, degrees.
        bend_deg: f64,
        /// Bend direction δ, degrees.
        #[serde(default)]
        dir_deg: f64,
        /// Length of the centre line, mm; defaults to the rest length.
        length_mm: Option<f64>,
        /// Time of the set-point on the clock of the stream, s. The tip follows a smooth curve through set-points with times. The
        /// first one is for now, and each may come up to 1 s ahead of its time.
        t_s: Option<f64>,
    },
    /// Follow a path from its first row. A path that is faster than `pace.bend_speed_deg_s`, or too fast for the pistons, is slowed
    /// down.
    Path {
        /// Rows, at most [`PATH_ROWS`] in all.
        rows: Vec<PathRow>,
        /// Further rows will come in the next request.
        #[serde(default)]
        more: bool,
    },
    /// Decelerate smoothly and hold.
    Hold {},
    /// Brake at once and hold. Latched until `arm`.
    Stop {},
    /// Return the pistons to zero slowly, then de-energise.
    Relax {},
    /// Define the present pose as zero bend.
    Zero {
        /// The operator states that the tip is straight. Without it, the remembered attitude must confirm it.
        #[serde(default)]
        straight: bool,
    },
    /// Report the state of the service.
    Status {},
    /// Clear a latched fault whose cause has been removed.
    ResetFault {},
    /// Read the gains file again and apply it.
    Reload {},
    /// Start or stop a recording.
    Record {
        /// Start or stop.
        action: RecordAction,
        /// Name of the recording without folder and extension; defaults to the time in seconds since 1970.
        name: Option<String>,
        /// The recording ends when the connection closes.
        #[serde(default)]
        owned: bool,
    },
    /// Identify, accept or discard transmission gains.
    Calibrate {
        /// What to do.
        action: CalibrateAction,
        /// Poses of a short one, 6 to 24.
        #[serde(default = "short_poses")]
        poses: usize,
    },
    /// Report the largest bend in each direction at the rest length, and the dimensions of the bending section.
    Reach {},
    /// Send frames at a fixed rate until the connection closes.
    Subscribe {
        /// Frames per second, 0.1 to 1000.
        rate_hz: f64,
    },
}

/// A row of a path: time in s, bend and direction in degrees, and length in mm or null for the rest length.
pub type PathRow = (f64, f64, f64, Option<f64>);
/// Most rows of a path.
pub const PATH_ROWS: usize = 100_000;
/// Longest duration of a path, s.
pub const PATH_MAX_S: f64 = 3600.0;
/// Least time from a row of a path to the next, s.
pub const PATH_STEP_S: f64 = 1e-6;
/// Directions that may be asked for, degrees: a scan may count a hundred turns.
pub const DIR_DEG: RangeInclusive<f64> = -36_000.0..=36_000.0;

/// Argument of `bend`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Frame {
    /// The base: the bend is kept, and the tip turns with the base.
    #[default]
    Base,
    /// The world: the tip keeps the orientation that the bend has now, while the base turns.
    World,
}

/// Poses of a short calibration.
pub const POSES: RangeInclusive<usize> = 6..=24;

fn short_poses() -> usize {
    *POSES.end()
}

/// Argument of `record`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum RecordAction {
    /// Start a recording.
    Start,
    /// Stop it.
    Stop,
}

/// Argument of `calibrate transmission`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CalibrateAction {
    /// Algorithm 1 from zero gains: 120 poses per pass.
    Full,
    /// One pass of a few poses with the present calibration as prior.
    Short,
    /// Apply the proposed gains, now and after every restart.
    Accept,
    /// Discard the proposed gains.
    Discard,
}

impl Request {
    /// A move in the frame of the base; angles in degrees, length in mm, speed in °/s.
    pub fn bend(
        bend_deg: f64,
        dir_deg: f64,
        length_mm: Option<f64>,
        speed_deg_s: Option<f64>,
    ) -> Self {
        Self::Bend {
            bend_deg,
            dir_deg,
            length_mm,
            speed_deg_s,
            frame: Frame::Base,
        }
    }

    /// A set-point at the rest length; angles in degrees, time in s.
    pub fn stream(bend_deg: f64, dir_deg: f64, t_s: Option<f64>) -> Self {
        Self::Stream {
            bend_deg,
            dir_deg,
            length_mm: None,
            t_s,
        }
    }

    /// True for requests that the status socket accepts.
    pub fn only_reads(&self) -> bool {
        matches!(
            self,
            Self::Status {} | Self::Reach {} | Self::Subscribe { .. }
        )
    }

    /// Name of the command, for the log.
    pub fn name(&self) -> String {
        json!(self)["cmd"]
            .as_str()
            .unwrap_or_default()
            .replace('_', "-")
    }
}

/// Why a request failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure {
    /// 1 refused, 2 not understood, 3 not reachable.
    pub code: u8,
    /// Explanation for the operator.
    pub message: String,
}

impl Failure {
    pub(super) fn new(code: u8, message: impl Into<String>) -> Self {
        let message = message.into();
        Self { code, message }
    }
    /// The request is valid but not possible now.
    pub fn refused(message: impl Into<String>) -> Self {
        Self::new(1, message)
    }
    /// The request is invalid.
    pub fn bad(message: impl Into<String>) -> Self {
        Self::new(2, message)
    }
    /// The service or its loop does not answer.
    pub fn unreachable(message: impl Into<String>) -> Self {
        Self::new(3, message)
    }
}

/// Parses one line into its `id` and the request. A stop is one whatever else its line says, also one that is not JSON: to brake is the
/// safe answer.
pub fn parse(line: &str) -> (Value, Result<Request, Failure>) {
    let mut object = match serde_json::from_str::<Object>(line) {
        Ok(Object(object)) => object,
        Err(_) if says_stop(line) => return (Value::Null, Ok(Request::Stop {})),
        Err(e) if e.is_data() => {
            let why = format!("a request is one JSON object per line: {e}");
            return (Value::Null, Err(Failure::bad(why)));
        }
        Err(e) => return (Value::Null, Err(Failure::bad(format!("not JSON: {e}")))),
    };
    let given = object.remove("id").unwrap_or_default();
    let is_echoed = given.is_string() || given.is_u64() || given.is_i64() || given.is_null();
    let id = if is_echoed { given } else { Value::Null };
    if object.get("cmd").is_some_and(|cmd| cmd == "stop") {
        return (id, Ok(Request::Stop {}));
    }
    if !is_echoed {
        let why = "an id is a string or a whole number of at most 64 bits";
        return (id, Err(Failure::bad(why)));
    }
    let version = object.remove("v");
    if version.as_ref().and_then(Value::as_u64) != Some(VERSION) {
        let found = version.map_or_else(|| "none".to_owned(), |v| v.to_string());
        let why = format!("protocol version {found}: this service uses \"v\":{VERSION}");
        return (id, Err(Failure::bad(why)));
    }
    let request = serde_json::from_value(Value::Object(object))
        .map_err(|e| Failure::bad(format!("not understood: {e}")));
    (id, request)
}

/// True if a line that cannot be read says `"cmd":"stop"`, with or without blanks.
pub(super) fn says_stop(line: &str) -> bool {
    let dense: String = line.split_whitespace().collect();
    dense.contains(r#""cmd":"stop""#)
}

/// A JSON object in which no key is given twice: two readers of such a line could understand two requests.
struct Object(serde_json::Map<String, Value>);

impl<'de> Deserialize<'de> for Object {
    fn deserialize<D: serde::Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_map(Self(serde_json::Map::new()))
    }
}

/// The object that is filled.
impl<'de> serde::de::Visitor<'de> for Object {
    type Value = Self;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: serde::de::MapAccess<'de>>(mut self, mut map: A) -> Result<Self, A::Error> {
        while let Some((key, value)) = map.next_entry::<String, Value>()? {
            if self.0.contains_key(&key) {
                let why = format!("the key {key:?} is given twice");
                return Err(serde::de::Error::custom(why));
            }
            self.0.insert(key, value);
        }
        Ok(self)
    }
}

/// Formats a request as a line.
pub fn request_line(id: u64, request: &Request) -> String {
    let mut value = json!(request);
    value["v"] = json!(VERSION);
    value["id"] = json!(id);
    value.to_string() + "\n"
}

/// Formats a reply as a line.
pub fn reply_line(id: &Value, reply: &Result<Value, Failure>) -> String {
    let value = match reply {
        Ok(result) => json!({"v": VERSION, "id": id, "ok": true, "result": result}),
        Err(f) => json!({"v": VERSION, "id": id, "ok": false, "code": f.code, "error": f.message}),
    };
    value.to_string() + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_survives_the_round_trip() {
        let bend = Request::Bend {
            bend_deg: 40.5,
            dir_deg: -30.0,
            length_mm: None,
            speed_deg_s: Some(10.0),
            frame: Frame::World,
        };
        for request in [
            Request::Arm {},
            bend,
            Request::Calibrate {
                action: CalibrateAction::Short,
                poses: 12,
            },
        ] {
            let (id, parsed) = parse(request_line(7, &request).trim());
            assert_eq!((id, parsed), (json!(7), Ok(request)));
        }
    }

    /// Every kind of value for every field, and fields that there are not.
    #[test]
    fn a_stop_is_a_stop_whatever_else_its_line_says() {
        let values = ["1", "2.5", "\"x\"", "null", "[]", "{}", "true", "1e300"];
        for key in ["x", "v", "id", "bend_deg", ""] {
            for value in values {
                for other in ["", r#""v":1,"#] {
                    let line = format!(r#"{{{other}"cmd":"stop","{key}":{value}}}"#);
                    if other.is_empty() || key != "v" {
                        assert_eq!(parse(&line).1, Ok(Request::Stop {}), "{line}");
                    }
                }
            }
        }
    }

    /// A whole line with every end cut off, with something in every place, and what is no request.
    #[test]
    fn a_stop_that_is_not_json_is_a_stop_too() {
        let whole = r#"{"v":1,"id":3,"cmd" : "stop","foo":[1]}"#;
        let said = whole.find("p\"").unwrap() + 2;
        for end in said..whole.len() {
            assert_eq!(parse(&whole[..end]).1, Ok(Request::Stop {}), "{end}");
        }
        for end in 0..said {
            assert!(parse(&whole[..end]).1.is_err(), "{end}");
        }
        for other in [
            r#"{"v":1,"cmd":"stop","foo":}"#,
            r#"{"v":1,"cmd":"stop","cmd":"arm"}"#,
            r#"[{"cmd": "stop"}]"#,
        ] {
            assert_eq!(parse(other).1, Ok(Request::Stop {}), "{other}");
        }
        let named = r#"{"v":1,"cmd":"record","action":"start","name":"\"cmd\":\"stop\""}"#;
        assert_ne!(parse(named).1, Ok(Request::Stop {}));
    }

    #[test]
    fn an_id_comes_back_as_it_was_or_is_refused() {
        let max = u64::MAX.to_string();
        for id in ["7", "-7", &max, "\"a\"", "null"] {
            let (echoed, request) = parse(&format!(r#"{{"v":1,"id":{id},"cmd":"arm"}}"#));
            assert_eq!(
                (echoed.to_string().as_str(), request),
                (id, Ok(Request::Arm {}))
            );
        }
        let long = format!("{max}0");
        for id in ["{}", "[1]", "true", "1.5", "0.1000000000000000055", &long] {
            let (echoed, request) = parse(&format!(r#"{{"v":1,"id":{id},"cmd":"arm"}}"#));
            let why = request.unwrap_err().message;
            assert!(echoed.is_null() && why.contains("an id is"), "{id}: {why}");
        }
    }

    #[test]
    fn an_invalid_line_is_refused_with_a_reason() {
        for (line, part) in [
            ("garbage", "not JSON"),
            ("[1]", "one JSON object"),
            (r#"{"cmd":"arm"}"#, "version none"),
            (r#"{"v":2,"cmd":"arm"}"#, "version 2"),
            (
                r#"{"v":1,"cmd":"bend","cmd":"arm"}"#,
                "\"cmd\" is given twice",
            ),
            (r#"{"v":1,"cmd":"fly"}"#, "fly"),
            (r#"{"v":1,"cmd":"bend"}"#, "bend_deg"),
            (r#"{"v":1,"cmd":"bend","bend_deg":1,"speed":3}"#, "speed"),
            (r#"{"v":1,"cmd":"bend","bend_deg":"NaN"}"#, "NaN"),
            (r#"{"v":1,"cmd":"bend","bend_deg":1e999}"#, "out of range"),
        ] {
            let (_, request) = parse(line);
            let failure = request.unwrap_err();
            assert!(
                failure.message.contains(part) && failure.code == 2,
                "{line}: {}",
                failure.message
            );
        }
    }
}
