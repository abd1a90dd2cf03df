//! A board file corrected to the wiring that was found.

use crate::config::{Board, place};
use crate::supervisor::commission::wiring::{TURN_SMALL_RAD, Wiring};
use nalgebra::{UnitQuaternion, Vector3};

/// The corrected text of a board file and the list of changes.
///
/// # Errors
/// The key that the text lacks.
pub fn rewired(
    text: &str,
    board: &Board,
    wiring: &Wiring,
) -> Result<(String, Vec<String>), String> {
    let mut new = text.to_owned();
    let mut changes = Vec::new();
    let mut set = |key: String, value: String| -> Result<(), String> {
        changes.push(format!("{key} = {value}"));
        new = place::replace(&new, &key, &value).ok_or(key)?;
        Ok(())
    };
    let Some(pins) = &board.pins else {
        return Err("pins".to_owned());
    };
    for (i, &bellow) in wiring.reaches.iter().enumerate() {
        // the driver that is configured as channel i drives `bellow`
        let (from, channel) = (&pins.channels[i], format!("pins.channels.{bellow}"));
        if bellow != i {
            set(format!("{channel}.step"), from.step.to_string())?;
            set(format!("{channel}.dir"), from.dir.to_string())?;
        }
        let turned = from.dir_inverted != wiring.inverted[i];
        if turned != pins.channels[bellow].dir_inverted {
            set(format!("{channel}.dir_inverted"), turned.to_string())?;
        }
    }
    if let (Some(imu), true) = (&board.imu, wiring.turned_rad.abs() >= TURN_SMALL_RAD) {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), wiring.turned_rad);
        let mount_deg = (turn * imu.mount()).scaled_axis().map(f64::to_degrees);
        let mount_deg = format!("{:.1?}", <[f64; 3]>::from(mount_deg));
        set("imu.mount_deg".to_owned(), mount_deg)?;
    }
    Ok((new, changes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::source;

    #[test]
    fn the_corrected_file_describes_the_wiring_that_was_found() {
        let text = include_str!("../../boards/pi4.toml");
        let board: Board = source::parse("pi4", text).unwrap();
        let wiring = Wiring {
            reaches: [1, 0, 2],
            inverted: [true, false, false],
            turned_rad: 0.7,
            residual_rad: 0.0,
        };
        let (new, changes) = rewired(text, &board, &wiring).unwrap();
        let mended: Board = source::parse("new", &new).unwrap();
        let (was, is) = (board.pins.unwrap().channels, mended.pins.unwrap().channels);
        // driver 1 drives bellow 2 and turns in the wrong direction
        assert_eq!(
            (is[1].step, is[1].dir, is[1].dir_inverted),
            (was[0].step, was[0].dir, true)
        );
        assert_eq!(
            (is[0].step, is[0].dir, is[0].dir_inverted),
            (was[1].step, was[1].dir, false)
        );
        assert_eq!(is[2], was[2]);
        assert!(
            (mended.imu.unwrap().mount().angle() - 0.7).abs() < 1e-3 && changes.len() == 6,
            "{changes:?}"
        );
        // comments and everything else are unchanged
        assert_eq!(new.lines().count(), text.lines().count());
        let sim: Board = source::parse("sim", include_str!("../../boards/sim.toml")).unwrap();
        assert_eq!(rewired("", &sim, &wiring).unwrap_err(), "pins");
    }
}
