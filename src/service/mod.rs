//! The service: a real-time loop and ordinary threads around it.
//!
//! ```text
//!      stop ═socket═ stop ────┐ (atomic counter)
//!  commands ═socket═ control ─┴──stop──▶ loop ──▶ machine
//!                      │ ▲                      ▲ │
//!                      ▼ │                orders│ │answers, frames   (wait-free rings)
//!  readers ═socket═ status ══ hub ──────────────┘ ▼
//!                        └──▶ state writer (disk), flight log (disk), recording (disk), systemd (notify socket)
//! ```
//!
//! The loop thread ([`rt_loop`]) uses no lock, no file and no allocator. Each socket has a thread ([`port`]); those of
//! `stop` and of the commands pass a stop to the loop directly ([`stop`]). The hub ([`hub`]) does everything else
//! and writes no file. If it is late, frames are lost and counted, and the loop is not affected. The loop watches the age
//! of the other threads ([`shared`]).

pub mod calibrate;
pub mod client;
pub mod connection;
pub mod disk;
pub mod error;
pub mod flight;
pub mod hub;
pub mod listener;
pub mod memory;
pub mod notify;
pub mod paths;
pub mod port;
pub mod protocol;
pub mod record;
pub mod rt_loop;
pub mod server;
pub mod shared;
pub mod start;
pub mod status;
pub mod stop;
pub mod store;

pub use error::ServiceError;
pub use listener::Listener;
pub use memory::{LearnedGains, Memory};
pub use notify::Notifier;
pub use port::{Caller, Port};
pub use protocol::{Failure, RecordAction, Request};
pub use rt_loop::Change;
pub use shared::{Shared, Watched};
pub use start::{RunConfig, Start};
pub use store::{Belief, StateWriter, Store};

use crate::config::ServiceSection;
use crate::hardware::rt::{self, RtRequest};
use crate::service::hub::{Facts, Hub, HubIo};
use crate::service::paths::Paths;
use crate::service::rt_loop::Loop;
use crate::service::store::{Found, Recall};
use crate::supervisor::{Machine, Runner};
use std::os::unix::fs::DirBuilderExt;
use std::path::PathBuf;
use std::sync::Arc;

/// The threads of the command socket and of `stop` have a real-time priority this far below that of the loop.
const CONTROL_BELOW: i32 = 20;

/// Exclusive use of the state folder and the sockets. It is taken before any device is opened, so that a second service
/// on the same machine ends without touching a pin.
pub struct Claim {
    store: Store,
    recall: Recall,
    control: Listener,
    status: Listener,
    stop: Listener,
}

impl Claim {
    /// Locks the state folder and creates the sockets.
    ///
    /// # Errors
    /// [`ServiceError`].
    pub fn new(service: &ServiceSection) -> Result<Self, ServiceError> {
        let paths = Paths::of(service);
        let (store, recall) = Store::open(&paths.state)?;
        let stop = paths::stop_socket(&paths.control);
        let (command, read) = (service.socket_mode, service.status_mode);
        let sockets = [
            (&paths.control, command),
            (&paths.status, read),
            (&stop, command),
        ];
        for folder in sockets.iter().filter_map(|(path, _)| path.parent()) {
            let mut builder = std::fs::DirBuilder::new();
            let created = builder.recursive(true).mode(0o755).create(folder);
            created.map_err(ServiceError::socket(folder))?;
        }
        // none is replaced unless all may be; the test whether a service answers on the last stops the tip of that service
        for (path, _) in sockets {
            Listener::is_stale(path)?;
        }
        let [control, status, stop] = sockets.map(|(path, mode)| Listener::bind(path, mode));
        Ok(Self {
            store,
            recall,
            control: control?,
            status: status?,
            stop: stop?,
        })
    }
}

/// Runs until a signal ends it, then returns the tip to rest. `pace` is that of simulated time beside real time, infinity as fast as
/// possible, `None` real time; `record` is a file to record into from the first cycle on.
///
/// # Errors
/// [`ServiceError`].
pub fn serve(
    claim: Claim,
    machine: Box<dyn Machine>,
    mut config: RunConfig,
    pace: Option<f64>,
    record: Option<PathBuf>,
) -> Result<(), ServiceError> {
    let (mut store, recall) = (claim.store, claim.recall);
    let (belief, memory) = believed(&recall, machine.is_simulated());
    if let (Some(gains), Some(file)) = (Start::accepted(&config, &memory), &config.calib) {
        let (tip, file) = (&gains.tip, file.display());
        tracing::info!(
            event = "calibration",
            "the accepted calibration of tip `{tip}` outranks {file}; to use the gains of the file, write another `tip` in it"
        );
    }
    let start = Start::new(&config, &memory, belief);
    config.supervisor = start.config.clone();
    if recall.found != Found::Intact {
        // from now on both slots say what is known
        store.write(&memory)?;
    }
    let remarks = machine.remarks();
    let notifier = Notifier::from_env();
    let shared = Arc::new(Shared::default());
    let (loop_rings, rings) = rt_loop::rings();
    let rt_loop = Loop {
        period_s: machine.info().period_s,
        runner: Runner::new(machine, start.supervisor()),
        rings: loop_rings,
        shared: Arc::clone(&shared),
        pace,
        heartbeat: notifier.heartbeat(),
    };
    let thread = rt::start("loop", wish(&config.service, pace), move || rt_loop.run());
    let (thread, grants) = thread.map_err(ServiceError::system("the loop thread"))?;
    let urgent = RtRequest {
        priority: control_priority(config.service.priority),
        cpu: None,
    };
    let stop = port::start_stop(claim.stop, Arc::clone(&shared), urgent);
    let stop = stop.map_err(ServiceError::system("the thread of stop"))?;
    let start_port = |socket, which, wish| {
        let port = Port::start(socket, Arc::clone(&shared), which, wish);
        port.map_err(ServiceError::system("a socket"))
    };
    let state_writer = StateWriter::start(store);
    let io = HubIo {
        control: start_port(claim.control, Watched::Control, urgent)?,
        status: start_port(claim.status, Watched::Status, RtRequest::default())?,
        notifier,
        state_writer: state_writer.map_err(ServiceError::system("the state writer"))?,
        rings,
        shared: Arc::clone(&shared),
    };
    let facts = Facts {
        remarks,
        grants,
        damaged: recall.damaged,
        belief,
    };
    let ended = Hub::new(io, config, memory, facts).run(record);
    shared.quit();
    thread.join().map_err(|_| ServiceError::LoopPanicked)??;
    ended?.into_iter().for_each(Port::join);
    // a thread that panicked has nothing left to do
    let _ = stop.join();
    Ok(())
}

/// What the loop's thread requests: nothing for simulated time.
fn wish(service: &ServiceSection, pace: Option<f64>) -> RtRequest {
    if pace.is_some() {
        return RtRequest::default();
    }
    let (priority, cpu) = (service.priority, service.cpu);
    RtRequest { priority, cpu }
}

/// Real-time priority of the threads that receive a stop: a busy computer delays no stop.
fn control_priority(of_loop: i32) -> i32 {
    match of_loop {
        ..=0 => 0,
        _ => (of_loop - CONTROL_BELOW).max(1),
    }
}

/// What is believed of a memory. A simulated plant begins at rest with the service, so only a damaged memory is doubted.
fn believed(recall: &Recall, simulated: bool) -> (Belief, Memory) {
    let (mut belief, mut memory) = (recall.belief(), recall.memory.clone().unwrap_or_default());
    let lost = recall.found == Found::Damaged || memory.lost;
    if simulated && belief != Belief::Certain && !lost {
        (belief, memory.restart, memory.unverified) = (Belief::Certain, None, false);
    }
    memory.lost = belief == Belief::Lost;
    for line in &recall.damaged {
        tracing::error!(event = "memory_damaged", "{line}");
    }
    if belief == Belief::Lost {
        let mend = "`retroflex status` says what ends that; `retroflex home`, without the service, does too";
        tracing::error!(
            event = "lost",
            "no memory tells where the pistons are: {mend}"
        );
    }
    (belief, memory)
}
