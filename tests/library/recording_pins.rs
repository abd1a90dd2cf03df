//! Pins without hardware that record every edge with its time.

use retroflex::hardware::pins::map::LineMap;
use retroflex::hardware::pins::{PinError, Pins};
use retroflex::hardware::rt::monotonic_ns;
use retroflex::motion::lines::{Inputs, Levels};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

/// A line of a driver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LineName {
    /// STEP of a channel, from 0.
    Step(usize),
    /// DIR of a channel, from 0.
    Dir(usize),
    /// EN.
    Enable,
}

/// A change of one line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// Time of the write, ns of the monotonic clock.
    pub t_ns: u64,
    /// The line.
    pub line: LineName,
    /// The new logical level.
    pub high: bool,
}

/// The edges between two states of the lines.
pub fn edges(t_ns: u64, old: &Levels, new: &Levels) -> impl Iterator<Item = Edge> {
    let (old, new) = (*old, *new);
    let edge = move |line, was: bool, is: bool| {
        (was != is).then_some(Edge {
            t_ns,
            line,
            high: is,
        })
    };
    (0..3)
        .flat_map(move |c| {
            [
                edge(LineName::Step(c), old.step[c], new.step[c]),
                edge(LineName::Dir(c), old.dir[c], new.dir[c]),
            ]
        })
        .chain([edge(LineName::Enable, old.enable, new.enable)])
        .flatten()
}

/// What was written.
#[derive(Debug)]
pub struct Record {
    /// The present levels.
    pub levels: Levels,
    /// The edges in order.
    pub edges: Vec<Edge>,
    /// Number of edges beyond the capacity.
    pub dropped: u64,
}

/// Pins that record edges. Clones share the record.
#[derive(Debug, Clone)]
pub struct RecordingPins {
    map: LineMap,
    record: Arc<Mutex<Record>>,
    inputs: Arc<AtomicU64>,
    fail_after: Option<u64>,
    found_energised: bool,
    writes: u64,
}

impl RecordingPins {
    /// Pins of a map that record up to `capacity` edges and count the rest.
    pub fn new(map: LineMap, capacity: usize) -> Self {
        let record = Record {
            levels: Levels::default(),
            edges: Vec::with_capacity(capacity),
            dropped: 0,
        };
        Self {
            map,
            record: Arc::new(Mutex::new(record)),
            inputs: Arc::default(),
            fail_after: None,
            found_energised: false,
            writes: 0,
        }
    }

    /// Makes every write after the first `writes` fail.
    pub fn failing_after(mut self, writes: u64) -> Self {
        self.fail_after = Some(writes);
        self
    }

    /// Reports the drivers as found energised.
    pub fn energised(mut self) -> Self {
        self.record().levels.enable = true;
        self.found_energised = true;
        self
    }

    /// A handle that sets the voltages of the inputs, in the order of [`LineMap::inputs`].
    pub fn inputs(&self) -> Arc<AtomicU64> {
        self.inputs.clone()
    }

    /// What was written so far.
    pub fn record(&self) -> MutexGuard<'_, Record> {
        self.record.lock().unwrap()
    }
}

impl Pins for RecordingPins {
    fn write(&mut self, levels: &Levels) -> Result<(), PinError> {
        self.writes += 1;
        if self.fail_after.is_some_and(|n| self.writes > n) {
            return Err(PinError::Pin("write", "the mock was set to fail".into()));
        }
        let mut record = self.record();
        let old = record.levels;
        for edge in edges(monotonic_ns(), &old, levels) {
            if record.edges.len() < record.edges.capacity() {
                record.edges.push(edge);
            } else {
                record.dropped += 1;
            }
        }
        record.levels = *levels;
        Ok(())
    }

    fn found_energised(&self) -> bool {
        self.found_energised
    }

    fn read(&mut self) -> Result<Inputs, PinError> {
        Ok(self.map.inputs_from(self.inputs.load(Ordering::Relaxed)))
    }
}
