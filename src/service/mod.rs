//! The service: a real-time loop and ordinary threads around it.
//!
//! ```text
//!  commands ═socket═ control ──stop (atomic)──▶ loop ──▶ machine
//!                      │ ▲                      ▲ │
//!                      ▼ │                orders│ │answers, frames, restart notes   (wait-free rings)
//!  readers ═socket═════ hub ────────────────────┘ ▼
//!                        └──▶ state writer (disk), recording (disk), systemd (notify socket)
//! ```
//!
//! The loop thread ([`rt_loop`]) uses no lock, no file and no allocator. The control thread ([`control_port`]) serves the
//! command socket and passes `stop` to the loop directly. The hub ([`hub`]) does everything that may wait. If the hub is
//! late, frames are lost and counted, and the loop is not affected.

pub mod calibrate;
pub mod client;
pub mod control_port;
pub mod error;
pub mod hub;
pub mod memory;
pub mod notify;
pub mod protocol;
pub mod record;
pub mod rt_loop;
pub mod server;
pub mod start;
pub mod state_writer;
pub mod status;
pub mod stop;
pub mod store;
pub mod tape;
pub mod tape_code;

use crate::config::service::ServiceSection;
use crate::hardware::rt::{self, RtRequest};
use crate::service::control_port::ControlPort;
use crate::service::error::ServiceError;
use crate::service::hub::{Facts, Hub, HubIo};
use crate::service::notify::Notifier;
use crate::service::rt_loop::{HeartbeatMonitor, Loop, Shared};
use crate::service::server::{Server, Waker};
use crate::service::start::{RunConfig, Start};
use crate::service::state_writer::StateWriter;
use crate::service::stop::StopCounter;
use crate::service::store::{Recall, Store};
use crate::supervisor::cycle::runner::Runner;
use crate::supervisor::machine::Machine;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::channel;

/// Exclusive use of the state folder and the sockets. It is taken before any device is opened, so that a second service
/// on the same machine ends without touching a pin.
pub struct Claim {
    store: Store,
    recall: Recall,
    control: (Server, Waker),
    status: (Server, Waker),
}

impl Claim {
    /// Locks the state folder and creates the sockets.
    ///
    /// # Errors
    /// [`ServiceError`].
    pub fn new(service: &ServiceSection) -> Result<Self, ServiceError> {
        let (store, recall) = Store::open(&service.state)?;
        let control = Server::bind(&service.socket, service.socket_mode, 1)?;
        let status = Server::bind(&service.status_socket, service.status_mode, 2)?;
        Ok(Self { store, recall, control, status })
    }
}

/// The machine and the way to run it.
pub struct Setup {
    /// The machine, opened.
    pub machine: Box<dyn Machine>,
    /// The configuration.
    pub config: RunConfig,
    /// How many times faster than real time a simulation runs; infinity: as fast as possible. `None`: in real time.
    pub pace: Option<f64>,
    /// Record from the first cycle on into this file.
    pub record: Option<PathBuf>,
}

/// Runs until a signal ends it, then returns the tip to rest.
///
/// # Errors
/// [`ServiceError`].
pub fn serve(claim: Claim, setup: Setup) -> Result<(), ServiceError> {
    let Setup { machine, mut config, pace, record } = setup;
    log_recall(&claim.recall);
    let memory = claim.recall.memory.unwrap_or_default();
    let start = Start::new(&config, &memory, claim.recall.unreadable);
    config.supervisor = start.config.clone();
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
        heartbeat: HeartbeatMonitor::new(notifier.heartbeat()),
        stops: StopCounter::default(),
    };
    // a simulation that runs ahead of time would take its processor from everybody
    let wish = if pace.is_some() {
        RtRequest { priority: 0, cpu: None }
    } else {
        RtRequest { priority: config.service.priority, cpu: config.service.cpu }
    };
    let (report, reported) = channel();
    let thread = std::thread::Builder::new().name("loop".into()).spawn(move || {
        let (status, _guard) = rt::enter(&wish);
        // the receiver is gone only if the service could not start
        let _ = report.send(status);
        rt_loop.run()
    });
    let thread = thread.map_err(ServiceError::system("the loop thread"))?;
    let grants = reported.recv().map_err(|_| ServiceError::LoopPanicked)?;
    let (status, hub_waker) = claim.status;
    let (control, waker) = claim.control;
    let io = HubIo {
        control: ControlPort::start(control, waker, hub_waker, Arc::clone(&shared)).map_err(ServiceError::system("the control thread"))?,
        status,
        notifier,
        state_writer: StateWriter::start(claim.store).map_err(ServiceError::system("the state writer"))?,
        rings,
        shared: Arc::clone(&shared),
    };
    let facts = Facts { remarks, grants, damaged: claim.recall.damaged, unreadable: claim.recall.unreadable };
    let ended = Hub::new(io, config, memory, facts).run(record);
    shared.quit();
    match thread.join() {
        Ok(result) => result?,
        Err(_) => return Err(ServiceError::LoopPanicked),
    }
    ended
}

fn log_recall(recall: &Recall) {
    for line in &recall.damaged {
        tracing::error!(event = "memory_damaged", "{line}");
    }
    if recall.unreadable {
        tracing::error!(event = "memory_unreadable", "no intact memory is left, so the piston positions are unknown: `retroflex zero`");
    }
}
