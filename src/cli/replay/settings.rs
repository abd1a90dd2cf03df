//! The settings that a flight log holds, and others to replay it with.

use crate::cli::inputs;
use crate::config::{Board, Calibration, Gains, source, supervisor};
use crate::diagnosis::tip::SavedModel;
use crate::estimation::fusion::estimator::EstimatorName;
use crate::model::DescribedMachine;
use crate::primitives::Check;
use crate::service::flight::start::Header;
use crate::supervisor::SupervisorConfig;
use miette::Result;
use serde::de::DeserializeOwned;
use std::path::PathBuf;
use std::sync::Arc;

/// Settings to replay a log with instead of its own.
#[derive(Debug, clap::Args)]
pub struct SettingsArgs {
    /// Also run it with this gains file and show what would have changed; it is speculation, because the recorded machine does
    /// not answer to it.
    #[arg(long)]
    gains: Option<PathBuf>,
    /// As `--gains`, with this calibration file.
    #[arg(long)]
    calib: Option<PathBuf>,
    /// As `--gains`, with this estimator of the orientation: `bend`, `madgwick`, `vqf`, `vqf-long` or `mekf`.
    #[arg(long, value_name = "NAME", value_parser = |name: &str| EstimatorName::try_from(name.to_owned()))]
    filter: Option<EstimatorName>,
    /// As `--gains`, fed forward through this model of `gap diagnose --save`.
    #[arg(long, value_name = "MODEL.toml")]
    feedforward: Option<PathBuf>,
}

impl SettingsArgs {
    /// True if there are any.
    pub fn any(&self) -> bool {
        let files = [&self.gains, &self.calib, &self.feedforward];
        self.filter.is_some() || files.into_iter().any(Option::is_some)
    }
}

/// The settings of a log.
#[derive(Clone)]
pub struct Settings {
    /// The board.
    pub board: Board,
    /// The gains.
    pub gains: Gains,
    /// The calibration.
    pub calibration: Calibration,
    /// The lines and dynamics of the log's header are in use instead of those of the calibration.
    learned: bool,
    feedforward: Option<Arc<DescribedMachine>>,
}

impl Settings {
    /// The settings that a log holds.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn of(header: &Header) -> std::result::Result<Self, String> {
        if header.log != 3 {
            let version = header.log;
            return Err(format!(
                "log version {version}; this program reads version 3"
            ));
        }
        let [board, gains, calibration, model @ ..] = header.texts.as_slice() else {
            return Err("has no configuration".to_owned());
        };
        let board: Board = text(board)?;
        let name = "model of the log";
        let parsed = |text: &String| -> std::result::Result<SavedModel, String> {
            source::parse(name, text).map_err(|e| e.to_string())
        };
        let model = model.first().map(parsed).transpose()?;
        Ok(Self {
            feedforward: model.map(|model| inputs::described_by(name, &model, &board)),
            gains: text(gains)?,
            calibration: text(calibration)?,
            learned: true,
            board,
        })
    }

    /// What a supervisor with these settings is made of.
    pub fn config(&self, header: &Header) -> SupervisorConfig {
        let (board, machine) = (&self.board, &header.machine);
        let mut config = supervisor::assemble(board, &self.calibration, &self.gains, machine);
        if let Some(machine) = &self.feedforward {
            config.tick = config.tick.fed_forward(Arc::clone(machine));
        }
        if self.learned {
            (config.tick.lines, config.tick.dynamics) = (header.lines, header.dynamics);
        }
        config
    }

    /// The settings with those of the command line.
    ///
    /// # Errors
    /// A report about a file.
    pub fn changed(mut self, args: &SettingsArgs) -> Result<Self> {
        self.gains = args.gains.as_deref().map_or(Ok(self.gains), source::read)?;
        self.gains.fuse.filter = args.filter.unwrap_or(self.gains.fuse.filter);
        if let Some(path) = &args.calib {
            (self.calibration, self.learned) = (source::read(path)?, false);
        }
        if let Some(path) = &args.feedforward {
            self.feedforward = Some(inputs::described(path, &self.board)?);
            self.learned = false;
        }
        Ok(self)
    }

    /// The settings as the header of a log holds them; `read` is the header of the log that is replayed.
    ///
    /// # Errors
    /// A report about a file.
    pub fn texts(&self, read: &Header, args: Option<&SettingsArgs>) -> Result<Vec<String>> {
        let mut texts = inputs::texts(&self.board, &self.gains, &self.calibration);
        texts.extend(match args.and_then(|args| args.feedforward.as_deref()) {
            Some(path) => Some(source::text_of(path)?),
            None => read.texts.get(texts.len()).cloned(),
        });
        Ok(texts)
    }
}

/// A configuration text of the log.
///
/// # Errors
/// What is wrong with it.
pub fn text<T: DeserializeOwned + Check>(text: &str) -> std::result::Result<T, String> {
    source::parse("configuration in the log", text).map_err(|e| e.to_string())
}
