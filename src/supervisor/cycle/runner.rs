//! Couples a supervisor to its machine.

use crate::primitives::{Seconds, Steps};
use crate::supervisor::{CycleOutput, Machine, MachineError, Order, Sensed, Supervisor};

/// A machine with its supervisor.
#[derive(Debug)]
pub struct Runner<M: ?Sized> {
    /// The machine.
    pub machine: Box<M>,
    /// The supervisor.
    pub supervisor: Supervisor,
    wanted: Steps,
    /// Last request to the drivers; `None` before the first cycle.
    energised: Option<bool>,
}

impl<M: Machine + ?Sized> Runner<M> {
    /// A runner before its first cycle.
    pub fn new(machine: impl Into<Box<M>>, supervisor: Supervisor) -> Self {
        let wanted = supervisor.keep().steps;
        Self {
            machine: machine.into(),
            supervisor,
            wanted,
            energised: None,
        }
    }

    /// One cycle at `now`: exchanges counts and samples with the machine, then runs the supervisor.
    ///
    /// # Errors
    /// [`MachineError`] of the machine.
    pub fn turn(
        &mut self,
        now: Seconds,
        order: Option<Order>,
    ) -> Result<CycleOutput, MachineError> {
        let sensed = self.sense(now)?;
        Ok(self.act(&sensed, order))
    }

    /// The first half of a cycle: exchanges counts and samples with the machine.
    ///
    /// # Errors
    /// [`MachineError`] of the machine.
    pub fn sense(&mut self, now: Seconds) -> Result<Sensed, MachineError> {
        self.machine.turn(now, &self.wanted)
    }

    /// The second half: runs the supervisor, and passes what it decides to the machine.
    pub fn act(&mut self, sensed: &Sensed, order: Option<Order>) -> CycleOutput {
        let output = self.supervisor.turn(sensed, order);
        if self.energised != Some(output.energise) {
            self.energised = Some(output.energise);
            self.machine.energise(output.energise);
        }
        if output.clear {
            self.machine.clear();
        }
        if let Some(counted) = output.recount {
            self.machine.recount(&counted);
        }
        self.wanted = output.steps;
        output
    }
}
