//! The service in the guest, as a person at the machine sees it: systemctl and the program's own commands.

use super::guest::{Done, Guest};
use super::tip::TheTip;
use super::verdicts::Verdicts;
use serde_json::Value;
use std::time::{Duration, Instant};

/// Speed of set-points, degrees a second: what an emulated processor keeps up with.
pub const SLOW_DEG_S: f64 = 8.0;

/// The true bend follows if it is nearer than this, degrees. Samples that come late, as they do here, are
/// fused less well; how exact a tip is, layer 1 judges.
const NEAR_DEG: f64 = 10.0;
/// Most stalls before the host is called unfit.
const STALLS_MAX: u32 = 20;

/// Everything a check needs.
pub struct Scene {
    /// The machine.
    pub guest: Guest,
    /// The tip.
    pub tip: TheTip,
    /// The tally.
    pub verdicts: Verdicts,
    /// What the registers had counted when the service last called the pistons zero.
    pub zero: [i32; 3],
    /// Times that this host stalled the guest for longer than a board can allow.
    pub stalls: u32,
}

impl Scene {
    /// A property of the unit.
    pub fn show(&mut self, property: &str) -> String {
        self.guest
            .run(&format!("systemctl show retroflex -p {property} --value"))
            .text
    }

    /// The status; null while the service does not answer.
    pub fn status(&mut self) -> Value {
        let done = self.guest.run("retroflex status --json");
        done.text
            .lines()
            .next()
            .and_then(|l| serde_json::from_str(l).ok())
            .unwrap_or(Value::Null)
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
        let found = format!(
            "mode {}, latched {}, alarm {}",
            status["mode"], status["latched"], status["alarm"]
        );
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
                let counted: [i32; 3] = std::array::from_fn(|i| after.counted[i] - self.zero[i]);
                let found = format!(
                    "service {told}, registers {counted:?} after {:?} pulses",
                    after.pulses
                );
                let holds = told == serde_json::json!(counted) && after.torn == 0;
                self.verdicts
                    .hold(&format!("counts agree {what}"), holds, &found);
                return;
            }
        }
    }

    /// A host with other work stalls the guest for longer than the largest bound that a board can have. The
    /// service latches that, as it must; the counts are compared all the same, and the fault is taken back as
    /// a person would. False if something else, or nothing, has tripped.
    pub fn resumed(&mut self) -> bool {
        let status = self.status();
        let alarm = status["alarm"].as_str().unwrap_or("").to_owned();
        let stalled = status["latched"] == "late"
            || (status["latched"] == "step_generator"
                && (alarm.contains("late") || alarm.contains("ran out")));
        if !stalled || self.stalls >= STALLS_MAX {
            return false;
        }
        self.stalls += 1;
        self.verdicts.say(&format!(
            "      this host stalled the guest: {}, {alarm}",
            status["latched"]
        ));
        self.counts_agree("after a stall");
        self.retroflex("reset-fault");
        self.retroflex("arm");
        true
    }

    /// A command, again after every stall that got in its way.
    pub fn insist(&mut self, words: &str) -> Done {
        loop {
            let done = self.retroflex(words);
            if done.code == 0 || !self.resumed() {
                return done;
            }
        }
    }

    /// Bends, waits until settled, compares counts.
    pub fn bend(&mut self, bend_deg: f64, dir_deg: f64) {
        let words = format!("bend {bend_deg} --toward {dir_deg} --speed {SLOW_DEG_S} --wait");
        let done = self.insist(&words);
        let what = format!("bend {bend_deg}° toward {dir_deg}°");
        self.verdicts.hold(
            &format!("{what} settles"),
            done.code == 0,
            &format!("exit {}, {}", done.code, last(&done)),
        );
        self.counts_agree(&format!("after {what}"));
        if self.zero == [0; 3] {
            // zeroed elsewhere, rest is another one than the truth's
            let off_deg = (self.tip.bend().beta().to_degrees() - bend_deg).abs();
            self.verdicts.hold(
                &format!("the true bend followed, within {NEAR_DEG}°"),
                off_deg < NEAR_DEG,
                &format!("off by {off_deg:.1}°"),
            );
        }
    }
}

/// The end of what was said, where the outcome stands.
fn last(done: &Done) -> String {
    let flat = done.flat();
    let from = flat.char_indices().rev().nth(120).map_or(0, |(i, _)| i);
    flat[from..].to_owned()
}
