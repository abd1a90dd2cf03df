//! A service without sockets, its machine, and what must hold in every cycle of it.

use super::requests;
use crate::config::supervisor::assemble;
use crate::config::{Board, Calibration, Gains, shipped, source};
use crate::hardware::rt;
use crate::primitives::{Seconds, Steps};
use crate::service::hub::{Facts, Hub, HubIo};
use crate::service::notify::Heartbeat;
use crate::service::rt_loop::{Loop, Precondition, rings};
use crate::service::store;
use crate::service::{
    Belief, Caller, Memory, Notifier, Port, Request, RunConfig, Shared, Start, StateWriter, Store,
};
use crate::simulation::lockstep::Lockstep;
use crate::simulation::sim::Sim;
use crate::supervisor::mode::{Event, TABLE};
use crate::supervisor::{Machine, MachineError, MachineInfo, Mode, Runner, Sensed};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

const CLIENTS: u64 = 4;
/// A tip that is stopped stands after this many cycles.
const BRAKED: u64 = 500;

/// What the machine was told, and where its pistons really are beside what it counts.
#[derive(Debug, Default, Clone)]
struct Seen {
    wanted: Steps,
    counted: Steps,
    energised: bool,
    /// True steps beyond the counted ones.
    beyond: [i32; 3],
}

/// A simulated tip that notes what it is told.
struct Probe {
    machine: Lockstep<Sim>,
    seen: Arc<Mutex<Seen>>,
}

impl Machine for Probe {
    fn info(&self) -> &MachineInfo {
        self.machine.info()
    }
    fn turn(&mut self, now: Seconds, wanted: &Steps) -> Result<Sensed, MachineError> {
        let sensed = self.machine.turn(now, wanted)?;
        let mut seen = self.seen.lock().unwrap();
        (seen.wanted, seen.counted) = (*wanted, sensed.counted);
        Ok(sensed)
    }
    fn energise(&mut self, on: bool) {
        self.seen.lock().unwrap().energised = on;
        self.machine.energise(on);
    }
    fn recount(&mut self, counted: &Steps) {
        let mut seen = self.seen.lock().unwrap();
        for i in 0..3 {
            seen.beyond[i] += seen.counted.0[i] - counted.0[i];
        }
        self.machine.recount(counted);
    }
    fn clear(&mut self) {
        self.machine.clear();
    }
    fn is_simulated(&self) -> bool {
        true
    }
    fn remarks(&self) -> Vec<String> {
        vec!["a simulated tip".to_owned()]
    }
}

/// A service without sockets and threads, but for those of the disk.
pub(super) struct House {
    pub(super) hub: Hub,
    pub(super) rt: Loop,
    pub(super) shared: Arc<Shared>,
    seen: Arc<Mutex<Seen>>,
    /// What the hub has sent through each port, line by line with the number of the client.
    replies: [Receiver<(u64, String)>; 2],
    folder: tempfile::TempDir,
    pub(super) seed: u64,
    pub(super) rng: StdRng,
    pub(super) cycles: u64,
    /// Lines that were received, with the number of stops until then.
    pub(super) queues: Vec<VecDeque<(Value, Request, u64)>>,
    /// Requests without an answer, by their number.
    pub(super) open: BTreeMap<u64, (u64, Request)>,
    pub(super) sent: u64,
    stopped_for: u64,
    pub(super) visited: BTreeMap<&'static str, u64>,
    pub(super) accepted: BTreeMap<String, u64>,
}

fn config(folder: &Path) -> RunConfig {
    let (mut board, gains, calibration): (Board, Gains, Calibration) = (
        source::parse("demo", shipped::DEMO.1).unwrap(),
        source::parse("gains", shipped::GAINS.1).unwrap(),
        source::parse("paper", shipped::PAPER.1).unwrap(),
    );
    let file = folder.join("gains.toml");
    std::fs::write(&file, shipped::GAINS.1).unwrap();
    let service = &mut board.service;
    (service.state, service.flight_max_mib) = (Some(folder.join("state")), 0.0);
    (service.attended_s, service.hold_max_s) = (0.0, Some(1.5));
    (service.checkpoint_s, service.record_free_mib) = (0.2, 1.0);
    let plant = board.plant.clone().unwrap();
    let info = MachineInfo {
        step_mm: plant.drive.step_mm,
        period_s: plant.period_s,
        rest_length_mm: board.geometry.rest_length_mm,
        ..MachineInfo::default()
    };
    RunConfig {
        supervisor: assemble(&board, &calibration, &gains, &info),
        service: board.service.clone(),
        config_hash: "test".to_owned(),
        texts: vec![String::new(); 3],
        board,
        gains: Some(file),
        calibration,
        calib: None,
        feedforward: None,
        tip: String::new(),
    }
}

fn caller(client: u64, id: Value, stops: u64) -> Caller {
    let (since, mode) = (Instant::now(), None);
    Caller {
        client,
        id,
        command: String::new(),
        then: Precondition { stops, since, mode },
    }
}

impl House {
    pub(super) fn new(seed: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let config = config(folder.path());
        let section = config.board.plant.clone().unwrap();
        let sim = Sim::new(&section, seed, 1, section.period_s).unwrap();
        let seen = Arc::<Mutex<Seen>>::default();
        let machine = Probe {
            machine: Lockstep::new(sim, &config.board.drive_limits()),
            seen: Arc::clone(&seen),
        };
        let (mut store, _) = Store::open(&folder.path().join("state")).unwrap();
        let memory = Memory::default();
        store.write(&memory).unwrap();
        let shared = Arc::new(Shared::default());
        let (loop_rings, hub_rings) = rings();
        let start = Start::new(&config, &memory, Belief::Certain);
        let machine: Box<dyn Machine> = Box::new(machine);
        let rt = Loop {
            period_s: section.period_s,
            runner: Runner::new(machine, start.supervisor()),
            rings: loop_rings,
            shared: Arc::clone(&shared),
            pace: Some(f64::INFINITY),
            heartbeat: Heartbeat::default(),
        };
        let ((control, commands), (status, reads)) = (Port::detached(), Port::detached());
        let io = HubIo {
            control,
            status,
            notifier: Notifier::default(),
            state_writer: StateWriter::start(store).unwrap(),
            rings: hub_rings,
            shared: Arc::clone(&shared),
        };
        let facts = Facts {
            remarks: Vec::new(),
            grants: std::array::from_fn(|_| ("", rt::Grant::NotRequested)),
            damaged: Vec::new(),
            belief: Belief::Certain,
        };
        let mut hub = Hub::new(io, config, memory, facts);
        hub.start_flight();
        Self {
            hub,
            rt,
            shared,
            seen,
            replies: [commands, reads],
            folder,
            seed,
            rng: StdRng::seed_from_u64(seed),
            cycles: 0,
            queues: vec![VecDeque::new(); CLIENTS as usize],
            open: BTreeMap::new(),
            sent: 0,
            stopped_for: 0,
            visited: BTreeMap::new(),
            accepted: BTreeMap::new(),
        }
    }

    /// One cycle, and what must hold after it.
    pub(super) fn cycle(&mut self) {
        let before = (
            self.rt.runner.supervisor.mode(),
            self.rt.runner.supervisor.is_stopped(),
            self.seen.lock().unwrap().counted,
        );
        let stop = self.shared.stop.requested() > self.shared.stop.completed();
        self.cycles += 1;
        let now = Seconds(self.cycles as f64 * self.rt.period_s);
        self.rt.cycle(now).unwrap();
        let supervisor = &self.rt.runner.supervisor;
        let (mode, stopped) = (supervisor.mode(), supervisor.is_stopped());
        let seen = self.seen.lock().unwrap().clone();
        *self.visited.entry(mode.name()).or_default() += 1;
        let (seed, n) = (self.seed, self.cycles);
        let at = format!("seed {seed}, cycle {n}: {} → {mode}", before.0);
        assert!(may_follow(before.0, mode), "{at}: not in the table");
        assert_eq!(supervisor.latched(), None, "{at}");
        assert!(mode != Mode::Lost, "{at}");
        assert_eq!(
            seen.beyond, [0; 3],
            "{at}: true steps beyond {:?}",
            seen.counted
        );
        let gate = &supervisor.config().gate;
        let most = gate.speed_mm_s * self.rt.period_s / gate.step_mm + 2.0;
        for i in 0..3 {
            let travel_mm = f64::from(seen.wanted.0[i]).abs() * gate.step_mm;
            assert!(travel_mm <= gate.travel_mm, "{at}: {travel_mm} mm");
            let (now, then) = (seen.counted.0[i], before.2.0[i]);
            assert!(
                f64::from(now - then).abs() <= most,
                "{at}: {then} → {now} steps"
            );
        }
        assert!(!stop || stopped, "{at}: a stop was requested");
        if before.1 && !stopped {
            let armed = matches!(before.0, Mode::Disarmed | Mode::Holding) && mode == Mode::Holding;
            assert!(armed, "{at}: the stop is forgotten");
        }
        self.stopped_for = if stopped { self.stopped_for + 1 } else { 0 };
        if self.stopped_for > 1 {
            let moves = matches!(mode, Mode::Tracking | Mode::Calibrating | Mode::Relaxing);
            assert!(!moves, "{at}: after a stop");
        }
        if self.stopped_for > BRAKED {
            assert_eq!(seen.counted, before.2, "{at}: after a stop");
        }
    }

    /// One round of the hub, with some of the lines that were received.
    pub(super) fn round(&mut self) {
        self.hub.take_loop_output();
        self.hub.status_cache = None;
        for client in 0..CLIENTS {
            let most = self.queues[client as usize].len();
            for _ in 0..self.rng.random_range(0..=most) {
                let (id, request, stops) = self.queues[client as usize].pop_front().unwrap();
                self.hub
                    .handle(caller(2 * client + 1, id, stops), Ok(request));
            }
        }
        self.hub.follow_recording();
        self.hub.persist();
        for from in &self.replies {
            for (client, line) in from.try_iter() {
                let reply: Value = serde_json::from_str(&line).unwrap();
                let id = reply["id"].as_u64().unwrap();
                let Some((by, request)) = self.open.remove(&id) else {
                    panic!("{line}: answered twice");
                };
                assert_eq!(by, client, "{request:?}");
                assert_ne!(reply["code"], json!(3), "{line}");
                if reply["ok"] == json!(true) {
                    *self.accepted.entry(request.name()).or_default() += 1;
                }
            }
        }
    }

    /// A request of the first client that the hub receives at once.
    pub(super) fn ask(&mut self, request: Request) {
        let first = caller(1, json!(self.cycles), self.shared.stop.requested());
        self.hub.handle(first, Ok(request));
    }

    /// What a restart would read now: whenever drivers may move, the disk says so.
    pub(super) fn look_at_the_disk(&self) {
        while !self.hub.io.state_writer.is_idle() {
            std::thread::sleep(Duration::from_micros(200));
        }
        let state = self.folder.path().join("state");
        let slots = store::SLOTS.map(|name| store::read_slot(&state.join(name)).unwrap());
        let (_, memory) = slots
            .into_iter()
            .flatten()
            .max_by_key(|slot| slot.0)
            .unwrap();
        let mode = self.rt.runner.supervisor.mode();
        let moves = mode.moves() || mode == Mode::Relaxing;
        let away = self.seen.lock().unwrap().counted != Steps::default();
        assert!(memory.armed || !(moves || away), "{mode}, away {away}");
    }

    /// A client sends lines ahead, or disconnects.
    pub(super) fn send(&mut self) {
        let client = self.rng.random_range(0..CLIENTS);
        if self.rng.random_range(0..200) == 0 {
            self.queues[client as usize].clear();
            self.open.retain(|_, (by, _)| *by != 2 * client + 1);
            self.hub.forget(2 * client + 1, "disconnected");
            // what was on its way is answered to nobody
            self.hub
                .pending
                .retain(|_, p| p.caller.client != 2 * client + 1);
            if let Some(recording) = &mut self.hub.recording {
                recording.starting.take_if(|c| c.client == 2 * client + 1);
                recording.ending.retain(|c| c.client != 2 * client + 1);
            }
            return;
        }
        for request in requests(&mut self.rng) {
            self.queue(client, request);
        }
    }

    /// A client sends a line.
    pub(super) fn queue(&mut self, client: u64, request: Request) {
        self.sent += 1;
        if request == (Request::Stop {}) {
            self.shared.stop.request();
            return;
        }
        let stops = self.shared.stop.requested();
        self.open
            .insert(self.sent, (2 * client + 1, request.clone()));
        self.queues[client as usize].push_back((json!(self.sent), request, stops));
    }

    /// Reads what was answered to [`House::ask`], and takes the numbers of requests that were accepted until now.
    pub(super) fn accepted_until_now(&mut self) -> BTreeMap<String, u64> {
        if self.open.is_empty() {
            self.replies
                .iter()
                .for_each(|from| from.try_iter().for_each(drop));
        }
        std::mem::take(&mut self.accepted)
    }
}

/// True if the table leads from one mode to another in a cycle: by at most one event of an operator, and by what happens by itself.
fn may_follow(from: Mode, to: Mode) -> bool {
    let by_itself = |event: Event| {
        use Event::{Aligned, Doubted, Opened, Rested, RestedUnaligned, Settled, Stop, Trip};
        let list = [
            Aligned,
            Doubted,
            Opened,
            Rested,
            RestedUnaligned,
            Settled,
            Stop,
            Trip,
        ];
        list.contains(&event)
    };
    from == to
        || TABLE.iter().any(|&(one, before, between)| {
            let then = |&(two, before, after): &(Event, &[Mode], Mode)| {
                before.contains(&between) && after == to && (by_itself(one) || by_itself(two))
            };
            before.contains(&from) && (between == to || TABLE.iter().any(then))
        })
}
