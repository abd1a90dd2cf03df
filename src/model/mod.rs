//! Kinematics and transmission of the tip (paper, Eq. 1-17), forward beside inverse, and the effects beyond them.

pub mod arc;
pub mod bend;
pub mod chain;
pub mod described;
pub mod drive;
pub mod effects;
pub mod nominal;
pub mod transmission;

pub use arc::{Geometry, Shape};
pub use bend::Bend;
pub use chain::Chain;
pub use described::{DescribedMachine, RestReadings, orientation};
pub use drive::Drive;
pub use nominal::{Event, Mode, Model, NOMINAL, lines, nominal_theta};
pub use transmission::{Line, Side, SideState};
