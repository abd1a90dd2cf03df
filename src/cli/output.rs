//! What every command shows alike: results on disk, whole or not at all, and progress.

use indicatif::{ProgressBar, ProgressStyle};
use miette::{Result, miette};
use std::io::Write;
use std::path::Path;

/// Progress of long work, on stderr, and only where that is a terminal: a bar if its length is known, then `text`
/// (a template of `indicatif`) and the time.
#[must_use]
pub fn bar(length: u64, text: &str) -> ProgressBar {
    let (bar, shape) = if length > 0 { (ProgressBar::new(length), "{bar:40}") } else { (ProgressBar::new_spinner(), "{spinner}") };
    if let Ok(style) = ProgressStyle::with_template(&format!("{shape} {text} {{elapsed}}")) {
        bar.set_style(style);
    }
    bar
}

/// Refuses early a result file that could not be written at the end.
///
/// # Errors
/// A report that names the file and what is in the way.
pub fn check(path: &Path) -> Result<()> {
    let folder = folder_of(path);
    if path.is_dir() {
        return Err(miette!("{}: is a folder; give the name of a file", path.display()));
    }
    if !folder.is_dir() {
        return Err(miette!("{}: the folder {} does not exist; make it first", path.display(), folder.display()));
    }
    Ok(())
}

/// Writes beside the file and renames, so that a reader sees the old text or the new one, never half.
///
/// # Errors
/// A report that names the file and the system's reason.
pub fn write(path: &Path, text: &str) -> Result<()> {
    // where the result is a pipe or a device there is nothing to replace
    if path.exists() && !path.is_file() {
        return std::fs::write(path, text).map_err(|e| miette!("{}: {e}", path.display()));
    }
    let name = path.file_name().map_or_else(Default::default, |n| n.to_string_lossy().into_owned());
    let beside = folder_of(path).join(format!(".{name}.{}.part", std::process::id()));
    let all = || -> std::io::Result<()> {
        let mut file = std::fs::File::create(&beside)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        std::fs::rename(&beside, path)
    };
    all().map_err(|e| {
        // the part may not exist; then there is nothing to clear away
        let _ = std::fs::remove_file(&beside);
        miette!("{}: {e}", path.display())
    })
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replaces_whole_files_and_leaves_nothing_beside() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.json");
        write(&path, "one").unwrap();
        write(&path, "two").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "two");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn names_what_is_in_the_way() {
        let folder = tempfile::tempdir().unwrap();
        assert!(check(folder.path()).unwrap_err().to_string().contains("is a folder"));
        let lost = folder.path().join("no/r.json");
        assert!(check(&lost).unwrap_err().to_string().contains("does not exist"));
        assert!(write(&lost, "").is_err());
    }
}
