//! One MCAP file.

use crate::service::flight::channels::{Channels, RATE_HZ, schema};
use crate::service::flight::cycle::{Cycle, encode};
use crate::service::flight::start::{Event, Logged};
use mcap::records::Metadata;
use mcap::{Attachment, Channel, McapError, McapResult, Message, Schema, WriteOptions, Writer};
use serde_json::{Value, json};
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

/// Topic of the cycles, and of what a replay starts from or is given later.
pub const TOPICS: [&str; 2] = ["/cycles", "/events"];
/// Name of the metadata in which a log that was made from a damaged one states the damage.
pub const DAMAGE: &str = "retroflex damage";
const LAYOUT: &str = "Cycles in the binary format of the Rust crate postcard; src/service/flight/cycle.rs defines them.";
/// Cycles from one with digests of its fields to the next.
const FIELDS_EVERY: u64 = 16;
/// Most cycles of one message.
const CYCLES_MAX: usize = 1000;

/// A file that is being written.
pub struct FlightFile {
    writer: Writer<BufWriter<File>>,
    file: File,
    channels: HashMap<String, Arc<Channel<'static>>>,
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
    let now = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |d| d.as_nanos() as u64);
    now.saturating_sub((t_s * 1e9) as u64)
}

impl FlightFile {
    /// Creates a file that must not exist yet.
    ///
    /// # Errors
    /// The operating system's, as for all that follows.
    pub fn create(path: &Path, zero_unix_ns: u64) -> McapResult<Self> {
        let file = File::create_new(path)?;
        let library = concat!("retroflex ", env!("CARGO_PKG_VERSION"));
        // a chunk reaches the file as a whole; a higher level saves little and costs more time
        let options = WriteOptions::new()
            .library(library)
            .chunk_size(None)
            .disable_seeking(true)
            .compression_level(7)
            .compression_threads(0);
        let writer = options.create(BufWriter::new(file.try_clone()?))?;
        let (channels, shown, cycles) = (HashMap::new(), Channels::default(), Vec::new());
        Ok(Self {
            writer,
            file,
            channels,
            shown,
            shown_s: f64::NEG_INFINITY,
            zero_unix_ns,
            first: 0,
            cycles,
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
        let Logged {
            number,
            events,
            output,
        } = logged;
        let t_s = output.sensed.t.0;
        let unix_ns = self.unix_ns(t_s);
        let waiting = self.cycles.len();
        let follows = *number == self.first + waiting as u64;
        if !follows || !events.is_empty() || waiting >= CYCLES_MAX {
            self.close_message()?;
            self.first = *number;
        }
        for event in events {
            self.event(&event.at(*number), unix_ns)?;
        }
        if t_s - self.shown_s > 0.98 / RATE_HZ {
            self.shown_s = t_s;
            for (topic, name, value) in self.shown.messages(output, unix_ns, self.step_mm) {
                self.put_json(topic, name, unix_ns, &value)?;
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
            for (name, fact) in [
                ("version", &header.program),
                ("machine", &header.machine.name),
                ("configuration hash", &header.config_hash),
            ] {
                metadata.insert(name.to_owned(), fact.clone());
            }
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
        self.put_json(TOPICS[1], "retroflex.Event", unix_ns, &json!(event))
    }

    /// Copies a message of another file.
    ///
    /// # Errors
    /// See [`Self::create`].
    pub fn copy(&mut self, message: &Message<'_>) -> McapResult<()> {
        let Channel {
            topic,
            schema,
            message_encoding,
            ..
        } = &*message.channel;
        let channel = || match schema.as_deref() {
            None => Default::default(),
            Some(s) => [
                &s.name,
                &s.encoding,
                &*String::from_utf8_lossy(&s.data),
                message_encoding,
            ]
            .map(str::to_owned),
        };
        self.put(topic, channel, message.log_time, message.data.to_vec())
    }

    /// States what is missing because the log that this one is made from is damaged.
    ///
    /// # Errors
    /// See [`Self::create`].
    pub fn state_damage(&mut self, damage: &[String]) -> McapResult<()> {
        let metadata = damage
            .iter()
            .map(|place| (format!("made from a damaged log: {place}"), String::new()))
            .collect();
        self.writer.write_metadata(&Metadata {
            name: DAMAGE.to_owned(),
            metadata,
        })
    }

    fn put_json(
        &mut self,
        topic: &'static str,
        name: &str,
        unix_ns: u64,
        value: &Value,
    ) -> McapResult<()> {
        let channel =
            || [name, "jsonschema", &schema(value).to_string(), "json"].map(str::to_owned);
        self.put(topic, channel, unix_ns, value.to_string().into())
    }

    /// `channel` is name, encoding and text of the schema, and the encoding of the messages.
    fn put(
        &mut self,
        topic: &str,
        channel: impl FnOnce() -> [String; 4],
        unix_ns: u64,
        data: Vec<u8>,
    ) -> McapResult<()> {
        let id = u16::try_from(self.channels.len() + 1)
            .map_err(|_| std::io::Error::other("more topics than a file can hold"))?;
        let channel = self.channels.entry(topic.to_owned()).or_insert_with(|| {
            let [name, encoding, text, message_encoding] = channel();
            let data = text.into_bytes().into();
            let schema = Some(Arc::new(Schema {
                id,
                name,
                encoding,
                data,
            }));
            let (topic, metadata) = (topic.to_owned(), BTreeMap::new());
            Arc::new(Channel {
                id,
                topic,
                schema,
                message_encoding,
                metadata,
            })
        });
        let channel = Arc::clone(channel);
        self.writer.write(&Message {
            channel,
            sequence: 0,
            log_time: unix_ns,
            publish_time: unix_ns,
            data: data.into(),
        })
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
        let channel = || ["retroflex.Cycles", "postcard", LAYOUT, "postcard"].map(str::to_owned);
        self.put(TOPICS[0], channel, unix_ns, message)
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
