//! Suspected faults and their messages.

use serde::{Deserialize, Serialize};

/// Kind of a suspected fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SuspicionKind {
    /// A line loses air slowly.
    Leak,
    /// A line lost its pressure suddenly.
    Burst,
    /// A line moves the tip less than before: trapped air, a softer bellow, or lost steps.
    Weak,
    /// A line moves the tip more than before.
    Strong,
    /// A piston moves in the wrong direction.
    Inverted,
    /// A line does not respond to its piston.
    NoResponse,
    /// Something holds or pushes the tip.
    Contact,
    /// The motor lost steps, or the drive slipped.
    LostSteps,
}

/// A suspected fault.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Suspicion {
    /// Kind of the fault.
    pub kind: SuspicionKind,
    /// Channel, 1 to 3; `None` if the fault is not one of a single channel.
    pub channel: Option<u8>,
    /// Residual of the bellow as a share of its predicted motion; negative if it moved too little.
    pub share: f64,
    /// Size of the residual, degrees.
    pub deg: f64,
}

impl std::fmt::Display for Suspicion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        use SuspicionKind::{Burst, Contact, Inverted, Leak, LostSteps, NoResponse, Strong, Weak};
        let tip = || "the tip".to_owned();
        let line = self.channel.map_or_else(tip, |c| format!("line {c}"));
        let percent = (self.share.abs() * 100.0).min(999.0);
        let (moves, deg) = (format!("{line} moves the tip"), self.deg);
        let text = match self.kind {
            Leak => format!(
                "{line} loses air slowly ({percent:.0} % so far): look for a leak at its connectors"
            ),
            Burst => format!(
                "{line} lost its pressure suddenly: a hose came off or a bellow is torn; relax and replace the tip"
            ),
            Weak => format!(
                "{moves} {percent:.0} % less than before: air in the line, a soft bellow, or lost steps"
            ),
            Strong => format!(
                "{moves} {percent:.0} % more than before: calibrate again, or something pushes the tip"
            ),
            Inverted => format!(
                "{moves} in the wrong direction: check the motor connector and `dir_inverted` of the channel"
            ),
            NoResponse => {
                format!(
                    "{line} does not respond to its piston: the driver is off, the line is kinked, or the piston is at its end stop"
                )
            }
            Contact => format!("something holds or pushes {line} by {deg:.0}°"),
            LostSteps => format!(
                "{line} has a constant offset of {deg:.1}°: its motor lost steps; `relax`, then `zero`"
            ),
        };
        f.write_str(&text)
    }
}
