//! Laws: pure, stateless, forward beside inverse (paper, Eq. 1-17).

pub mod arc;
pub mod bend;
pub mod drive;
pub mod effects;
pub mod transmission;
