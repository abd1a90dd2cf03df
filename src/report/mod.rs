//! Reports for people: charts as SVG, pages as single HTML files without scripts.

pub mod bars;
pub mod chart;
pub mod evaluation;
pub mod gap;
pub mod page;
pub mod polar;
pub mod svg;
pub mod sweep;
pub mod table;
pub mod wiring;
