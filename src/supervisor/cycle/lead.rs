//! How the supervisor leads the set-point along a path, through set-points with times, or towards an orientation in the world.

use crate::control::{Path, Reference};
use crate::model::{Bend, Shape};
use crate::primitives::{Base, Rotation, Tip};
use crate::supervisor::cycle::guide::Guide;
use crate::supervisor::{Guidance, Mode, Refusal, Supervisor};
use nalgebra::{UnitQuaternion, Vector3};

/// Longest time by which a set-point may come ahead of its time, s.
const AHEAD_MAX_S: f64 = 1.0;
/// Period at which an orientation in the world becomes a set-point, s.
const WORLD_EVERY_S: f64 = 0.01;

impl Supervisor {
    /// Loads a path for [`crate::supervisor::cycle::order::Order::Play`], and gives the one before back in its place. A path in progress ends.
    pub fn load(&mut self, path: &mut Option<Box<Path>>) {
        if matches!(self.guide, Guide::Path { .. }) {
            self.rest_at(self.setpoint);
        }
        std::mem::swap(&mut self.path, path);
    }

    /// Follows the loaded path from its beginning.
    pub(super) fn play(&mut self, now_s: f64) -> Result<(), Refusal> {
        let first = self.path.as_ref().ok_or(Refusal::NoPath)?.at(0.0).shape;
        self.lead_by(
            Guide::Path { began_s: now_s },
            &Shape {
                bend: first.bend,
                length: first.length,
            },
            None,
            None,
        )
    }

    /// Takes a set-point with a time. The first one starts the clock of the stream, and so does one that comes too late.
    pub(super) fn stream(&mut self, command: &Shape, t_s: f64, now_s: f64) -> Result<(), Refusal> {
        if !t_s.is_finite() {
            return Err(Refusal::NotANumber);
        }
        let running = match self.guide {
            Guide::Stream { offset_s } if t_s + offset_s >= now_s - self.config.dead_man_s => {
                Some(offset_s)
            }
            _ => None,
        };
        let offset_s = running.unwrap_or(now_s - t_s);
        let at_s = t_s + offset_s;
        if running.is_some()
            && self
                .recent
                .newest_s()
                .is_some_and(|newest_s| at_s <= newest_s)
        {
            return Err(Refusal::Backwards);
        }
        if at_s > now_s + AHEAD_MAX_S {
            return Err(Refusal::Ahead);
        }
        // a client that sends ahead may fall silent until the time of its last set-point
        let until_s = (now_s + self.config.dead_man_s).max(at_s);
        self.lead_by(Guide::Stream { offset_s }, command, None, Some(until_s))?;
        if running.is_none() {
            self.recent.clear();
        }
        self.recent.push(
            at_s,
            &Shape {
                bend: command.bend,
                length: command.length,
            },
        );
        Ok(())
    }

    /// Keeps the tip at the orientation in the world that this bend has now.
    pub(super) fn point(
        &mut self,
        command: &Shape,
        speed_rad_s: Option<f64>,
    ) -> Result<(), Refusal> {
        if !self.state.fusion.tracks_base() {
            return Err(Refusal::NoBase);
        }
        let aim = self.state.fusion.base_attitude() * command.bend.rotation();
        self.lead_by(
            Guide::World {
                aim,
                length: command.length,
                reached: true,
            },
            command,
            speed_rad_s,
            None,
        )?;
        self.recent.clear();
        Ok(())
    }

    fn lead_by(
        &mut self,
        guide: Guide,
        to: &Shape,
        speed_rad_s: Option<f64>,
        until_s: Option<f64>,
    ) -> Result<(), Refusal> {
        self.bend(to, speed_rad_s, until_s)?;
        (self.guide, self.pending.command) = (guide, None);
        Ok(())
    }

    /// Ends the guide: the tip comes to rest at `shape`.
    fn rest_at(&mut self, shape: Shape) {
        self.guide = Guide::Target;
        self.pending.command = Some(Shape {
            bend: shape.bend,
            length: shape.length,
        });
    }

    /// The moving reference of this cycle.
    pub(super) fn guided(&mut self, now_s: f64, dt_s: f64) -> Option<Reference> {
        match (self.mode(), self.guide) {
            (Mode::Tracking, _) | (Mode::Holding, Guide::Lost) => {}
            _ => self.guide = Guide::Target,
        }
        let wanted_s = now_s + self.state.answers_after_s(&self.config.tick, dt_s);
        match self.guide {
            Guide::Target | Guide::Lost => None,
            Guide::Path { began_s } => {
                let path = self.path.as_deref()?;
                let (end_s, end) = (path.duration_s(), path.at(path.duration_s()).shape);
                if now_s - began_s <= end_s {
                    return Some(path.at(wanted_s - began_s));
                }
                self.rest_at(end);
                None
            }
            Guide::Stream { .. } => self.recent.expected(wanted_s, &self.config.tick.bend_pace),
            Guide::World { aim, length, .. } => {
                if !self.state.fusion.tracks_base() {
                    self.rest_at(self.setpoint);
                    self.guide = Guide::Lost;
                    return None;
                }
                if self
                    .recent
                    .newest_s()
                    .is_none_or(|newest_s| now_s - newest_s >= WORLD_EVERY_S)
                {
                    let wanted: Rotation<Base, Tip> =
                        self.state.fusion.base_attitude().inverse() * aim;
                    let shape = Shape {
                        bend: Bend::from_axis(&self.untwisted(&wanted.apply(&Vector3::z()))),
                        length,
                    };
                    let config = &self.config.tick;
                    let share =
                        config
                            .limits
                            .largest_share(&config.geometry, self.state.lines(), &shape);
                    self.recent.push(
                        now_s,
                        &Shape {
                            bend: Bend(shape.bend.0 * share),
                            length,
                        },
                    );
                    self.guide = Guide::World {
                        aim,
                        length,
                        reached: share >= 1.0,
                    };
                }
                self.recent.expected(wanted_s, &self.config.tick.bend_pace)
            }
        }
    }

    /// The axis of a tip without twist whose twisted tip has this axis: R = Rz(ψ/2) R(bend) Rz(ψ/2).
    fn untwisted(&self, axis: &Vector3<f64>) -> Vector3<f64> {
        let half = self
            .state
            .fusion
            .estimate()
            .map_or(0.0, |e| e.r_base_tip.quat().k.atan2(e.r_base_tip.quat().w));
        UnitQuaternion::from_scaled_axis(Vector3::z() * -half) * axis
    }

    /// What leads the set-point, for the status.
    pub(super) fn guidance(&self, now_s: f64) -> Guidance {
        match self.guide {
            Guide::Target => Guidance::Target,
            Guide::Path { began_s } => Guidance::Path {
                at_s: now_s - began_s,
            },
            Guide::Stream { .. } => Guidance::Stream,
            Guide::World { reached: true, .. } => Guidance::World,
            Guide::World { .. } => Guidance::WorldOutOfReach,
            Guide::Lost => Guidance::WorldLost,
        }
    }
}
