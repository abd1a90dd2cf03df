//! One MCAP file.

use crate::service::disk::create_recording;
use crate::service::flight::channels::{Channels, RATE_HZ};
use crate::service::flight::cycle::{Cycle, encode};
use crate::service::flight::schema::{self, ENCODING};
use crate::service::flight::start::{Event, Logged};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, McapError, McapResult, Message, WriteOptions, Writer};
use serde_json::{Value, json};
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;
use std::time::UNIX_EPOCH;

/// Topic of the cycles, and of what a replay starts from or is given later.
pub const TOPICS: [&str; 2] = ["/cycles", "/events"];
/// Name of the metadata in which a log that was made from a damaged one states the damage.
pub const DAMAGE: &str = "retroflex damage";
/// Cycles from one with digests of its fields to the next.
const FIELDS_EVERY: u64 = 16;
/// Most cycles of one message.
const CYCLES_MAX: usize = 1000;

/// A file that is being written.
pub struct FlightFile {
    writer: Writer<BufWriter<File>>,
    file: File,
    /// Numbers of the channels by topic.
    channels: HashMap<&'static str, u16>,
    shown: Channels,
    /// When the channels were shown last, on the loop's clock, s.
    shown_s: f64,
    /// Time of the loop's zero, ns since 1970.
    zero_unix_ns: u64,
    first: u64,
    cycles: Vec<Cycle>,
    step_mm: f64,
}

/// The error of the operating system, where it is one of its.
pub fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(io) => io,
        other => io::Error::other(other),
    }
}

/// Time of the loop's zero, ns since 1970, if it is `t_s` now.
pub fn zero_unix_ns(t_s: f64) -> u64 {
    let now = UNIX_EPOCH.elapsed().map_or(0, |d| d.as_nanos() as u64);
    now.saturating_sub((t_s * 1e9) as u64)
}

impl FlightFile {
    /// Creates a file that must not exist yet.
    ///
    /// # Errors
    /// The operating system's, as for all that follows.
    pub fn create(path: &Path, zero_unix_ns: u64) -> McapResult<Self> {
        let file = create_recording(path)?;
        let library = concat!("retroflex ", env!("CARGO_PKG_VERSION"));
        // a chunk reaches the file as a whole; a higher level saves little and costs more time
        let options = WriteOptions::new()
            .library(library)
            .chunk_size(None)
            .disable_seeking(true)
            .compression_level(7)
            .compression_threads(0);
        let mut writer = options.create(BufWriter::new(file.try_clone()?))?;
        let mut channels = HashMap::new();
        for (topic, name) in schema::TOPICS {
            let schema = writer.add_schema(name, ENCODING, &schema::description(topic)?)?;
            let channel = writer.add_channel(schema, topic, ENCODING, &BTreeMap::new())?;
            channels.insert(topic, channel);
        }
        Ok(Self {
            writer,
            file,
            channels,
            shown: Channels::default(),
            shown_s: f64::NEG_INFINITY,
            zero_unix_ns,
            first: 0,
            cycles: Vec::new(),
            step_mm: 0.0,
        })
    }

    /// Bytes on the disk so far.
    ///
    /// # Errors
    /// See [`Self::create`].
    pub fn size(&self) -> io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }

    /// Adds one cycle and what happened before it.
    ///
    /// # Errors
    /// See [`Self::create`].
    pub fn write(&mut self, logged: &Logged) -> McapResult<()> {
        let (number, output) = (logged.number, &logged.output);
        let t_s = output.sensed.t.0;
        let unix_ns = self.unix_ns(t_s);
        let waiting = self.cycles.len();
        let follows = number == self.first + waiting as u64;
        if !follows || !logged.events.is_empty() || waiting >= CYCLES_MAX {
            self.close_message()?;
            self.first = number;
        }
        for event in &logged.events {
            self.event(&event.at(number), unix_ns)?;
        }
        self.shown.take(&output.sensed);
        if t_s - self.shown_s > 0.98 / RATE_HZ {
            self.shown_s = t_s;
            for (topic, value) in self.shown.messages(output, unix_ns, self.step_mm) {
                self.put_fields(topic, unix_ns, value)?;
            }
        }
        self.cycles
            .push(Cycle::new(output, number.is_multiple_of(FIELDS_EVERY)));
        Ok(())
    }

    /// Writes an event; a start also as attachments and hashes, which every reader of MCAP shows.
    ///
    /// # Errors
    /// See [`Self::create`].
    pub fn event(&mut self, event: &Event, unix_ns: u64) -> McapResult<()> {
        if let Event::Start(header) = event {
            self.step_mm = header.machine.step_mm;
            let mut metadata = header.hashes();
            let facts = [
                ("version", &header.program),
                ("machine", &header.machine.name),
                ("configuration hash", &header.config_hash),
            ];
            metadata.extend(facts.map(|(name, fact)| (name.to_owned(), fact.clone())));
            let name = "retroflex".to_owned();
            self.writer.write_metadata(&Metadata { name, metadata })?;
            let version = ("version.txt", header.program.as_str());
            for (name, text) in header.named_texts().chain([version]) {
                self.writer.attach(&Attachment {
                    log_time: unix_ns,
                    create_time: unix_ns,
                    name: name.to_owned(),
                    media_type: "text/plain".to_owned(),
                    data: text.as_bytes().into(),
                })?;
            }
        }
        let all = json!(event);
        let kind = all.as_object().and_then(|all| all.keys().next());
        let fields = json!({"kind": kind, "json": all.to_string()});
        self.put_fields(TOPICS[1], unix_ns, fields)
    }

    /// Copies a message of a channel for people from another file. What it cannot say in the present schema is left out: the poses of
    /// logs whose messages are JSON.
    ///
    /// # Errors
    /// See [`Self::create`].
    pub fn copy(&mut self, message: &Message<'_>) -> McapResult<()> {
        let topic = &message.channel.topic;
        if message.channel.message_encoding == ENCODING {
            return self.put(topic, message.log_time, &message.data);
        }
        let fields = serde_json::from_slice(&message.data);
        match fields.map(|fields| schema::encode(topic, fields)) {
            Ok(Ok(data)) => self.put(topic, message.log_time, &data),
            _ => Ok(()),
        }
    }

    /// States what is missing because the log that this one is made from is damaged.
    ///
    /// # Errors
    /// See [`Self::create`].
    pub fn state_damage(&mut self, damage: &[String]) -> McapResult<()> {
        let stated = |place| (format!("made from a damaged log: {place}"), String::new());
        self.writer.write_metadata(&Metadata {
            name: DAMAGE.to_owned(),
            metadata: damage.iter().map(stated).collect(),
        })
    }

    fn put_fields(&mut self, topic: &str, unix_ns: u64, fields: Value) -> McapResult<()> {
        self.put(topic, unix_ns, &schema::encode(topic, fields)?)
    }

    fn put(&mut self, topic: &str, unix_ns: u64, data: &[u8]) -> McapResult<()> {
        let Some(&channel_id) = self.channels.get(topic) else {
            return Ok(());
        };
        let header = MessageHeader {
            channel_id,
            sequence: 0,
            log_time: unix_ns,
            publish_time: unix_ns,
        };
        self.writer.write_to_known_channel(&header, data)
    }

    fn unix_ns(&self, t_s: f64) -> u64 {
        self.zero_unix_ns + (t_s * 1e9) as u64
    }

    fn close_message(&mut self) -> McapResult<()> {
        let Some(last) = self.cycles.last() else {
            return Ok(());
        };
        let (first, unix_ns) = (self.first, self.unix_ns(last.sensed.t.0));
        let cycles = std::mem::take(&mut self.cycles);
        self.first += cycles.len() as u64;
        self.write_cycles(first, &cycles, unix_ns)
    }

    /// Writes consecutive cycles from this number on, the last of which is of this time.
    ///
    /// # Errors
    /// See [`Self::create`].
    pub fn write_cycles(&mut self, first: u64, cycles: &[Cycle], unix_ns: u64) -> McapResult<()> {
        let message = encode(first, cycles).map_err(io::Error::other)?;
        self.put(TOPICS[0], unix_ns, &schema::wrap(TOPICS[0], message)?)
    }

    /// Closes the chunk: everything so far can be read whatever happens to the program; with `sync` also whatever happens to
    /// the power.
    ///
    /// # Errors
    /// See [`Self::create`].
    pub fn flush(&mut self, sync: bool) -> McapResult<()> {
        self.close_message()?;
        self.writer.flush()?;
        if sync {
            self.file.sync_data()?;
        }
        Ok(())
    }

    /// Writes the summary and waits for the disk.
    ///
    /// # Errors
    /// See [`Self::create`].
    pub fn finish(mut self) -> McapResult<()> {
        self.close_message()?;
        self.writer.finish()?;
        drop(self.writer);
        Ok(self.file.sync_all()?)
    }
}
