//! Text files that are read as a whole, and why a file cannot be read.

use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::Path;

/// Most bytes of a text that is read as a whole.
const TEXT_MAX: u64 = 1 << 20;

/// Why a file cannot be read, and what to do, in words that follow its name.
pub fn why_unreadable(path: &Path, error: &std::io::Error) -> String {
    match error.kind() {
        _ if path.is_dir() => "this is a folder, not a file; give the name of a file".to_owned(),
        ErrorKind::NotFound => "there is no such file; check the path".to_owned(),
        ErrorKind::PermissionDenied => {
            "this user has no permission to read the file; change its permissions or its owner"
                .to_owned()
        }
        ErrorKind::FileTooLarge => {
            "the file is larger than 1 MiB, so it is another file than is expected here".to_owned()
        }
        ErrorKind::InvalidData if error.get_ref().is_some() => error.to_string(),
        ErrorKind::InvalidData => "this is not a text file (not valid UTF-8)".to_owned(),
        _ => format!("the file cannot be read: {error}"),
    }
}

/// True for a folder, a device or a pipe: reading it may never end.
pub fn is_irregular(path: &Path) -> bool {
    path.metadata().is_ok_and(|file| !file.is_file())
}

/// The text of a file that is read as a whole: settings, or a token.
///
/// # Errors
/// The operating system's, or [`ErrorKind::FileTooLarge`] above 1 MiB.
pub fn text(path: &Path) -> io::Result<String> {
    let (mut bytes, mut start) = (Vec::new(), File::open(path)?.take(TEXT_MAX + 1));
    if start.read_to_end(&mut bytes)? as u64 > TEXT_MAX {
        return Err(ErrorKind::FileTooLarge.into());
    }
    if let Some(problem) = encoding(&bytes) {
        return Err(io::Error::new(ErrorKind::InvalidData, problem));
    }
    String::from_utf8(bytes).map_err(|_| ErrorKind::InvalidData.into())
}

/// What is wrong with the encoding of a text that begins with these bytes.
pub fn encoding(start: &[u8]) -> Option<&'static str> {
    let is_text =
        |byte: u8| byte == b'\t' || byte == b'\n' || byte == b'\r' || (b' '..0x7f).contains(&byte);
    // without a mark: every other byte of a text is zero
    let wide = |zero: usize| {
        let mut pairs = start[..start.len().min(64)].chunks_exact(2);
        pairs.len() > 2 && pairs.all(|pair| pair[zero] == 0 && is_text(pair[1 - zero]))
    };
    if start.starts_with(&[0xff, 0xfe]) || start.starts_with(&[0xfe, 0xff]) || wide(0) || wide(1) {
        return Some("this is UTF-16 text, as some Windows programs write it; save it as UTF-8");
    }
    match std::str::from_utf8(start) {
        Err(e) if e.error_len().is_some() => Some(
            "this is not UTF-8 text: perhaps Latin-1 (Windows-1252), or no text at all; save it as UTF-8",
        ),
        _ => None,
    }
}
