//! Reads flight logs, chunk by chunk. A file that was never closed ends with its last whole chunk; a damaged place is left out, up to
//! the next chunk that can be read.

use crate::log::error::why_unreadable;
use crate::service::flight::cycle::{Cycle, decode};
use crate::service::flight::file::{DAMAGE, TOPICS};
use crate::service::flight::start::Event;
use mcap::read::{ChannelAccumulator, ChunkReader, parse_record};
use mcap::records::{ChunkHeader, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapError, McapResult, Message};
use serde_json::Value;
use std::fmt;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Largest record and largest chunk, bytes: a damaged length does not exhaust the memory.
const RECORD_MAX: usize = 64 << 20;
/// Bytes from the beginning of a chunk to the name of its compression, and that name with its length.
const COMPRESSION: (usize, &[u8]) = (37, b"\x04\0\0\0zstd");

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
    pub const COMPLETE: Self = Self { closed: true, damage: Vec::new() };
}

impl fmt::Display for Ending {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let open = "the file was not closed; read up to its last whole chunk";
        match (self.closed, self.damage.join("; ")) {
            (true, damage) if damage.is_empty() => f.write_str("complete"),
            (true, damage) => f.write_str(&damage),
            (false, damage) if damage.is_empty() => f.write_str(open),
            (false, damage) => write!(f, "{damage}; {open}"),
        }
    }
}

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

type Visit<'a> = dyn FnMut(Message<'static>) -> Result<(), String> + 'a;

/// Reads the messages of a file. Returns how it ends and where it is damaged.
///
/// # Errors
/// What is wrong with the file or, from the visitor, with a message, with the name of the file.
pub fn messages(path: &Path, visit: &mut Visit<'_>) -> Result<Ending, String> {
    let named = |problem: String| format!("{}: {problem}", path.display());
    let file = File::open(path).map_err(|e| named(why_unreadable(path, &e)))?;
    parse(BufReader::new(file), visit).map_err(named)
}

/// As [`messages`], from any source.
///
/// # Errors
/// As for [`messages`], without the name of the file.
pub fn parse(mut source: impl Read + Seek, visit: &mut Visit<'_>) -> Result<Ending, String> {
    let failed = |e: io::Error| format!("the file cannot be read: {e}");
    let mut log = Reading::default();
    if !has_magic(&mut source, SeekFrom::Start(0)) {
        return Err("this is no MCAP file, and so no flight log".to_owned());
    }
    let mut at = 0;
    loop {
        source.seek(SeekFrom::Start(at)).map_err(failed)?;
        let why = match log.stretch(&mut source, &mut at, visit) {
            Ok(()) => break,
            Err(Stop::Refused(why)) => return Err(why),
            Err(Stop::Damaged(why)) => format!("damaged at byte {at} ({why})"),
        };
        let next = next_chunk(&mut source, at + 1).map_err(failed)?;
        log.ending.closed |= next.is_none() && has_magic(&mut source, SeekFrom::End(-(MAGIC.len() as i64)));
        if next.is_some() || log.ending.closed {
            log.hole.get_or_insert(why);
        }
        match next {
            Some(next) => at = next,
            None => break,
        }
    }
    let Reading { known, mut ending, hole, .. } = log;
    ending.damage.extend(hole.map(|hole| format!("{hole}, and nothing after it can be read")));
    match known {
        true => Ok(ending),
        false if ending == Ending::COMPLETE => {
            Err("this is an MCAP file of another program; `retroflex run` writes flight logs".to_owned())
        }
        false => Err(format!("this is no flight log, or nothing of it can be read: {ending}")),
    }
}

fn has_magic(source: &mut (impl Read + Seek), at: SeekFrom) -> bool {
    let mut bytes = [0; MAGIC.len()];
    source.seek(at).and_then(|_| source.read_exact(&mut bytes)).is_ok() && bytes == *MAGIC
}

/// Position of the next chunk from a byte on.
fn next_chunk(source: &mut (impl Read + Seek), mut from: u64) -> io::Result<Option<u64>> {
    let (before, name) = COMPRESSION;
    let (most, overlap) = (1 << 20, before + name.len());
    loop {
        let mut block = Vec::new();
        source.seek(SeekFrom::Start(from))?;
        source.take(most as u64).read_to_end(&mut block)?;
        if let Some(k) = block.windows(overlap).position(|w| w[0] == op::CHUNK && w[before..] == *name) {
            return Ok(Some(from + k as u64));
        }
        if block.len() < most {
            return Ok(None);
        }
        from += (most - overlap) as u64;
    }
}

/// Why reading stops.
enum Stop {
    /// The file is damaged here.
    Damaged(String),
    /// The visitor, or the disk.
    Refused(String),
}

impl From<McapError> for Stop {
    fn from(e: McapError) -> Self {
        Self::Damaged(e.to_string().to_lowercase())
    }
}

#[derive(Default)]
struct Reading {
    channels: ChannelAccumulator<'static>,
    known: bool,
    /// Everything up to the summary has been read.
    data_ended: bool,
    ending: Ending,
    /// The damage that the next chunk follows.
    hole: Option<String>,
    /// Time of the last message, ns.
    last_ns: u64,
}

impl Reading {
    /// Reads the records from a byte on; `at` is then the end of the file or the beginning of a damaged record.
    fn stretch(&mut self, source: &mut impl Read, at: &mut u64, visit: &mut Visit<'_>) -> Result<(), Stop> {
        let options = LinearReaderOptions::default().with_emit_chunks(true).with_record_length_limit(RECORD_MAX);
        let whole = *at == 0;
        let options = options.with_skip_start_magic(!whole).with_validate_data_section_crc(whole);
        let mut reader = LinearReader::new_with_options(options.with_validate_summary_section_crc(true));
        if whole {
            *at = MAGIC.len() as u64;
        }
        while let Some(event) = reader.next_event() {
            match event? {
                LinearReadEvent::ReadRequest(need) => {
                    let read = source.read(reader.insert(need)).map_err(|e| Stop::Refused(format!("the file cannot be read: {e}")))?;
                    reader.notify_read(read);
                }
                LinearReadEvent::Record { opcode, data } => {
                    self.record(opcode, data, visit)?;
                    // after an opcode and a length
                    *at += 9 + data.len() as u64;
                }
            }
        }
        Ok(())
    }

    fn record(&mut self, opcode: u8, data: &[u8], visit: &mut Visit<'_>) -> Result<(), Stop> {
        match opcode {
            op::CHUNK | op::METADATA => match parse_record(opcode, data)? {
                Record::Chunk { header, data } => self.chunk(header, &data, visit)?,
                Record::Metadata(mut stated) if stated.name == DAMAGE => self.ending.damage.extend(stated.metadata.remove(DAMAGE)),
                _ => {}
            },
            op::HEADER | op::MESSAGE_INDEX | op::ATTACHMENT => {}
            op::DATA_END => self.data_ended = true,
            _ if self.data_ended => self.ending.closed |= opcode == op::FOOTER,
            _ => return Err(Stop::Damaged("an unknown record".to_owned())),
        }
        Ok(())
    }

    fn chunk(&mut self, header: ChunkHeader, data: &[u8], visit: &mut Visit<'_>) -> Result<(), Stop> {
        let (start_ns, end_ns) = (header.message_start_time, header.message_end_time);
        if header.uncompressed_size > RECORD_MAX as u64 {
            return Err(Stop::Damaged("a chunk that is too large".to_owned()));
        }
        // all of it before any message of it is believed
        let records = ChunkReader::new(header, data)?.collect::<McapResult<Vec<_>>>()?;
        if start_ns < self.last_ns && end_ns <= self.last_ns {
            return Err(Stop::Damaged("a chunk that repeats what is before it".to_owned()));
        }
        if let Some(hole) = self.hole.take() {
            let lost = match self.last_ns {
                0 => "the beginning is lost".to_owned(),
                last_ns => format!("{:.2} s lost", start_ns.saturating_sub(last_ns) as f64 * 1e-9),
            };
            self.ending.damage.push(format!("{hole}, {lost}"));
        }
        self.last_ns = end_ns;
        for record in records {
            match record {
                Record::Schema { header, data } => self.channels.add_schema(header, data.into_owned().into())?,
                Record::Channel(channel) => self.channels.add_channel(channel)?,
                Record::Message { header, data } => {
                    // a channel of a chunk that is lost is unknown
                    let Some(channel) = self.channels.get(header.channel_id) else { continue };
                    self.known |= channel.topic == TOPICS[1];
                    let (sequence, log_time, publish_time) = (header.sequence, header.log_time, header.publish_time);
                    let message = Message { channel, sequence, log_time, publish_time, data: data.into_owned().into() };
                    visit(message).map_err(Stop::Refused)?;
                }
                _ => {}
            }
        }
        Ok(())
    }
}
