//! Inputs that several commands share: configuration files with their built-in defaults, and foreign plants.

use crate::config::{Board, Calibration, Gains, shipped, show, source};
use crate::diagnosis::tip::SavedModel;
use crate::hardware::rt;
use crate::model::DescribedMachine;
use crate::primitives::Check;
use miette::{IntoDiagnostic, Result, bail, miette};
use serde::de::DeserializeOwned;
use std::net::{SocketAddr, TcpListener};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A board file, or the board that comes with the program under this name; by default the paper twin.
///
/// # Errors
/// A report that names file, line and key.
pub fn board(path: Option<&Path>) -> Result<Board> {
    let Some(name) = path.filter(|p| !p.exists() && p.extension().is_none()) else {
        return read_or(path, shipped::SIM);
    };
    let name = name.display().to_string();
    let Some(text) = shipped::board(&name) else {
        let names = shipped::names();
        bail!("{name}: there is no such file, and no such board: the boards are {names}");
    };
    Ok(source::parse(&name, text)?)
}

/// The board file of the service where none is named: the user's, else the system's.
pub fn own_board() -> Option<PathBuf> {
    let folder = |variable: &str| std::env::var_os(variable).map(PathBuf::from);
    let user = folder("XDG_CONFIG_HOME").or_else(|| Some(folder("HOME")?.join(".config")));
    let folders = user.into_iter().chain(["/etc".into()]);
    let mut files = folders.map(|f| f.join("retroflex/board.toml"));
    files.find(|file| file.exists())
}

/// A gains file; by default `boards/gains.toml`.
///
/// # Errors
/// A report that names file, line and key.
pub fn gains(path: Option<&Path>) -> Result<Gains> {
    read_or(path, shipped::GAINS)
}

/// A calibration file; by default the paper's gains.
///
/// # Errors
/// A report that names file, line and key.
pub fn calibration(path: Option<&Path>) -> Result<Calibration> {
    read_or(path, shipped::PAPER)
}

/// A file of any kind, or what comes with the program in its place.
fn read_or<T: DeserializeOwned + Check>(
    path: Option<&Path>,
    (name, built_in): (&str, &str),
) -> Result<T> {
    Ok(match path {
        Some(path) => source::read(path)?,
        None => source::parse(name, built_in)?,
    })
}

/// A parser of options that take a number from a range.
pub fn within(
    allowed: RangeInclusive<f64>,
    unit: &'static str,
) -> impl Fn(&str) -> std::result::Result<f64, String> + Clone {
    move |text| match text.parse() {
        Ok(number) if allowed.contains(&number) => Ok(number),
        _ => {
            let (least, most) = (allowed.start(), allowed.end());
            Err(format!("expected a number from {least} to {most} {unit}"))
        }
    }
}

/// The machine that a saved model describes, without the effects that happen once, which are named on standard error.
///
/// # Errors
/// A report that names file and key.
pub fn described(path: &Path, board: &Board) -> Result<Arc<DescribedMachine>> {
    let model = tip_model(path)?;
    Ok(described_by(&path.display().to_string(), &model, board))
}

/// Whether a saved model is that of a mapped rig, and not of a tip.
///
/// # Errors
/// A report that names the file.
pub fn is_mapped(path: &Path) -> Result<bool> {
    let table: Option<toml::Table> = source::text_of(path)?.parse().ok();
    Ok(table.is_some_and(|table| table.contains_key("map")))
}

/// A saved model of a tip.
///
/// # Errors
/// A report that names file and key.
pub fn tip_model(path: &Path) -> Result<SavedModel> {
    if is_mapped(path)? {
        let file = path.display();
        bail!(
            "{file}: this is the model of a mapped rig, which only `gap check` reads; give the model of a tip"
        );
    }
    Ok(source::read(path)?)
}

/// The model for the feedforward, and its path: the one on the command line, or the one that the calibration file names.
///
/// # Errors
/// As for [`described`].
pub fn feedforward(
    given: &Option<PathBuf>,
    calib: &Option<PathBuf>,
    calibration: &Calibration,
    board: &Board,
) -> Result<Option<(PathBuf, Arc<DescribedMachine>)>> {
    let named = Some(&calibration.feedforward).filter(|name| !name.is_empty());
    let calib = calib.as_deref().unwrap_or(Path::new(""));
    let beside = |name| calib.with_file_name(name);
    let Some(path) = given.clone().or_else(|| named.map(beside)) else {
        return Ok(None);
    };
    let machine = described(&path, board)?;
    Ok(Some((path, machine)))
}

/// [`described`] for a model that has been read from `origin`.
pub fn described_by(origin: &str, model: &SavedModel, board: &Board) -> Arc<DescribedMachine> {
    let whole = model.described(board.geometry.law());
    let machine = whole.clone().foreseeable();
    let mut left_out: Vec<&str> = whole.names().collect();
    left_out.retain(|n| !machine.names().any(|m| m == *n));
    if !left_out.is_empty() {
        let names = left_out.join(", ");
        eprintln!("{origin}: left out, because it happens once: {names}");
    }
    Arc::new(machine)
}

/// Configuration texts as the header of a flight log holds them; the text of the model for the feedforward may follow.
pub fn texts(board: &Board, gains: &Gains, calibration: &Calibration) -> Vec<String> {
    vec![
        show::compact(board),
        show::compact(gains),
        show::compact(calibration),
    ]
}

/// Becomes true with a signal that ends a process.
///
/// # Errors
/// The operating system's.
pub fn ended() -> Result<Arc<AtomicBool>> {
    let ended = Arc::new(AtomicBool::new(false));
    for signal in rt::ending_signals() {
        signal_hook::flag::register(signal, Arc::clone(&ended)).into_diagnostic()?;
    }
    Ok(ended)
}

/// Program and arguments of `--plant 'exec:PROGRAM ARG…'`.
///
/// # Errors
/// A report that says what is missing.
pub fn program(plant: &str) -> Result<(String, Vec<String>)> {
    let refused = |why: &str| miette!("--plant `{plant}`: {why}");
    let line = plant.strip_prefix("exec:");
    let line = line.ok_or_else(|| refused("expected `exec:PROGRAM ARG…`"))?;
    let words = shlex::split(line).ok_or_else(|| refused("a quote is not closed"))?;
    match words.as_slice() {
        [program, args @ ..] => Ok((program.clone(), args.to_vec())),
        [] => Err(refused("no program is named after `exec:`")),
    }
}

/// Listens at the address of `--listen`; the result names the port, too, if that may be any.
///
/// # Errors
/// A report about an address at which nothing can be served.
pub fn listen(at: SocketAddr) -> Result<(SocketAddr, TcpListener)> {
    let opened = TcpListener::bind(at).and_then(|listener| Ok((listener.local_addr()?, listener)));
    opened.map_err(|e| {
        let why = e.kind();
        miette!("--listen {at}: {why}; name an address of this computer and a free port")
    })
}
