//! What is asked of the service while the tip is closed around it, and of its ends.

use super::service::Scene;

/// The unit as shipped, on registers, with the tip closed around it.
pub fn service(scene: &mut Scene) {
    let bus = scene
        .guest
        .run("systemctl start bus && udevadm settle && sleep 2 && ls -l /dev/i2c-1");
    scene.verdicts.says(
        "a bus with a sensor that moves",
        &bus.text,
        &["i2c", "/dev/i2c-1"],
    );
    let started = scene.guest.run_for("systemctl start retroflex", 240.0);
    scene.verdicts.hold(
        "the unit starts: READY=1 came",
        started.code == 0,
        &format!("exit {} {}", started.code, started.text),
    );
    let kind = (
        scene.show("Type"),
        scene.show("ActiveState"),
        scene.show("User"),
    );
    scene.verdicts.hold(
        "Type=notify, active, as its own user",
        kind == ("notify".into(), "active".into(), "retroflex".into()),
        &format!("{kind:?}"),
    );
    scene.reaches(
        "a machine without a memory does not know where its pistons are",
        "lost",
        120.0,
    );
    let stated = scene.retroflex("zero --straight");
    scene.verdicts.hold(
        "the operator states that the tip is straight",
        stated.code == 0,
        &stated.flat(),
    );
    scene.reaches("rest is found", "disarmed", 120.0);
    let text = scene.show("StatusText");
    scene
        .verdicts
        .says("STATUS= is shown", &text, &["disarmed"]);
    let granted = scene.status()["real_time"].to_string();
    scene
        .verdicts
        .says("real time is granted", &granted, &["SCHED_FIFO"]);
    let armed = scene.retroflex("arm");
    scene.verdicts.hold("arms", armed.code == 0, &armed.flat());
    scene.bend(30.0, 40.0);
    scene.bend(45.0, -120.0);
    let held = scene.insist("hold");
    scene.verdicts.hold("holds", held.code == 0, &held.flat());
    scene.counts_agree("while holding");
}

/// The first process stops: systemd kills it, starts it anew, and the count is remembered.
pub fn watchdog(scene: &mut Scene) {
    let pid = scene.show("MainPID");
    let bent_deg = scene.tip.bend().beta().to_degrees();
    // stopped at a moment when nothing moves and all is on the disk: a tip that creeps is led after it
    let stopped = loop {
        let before = scene.tip.lines_at_rest();
        scene.guest.run(&format!("kill -STOP {pid}"));
        let stopped = scene.tip.lines_at_rest();
        if before.pulses == stopped.pulses {
            break stopped;
        }
        scene.guest.run(&format!("kill -CONT {pid}; sleep 2"));
    };
    let waits = "for i in $(seq 120); do [ \"$(systemctl show retroflex -p NRestarts --value)\" = 1 ] && break; sleep 1; done; systemctl show retroflex -p NRestarts --value";
    let restarts = scene.guest.run_for(waits, 300.0).text;
    scene.verdicts.hold(
        "the watchdog restarts a service that hangs",
        restarts == "1",
        &format!("NRestarts={restarts}"),
    );
    let journal = scene
        .guest
        .run("journalctl -u retroflex -o cat --no-pager | grep -i watchdog")
        .text;
    scene.verdicts.says(
        "and the journal says so",
        &journal,
        &["Watchdog timeout", "result 'watchdog'"],
    );
    let status = scene.until(120.0, |s| {
        matches!(s["mode"].as_str(), Some("disarmed" | "lost"))
    });
    let after = scene.tip.lines_at_rest();
    let found = format!(
        "registers {:?}, remembered {}",
        stopped.counted, status["counted"]
    );
    let holds = status["counted"] == serde_json::json!(stopped.counted)
        && stopped.counted != [0; 3]
        && after.pulses == stopped.pulses;
    scene.verdicts.hold(
        "the count is remembered, and nothing was pulsed",
        holds,
        &found,
    );
    // the registers kept the current, so the tip is where it was, and gravity proves it
    let now_deg = scene.tip.bend().beta().to_degrees();
    let found = format!(
        "mode {}, energised {}, bent {bent_deg:.1}° and now {now_deg:.1}°",
        status["mode"],
        after.energised()
    );
    let kept =
        status["mode"] == "disarmed" && after.energised() && (now_deg - bent_deg).abs() < 3.0;
    scene.verdicts.hold(
        "the bent tip was held meanwhile, and is believed",
        kept,
        &found,
    );
    let armed = scene.insist("arm");
    scene
        .verdicts
        .hold("arms where it is", armed.code == 0, &armed.flat());
    scene.bend(20.0, 60.0);
    killed(scene);
}

/// Killed, and the air let out before it is back: what is remembered is not believed.
fn killed(scene: &mut Scene) {
    let before = scene.tip.lines_at_rest();
    scene.guest.run("systemctl kill -s KILL retroflex");
    scene.tip.vent();
    let status = scene.until(120.0, |s| {
        matches!(s["mode"].as_str(), Some("disarmed" | "lost"))
    });
    let after = scene.tip.lines_at_rest();
    let found = format!(
        "mode {}, energised {}, {:?} pulses and now {:?}",
        status["mode"],
        after.energised(),
        before.pulses,
        after.pulses
    );
    let doubted = status["mode"] == "lost" && !after.energised() && after.pulses == before.pulses;
    scene.verdicts.hold(
        "a tip that went soft meanwhile is not believed, nor moved",
        doubted,
        &found,
    );
    let refused = scene.retroflex("arm");
    scene.verdicts.hold(
        "arming is refused, with the way out",
        refused.code != 0 && refused.flat().contains("zero"),
        &refused.flat(),
    );
    std::thread::sleep(std::time::Duration::from_secs(2));
    zero(scene);
    scene.bend(20.0, 60.0);
}

/// What is now is the rest; then armed.
fn zero(scene: &mut Scene) {
    scene.zero = scene.tip.lines_at_rest().counted;
    scene.retroflex("zero");
    scene.reaches("rest is found anew", "disarmed", 60.0);
    scene.counts_agree("at rest");
    let armed = scene.retroflex("arm");
    scene
        .verdicts
        .hold("armed again", armed.code == 0, &armed.flat());
}

/// A tip that does not come: the gate notices, holds, and every pulse is accounted for.
pub fn caught(scene: &mut Scene) {
    scene.tip.catch(true);
    let status = loop {
        scene.retroflex("bend 70 --toward 60 --speed 20");
        let status = scene.until(120.0, |s| s["mode"] == "faulted");
        if status["latched"] == "following" || !scene.resumed() {
            break status;
        }
    };
    scene.verdicts.hold(
        "a tip that does not follow is a fault",
        status["mode"] == "faulted",
        &status["mode"].to_string(),
    );
    scene.verdicts.hold(
        "its name is `following`",
        status["latched"] == "following",
        &status["latched"].to_string(),
    );
    scene.counts_agree("after the fault");
    let lines = scene.tip.lines_at_rest();
    scene.verdicts.hold(
        "it holds, with current",
        lines.energised(),
        &format!("energised: {}", lines.energised()),
    );
    scene.tip.catch(false);
    std::thread::sleep(std::time::Duration::from_secs(3));
    scene.retroflex("relax");
    scene.reaches("relaxed after it", "disarmed", 60.0);
    scene.retroflex("reset-fault");
    zero(scene);
    scene.bend(25.0, 60.0);
}

/// SIGTERM while bent: back to rest, then without current.
pub fn stop(scene: &mut Scene) {
    let stopped = scene.guest.run_for("systemctl stop retroflex", 240.0);
    let ended = (scene.show("Result"), scene.show("ActiveState"));
    let found = format!("exit {}, {ended:?}", stopped.code);
    scene.verdicts.hold(
        "systemctl stop ends it well",
        stopped.code == 0 && ended == ("success".into(), "inactive".into()),
        &found,
    );
    let lines = scene.tip.lines_at_rest();
    let counted: [i32; 3] = std::array::from_fn(|i| lines.counted[i] - scene.zero[i]);
    let counts = (counted, lines.lost, lines.torn, lines.energised());
    scene.verdicts.hold(
        "relaxed: every step taken back, no current",
        counts == ([0; 3], 0, 0, false),
        &format!("{counts:?} after {:?}", lines.pulses),
    );
    let kept = scene
        .guest
        .run("retroflex drill --recall /var/lib/retroflex")
        .text;
    scene.verdicts.says(
        "and remembered so",
        &kept,
        &["armed false, steps [0, 0, 0]"],
    );
    let left = scene.tip.bend().beta().to_degrees();
    scene.verdicts.hold(
        "the tip is nearly straight",
        left < 8.0,
        &format!("{left:.1}°"),
    );
    scene.guest.run_for(
        "journalctl -u retroflex -o short-monotonic --no-pager",
        240.0,
    );
    let pulses: u64 = lines.pulses.iter().sum();
    scene.verdicts.say(&format!(
        "{pulses} pulses; {} stalls of the host",
        scene.stalls
    ));
}
