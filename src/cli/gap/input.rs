//! Inputs that the gap commands share: machine, log and saved model.

use crate::cli::inputs;
use crate::diagnosis::plausibility;
use crate::diagnosis::rig::table::{self, MapError};
use crate::diagnosis::rig::{MapFile, Signals};
use crate::diagnosis::tip::Rig;
use crate::diagnosis::tip::observed::Observed;
use crate::log::bend_log;
use crate::model::Line;
use miette::{IntoDiagnostic, Result, bail, miette};
use std::path::{Path, PathBuf};

/// A machine, and what it was driven with while a log was recorded.
#[derive(Debug, clap::Args)]
pub struct DrivenArgs {
    /// Board file of the machine; default: the machine of the paper.
    #[arg(long, value_name = "FILE.toml")]
    board: Option<PathBuf>,
    /// Calibration the log was driven with.
    #[arg(long)]
    calib: Option<PathBuf>,
}

impl DrivenArgs {
    /// [`rig`] of the board file.
    ///
    /// # Errors
    /// As for [`rig`].
    pub fn rig(&self) -> Result<Rig> {
        rig(self.board.as_deref())
    }

    /// Names of the board file and of the calibration.
    pub fn named(&self) -> [String; 2] {
        let name = |file: &Option<PathBuf>| {
            let own = || "that of the paper".to_owned();
            file.as_deref().map_or_else(own, file_name)
        };
        [name(&self.board), name(&self.calib)]
    }

    /// The gains of the calibration.
    ///
    /// # Errors
    /// A report that names file and key.
    pub fn lines(&self) -> Result<[Line; 3]> {
        inputs::calibration(self.calib.as_deref()).map(|calibration| calibration.lines())
    }
}

/// The machine of a board file; by default the paper twin. A board file has no gains, so the priors are the paper's.
///
/// # Errors
/// A report that names file and key.
pub fn rig(board: Option<&Path>) -> Result<Rig> {
    let board = inputs::board(board)?;
    Ok(Rig {
        geometry: board.geometry.law(),
        bellow_mm: [board.geometry.bellow_min_mm, board.geometry.bellow_max_mm],
        travel_mm: board.limits.travel_mm,
        speed_max_mm_s: board.motion.speed_max_mm_s,
        ..Rig::default()
    })
}

/// Reads a bend log of a machine; a warning lists unknown columns.
///
/// # Errors
/// A report that names file, line and column, or says what to record instead; also for a log whose units or wiring cannot
/// be right.
pub fn observe(path: &Path, rig: &Rig) -> Result<Observed> {
    let log = bend_log::read(path).into_diagnostic()?;
    plausibility::check(&log, &rig.geometry, &[rig.prior; 3]).into_diagnostic()?;
    let observed = Observed::new(&log, rig).map_err(|e| miette!("{}: {e}", path.display()))?;
    if !log.ignored.is_empty() {
        let (file, columns) = (path.display(), log.ignored.join(", "));
        eprintln!("warning: {file}: unknown columns ignored: {columns}");
    }
    Ok(observed)
}

/// Reads a log with the map that stands in `file`.
///
/// # Errors
/// That of the reader; a column that the log lacks is named with its key in the map.
pub fn mapped(path: &Path, map: &MapFile, file: &Path) -> Result<Signals> {
    table::read(path, map).map_err(|e| {
        let lacking = match &e {
            MapError::Read(e) => e.lacking.as_deref(),
            _ => None,
        };
        let mut columns = map.columns().into_iter();
        match columns.find(|(_, name)| Some(*name) == lacking) {
            Some((key, _)) => miette!(
                "{e}; {} names it under `{key}`: correct the one that is wrong",
                file.display()
            ),
            None => miette!("{e}"),
        }
    })
}

/// Reads several logs.
///
/// # Errors
/// That of the reader, or a log that is given twice.
pub fn each<T>(paths: &[PathBuf], read: impl Fn(&Path) -> Result<T>) -> Result<Vec<T>> {
    let one = |(n, path): (usize, &PathBuf)| {
        if paths[..n].contains(path) {
            bail!("{}: given twice; a log counts once", path.display())
        } else {
            read(path)
        }
    };
    paths.iter().enumerate().map(one).collect()
}

/// The name of a file without its folder.
pub fn file_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}
