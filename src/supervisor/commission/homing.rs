//! Zero by home switches: approach, back off, approach slowly, twice.
//!
//! The count at the second slow closing becomes the position that the board file states for the switch. The difference
//! between the two slow closings is the repeatability and must stay within its limit.

use crate::supervisor::commission::manual_motion::{ManualMotion, ManualMotionError};
use crate::{choices, parameters};
use nalgebra::Vector3;

choices! {
    /// How zero is found.
    pub enum HomingMethod {
        /// A person brings the pistons to rest and confirms it.
        Operator = "operator",
        /// Every channel has a home switch.
        Switches = "switches",
    }
}

parameters! {
    /// How zero is found.
    pub struct HomingConfig: Copy {
        /// `operator`: a person brings the pistons to rest and confirms it; `switches`: every channel has a `home` line.
        method: HomingMethod = HomingMethod::Operator;
        /// Speed of the first approach to a switch. A larger value is quicker and overruns the switch further.
        speed_mm_s: f64 = 4.0, "mm/s", 0.1..=10.0, "slow enough to stop within the switch's travel";
        /// Distance from a closed switch before the slow second approach: more than the switch's own travel. A larger value
        /// takes longer.
        back_off_mm: f64 = 2.0, "mm", 0.1..=100.0, "more than the switch's own travel";
        /// Largest difference between two approaches; the default is three microsteps. A larger value accepts a worse switch.
        repeat_max_mm: f64 = 0.09, "mm", 0.001..=1.0, "a few microsteps";
        /// Piston position of each channel where its switch closes; the default is the end of travel that shortens the bellow.
        /// The sign sets the direction of the search.
        at_mm: [f64; 3] = [-30.0; 3], "mm", -100.0..=100.0, "where the switch closes, within limits.travel_mm";
    }
}

/// Result of the homing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Homed {
    /// Difference between the two slow closings of each switch, mm.
    pub repeat_mm: [f64; 3],
    /// Correction of the zero position, mm.
    pub moved_mm: [f64; 3],
}

/// Why the homing failed.
#[derive(Debug, thiserror::Error)]
pub enum HomingError {
    /// A move ended early.
    #[error(transparent)]
    Motion(#[from] ManualMotionError),
    /// The switch did not close.
    #[error(
        "the home switch of channel {channel} did not close within {mm} mm: is it wired, is homing.at_mm on the right side, does the motor turn (`retroflex jog`)?"
    )]
    NeverClosed {
        /// Channel, from 1.
        channel: usize,
        /// Distance searched, mm.
        mm: f64,
    },
    /// The switch did not open.
    #[error(
        "the home switch of channel {channel} stays closed after backing off by {mm} mm: check its polarity (`active_low`), its wire and homing.back_off_mm"
    )]
    NeverOpened {
        /// Channel, from 1.
        channel: usize,
        /// Distance backed off, mm.
        mm: f64,
    },
    /// The two closings differ too much.
    #[error(
        "the home switch of channel {channel} closed at two positions {mm:.3} mm apart, more than homing.repeat_max_mm = {max} mm: a loose switch, or lost steps"
    )]
    NotRepeatable {
        /// Channel, from 1.
        channel: usize,
        /// The difference, mm.
        mm: f64,
        /// Largest permitted difference, mm.
        max: f64,
    },
}

/// Finds zero with the switches of all channels, one after the other, and moves the pistons there. A switch that does not close
/// within `search_max_mm` ends the search; the second approach has a quarter of the speed of the first.
///
/// # Errors
/// [`HomingError`]; the pistons stay where they stopped.
pub fn with_switches(
    drive: &mut ManualMotion<'_>,
    config: &HomingConfig,
    search_max_mm: f64,
) -> Result<Homed, HomingError> {
    let mut repeat_mm = [0.0; 3];
    let mut closed_mm = [0.0; 3];
    for i in 0..3 {
        let mut search = Search { drive, config, i };
        search.leave()?;
        search.close(config.speed_mm_s, search_max_mm)?;
        search.leave()?;
        let (slow, most_mm) = (0.25 * config.speed_mm_s, 2.0 * config.back_off_mm);
        let first_mm = search.close(slow, most_mm)?;
        search.leave()?;
        closed_mm[i] = search.close(slow, most_mm)?;
        search.leave()?;
        let (mm, max) = ((closed_mm[i] - first_mm).abs(), config.repeat_max_mm);
        if mm > max {
            let channel = i + 1;
            return Err(HomingError::NotRepeatable { channel, mm, max });
        }
        repeat_mm[i] = mm;
    }
    let moved_mm = Vector3::from(config.at_mm) - Vector3::from(closed_mm);
    let stands_mm = Vector3::from(drive.stands_mm());
    let counted = drive.drive().steps(&(stands_mm + moved_mm));
    drive.recount(counted)?;
    drive.go([0.0; 3], config.speed_mm_s, &mut |_| false)?;
    Ok(Homed {
        repeat_mm,
        moved_mm: moved_mm.into(),
    })
}

/// The search of one channel's switch.
struct Search<'h, 'a> {
    drive: &'h mut ManualMotion<'a>,
    config: &'h HomingConfig,
    /// The channel, from 0.
    i: usize,
}

impl Search<'_, '_> {
    /// The present target, with this channel moved towards its switch by `by_mm`.
    fn towards(&self, by_mm: f64) -> [f64; 3] {
        let mut target = self.drive.wanted_mm;
        target[self.i] += self.config.at_mm[self.i].signum() * by_mm;
        target
    }

    /// Approaches until the switch closes; returns the position of the closing, mm.
    fn close(&mut self, speed_mm_s: f64, most_mm: f64) -> Result<f64, HomingError> {
        let (i, channel, mm) = (self.i, self.i + 1, most_mm);
        let (drive, target) = (self.drive.drive(), self.towards(most_mm));
        let mut at = None;
        self.drive.go(target, speed_mm_s, &mut |s| {
            if s.inputs.home[i] {
                at.get_or_insert(drive.piston_mm(&s.counted)[i]);
            }
            at.is_some()
        })?;
        at.ok_or(HomingError::NeverClosed { channel, mm })
    }

    /// Backs off from a closed switch by the whole distance.
    fn leave(&mut self) -> Result<(), HomingError> {
        let (i, channel, mm) = (self.i, self.i + 1, self.config.back_off_mm);
        if !self.drive.turn()?.inputs.home[i] {
            return Ok(());
        }
        let target = self.towards(-mm);
        self.drive
            .go(target, self.config.speed_mm_s, &mut |_| false)?;
        if self.drive.turn()?.inputs.home[i] {
            return Err(HomingError::NeverOpened { channel, mm });
        }
        Ok(())
    }
}
