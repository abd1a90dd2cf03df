//! What goes over the sockets: one JSON object a line, version-stamped both ways.
//!
//! ```text
//! → {"v":1,"id":7,"cmd":"bend","bend_deg":40,"dir_deg":30}
//! ← {"v":1,"id":7,"ok":true,"result":{}}
//! ← {"v":1,"id":7,"ok":false,"code":1,"error":"not while disarmed: `retroflex arm` first"}
//! ← {"v":1,"event":"frame", …}                     after `subscribe`
//! ```
//!
//! `code` is the exit code a command line should end with: 1 refused, 2 not understood, 3 not reachable.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Version of the protocol.
pub const VERSION: u64 = 1;
/// Longest line of a client, bytes.
pub const LINE_MAX: usize = 16 * 1024;

/// A command.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "cmd", rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// Energise and hold.
    Arm {},
    /// Take no more motion.
    Disarm {},
    /// Bend.
    Bend {
        /// Bend angle β, degrees.
        bend_deg: f64,
        /// Bend direction δ, degrees.
        #[serde(default)]
        dir_deg: f64,
        /// Centre length, mm; left out: at rest.
        #[serde(default)]
        length_mm: Option<f64>,
        /// Speed of the set-point, °/s; left out: that of the gains file.
        #[serde(default)]
        speed_deg_s: Option<f64>,
    },
    /// One of a stream of set-points; when it falls silent the tip stops.
    Stream {
        /// Bend angle β, degrees.
        bend_deg: f64,
        /// Bend direction δ, degrees.
        #[serde(default)]
        dir_deg: f64,
        /// Centre length, mm; left out: at rest.
        #[serde(default)]
        length_mm: Option<f64>,
    },
    /// Come to rest smoothly, hold.
    Hold {},
    /// Halt now, hold.
    Stop {},
    /// Back to rest, then de-energise.
    Relax {},
    /// What is now is the rest.
    Zero {},
    /// Everything worth knowing.
    Status {},
    /// Forget the fault.
    ResetFault {},
    /// Read the gains file again.
    Reload {},
    /// Begin or end a recording.
    Record {
        /// What to do.
        action: RecordAction,
        /// Name of the recording, without folder or ending; left out: the date.
        #[serde(default)]
        name: Option<String>,
    },
    /// Find, accept or forget transmission gains.
    Calibrate {
        /// What to do.
        action: CalibrateAction,
    },
    /// Frames at a rate, until the connection ends.
    Subscribe {
        /// How many a second, 0.1 to 1000.
        rate_hz: f64,
    },
}

/// `record …`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RecordAction {
    /// Begin.
    Start,
    /// End.
    Stop,
}

/// `calibrate transmission …`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CalibrateAction {
    /// Algorithm 1 from zero: 120 states a pass.
    Full,
    /// Twenty-four poses with the calibration in use as prior.
    Short,
    /// Use what was found, from now on and after a restart.
    Accept,
    /// Forget what was found.
    Discard,
}

impl Request {
    /// Reading it needs no right to command.
    #[must_use]
    pub fn only_reads(&self) -> bool {
        matches!(self, Self::Status {} | Self::Subscribe { .. })
    }

    /// Name, for the log.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Arm {} => "arm",
            Self::Disarm {} => "disarm",
            Self::Bend { .. } => "bend",
            Self::Stream { .. } => "stream",
            Self::Hold {} => "hold",
            Self::Stop {} => "stop",
            Self::Relax {} => "relax",
            Self::Zero {} => "zero",
            Self::Status {} => "status",
            Self::ResetFault {} => "reset-fault",
            Self::Reload {} => "reload",
            Self::Record { .. } => "record",
            Self::Calibrate { .. } => "calibrate",
            Self::Subscribe { .. } => "subscribe",
        }
    }
}

/// Why a request failed: exit code and words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure {
    /// 1 refused, 2 not understood, 3 not reachable.
    pub code: u8,
    /// In words.
    pub words: String,
}

impl Failure {
    /// Refused.
    pub fn refused(words: impl Into<String>) -> Self {
        Self { code: 1, words: words.into() }
    }
    /// Not understood.
    pub fn bad(words: impl Into<String>) -> Self {
        Self { code: 2, words: words.into() }
    }
}

/// Reads one line: the number to answer under, and the request or why it is none.
pub fn parse(line: &str) -> (Value, Result<Request, Failure>) {
    let mut object = match serde_json::from_str::<Value>(line) {
        Ok(Value::Object(object)) => object,
        Ok(_) => return (Value::Null, Err(Failure::bad("a request is one JSON object a line"))),
        Err(e) => return (Value::Null, Err(Failure::bad(format!("not JSON: {e}")))),
    };
    let id = object.remove("id").filter(|v| v.is_number() || v.is_string()).unwrap_or(Value::Null);
    let version = object.remove("v");
    if version.as_ref().and_then(Value::as_u64) != Some(VERSION) {
        let said = version.map_or_else(|| "none".to_owned(), |v| v.to_string());
        return (id, Err(Failure::bad(format!("protocol version {said}: this service speaks \"v\":{VERSION}"))));
    }
    let request = serde_json::from_value(Value::Object(object)).map_err(|e| Failure::bad(format!("not understood: {e}")));
    (id, request)
}

/// The line of a request.
#[must_use]
pub fn request_line(id: u64, request: &Request) -> String {
    let mut value = json!(request);
    value["v"] = json!(VERSION);
    value["id"] = json!(id);
    value.to_string() + "\n"
}

/// The line of an answer.
#[must_use]
pub fn answer_line(id: &Value, answer: &Result<Value, Failure>) -> String {
    let value = match answer {
        Ok(result) => json!({"v": VERSION, "id": id, "ok": true, "result": result}),
        Err(f) => json!({"v": VERSION, "id": id, "ok": false, "code": f.code, "error": f.words}),
    };
    value.to_string() + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_come_back_as_they_were() {
        let bend = Request::Bend { bend_deg: 40.5, dir_deg: -30.0, length_mm: None, speed_deg_s: Some(10.0) };
        for request in [Request::Arm {}, bend, Request::Calibrate { action: CalibrateAction::Short }] {
            let (id, back) = parse(request_line(7, &request).trim());
            assert_eq!((id, back), (json!(7), Ok(request)));
        }
    }

    #[test]
    fn what_is_not_understood_is_answered_in_words() {
        for (line, word) in [
            ("garbage", "not JSON"),
            ("[1]", "one JSON object"),
            (r#"{"cmd":"arm"}"#, "version none"),
            (r#"{"v":2,"cmd":"arm"}"#, "version 2"),
            (r#"{"v":1,"cmd":"fly"}"#, "fly"),
            (r#"{"v":1,"cmd":"bend"}"#, "bend_deg"),
            (r#"{"v":1,"cmd":"bend","bend_deg":1,"speed":3}"#, "speed"),
            (r#"{"v":1,"cmd":"bend","bend_deg":"NaN"}"#, "NaN"),
            (r#"{"v":1,"cmd":"bend","bend_deg":1e999}"#, "out of range"),
        ] {
            let (_, answer) = parse(line);
            let failure = answer.unwrap_err();
            assert!(failure.words.contains(word) && failure.code == 2, "{line}: {}", failure.words);
        }
    }
}
