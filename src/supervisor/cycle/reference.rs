//! How the source of the set-point leads to the reference of a cycle.

use crate::control::{Path, Reference};
use crate::model::{Bend, Shape};
use crate::primitives::{Base, Mm, Rotation, Tip, World};
use crate::supervisor::cycle::source::Source;
use crate::supervisor::{Mode, Refusal, Supervisor};
use nalgebra::{UnitQuaternion, Vector3};

/// Longest time by which a set-point may come ahead of its time, s.
const AHEAD_MAX_S: f64 = 1.0;
/// Period at which an orientation in the world becomes a set-point, s.
const WORLD_EVERY_S: f64 = 0.01;

impl Supervisor {
    /// Loads a path for [`crate::supervisor::Order::Play`], and gives the one before back in its place. A path in progress ends.
    pub fn load(&mut self, path: &mut Option<Box<Path>>) {
        if matches!(self.source, Source::Path { .. }) {
            self.rest_at(self.setpoint);
        }
        std::mem::swap(&mut self.path, path);
    }

    /// Follows the loaded path from its beginning, once the pistons had the time to get ready.
    pub(super) fn play(&mut self, now_s: f64) -> Result<(), Refusal> {
        let first = self.path.as_ref().ok_or(Refusal::NoPath)?.at(0.0).shape;
        let began_s = now_s + self.state.begins_after_s(&self.config.tick);
        self.bend(Source::Path { began_s }, &first, None, None)
    }

    /// Takes a set-point with a time, later than that of the one before. The first one starts the clock of the stream, and so does one
    /// that comes too late: both are for now.
    pub(super) fn stream(&mut self, to: &Shape, t_s: f64, now_s: f64) -> Result<(), Refusal> {
        if !t_s.is_finite() {
            return Err(Refusal::NotANumber);
        }
        let dead_man_s = self.config.dead_man_s;
        let mut running = match self.source {
            Source::Stream { offset_s } => Some(offset_s),
            _ => None,
        };
        if let (Some(offset_s), Some(newest_s)) = (running, self.recent.newest_s())
            && t_s + offset_s <= newest_s
        {
            return Err(Refusal::Backwards);
        }
        running = running.filter(|offset_s| t_s + offset_s >= now_s - dead_man_s);
        let offset_s = running.unwrap_or(now_s - t_s);
        let at_s = t_s + offset_s;
        if at_s > now_s + AHEAD_MAX_S {
            return Err(Refusal::Ahead);
        }
        // a client that sends ahead may fall silent until the time of its last set-point
        let until_s = (now_s + dead_man_s).max(at_s);
        self.bend(Source::Stream { offset_s }, to, None, Some(until_s))?;
        if running.is_none() {
            self.recent.count = 0;
        }
        self.recent.push(at_s, to);
        Ok(())
    }

    /// Keeps the tip at the orientation in the world that this bend has now.
    pub(super) fn point(&mut self, to: &Shape, speed_rad_s: Option<f64>) -> Result<(), Refusal> {
        if !self.state.fusion.tracks_base() {
            return Err(Refusal::NoBase);
        }
        let source = Source::World {
            aim: self.state.fusion.base_attitude() * to.bend.rotation(),
            length: to.length,
            reached: true,
        };
        self.bend(source, to, speed_rad_s, None)?;
        self.recent.count = 0;
        Ok(())
    }

    /// The tip comes to rest at `shape`, whatever led it.
    pub(super) fn rest_at(&mut self, shape: Shape) {
        (self.source, self.pending.target) = (Source::Target, Some(shape));
    }

    /// The moving reference of this cycle.
    pub(super) fn reference(&mut self, now_s: f64, dt_s: f64) -> Option<Reference> {
        match (self.mode, self.source) {
            (Mode::Tracking, _) | (Mode::Holding, Source::WorldLost) => {}
            _ => self.source = Source::Target,
        }
        let wanted_s = now_s + self.state.answers_after_s(&self.config.tick, dt_s);
        match self.source {
            Source::Target | Source::WorldLost => None,
            Source::Path { began_s } => {
                let path = self.path.as_deref()?;
                let end_s = path.duration_s();
                if now_s - began_s <= end_s {
                    return Some(path.at(wanted_s - began_s));
                }
                self.rest_at(path.at(end_s).shape);
                None
            }
            Source::Stream { .. } => self.recent.expected(wanted_s, &self.config.tick.bend_pace),
            Source::World { aim, length, .. } => {
                if !self.state.fusion.tracks_base() {
                    self.rest_at(self.setpoint);
                    self.source = Source::WorldLost;
                    return None;
                }
                let newest_s = self.recent.newest_s();
                if newest_s.is_none_or(|newest_s| now_s - newest_s >= WORLD_EVERY_S) {
                    let (shape, reached) = self.towards(&aim, length);
                    self.recent.push(now_s, &shape);
                    self.source = Source::World {
                        aim,
                        length,
                        reached,
                    };
                }
                self.recent.expected(wanted_s, &self.config.tick.bend_pace)
            }
        }
    }

    /// The shape that has the orientation `aim` now, as far as the tip can bend; and whether it can bend that far.
    fn towards(&self, aim: &Rotation<World, Tip>, length: Mm) -> (Shape, bool) {
        let wanted: Rotation<Base, Tip> = self.state.fusion.base_attitude().inverse() * *aim;
        let bend = Bend::from_axis(&self.untwisted(&wanted.apply(&Vector3::z())));
        let (config, lines) = (&self.config.tick, self.state.lines());
        let shape = Shape { bend, length };
        let share = config.limits.largest_share(&config.geometry, lines, &shape);
        (Shape::new(bend.0 * share, length.0), share >= 1.0)
    }

    /// The axis of a tip without twist whose twisted tip has this axis: R = Rz(ψ/2) R(bend) Rz(ψ/2).
    fn untwisted(&self, axis: &Vector3<f64>) -> Vector3<f64> {
        let estimate = self.state.fusion.estimate();
        let half = estimate.map_or(0.0, |e| e.r_base_tip.quat().k.atan2(e.r_base_tip.quat().w));
        UnitQuaternion::from_scaled_axis(Vector3::z() * -half) * axis
    }
}
