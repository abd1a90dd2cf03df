//! What people look at: charts as SVG, pages as one HTML file without scripts.

pub mod evaluation;
pub mod page;
pub mod svg;
