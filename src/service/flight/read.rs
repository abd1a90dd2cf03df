//! Reads flight logs, chunk by chunk. A file that was never closed, or is damaged, ends with its last whole chunk.

use crate::log::error::why_unreadable;
use crate::service::flight::cycle::{Cycle, decode};
use crate::service::flight::file::TOPICS;
use crate::service::flight::start::Event;
use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;
use mcap::{McapError, Message};
use serde_json::Value;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// Largest record and largest chunk, bytes: a damaged length does not exhaust the memory.
const RECORD_MAX: usize = 64 << 20;

/// What a message holds.
#[derive(Debug)]
pub enum Entry {
    /// A fresh supervisor, or new gains.
    Event(Box<Event>),
    /// Consecutive cycles with the number of the first one.
    Cycles(u64, Vec<Cycle>),
    /// What a channel for people shows.
    Shown(Value),
}

impl Entry {
    /// The entry of a message.
    ///
    /// # Errors
    /// What is wrong with the message.
    pub fn of(message: &Message<'_>) -> Result<Self, String> {
        let topic = message.channel.topic.as_str();
        let named = |problem: String| format!("channel {topic}: {problem}; was it written by another version of the program?");
        let json = || serde_json::from_slice(&message.data).map_err(|e| named(e.to_string()));
        Ok(match topic {
            _ if topic == TOPICS[0] => {
                decode(&message.data).map(|(n, cycles)| Self::Cycles(n, cycles)).map_err(|e| named(e.to_string()))?
            }
            _ if topic == TOPICS[1] => Self::Event(serde_json::from_value(json()?).map_err(|e| named(e.to_string()))?),
            _ => Self::Shown(json()?),
        })
    }
}

/// Reads the messages of a file. Returns how the file ends: `None` if it was closed properly.
///
/// # Errors
/// What is wrong with the file or, from the visitor, with a message, with the name of the file.
pub fn messages(path: &Path, visit: &mut dyn FnMut(Message<'static>) -> Result<(), String>) -> Result<Option<String>, String> {
    let named = |problem: String| format!("{}: {problem}", path.display());
    let file = File::open(path).map_err(|e| named(why_unreadable(path, &e)))?;
    parse(BufReader::new(file), visit).map_err(named)
}

/// As [`messages`], from any source.
///
/// # Errors
/// As for [`messages`], without the name of the file.
pub fn parse(source: impl Read, visit: &mut dyn FnMut(Message<'static>) -> Result<(), String>) -> Result<Option<String>, String> {
    let options = LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(RECORD_MAX);
    let mut known = false;
    let mut ending = None;
    for message in MessageReader::new_with_options(source, options) {
        match message {
            Ok(message) => {
                known |= message.channel.topic == TOPICS[1];
                visit(message)?;
            }
            Err(McapError::UnexpectedEof) => ending = Some("the file was not closed".to_owned()),
            Err(e) => ending = Some(e.to_string().to_lowercase()),
        }
    }
    match (known, ending) {
        (true, ending) => Ok(ending.map(|problem| format!("{problem}; read up to its last whole chunk"))),
        (false, None) => Err("this is an MCAP file of another program; `retroflex run` writes flight logs".to_owned()),
        (false, Some(problem)) => Err(format!("this is no flight log, or nothing of it can be read: {problem}")),
    }
}
