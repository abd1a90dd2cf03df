//! The daemon: one loop that nothing may delay, and ordinary threads around it.
//!
//! ```text
//!  clients ═socket═ hub ──orders──▶ loop ──▶ machine
//!                    ▲ ◀─answers───  │
//!                    │ ◀─frames────  │        all four rings are wait-free
//!                    │ ◀─keeps─────  ┘
//!                    └─▶ keeper (disk)   recorder (disk)   systemd (notify socket)
//! ```
//!
//! The loop thread flies ([`rt_loop`]); it touches no lock, no file and no allocator. The hub thread
//! ([`hub`]) reads and answers clients, follows the frames and does everything that may wait; what must
//! be forced to a disk goes through the keeper. When the hub is slow, frames are lost and counted, and
//! the loop does not notice.

pub mod calibrate;
pub mod client;
pub mod hub;
pub mod memory;
pub mod notify;
pub mod protocol;
pub mod record;
pub mod rt_loop;
pub mod server;
pub mod state_writer;
pub mod status;
pub mod tape;

use crate::config::board::Board;
use crate::config::gains::Gains;
use crate::config::service::ServiceSection;
use crate::hardware::rt::{self, RtRequest};
use crate::service::hub::Hub;
use crate::service::memory::{Memory, MemoryError, Recall, Store};
use crate::service::notify::Notifier;
use crate::service::rt_loop::{Loop, Shared};
use crate::service::server::Server;
use crate::supervisor::cycle::runner::Runner;
use crate::supervisor::cycle::{Supervisor, SupervisorConfig};
use crate::supervisor::machine::Machine;
use crate::supervisor::machine::MachineError;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::channel;
use thiserror::Error;

/// Everything a service is started from.
pub struct Setup {
    /// The machine, open.
    pub machine: Box<dyn Machine>,
    /// What the pilot runs on.
    pub supervisor: SupervisorConfig,
    /// The daemon's own table.
    pub service: ServiceSection,
    /// The board, to put a reload together.
    pub board: Board,
    /// The gains file, to read again at a reload; `None` runs on the defaults.
    pub gains: Option<PathBuf>,
    /// The gains in use.
    pub gains_now: Gains,
    /// The calibration in use.
    pub calibration: crate::config::calib::Calibration,
    /// Identity of the tip that is mounted; empty if none was given.
    pub tip: String,
    /// Hash of board, gains and calibration.
    pub config_hash: String,
    /// Texts of board, gains and calibration, for the tape.
    pub texts: [String; 3],
    /// Do not wait for the clock: a simulation as fast as it goes.
    pub fast: bool,
    /// Record from the first turn on, into this file.
    pub record: Option<PathBuf>,
}

/// Why a service ended, other than by being told to.
#[derive(Debug, Error)]
pub enum ServiceError {
    /// Memory cannot be used.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// The machine is gone.
    #[error(transparent)]
    World(#[from] MachineError),
    /// A socket cannot be made.
    #[error("{path}: {source}; RuntimeDirectory= in the unit makes the folder, `--socket` names another")]
    Socket {
        /// Its path.
        path: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The operating system gave no thread, or a recording could not be begun.
    #[error("{what}: {source}")]
    System {
        /// What was wanted.
        what: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The loop ended by a panic.
    #[error("the loop ended unexpectedly; this is a fault of the program, please report it with the log")]
    Died,
}

/// Runs until told to end; ends relaxed.
///
/// # Errors
/// [`ServiceError`].
pub fn serve(setup: Setup) -> Result<(), ServiceError> {
    let (store, recall) = Store::open(&setup.service.state)?;
    report_recall(&recall);
    let memory = recall.memory.unwrap_or_default();
    let supervisor = supervisor_of(&setup, &memory, recall.unknown);
    let period_s = setup.machine.info().period_s;
    let remarks = setup.machine.remarks();
    let server = Server::bind(&setup.service)?;
    let notifier = Notifier::from_env();
    let shared = Arc::new(Shared::default());
    let (wires, other_end) = rt_loop::wires();
    let turning = Loop {
        runner: Runner::new(setup.machine, supervisor),
        wires,
        shared: Arc::clone(&shared),
        period_s,
        fast: setup.fast,
        feed: notifier.watchdog(),
    };
    let wish = RtRequest { priority: setup.service.priority, cpu: setup.service.cpu };
    let (tell, told) = channel();
    let thread = std::thread::Builder::new().name("loop".into()).spawn(move || {
        let (status, _guard) = rt::enter(&wish);
        // nobody waits for it any more only when the service is ending
        let _ = tell.send(status);
        turning.run()
    });
    let thread = thread.map_err(|source| ServiceError::System { what: "the loop's thread".to_owned(), source })?;
    let grants = told.recv().map_err(|_| ServiceError::Died)?;
    let state_writer =
        state_writer::start(store).map_err(|source| ServiceError::System { what: "the keeper's thread".to_owned(), source })?;
    let hub = Hub::new(hub::Parts {
        server,
        notifier,
        state_writer,
        other_end,
        shared: Arc::clone(&shared),
        memory,
        board: setup.board,
        gains: setup.gains,
        gains_now: setup.gains_now,
        calibration: setup.calibration,
        tip: setup.tip,
        config_hash: setup.config_hash,
        texts: setup.texts,
        service: setup.service,
        remarks,
        grants,
        set_aside: recall.set_aside,
        doubted: recall.unknown,
        supervisor: setup.supervisor,
        fast: setup.fast,
    });
    let ended = hub.run(setup.record);
    shared.quit();
    match thread.join() {
        Ok(result) => result?,
        Err(_) => return Err(ServiceError::Died),
    }
    ended
}

fn report_recall(recall: &Recall) {
    for line in &recall.set_aside {
        tracing::error!(event = "memory_set_aside", "{line}");
    }
    if recall.unknown {
        tracing::error!(event = "memory_unknown", "nothing that is remembered can be believed: `zero` is asked for");
    }
}

/// A pilot with what is remembered of this very tip.
fn supervisor_of(setup: &Setup, memory: &Memory, unknown: bool) -> Supervisor {
    let mut config = setup.supervisor.clone();
    if let Some(gains) = memory.accepted.as_ref().filter(|g| g.tip == setup.tip) {
        config.tick.lines =
            std::array::from_fn(|i| crate::model::transmission::Line { k_epsilon: gains.k_epsilon[i], k_lambda_mm: gains.k_lambda_mm[i] });
        config.tick.dynamics = crate::control::pi::Dynamics { lag_s: gains.lag_s, delay_s: gains.delay_s };
    }
    let mut kept = memory.kept;
    if let Some(kept) = &mut kept
        && memory.tip != setup.tip
    {
        // another tip has other gains; where the pistons stand is the machine's
        kept.k_epsilon = config.tick.lines.map(|l| l.k_epsilon);
        kept.k_lambda_mm = config.tick.lines.map(|l| l.k_lambda_mm);
        kept.rest = None;
    }
    let mut supervisor = Supervisor::new(config, kept);
    if unknown {
        supervisor.doubt();
    }
    supervisor
}
