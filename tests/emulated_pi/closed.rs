//! The service on device files with a plant behind them. The true bend follows the commands, and the counts of the service
//! equal the pulses on the lines.
#![allow(unsafe_code)]

use super::rig::Rig;
use super::server::ADDRESS;
use retroflex::model::bend::Bend;
use retroflex::service::client::Client;
use retroflex::service::protocol::{Frame, Request};
use serde_json::Value;
use std::fs::File;
use std::process::{Child, ExitStatus};
use std::time::{Duration, Instant};

/// A running service and a connection to it.
pub struct Service<'r> {
    rig: &'r Rig,
    child: Child,
    client: Client,
    /// Number of comparisons of counts.
    pub compared: u32,
    /// Number of times that the host stalled the step thread for longer than the board permits.
    pub stalls: u32,
    target: Option<(f64, f64)>,
}

impl<'r> Service<'r> {
    /// Starts the service on a board and waits until it answers.
    pub fn start(rig: &'r Rig, board: &str) -> Self {
        let (socket, state) = (
            rig.folder().join("control.sock"),
            rig.folder().join("state"),
        );
        let mut command = rig.command(&["run", "--board", board]);
        command
            .arg("--socket")
            .arg(&socket)
            .arg("--state")
            .arg(&state);
        command
            .stderr(File::create(rig.folder().join("stderr")).unwrap())
            .stdout(std::process::Stdio::null());
        let mut child = command.spawn().unwrap();
        let began = Instant::now();
        let client = loop {
            if let Ok(client) = Client::connect(&socket) {
                break client;
            }
            let ended = child.try_wait().unwrap();
            assert!(
                ended.is_none() && began.elapsed() < Duration::from_secs(20),
                "{ended:?}: {}",
                said(rig)
            );
            std::thread::sleep(Duration::from_millis(50));
        };
        Self {
            rig,
            child,
            client,
            compared: 0,
            stalls: 0,
            target: None,
        }
    }

    /// Sends a request; a refusal fails the test.
    pub fn ask(&mut self, request: &Request) -> Value {
        match self.client.request(request) {
            Ok(answer) => answer,
            Err(failure) => panic!("{request:?}: {failure:?}\n{}", said(self.rig)),
        }
    }

    /// The status.
    pub fn status(&mut self) -> Value {
        self.ask(&Request::Status {})
    }

    /// Waits until the status meets a condition.
    pub fn until(&mut self, what: &str, seconds: f64, good: impl Fn(&Value) -> bool) -> Value {
        let mut began = Instant::now();
        loop {
            let status = self.status();
            if good(&status) {
                return status;
            }
            let alarm = status["alarm"].as_str().unwrap_or("");
            let stalled = alarm.contains("late") || alarm.contains("ran out");
            // a host that stops for longer stops the loop too
            if stalled
                && ["step_generator", "late", "stale"]
                    .iter()
                    .any(|cause| status["latched"] == *cause)
            {
                let alarm = alarm.to_owned();
                self.resume(&alarm);
                began = Instant::now();
                continue;
            }
            assert!(
                began.elapsed().as_secs_f64() < seconds,
                "not {what} within {seconds} s: {status:#}\n{}",
                said(self.rig)
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// The host shares its processors, and others may stall the step thread for longer than a board permits. The service
    /// latches this. The stall is counted here, the counts are compared, and the fault is reset.
    fn resume(&mut self, alarm: &str) {
        self.stalls += 1;
        println!("this host stalled the step thread: {alarm}");
        assert!(
            self.stalls <= 30,
            "a host that stalls all the time: {}",
            said(self.rig)
        );
        self.compare();
        self.ask(&Request::ResetFault {});
        self.ask(&Request::Arm {});
        if let Some((bend_deg, dir_deg)) = self.target {
            self.bend(bend_deg, dir_deg);
        }
    }

    /// Bends the tip.
    pub fn bend(&mut self, bend_deg: f64, dir_deg: f64) {
        self.target = Some((bend_deg, dir_deg));
        let request = Request::Bend {
            bend_deg,
            dir_deg,
            length_mm: None,
            speed_deg_s: None,
            frame: Frame::Base,
        };
        match self.client.request(&request) {
            Ok(_) => {}
            // a stall has just occurred; its reset repeats the target
            Err(failure) if failure.message.contains("not while faulted") => {
                self.until("recovered", 10.0, |s| s["latched"].is_null());
            }
            Err(failure) => panic!("{request:?}: {failure:?}\n{}", said(self.rig)),
        }
    }

    /// Waits until the set-point has arrived.
    pub fn arrived(&mut self) {
        self.until("holding", 15.0, |s| s["mode"] == "holding");
    }

    /// Waits until the tip rests at its target; returns the error of the true bend, degrees.
    pub fn settled_error_deg(&mut self, bend_deg: f64, dir_deg: f64) -> f64 {
        self.until("at rest", 15.0, |s| {
            s["mode"] == "holding" && s["at_rest"] == true
        });
        std::thread::sleep(Duration::from_millis(300));
        self.compare();
        let truth = Bend::from_rotation(&self.rig.world().truth().r_base_tip);
        let wanted = Bend::from_deg(bend_deg, dir_deg);
        let (beta, vector) = (
            (truth.beta() - wanted.beta()).to_degrees(),
            (truth.0 - wanted.0).norm().to_degrees(),
        );
        println!(
            "asked for {bend_deg}° toward {dir_deg}°: bend off by {beta:+.2}°, as a vector {vector:.2}°"
        );
        beta.abs()
    }

    /// Compares the counts of the service and of the lines. They refer to the same time only at rest.
    pub fn compare(&mut self) {
        let began = Instant::now();
        loop {
            let before = self.rig.world().chip.counted;
            // a status describes an earlier cycle, so it is compared only if nothing has moved since
            std::thread::sleep(Duration::from_millis(60));
            let told = self.status()["counted"].clone();
            let after = self.rig.world().chip.counted;
            if before == after {
                assert_eq!(told, serde_json::json!(after), "service and lines disagree");
                self.compared += 1;
                return;
            }
            assert!(
                began.elapsed().as_secs_f64() < 5.0,
                "the pistons do not come to rest"
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Applies a fault to the sensor for some time.
    pub fn spoil(&self, how: Spoil, seconds: f64) {
        let set = |on: bool| {
            let mut world = self.rig.world();
            match how {
                Spoil::Nack => world.bus.chips.nack(ADDRESS, if on { u32::MAX } else { 0 }),
                Spoil::Frozen => world.bus.chips.spoil(ADDRESS, |q| q.frozen = on),
                Spoil::Hang => world.bus.hangs = on,
            }
        };
        set(true);
        std::thread::sleep(Duration::from_secs_f64(seconds));
        set(false);
        self.rig.unhang();
    }

    /// Ends the service as systemd does. The second value is true if the host stalled the step thread on the way to rest, so
    /// that it stopped there.
    pub fn terminate(mut self) -> (ExitStatus, bool) {
        let faults = || said(self.rig).matches("event=\"fault\"").count();
        let before = faults();
        // SAFETY: a signal to a child that has not been waited for yet, so the number is still its own.
        unsafe { libc::kill(self.child.id() as i32, libc::SIGTERM) };
        let began = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return (status, faults() > before);
            }
            assert!(
                began.elapsed().as_secs_f64() < 30.0,
                "SIGTERM does not end it\n{}",
                said(self.rig)
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Service<'_> {
    fn drop(&mut self) {
        // it has ended already after `terminate`
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Faults of the sensor.
#[derive(Debug, Clone, Copy)]
pub enum Spoil {
    /// No transfer is acknowledged.
    Nack,
    /// The reading does not change.
    Frozen,
    /// A transfer never ends.
    Hang,
}

/// What the service wrote to its error output.
pub fn said(rig: &Rig) -> String {
    std::fs::read_to_string(rig.folder().join("stderr")).unwrap_or_default()
}
