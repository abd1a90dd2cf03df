//! What people look at: charts as SVG, pages as one HTML file without scripts.

pub mod bars;
pub mod evaluation;
pub mod gap;
pub mod page;
pub mod polar;
pub mod svg;
