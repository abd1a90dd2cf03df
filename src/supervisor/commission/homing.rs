//! Zero by home switches: approach, back off, approach slowly, twice; both must agree.
//!
//! A switch that closes tells one thing: where it is. So the count at the slow closing is called the
//! position that the board file gives for the switch, and the difference of two closings is the proof.

use crate::primitives::units::Steps;
use crate::supervisor::commission::manual_motion::{Hand, HandError};

/// How to search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HomingConfig {
    /// Speed of the first approach, mm/s; the second is a quarter of it.
    pub speed_mm_s: f64,
    /// Distance of backing off, mm.
    pub back_off_mm: f64,
    /// Most that two closings may differ, mm.
    pub repeat_max_mm: f64,
    /// Piston position of each channel where its switch closes, mm.
    pub at_mm: [f64; 3],
    /// Farthest that a switch is searched, mm.
    pub search_max_mm: f64,
}

/// What was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Homed {
    /// How far the two slow closings of each switch were apart, mm.
    pub repeat_mm: [f64; 3],
    /// How far the old zero was off, mm.
    pub moved_mm: [f64; 3],
}

/// Why zero was not found.
#[derive(Debug, thiserror::Error)]
pub enum HomingError {
    /// The move itself.
    #[error(transparent)]
    Hand(#[from] HandError),
    /// Never closed.
    #[error(
        "the home switch of channel {channel} did not close within {mm} mm: is it wired, is homing.at_mm on the right side, does the motor turn (`retroflex jog`)?"
    )]
    NeverClosed {
        /// Channel, from 1.
        channel: usize,
        /// How far was searched, mm.
        mm: f64,
    },
    /// Never opened.
    #[error(
        "the home switch of channel {channel} stays closed {mm} mm away from it: check its polarity (`active_low`), its wire and homing.back_off_mm"
    )]
    NeverOpened {
        /// Channel, from 1.
        channel: usize,
        /// How far was backed off, mm.
        mm: f64,
    },
    /// Not where it was.
    #[error(
        "the home switch of channel {channel} closed {mm:.3} mm apart twice, more than homing.repeat_max_mm = {max} mm: a loose switch, or lost steps"
    )]
    NotRepeatable {
        /// Channel, from 1.
        channel: usize,
        /// The difference, mm.
        mm: f64,
        /// What is allowed, mm.
        max: f64,
    },
}

/// Finds zero with the switches of all channels, one after the other, and drives the pistons there.
///
/// # Errors
/// [`HomingError`]; the pistons stand where they are.
pub fn with_switches(hand: &mut Hand<'_>, config: &HomingConfig) -> Result<Homed, HomingError> {
    let mut repeat_mm = [0.0; 3];
    let mut closed_mm = [0.0; 3];
    for channel in 0..3 {
        let mut search = Search { hand, config, channel, side: config.at_mm[channel].signum() };
        search.leave()?;
        search.close(config.speed_mm_s, config.search_max_mm)?;
        search.leave()?;
        let slow = 0.25 * config.speed_mm_s;
        let first_mm = search.close(slow, 2.0 * config.back_off_mm)?;
        search.leave()?;
        closed_mm[channel] = search.close(slow, 2.0 * config.back_off_mm)?;
        search.leave()?;
        repeat_mm[channel] = (closed_mm[channel] - first_mm).abs();
        if repeat_mm[channel] > config.repeat_max_mm {
            return Err(HomingError::NotRepeatable { channel: channel + 1, mm: repeat_mm[channel], max: config.repeat_max_mm });
        }
    }
    let (stands_mm, step_mm) = (hand.stands_mm(), hand.step_mm());
    let moved_mm: [f64; 3] = std::array::from_fn(|i| config.at_mm[i] - closed_mm[i]);
    hand.recount(Steps(std::array::from_fn(|i| ((stands_mm[i] + moved_mm[i]) / step_mm).round() as i32)))?;
    hand.go([0.0; 3], config.speed_mm_s, &mut |_| false)?;
    Ok(Homed { repeat_mm, moved_mm })
}

/// The search of one channel's switch.
struct Search<'h, 'a> {
    hand: &'h mut Hand<'a>,
    config: &'h HomingConfig,
    channel: usize,
    side: f64,
}

impl Search<'_, '_> {
    /// The present target with this channel moved by `by_mm` towards its switch.
    fn towards(&self, by_mm: f64) -> [f64; 3] {
        let mut target = self.hand.wanted_mm();
        target[self.channel] += self.side * by_mm;
        target
    }

    /// Approaches until the switch closes; where it did, mm.
    fn close(&mut self, speed_mm_s: f64, most_mm: f64) -> Result<f64, HomingError> {
        let (channel, step_mm) = (self.channel, self.hand.step_mm());
        let mut at = None;
        let target = self.towards(most_mm);
        self.hand.go(target, speed_mm_s, &mut |s| {
            if s.inputs.home[channel] {
                at.get_or_insert(f64::from(s.counted.0[channel]) * step_mm);
            }
            at.is_some()
        })?;
        at.ok_or(HomingError::NeverClosed { channel: channel + 1, mm: most_mm })
    }

    /// Backs off until the switch is open, and then all of the distance.
    fn leave(&mut self) -> Result<(), HomingError> {
        let channel = self.channel;
        if !self.hand.turn()?.inputs.home[channel] {
            return Ok(());
        }
        let target = self.towards(-self.config.back_off_mm);
        self.hand.go(target, self.config.speed_mm_s, &mut |_| false)?;
        if self.hand.turn()?.inputs.home[channel] {
            return Err(HomingError::NeverOpened { channel: channel + 1, mm: self.config.back_off_mm });
        }
        Ok(())
    }
}
