//! The monitor: its screens, logs, and a session on a terminal of its own.

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use retroflex::cli::client::monitor::draw::draw;
use retroflex::cli::client::monitor::player::Player;
use retroflex::cli::client::monitor::view::View;
use retroflex::drill::process::Daemon;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::num::NonZero;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// A view as a terminal shows it.
fn screen(view: &View, width: u16, height: u16) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw(frame, view)).unwrap();
    terminal.backend().to_string()
}

/// Waits until the terminal shows `text`.
fn await_text(terminal: &Mutex<vt100::Parser>, text: &str) {
    let deadline = Instant::now() + Duration::from_secs(20);
    let contents = || terminal.lock().unwrap().screen().contents();
    while !contents().contains(text) {
        assert!(Instant::now() < deadline, "no `{text}`: {}", contents());
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// The status of a tip that holds 40° at 30°, `error` away from it.
fn status(t: f64, error: f64) -> Value {
    json!({
        "t": t, "mode": "holding", "energised": true, "stopped": false, "blocked": false, "hunting": false,
        "target": {"bend_deg": 40.0, "dir_deg": 30.0}, "setpoint": {"bend_deg": 40.0, "dir_deg": 30.0},
        "estimate": {"bend_deg": 40.0 - error, "dir_deg": 30.0}, "sigma_deg": 0.21, "length_mm": 20.0,
        "piston_mm": [-12.34, 3.21, 29.8], "pressure_kpa": [-12.0, 3.0, 31.5], "at_rest": true,
        "k_epsilon": [2.22, 2.53, 3.83], "k_lambda_mm": [0.87, 0.92, 0.81], "lag_s": 0.12, "delay_s": 0.03, "integral_s": 0.5,
        "limits": {"travel_mm": 30.0, "k_epsilon": [[0.61, 3.83], [0.76, 4.3], [0.6, 3.83]],
            "k_lambda_mm": [[0.07, 1.67], [0.12, 1.72], [0.01, 1.61]]},
        "sensor": {"active": [], "advice": []}, "fault": null, "suspicion": null, "alarm": null, "base": null, "shortfall": null,
        "tip": "t7", "calibration": "paper", "cycles": 123_456, "late_cycles": 0, "max_lateness_us": 310, "lost_frames": 0,
    })
}

/// A minute of holding, with a disturbance that fades.
fn holding() -> View {
    let mut view = View {
        source: "live, /run/retroflex/control.sock".to_owned(),
        keys: "h hold   s stop   r relax   q quit",
        ..View::default()
    };
    for k in 0..=600 {
        let t = f64::from(k) * 0.1;
        view.take(status(t, 6.0 * (-(t - 20.0_f64).abs() / 5.0).exp() + 0.3));
    }
    view
}

fn both(name: &str, view: &View) {
    insta::assert_snapshot!(format!("{name}_80x24"), screen(view, 80, 24));
    insta::assert_snapshot!(format!("{name}_200x60"), screen(view, 200, 60));
}

#[test]
fn a_tip_that_holds_with_an_error() {
    both("holding", &holding());
}

#[test]
fn a_fault() {
    let mut view = holding();
    let mut fault = status(60.1, 8.0);
    let text = "the tip does not follow its set-point: see the suspected cause";
    (fault["mode"], fault["fault"], fault["target"]) = (json!("faulted"), json!(text), Value::Null);
    fault["suspicion"] = json!("line 3 does not respond as its piston moved");
    fault["sensor"] =
        json!({"active": ["mag_disturbed"], "advice": ["look for a magnet near the tip"]});
    view.take(fault);
    view.note("relax: not while faulted: `retroflex reset-fault` first");
    both("fault", &view);
}

#[test]
fn a_service_that_does_not_answer() {
    let mut view = holding();
    view.silent_s = Some(1.23);
    both("no_service", &view);
    assert!(screen(&view, 80, 24).contains("no answer for 1.2 s"));
}

/// Frames of a recorded log at 10 Hz, of which the bend follows the time.
fn player() -> Player {
    let frame = |k: u32| {
        let t = f64::from(k) * 0.1;
        let mut now = status(t, 0.5);
        now["mode"] = json!(if t < 30.0 { "tracking" } else { "holding" });
        now["estimate"]["bend_deg"] = json!(t);
        for key in ["tip", "calibration", "cycles"] {
            now[key] = Value::Null;
        }
        (t, now.to_string())
    };
    Player::of(
        "log flight.mcap".to_owned(),
        (0..900).map(frame).collect(),
        2.0,
    )
}

#[test]
fn a_log_is_played_paused_and_sought() {
    let (mut player, mut view) = (player(), View::default());
    player.advance(17.5, &mut view);
    both("log", &view);
    let bend = |view: &View| view.now["estimate"]["bend_deg"].as_f64().unwrap();
    assert_eq!(bend(&view), 35.0);
    player.paused = true;
    player.advance(5.0, &mut view);
    assert_eq!(bend(&view), 35.0);
    player.seek(-5.0);
    player.advance(0.0, &mut view);
    // the minute before is shown again, and nothing of the future
    assert_eq!(
        (bend(&view), view.errors.len(), view.events.len()),
        (30.0, 301, 2)
    );
    for _ in 0..20 {
        player.seek(5.0);
    }
    player.advance(0.0, &mut view);
    assert!(
        (bend(&view) - 89.9).abs() < 1e-9 && view.errors.len() <= 601,
        "{}",
        bend(&view)
    );
}

#[test]
fn every_size_is_drawn_and_a_small_one_says_what_it_needs() {
    let view = holding();
    for (width, height) in (1..=220)
        .step_by(7)
        .flat_map(|width| (1..=70).step_by(3).map(move |height| (width, height)))
    {
        screen(&view, width, height);
        screen(&View::default(), width, height);
    }
    assert!(screen(&view, 39, 12).contains("The monitor needs a terminal of"));
    let least = screen(&view, 40, 12);
    assert!(
        least.contains("holding") && least.contains("12.34"),
        "{least}"
    );
}

#[test]
fn a_recorded_flight_is_shown() {
    let (mut player, mut view) = (
        Player::open(Path::new("tests/replay/backlash.mcap"), 1.0).unwrap(),
        View::default(),
    );
    player.advance(1.95, &mut view);
    for key in ["piston_mm", "k_epsilon", "k_lambda_mm"] {
        assert_eq!(view.now[key].as_array().unwrap().len(), 3);
    }
    assert!(view.now["limits"]["k_epsilon"][2][1].as_f64().unwrap() > 1.0);
    assert!(
        view.status.estimate.unwrap().bend().beta() > 0.2 && view.error_deg().unwrap() < 15.0,
        "{}",
        view.now
    );
    assert!(
        view.events
            .iter()
            .any(|event| event.contains("mode tracking")),
        "{:?}",
        view.events
    );
}

/// On a terminal, that of `script`, the monitor shows the service, sends a stop, and restores the terminal when it ends and when it is killed.
#[test]
fn a_session_restores_the_terminal() {
    if Command::new("script").arg("--version").output().is_err() {
        eprintln!("skipped: there is no program `script`");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let program = Path::new(env!("CARGO_BIN_EXE_retroflex"));
    let daemon = Daemon::start(program, folder.path()).unwrap();
    let socket = daemon.sockets()[0].clone();
    daemon
        .until(10.0, "alignment", |s| s["mode"] == "disarmed")
        .unwrap();
    // what looks like the beginning of an escape sequence hides no key after it
    for keys in [&["\x1b[<", "s", "q"][..], &["s", "\x1b[<"]] {
        let line = format!(
            "stty rows 40 cols 80; echo $$ >pid; exec {} monitor --socket {}",
            program.display(),
            socket.display()
        );
        let mut script = Command::new("script");
        script
            .args(["-qec", &line, "/dev/null"])
            .current_dir(folder.path())
            .env("TERM", "xterm");
        let mut child = script
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut input = child.stdin.take().unwrap();
        let (rows, columns) = (
            const { NonZero::new(40).unwrap() },
            const { NonZero::new(80).unwrap() },
        );
        let terminal = Arc::new(Mutex::new(vt100::Parser::new(rows, columns, 0)));
        let mut output = child.stdout.take().unwrap();
        let shown = Arc::clone(&terminal);
        let reader = std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(n @ 1..) = output.read(&mut bytes) {
                shown.lock().unwrap().process(&bytes[..n]);
            }
        });
        await_text(&terminal, "disarmed");
        assert!(terminal.lock().unwrap().screen().alternate_screen());
        for key in keys {
            write!(input, "{key}").unwrap();
            match *key {
                "s" => await_text(&terminal, "accepted"),
                _ => std::thread::sleep(Duration::from_millis(800)),
            }
        }
        if !keys.contains(&"q") {
            let pid = std::fs::read_to_string(folder.path().join("pid")).unwrap();
            assert!(
                Command::new("kill")
                    .args(["-TERM", pid.trim()])
                    .status()
                    .unwrap()
                    .success()
            );
        }
        let status = child.wait().unwrap();
        reader.join().unwrap();
        let terminal = terminal.lock().unwrap();
        let screen = terminal.screen();
        assert!(status.success(), "{status}: {}", screen.contents());
        assert!(!screen.alternate_screen() && !screen.hide_cursor());
        assert_eq!(screen.contents().trim(), "");
        daemon.until(2.0, "stop", |s| s["stopped"] == true).unwrap();
    }
}
