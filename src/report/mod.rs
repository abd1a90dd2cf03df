//! Reports for people: answers in words and tables, charts as SVG, pages as single HTML files without scripts.

pub mod bars;
pub mod chart;
pub mod evaluation;
pub mod exam;
pub mod fleet;
pub mod gap;
pub mod page;
pub mod polar;
pub mod svg;
pub mod sweep;
pub mod table;
pub mod wiring;

pub use chart::{Axis, Chart, Series, Stroke};
pub use page::Page;
pub use svg::Ink;
pub use table::table;
