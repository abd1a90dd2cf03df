//! A pilot and its machine, turn by turn.

use crate::primitives::units::{Seconds, Steps};
use crate::supervisor::cycle::order::Order;
use crate::supervisor::cycle::{CycleOutput, Supervisor};
use crate::supervisor::machine::MachineError;
use crate::supervisor::machine::{Machine, Sensed};

/// A pilot at the controls of a machine.
#[derive(Debug)]
pub struct Runner<M> {
    /// The machine.
    pub machine: M,
    /// The pilot.
    pub supervisor: Supervisor,
    wanted: Steps,
    /// What the machine was told; nothing before the first turn.
    energised: Option<bool>,
}

impl<M: Machine> Runner<M> {
    /// Nothing has been sensed yet.
    pub fn new(machine: M, supervisor: Supervisor) -> Self {
        let wanted = supervisor.keep().steps;
        Self { machine, supervisor, wanted, energised: None }
    }

    /// One turn at `now`: the machine hands over what came and takes what was wanted, the pilot decides.
    ///
    /// # Errors
    /// The machine's.
    pub fn turn(&mut self, now: Seconds, order: Option<Order>) -> Result<CycleOutput, MachineError> {
        let sensed: Sensed = self.machine.turn(now, &self.wanted)?;
        let turned = self.supervisor.turn(&sensed, order);
        if self.energised != Some(turned.energise) {
            self.energised = Some(turned.energise);
            self.machine.energise(turned.energise);
        }
        if turned.clear {
            self.machine.clear();
        }
        if let Some(counted) = turned.recount {
            self.machine.recount(&counted);
        }
        self.wanted = turned.steps;
        Ok(turned)
    }
}
