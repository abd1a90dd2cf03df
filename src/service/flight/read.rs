//! Reads flight logs, chunk by chunk. A file that was never closed ends with its last whole chunk; a damaged place is left out, up to
//! the next chunk that can be read.

use crate::service::flight::cycle::{Cycle, decode};
use crate::service::flight::file::{DAMAGE, TOPICS, io_error};
use crate::service::flight::schema::{self, ENCODING};
use crate::service::flight::start::Event;
use mcap::read::{ChannelAccumulator, parse_record};
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapResult, Message};
use serde_json::Value;
use std::error::Error;
use std::fmt;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Largest record and largest chunk, bytes: a damaged length does not exhaust the memory.
const RECORD_MAX: u64 = 64 << 20;
/// Name of the compression of a chunk with its length, and the place of its last byte in the chunk.
const COMPRESSION: &[u8; 8] = b"\x04\0\0\0zstd";
const COMPRESSION_END: usize = 44;

/// How a file ends, and where it is damaged.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Ending {
    /// The file was closed properly.
    pub closed: bool,
    /// Damaged places, in words.
    pub damage: Vec<String>,
}

impl Ending {
    /// The ending of a whole file.
    pub const COMPLETE: Self = Self {
        closed: true,
        damage: Vec::new(),
    };
}

impl fmt::Display for Ending {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let open = "the file was not closed; read up to its last whole chunk";
        let damage = self.damage.iter().map(String::as_str);
        let all: Vec<&str> = damage.chain((!self.closed).then_some(open)).collect();
        f.write_str(if all.is_empty() { "complete" } else { "" })?;
        f.write_str(&all.join("; "))
    }
}

/// What a message holds.
#[derive(Debug)]
pub enum Entry {
    /// A fresh supervisor, or new gains.
    Event(Box<Event>),
    /// Consecutive cycles with the number of the first one.
    Cycles(u64, Vec<Cycle>),
    /// What a channel shows of the status; null of any other channel.
    Shown(Value),
}

impl Entry {
    /// The entry of a message.
    ///
    /// # Errors
    /// What is wrong with the message.
    pub fn of(message: &Message<'_>) -> Result<Self, String> {
        Self::read(message).map_err(|problem| {
            let topic = &message.channel.topic;
            format!("channel {topic}: {problem}; was it written by another version of the program?")
        })
    }

    fn read(message: &Message<'_>) -> Result<Self, Box<dyn Error>> {
        let (topic, data) = (message.channel.topic.as_str(), &*message.data);
        // the messages of older logs are JSON, and cycles without a schema
        let older = message.channel.message_encoding != ENCODING;
        let fields = || {
            if older {
                serde_json::from_slice(data).map_err(io::Error::from)
            } else {
                schema::decode(topic, data)
            }
        };
        if topic == TOPICS[0] {
            let exact = if older {
                data.to_vec()
            } else {
                schema::unwrap(topic, data)?
            };
            let (first, cycles) = decode(&exact)?;
            return Ok(Self::Cycles(first, cycles));
        }
        if topic == TOPICS[1] {
            let fields: Value = fields()?;
            let event: Event = match fields["json"].as_str() {
                Some(text) => serde_json::from_str(text)?,
                None => serde_json::from_value(fields)?,
            };
            if !event.is_possible() {
                return Err("an event has a value that no machine has".into());
            }
            return Ok(Self::Event(Box::new(event)));
        }
        let mut shown = schema::TOPICS[..schema::STATUS].iter();
        Ok(Self::Shown(if shown.any(|(name, _)| *name == topic) {
            fields()?
        } else {
            Value::Null
        }))
    }
}

/// The messages of a record.
pub type Messages = Vec<Message<'static>>;
type Visit<'a> = dyn FnMut(Message<'static>) -> Result<(), String> + 'a;

/// Reads the messages of a log. Returns how it ends and where it is damaged.
///
/// # Errors
/// What is wrong with the log or, from the visitor, with a message.
pub fn parse(mut source: impl BufRead + Seek, visit: &mut Visit<'_>) -> Result<Ending, String> {
    let failed = |e: io::Error| format!("the file cannot be read: {e}");
    let mut has_magic = |at| {
        let mut bytes = [0; MAGIC.len()];
        let read = source.seek(at).and_then(|_| source.read_exact(&mut bytes));
        read.is_ok() && bytes == *MAGIC
    };
    let closed = has_magic(SeekFrom::End(-(MAGIC.len() as i64)));
    if !has_magic(SeekFrom::Start(0)) {
        return Err("this is no MCAP file, and so no flight log".to_owned());
    }
    let (mut hole, mut known, mut log) = (None, false, Reading::default());
    log.ending.closed = closed;
    loop {
        let (at, last_ns) = (log.at(), log.last_ns);
        match log.record(&mut source) {
            Ok(None) => break,
            Ok(Some(messages)) => {
                if let (Some(first), Some(hole)) =
                    (messages.first(), hole.take_if(|_| !messages.is_empty()))
                {
                    let lost_s = first.log_time.saturating_sub(last_ns) as f64 * 1e-9;
                    let lost = match last_ns {
                        0 => "the beginning is".to_owned(),
                        _ => format!("{lost_s:.2} s"),
                    };
                    log.ending.damage.push(format!("{hole}, {lost} lost"));
                }
                for message in messages {
                    known |= message.channel.topic == TOPICS[1];
                    visit(message)?;
                }
            }
            Err(e) => {
                let goes_on = log.skip(&mut source).map_err(failed)?;
                if goes_on || closed {
                    let why = io_error(e).to_string().to_lowercase();
                    hole.get_or_insert(format!("damaged at byte {at} ({why})"));
                }
                if !goes_on {
                    break;
                }
            }
        }
    }
    let mut ending = log.ending;
    let rest = hole.map(|hole| format!("{hole}, and nothing after it can be read"));
    ending.damage.extend(rest);
    if known {
        Ok(ending)
    } else if ending == Ending::COMPLETE {
        Err(
            "this is an MCAP file of another program; `retroflex run` writes flight logs"
                .to_owned(),
        )
    } else {
        Err(format!(
            "this is no flight log, or nothing of it can be read: {ending}"
        ))
    }
}

/// Follows a log that is being written.
pub struct Tail {
    source: BufReader<File>,
    log: Reading,
}

impl Tail {
    /// Opens a log at its beginning.
    ///
    /// # Errors
    /// The operating system's.
    pub fn open(path: &Path) -> io::Result<Self> {
        let (source, log) = (BufReader::new(File::open(path)?), Reading::default());
        Ok(Self { source, log })
    }

    /// The messages of the next record; `None` as long as it is not whole, or at the end of the log. What is damaged is left out.
    ///
    /// # Errors
    /// The operating system's.
    pub fn next_record(&mut self) -> io::Result<Option<Messages>> {
        let read = self.log.record(&mut self.source);
        read.or_else(|_| Ok(self.log.skip(&mut self.source)?.then(Vec::new)))
    }
}

/// The records of a chunk. Its checksum is compared first.
fn records(mut chunk: &[u8], most: usize) -> McapResult<Vec<Record<'static>>> {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(most);
    let (mut reader, mut records) = (LinearReader::new_with_options(options), Vec::new());
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(bytes) => {
                let read = chunk.read(reader.insert(bytes))?;
                reader.notify_read(read);
            }
            LinearReadEvent::Record { opcode, data } => {
                records.push(parse_record(opcode, data)?.into_owned());
            }
        }
    }
    Ok(records)
}

#[derive(Default)]
struct Reading {
    /// Length of everything before the next record but [`MAGIC`], bytes.
    passed: u64,
    channels: ChannelAccumulator<'static>,
    ending: Ending,
    /// Time of the last message, ns.
    last_ns: u64,
}

impl Reading {
    /// Position of the next record.
    fn at(&self) -> u64 {
        MAGIC.len() as u64 + self.passed
    }

    /// The messages of the next record; `None` at the end of the data.
    fn record(&mut self, source: &mut (impl Read + Seek)) -> McapResult<Option<Messages>> {
        // a seek empties the buffer
        if source.stream_position()? != self.at() {
            source.seek(SeekFrom::Start(self.at()))?;
        }
        let mut head = [0; 9];
        source.read_exact(&mut head)?;
        let [opcode, length @ ..] = head;
        let length = u64::from_le_bytes(length);
        let wrong = |what: &str| Err(io::Error::other(what).into());
        if length > RECORD_MAX {
            return wrong("a record that is too long");
        }
        let mut whole = head.to_vec();
        if source.take(length).read_to_end(&mut whole)? as u64 != length {
            return wrong("a record that is cut off");
        }
        let data = &whole[head.len()..];
        let messages = match opcode {
            op::DATA_END => return Ok(None),
            op::HEADER | op::MESSAGE_INDEX | op::ATTACHMENT => Vec::new(),
            op::CHUNK | op::METADATA => match parse_record(opcode, data)? {
                Record::Chunk { header, .. } if header.uncompressed_size > RECORD_MAX => {
                    return wrong("a chunk that is too large");
                }
                Record::Chunk { header, .. }
                    if 40 + header.compression.len() as u64 + header.compressed_size != length =>
                {
                    return wrong("a chunk of a wrong length");
                }
                Record::Chunk { header, .. } => {
                    self.chunk(&whole, header.uncompressed_size.max(length))?
                }
                Record::Metadata(stated) if stated.name == DAMAGE => {
                    self.ending.damage.extend(stated.metadata.into_keys());
                    Vec::new()
                }
                _ => Vec::new(),
            },
            _ => return wrong("an unknown record"),
        };
        self.passed += whole.len() as u64;
        Ok(Some(messages))
    }

    /// Goes to the next chunk, found by the name of its compression; false if there is none.
    fn skip(&mut self, source: &mut (impl BufRead + Seek)) -> io::Result<bool> {
        source.seek(SeekFrom::Start(self.at() + 1))?;
        let mut last = [0; COMPRESSION.len()];
        for (k, byte) in source.bytes().enumerate() {
            last.rotate_left(1);
            last[COMPRESSION.len() - 1] = byte?;
            if last == *COMPRESSION && k >= COMPRESSION_END {
                self.passed += 1 + (k - COMPRESSION_END) as u64;
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The messages of a chunk, all of which is read before any of it is believed. No record of it may be longer than `most` bytes,
    /// which is more than the chunk holds.
    fn chunk(&mut self, whole: &[u8], most: u64) -> McapResult<Messages> {
        let mut messages = Messages::new();
        for record in records(whole, most as usize)? {
            match record {
                Record::Schema { header, data } => {
                    self.channels.add_schema(header, data.into_owned().into())?
                }
                Record::Channel(channel) => self.channels.add_channel(channel)?,
                Record::Message { header, data } => {
                    // a channel of a chunk that is lost is unknown
                    let Some(channel) = self.channels.get(header.channel_id) else {
                        continue;
                    };
                    messages.push(Message {
                        channel,
                        sequence: header.sequence,
                        log_time: header.log_time,
                        publish_time: header.publish_time,
                        data: data.into_owned().into(),
                    });
                }
                _ => {}
            }
        }
        // the header has no checksum
        let times = messages.iter().map(|message| message.log_time);
        if let (Some(begin_ns), Some(end_ns)) = (times.clone().min(), times.max()) {
            if begin_ns < self.last_ns && end_ns <= self.last_ns {
                return Err(io::Error::other("a chunk that repeats what is before it").into());
            }
            self.last_ns = end_ns;
        }
        Ok(messages)
    }
}
