//! Pins without hardware: every edge is recorded with its time. Part of the product: `bench rt` and
//! rehearsals of the whole service run on it.

use crate::hardware::pins::map::LineMap;
use crate::hardware::pins::{PinError, Pins};
use crate::hardware::rt::monotonic_ns;
use crate::motion::lines::Inputs;
use crate::motion::lines::Levels;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Which line of which channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LineName {
    /// STEP of a channel, from 0.
    Step(usize),
    /// DIR of a channel, from 0.
    Dir(usize),
    /// EN.
    Enable,
}

/// One edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// When it was written, ns of the monotonic clock.
    pub t_ns: u64,
    /// Where.
    pub line: LineName,
    /// To which level (meaning, not voltage).
    pub high: bool,
}

/// Edges between two states of the lines, in the order STEP, DIR, EN.
pub fn edges(t_ns: u64, old: &Levels, new: &Levels) -> impl Iterator<Item = Edge> {
    let (old, new) = (*old, *new);
    let edge = move |line, was: bool, is: bool| (was != is).then_some(Edge { t_ns, line, high: is });
    (0..3)
        .flat_map(move |c| [edge(LineName::Step(c), old.step[c], new.step[c]), edge(LineName::Dir(c), old.dir[c], new.dir[c])])
        .chain([edge(LineName::Enable, old.enable, new.enable)])
        .flatten()
}

/// Hand on the mock's inputs, for a test or a rehearsal.
#[derive(Debug, Clone, Default)]
pub struct MockInputs(Arc<AtomicU64>);

impl MockInputs {
    /// Sets the voltages of the inputs; the order is that of [`LineMap::inputs`].
    pub fn set_bits(&self, bits: u64) {
        self.0.store(bits, Ordering::Relaxed);
    }
}

/// Pins that record.
#[derive(Debug)]
pub struct MockPins {
    map: LineMap,
    levels: Levels,
    record: Vec<Edge>,
    dropped: u64,
    inputs: MockInputs,
    fail_after: Option<u64>,
    found_energised: bool,
    writes: u64,
}

impl MockPins {
    /// Pins of a map that record up to `capacity` edges; further ones are only counted.
    #[must_use]
    pub fn new(map: LineMap, capacity: usize) -> Self {
        Self {
            map,
            levels: Levels::default(),
            record: Vec::with_capacity(capacity),
            dropped: 0,
            inputs: MockInputs::default(),
            fail_after: None,
            found_energised: false,
            writes: 0,
        }
    }

    /// Makes every write after the first `writes` fail.
    #[must_use]
    pub fn failing_after(mut self, writes: u64) -> Self {
        self.fail_after = Some(writes);
        self
    }

    /// Takes the lines over with the drivers energised.
    #[must_use]
    pub fn energised(mut self) -> Self {
        (self.levels.enable, self.found_energised) = (true, true);
        self
    }

    /// A hand on the inputs.
    #[must_use]
    pub fn inputs(&self) -> MockInputs {
        self.inputs.clone()
    }

    /// The edges recorded, in order.
    #[must_use]
    pub fn record(&self) -> &[Edge] {
        &self.record
    }

    /// Edges that were not recorded for want of room.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Levels now.
    #[must_use]
    pub fn levels(&self) -> &Levels {
        &self.levels
    }
}

impl Pins for MockPins {
    fn write(&mut self, levels: &Levels) -> Result<(), PinError> {
        self.writes += 1;
        if self.fail_after.is_some_and(|n| self.writes > n) {
            return Err(PinError::Pin { what: "write", why: "the mock was told to fail".into() });
        }
        for edge in edges(monotonic_ns(), &self.levels, levels) {
            if self.record.len() < self.record.capacity() {
                self.record.push(edge);
            } else {
                self.dropped += 1;
            }
        }
        self.levels = *levels;
        Ok(())
    }

    fn found_energised(&self) -> bool {
        self.found_energised
    }

    fn read(&mut self) -> Result<Inputs, PinError> {
        Ok(self.map.meaning(self.inputs.0.load(Ordering::Relaxed)))
    }
}
