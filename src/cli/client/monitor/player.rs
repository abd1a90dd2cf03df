//! Plays the frames of a flight log.

use super::view::{CHART_S, View};
use crate::cli::flight;
use crate::cli::replay::settings::Settings;
use crate::service::flight::file::TOPICS;
use crate::service::flight::read::Entry;
use crate::service::flight::start::Event;
use crate::service::status;
use miette::{Result, bail};
use serde_json::{Map, Value, json};
use std::path::Path;

/// Time between two frames, s.
const PERIOD_S: f64 = 0.1;

/// Times in s from the first frame, and statuses as text, which takes less memory.
pub type Frames = Vec<(f64, String)>;

/// A log that is being played.
pub struct Player {
    name: String,
    frames: Frames,
    /// Frames that the view has taken.
    shown: usize,
    at_s: f64,
    speed: f64,
    /// The log stands still.
    pub paused: bool,
}

impl Player {
    /// Reads a log.
    ///
    /// # Errors
    /// A report that names the file.
    pub fn open(path: &Path, speed: f64) -> Result<Self> {
        let (frames, name) = (recorded(path)?, path.display());
        if frames.is_empty() {
            bail!("{name}: the log holds nothing to show");
        }
        Ok(Self::of(format!("log {name}"), frames, speed))
    }

    /// Plays frames.
    pub fn of(name: String, frames: Frames, speed: f64) -> Self {
        Self {
            name,
            frames,
            shown: 0,
            at_s: 0.0,
            speed,
            paused: false,
        }
    }

    /// Moves by a time, s, within the log.
    pub fn seek(&mut self, by_s: f64) {
        let end_s = self.frames.last().map_or(0.0, |frame| frame.0);
        self.at_s = (self.at_s + by_s).clamp(0.0, end_s);
    }

    /// Lets a time pass, s, and shows the frames up to then.
    pub fn advance(&mut self, elapsed_s: f64, view: &mut View) {
        if !self.paused {
            self.seek(elapsed_s * self.speed);
        }
        let next = self.frames.partition_point(|(t_s, _)| *t_s <= self.at_s);
        let most = (CHART_S / PERIOD_S) as usize;
        if next < self.shown || next > self.shown + most {
            *view = View::default();
            self.shown = next.saturating_sub(most);
        }
        for (t_s, text) in &self.frames[self.shown..next] {
            let mut value: Value = serde_json::from_str(text).unwrap_or_default();
            value["t"] = json!(t_s);
            view.take(value);
        }
        self.shown = next;
        let paused = if self.paused { ", paused" } else { "" };
        let (name, at_s, speed) = (&self.name, self.at_s, self.speed);
        view.source = format!("{name}, {at_s:.1} s, {speed} × real time{paused}");
        view.keys = "space pause   ←/→ 5 s   q quit";
    }
}

/// The frames that the channels for people hold.
fn recorded(path: &Path) -> Result<Frames> {
    let (mut frames, mut now) = (Vec::new(), Map::new());
    flight::read(path, &mut |t_s, message| {
        if now.contains_key("mode") && t_s >= PERIOD_S * frames.len() as f64 {
            frames.push((t_s, json!(now).to_string()));
        }
        if message.channel.topic == TOPICS[0] {
            return Ok(());
        }
        match Entry::of(message)? {
            Entry::Event(ref event) if let Event::Start(header) = &**event => {
                let limits = status::limits(&Settings::of(header)?.config(header));
                now.insert("limits".to_owned(), limits);
            }
            Entry::Shown(Value::Object(fields)) => now.extend(fields),
            _ => {}
        }
        Ok(())
    })?;
    Ok(frames)
}
