//! What every command writes: result files, standard output, tables and progress.
//!
//! A result option takes a file name, or `-` for standard output.

use crate::config::Calibration;
use crate::hardware::rt;
use crate::primitives::Parameters;
use crate::primitives::file::is_irregular;
pub use crate::report::table::table;
use clap::ArgMatches;
use indicatif::{ProgressBar, ProgressFinish, ProgressStyle};
use miette::{IntoDiagnostic, Result, bail, miette};
use serde::Serialize;
use signal_hook::iterator::Signals;
use std::borrow::Cow;
use std::ffi::OsString;
use std::fmt;
use std::fs::Metadata;
use std::io::{Read, Stdout, Write};
use std::ops::Deref;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The file of a result, as an option of a command names it; `-` is standard output. Every argument that is a path of another type is
/// an input. Before a command runs, [`check_arguments`] protects the inputs from its results.
#[derive(Debug, Clone)]
pub struct ResultFile(PathBuf);

impl From<OsString> for ResultFile {
    fn from(path: OsString) -> Self {
        Self(path.into())
    }
}

impl Deref for ResultFile {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.0
    }
}

/// A temporary folder, which is removed at the end and on a signal that ends the program.
pub struct Scratch(pub PathBuf);

impl Scratch {
    /// Creates the folder; `name` becomes a part of its name.
    ///
    /// # Errors
    /// A report that names the folder.
    pub fn new(name: &str) -> Result<Self> {
        let path = std::env::temp_dir().join(format!("retroflex-{name}-{}", std::process::id()));
        std::fs::create_dir(&path).map_err(|e| miette!("{}: {e}", path.display()))?;
        let mut signals = Signals::new(rt::ending_signals()).into_diagnostic()?;
        let folder = path.clone();
        std::thread::spawn(move || {
            if let Some(signal) = signals.forever().next() {
                // the operating system removes what is left
                let _ = std::fs::remove_dir_all(folder);
                std::process::exit(128 + signal);
            }
        });
        Ok(Self(path))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // the operating system removes what is left
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Time after which progress shows that the work goes on.
const TICK: Duration = Duration::from_millis(200);

/// Progress of long work on standard error, shown only on a terminal: a bar if the length is known, else a spinner, followed by
/// `text` (an `indicatif` template) and the elapsed time. It vanishes when it is dropped.
pub fn bar(length: u64, text: &str) -> ProgressBar {
    let (bar, shape) = match length {
        0 => (ProgressBar::new_spinner(), "{spinner}"),
        _ => (ProgressBar::new(length), "{bar:40}"),
    };
    let bar = bar.with_finish(ProgressFinish::AndClear);
    bar.enable_steady_tick(TICK);
    if let Ok(style) = ProgressStyle::with_template(&format!("{shape} {text} {{elapsed}}")) {
        bar.set_style(style);
    }
    bar
}

/// Prints on standard output, without control characters. A reader that has closed its end, such as `head`, is not an error; any other
/// obstacle, such as a full disk, ends the program with code 2.
pub fn print(text: impl AsRef<[u8]>) {
    let text = printable(text.as_ref());
    // whoever prints once has nothing left to do for a reader that has gone
    let _ = print_with(|out| out.write_all(&text));
}

/// Prints on standard output by a function that does so, as [`print()`] does; false if the reader has closed its end.
pub fn print_with(write: impl FnOnce(&mut Stdout) -> std::io::Result<()>) -> bool {
    let mut out = std::io::stdout();
    match write(&mut out).and_then(|()| out.flush()) {
        Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => false,
        Err(e) => unprintable(&format!("standard output: {e}")),
        Ok(()) => true,
    }
}

/// The text with its control characters escaped, but for the ends of its lines and tabs: names from a log, a memory or a client must not
/// command the terminal.
pub fn printable(text: &[u8]) -> Cow<'_, [u8]> {
    let safe = |c: char| !c.is_control() || matches!(c, '\n' | '\t');
    let lossy = String::from_utf8_lossy(text);
    if lossy.chars().all(safe) {
        return Cow::Borrowed(text);
    }
    Cow::Owned(escaped(&lossy, safe).into_bytes())
}

/// The text with all but its safe characters escaped.
pub fn escaped(text: &str, is_safe: impl Fn(char) -> bool) -> String {
    let shown = |c: char| {
        if is_safe(c) {
            c.to_string()
        } else {
            c.escape_default().to_string()
        }
    };
    text.chars().map(shown).collect()
}

/// Ends the program with code 2, with this message if it can be printed.
fn unprintable(message: &str) -> ! {
    let _ = writeln!(std::io::stderr(), "{message}");
    std::process::exit(2)
}

/// Makes a message that cannot be printed, because nobody reads it or the disk is full, end the program with code 2. The macros of the
/// standard library panic.
pub fn exit_on_print_failure() {
    let otherwise = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| match info.payload_as_str() {
        Some(text) if text.starts_with("failed printing to") => unprintable(text),
        _ => otherwise(info),
    }));
}

/// Prints text for people on standard output, or on standard error if a result occupies standard output.
pub fn show(text: impl fmt::Display, result: &Option<ResultFile>) {
    if result.as_deref().is_some_and(is_stdout) {
        eprint!("{text}")
    } else {
        print(text.to_string())
    }
}

/// [`check`] of the results and the inputs among the arguments of a command.
///
/// # Errors
/// As for [`check`].
pub fn check_arguments(mut arguments: &ArgMatches) -> Result<()> {
    while let Some((_, inner)) = arguments.subcommand() {
        arguments = inner;
    }
    let names = || arguments.ids().map(clap::Id::as_str);
    let result = |name| Some((name, &**arguments.try_get_one::<ResultFile>(name).ok()??));
    let results: Vec<(&str, &Path)> = names().filter_map(result).collect();
    let inputs = names().filter_map(|name| arguments.try_get_many::<PathBuf>(name).ok()?);
    let inputs: Vec<&Path> = inputs.flatten().map(PathBuf::as_path).collect();
    check(&results, &inputs)
}

/// Checks, before any work starts, that every result can be written and that none replaces an input.
///
/// `results` are pairs of option, without its dashes, and path. A result is refused if its folder does not exist, if another result has
/// the same path, if it is one of the `inputs` (links included), or if it would replace a file of another kind. The last case protects
/// recordings from `--json *.csv`, which the shell expands so that the first recording becomes the result.
///
/// # Errors
/// A report that names the option, the file and the obstacle.
pub fn check(results: &[(&str, &Path)], inputs: &[&Path]) -> Result<()> {
    for (n, &(option, path)) in results.iter().enumerate() {
        let file = path.display();
        if let Some((other, _)) = results[..n].iter().find(|r| r.1 == path) {
            bail!(
                "{file}: both --{other} and --{option} name this file; give each result its own file"
            );
        }
        if is_stdout(path) {
            continue;
        }
        if path.is_dir() {
            bail!("--{option} {file}: this is a folder; give the name of a file");
        }
        if !folder_of(path).is_dir() {
            let folder = folder_of(path).display();
            bail!("--{option} {file}: the folder {folder} does not exist; create it first");
        }
        if !is_irregular(path) {
            let probe = beside(path);
            let made = std::fs::File::create(&probe).and_then(|_| std::fs::remove_file(&probe));
            made.map_err(|e| {
                miette!("--{option} {file}: {e}; name a file in a folder in which you may write")
            })?;
        }
        if let Some(input) = inputs.iter().find(|input| same_file(path, input)) {
            let input = input.display();
            bail!(
                "--{option} {file} would overwrite the input file {input}; give the result another name"
            );
        }
        check_kind(option, path, inputs)?;
    }
    Ok(())
}

/// Refuses to replace a file whose content is not what the option writes.
fn check_kind(option: &str, path: &Path, inputs: &[&Path]) -> Result<()> {
    // opening a pipe could block
    if !path.is_file() {
        return Ok(());
    }
    let file = path.display();
    let old = head(path).map_err(|e| miette!("--{option} {file}: {e}"))?;
    if old.trim_ascii().is_empty() || may_replace(option, path, old.trim_ascii_start()) {
        return Ok(());
    }
    let inputs: Vec<String> = inputs.iter().map(|p| p.display().to_string()).collect();
    let beside = if inputs.is_empty() { "" } else { " beside " };
    let inputs = inputs.join(", ");
    bail!(
        "--{option} {file} would overwrite an existing file of another kind, perhaps an input{beside}{inputs}; give the result another name"
    )
}

/// Whether a file that begins with `old` is of the kind that the option writes.
fn may_replace(option: &str, path: &Path, old: &[u8]) -> bool {
    let text = || std::fs::read_to_string(path).ok();
    let table = || text()?.parse::<toml::Table>().ok();
    let has = |key: &str| table().is_some_and(|table| table.contains_key(key));
    // a file with nothing but `[imu]` is a calibration, too
    let known = <Calibration as Parameters>::TABLE;
    let is_calibration = |table: toml::Table| table.keys().all(|key| known.row(key).is_some());
    match (option, path.extension().and_then(|e| e.to_str())) {
        ("json", _) => matches!(old[0], b'{' | b'['),
        ("html" | "svg", _) => old[0] == b'<',
        ("parquet" | "rows" | "merged", _) => old.starts_with(b"PAR1"),
        ("save", _) => has("with_effects"),
        ("calib" | "prior", _) | ("out", Some("toml")) => {
            table().is_some_and(is_calibration) || has("conformal")
        }
        ("csv", _) | ("out", Some("csv")) => {
            old.starts_with(b"\x1f\x8b")
                || (old.contains(&b',') && table().is_none() && old[0] != b'<')
        }
        ("out", Some("mcap")) => old.starts_with(b"\x89MCAP"),
        ("out", _) => table().is_none() && old[0] != b'<',
        _ => true,
    }
}

fn head(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut file = std::fs::File::open(path)?.take(64);
    file.read_to_end(&mut bytes).map(|_| bytes)
}

fn same_file(a: &Path, b: &Path) -> bool {
    let file = |path: &Path| path.metadata().ok().filter(|m| m.is_file());
    let same = |(a, b): (Metadata, Metadata)| (a.dev(), a.ino()) == (b.dev(), b.ino());
    file(a).zip(file(b)).is_some_and(same)
}

/// Writes a result, if its file is named.
///
/// # Errors
/// That of the content, or as [`write()`].
pub fn write_some<T: AsRef<[u8]>>(
    file: &Option<ResultFile>,
    content: impl FnOnce() -> Result<T>,
) -> Result<()> {
    let file = file.as_deref();
    file.map_or(Ok(()), |path| write(path, content()?))
}

/// Writes a value as indented JSON, if a file is named.
///
/// # Errors
/// As [`write()`].
pub fn json(file: &Option<ResultFile>, value: &impl Serialize) -> Result<()> {
    let text = || serde_json::to_string_pretty(value).into_diagnostic();
    write_some(file, || Ok(text()? + "\n"))
}

/// The answer of a command: as JSON, if a file is named, and for people.
///
/// # Errors
/// As [`write()`].
pub fn answer(
    file: &Option<ResultFile>,
    value: &impl Serialize,
    text: impl fmt::Display,
) -> Result<()> {
    json(file, value)?;
    show(text, file);
    Ok(())
}

/// Writes a file atomically: to a temporary file in the same folder, which then replaces the old one.
///
/// # Errors
/// A report that names the file and the system's reason.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    let content = content.as_ref();
    if is_stdout(path) {
        print(content);
        return Ok(());
    }
    // pipes and devices are written in place
    if is_irregular(path) {
        return std::fs::write(path, content).map_err(|e| miette!("{}: {e}", path.display()));
    }
    let beside = beside(path);
    replace(path, &beside, content).map_err(|e| {
        // the temporary file may not exist
        let _ = std::fs::remove_file(&beside);
        miette!("{}: {e}", path.display())
    })
}

/// The temporary file of a result.
fn beside(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    folder_of(path).join(format!(".{name}.{}.part", std::process::id()))
}

fn replace(path: &Path, beside: &PathBuf, content: &[u8]) -> std::io::Result<()> {
    let mut file = std::fs::File::create(beside)?;
    file.write_all(content)?;
    file.sync_all()?;
    std::fs::rename(beside, path)
}

fn is_stdout(path: &Path) -> bool {
    path == Path::new("-")
}

fn folder_of(path: &Path) -> &Path {
    let parent = path.parent().filter(|p| !p.as_os_str().is_empty());
    parent.unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn write_replaces_whole_files_and_leaves_nothing_beside() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.json");
        write(&path, "one").unwrap();
        write(&path, "two").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "two");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    fn refusal(results: &[(&str, &Path)], inputs: &[&Path]) -> String {
        check(results, inputs).unwrap_err().to_string()
    }

    #[test]
    fn check_names_the_obstacle() {
        let folder = tempfile::tempdir().unwrap();
        assert!(refusal(&[("json", folder.path())], &[]).contains("is a folder"));
        let lost = folder.path().join("no/r.json");
        assert!(refusal(&[("json", &lost)], &[]).contains("does not exist"));
        assert!(write(&lost, "").is_err());
        let one = Path::new("r.out");
        assert!(refusal(&[("json", one), ("html", one)], &[]).contains("both --json and --html"));
        assert!(check(&[("json", Path::new("-"))], &[]).is_ok());
    }

    #[test]
    fn check_protects_inputs() {
        let folder = tempfile::tempdir().unwrap();
        let [input, link, old] = ["a.csv", "b.csv", "old.json"].map(|n| folder.path().join(n));
        std::fs::write(&input, "time_s,piston1_mm\n").unwrap();
        std::os::unix::fs::symlink(&input, &link).unwrap();
        for result in [&input, &link] {
            let text = refusal(&[("out", result)], &[&input]);
            assert!(
                text.contains("would overwrite the input file") && text.contains("a.csv"),
                "{text}"
            );
        }
        assert!(refusal(&[("json", &input)], &[]).contains("another kind"));
        std::fs::write(&old, "[]\n").unwrap();
        assert!(check(&[("json", &old)], &[&input]).is_ok());
    }

    #[test]
    fn a_result_replaces_files_of_its_own_kind_only() {
        let folder = tempfile::tempdir().unwrap();
        let may = |option: &str, name: &str, old: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, old).unwrap();
            may_replace(option, &path, old.as_bytes())
        };
        assert!(may("out", "a.toml", "[imu]\n"));
        assert!(may(
            "calib",
            "a.toml",
            "[transmission]\nk_epsilon = [2.2, 2.2, 2.2]\nk_lambda_mm = [0.8, 0.8, 0.8]\n"
        ));
        assert!(!may("calib", "a.toml", "base = \"demo\"\n[pins]\n"));
        assert!(may("csv", "a.csv", "t_s,p1_mm\n") && !may("csv", "a.csv", "a = \"1,2\"\n"));
        assert!(!may("save", "a.toml", "[transmission]\n") && !may("json", "a.csv", "t_s,p1_mm\n"));
    }
}
