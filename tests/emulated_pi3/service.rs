//! The service in the guest, as a person at the machine sees it: systemctl and the program's own commands.

use crate::guest::{Done, Guest};
use crate::tip::TheTip;
use crate::verdicts::Verdicts;
use serde_json::Value;
use std::time::{Duration, Instant};

/// Everything a check needs.
pub struct Scene {
    /// The machine.
    pub guest: Guest,
    /// The tip.
    pub tip: TheTip,
    /// The tally.
    pub verdicts: Verdicts,
}

impl Scene {
    /// A property of the unit.
    pub fn show(&mut self, property: &str) -> String {
        self.guest.run(&format!("systemctl show retroflex -p {property} --value")).text
    }

    /// The status; null while the service does not answer.
    pub fn status(&mut self) -> Value {
        let done = self.guest.run("retroflex status --json");
        done.text.lines().next().and_then(|l| serde_json::from_str(l).ok()).unwrap_or(Value::Null)
    }

    /// A command of the program.
    pub fn retroflex(&mut self, words: &str) -> Done {
        self.guest.run_for(&format!("retroflex {words}"), 240.0)
    }

    /// The status once it is as wanted, or the last one.
    pub fn until(&mut self, limit_s: f64, good: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            let status = self.status();
            if good(&status) || began.elapsed().as_secs_f64() > limit_s {
                return status;
            }
            std::thread::sleep(Duration::from_secs(1));
        }
    }

    /// Waits for a mode, and judges that it came.
    pub fn reaches(&mut self, what: &str, mode: &str, limit_s: f64) -> Value {
        let status = self.until(limit_s, |s| s["mode"] == mode);
        let found = format!("mode {}, latched {}, alarm {}", status["mode"], status["latched"], status["alarm"]);
        self.verdicts.hold(what, status["mode"] == mode, &found);
        status
    }

    /// Judges that the service's count is the chip's, exactly, at rest.
    pub fn counts_agree(&mut self, what: &str) {
        let began = Instant::now();
        loop {
            let before = self.tip.lines_at_rest();
            let told = self.status()["counted"].clone();
            let after = self.tip.lines_at_rest();
            if before.pulses == after.pulses || began.elapsed() > Duration::from_secs(60) {
                let found = format!("service {told}, registers {:?} after {:?} pulses", after.counted, after.pulses);
                let holds = told == serde_json::json!(after.counted) && after.torn == 0;
                self.verdicts.hold(&format!("counts agree {what}"), holds, &found);
                return;
            }
        }
    }

    /// Bends, waits until settled, compares counts.
    pub fn bend(&mut self, bend_deg: f64, dir_deg: f64) {
        let done = self.retroflex(&format!("bend {bend_deg} --toward {dir_deg} --wait"));
        let what = format!("bend {bend_deg}° toward {dir_deg}°");
        self.verdicts.hold(&format!("{what} settles"), done.code == 0, &format!("exit {}: {}", done.code, done.flat()));
        self.counts_agree(&format!("after {what}"));
        let truth = self.tip.bend();
        let off = (truth.beta().to_degrees() - bend_deg).abs();
        self.verdicts.hold(&format!("{what} is where the truth is, within 3°"), off < 3.0, &format!("off by {off:.2}°"));
    }
}
