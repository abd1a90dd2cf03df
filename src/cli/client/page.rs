//! `page`: a page for the browser of a tablet beside the unit.
//!
//! The command is a client of the service like any other, and a process of its own, so that the service itself keeps no network. All
//! pages share one subscription; `server` bounds the connections, decides who may enter and what is answered, and `site` knows the
//! open pages and ends the motion of one that is lost.

mod server;
mod site;

use super::connection::{At, socket};
use crate::cli::{inputs, output};
use crate::primitives::file::{text, why_unreadable};
use hyper::body::Bytes;
use miette::{IntoDiagnostic, Result, bail, miette};
use site::Site;
use std::io::Write;
use std::net::SocketAddr;
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use tokio::sync::{Mutex, watch};

/// Shortest token, characters.
const TOKEN_MIN: usize = 16;

/// Arguments of `page`.
#[derive(Debug, clap::Args)]
pub struct PageArgs {
    #[command(flatten)]
    at: At,
    /// Address and port of the page. Any but a loopback address needs `--token-file`.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8088")]
    listen: SocketAddr,
    /// File of the token that a browser must show. A file that does not exist is created with a new token.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Result of `gap diagnose --json FILE`, which the page shows.
    #[arg(long, value_name = "FILE")]
    diagnosis: Option<PathBuf>,
}

/// Serves the page until the process is ended.
///
/// # Errors
/// A report about the address or the token.
pub fn page(args: &PageArgs) -> Result<()> {
    let (listen, socket) = (args.listen, socket(&args.at)?);
    let token = args.token_file.as_deref().map(token).transpose()?;
    if token.is_none() && !listen.ip().is_loopback() {
        bail!(
            "--listen {listen}: others can reach it: name the file of a token with --token-file, which is created if there is none"
        );
    }
    args.diagnosis.as_deref().map_or(Ok(()), check_diagnosis)?;
    let (address, listener) = inputs::listen(listen)?;
    let file = args.token_file.as_ref();
    let file = file.map(|file| format!("?token=TOKEN, with the token in {}", file.display()));
    output::print(format!("http://{address}/{}\n", file.unwrap_or_default()));
    let (sender, latest) = watch::channel(Bytes::new());
    let control = socket.clone();
    std::thread::spawn(move || site::follow(&control, &sender));
    let site = Site {
        socket,
        token,
        diagnosis: site::read_again(args.diagnosis.clone()),
        latest,
        pages: Mutex::default(),
    };
    server::run(listener, site).into_diagnostic()
}

/// Refuses a file that is no diagnosis. One that does not exist yet may become one, and a pipe may keep everybody waiting.
fn check_diagnosis(path: &Path) -> Result<()> {
    let fail = |why: &str| miette!("--diagnosis {}: {why}", path.display());
    if !path.is_file() && !path.is_dir() {
        return Ok(());
    }
    let text = text(path).map_err(|e| fail(&why_unreadable(path, &e)))?;
    if site::is_diagnosis(&text) {
        return Ok(());
    }
    Err(fail(
        "this is no diagnosis; name what `gap diagnose --json FILE` wrote",
    ))
}

/// The token of a file, which is created if there is none.
fn token(path: &Path) -> Result<String> {
    let fail = |why: String| miette!("--token-file {}: {why}", path.display());
    let mut options = std::fs::File::options();
    options.write(true).create_new(true).mode(0o600);
    if let Ok(mut file) = options.open(path) {
        let written = writeln!(file, "{:032x}", rand::random::<u128>());
        written.map_err(|e| fail(e.kind().to_string()))?;
    }
    let text = text(path).map_err(|e| fail(why_unreadable(path, &e)))?;
    let is_open = |file: std::fs::Metadata| file.permissions().mode() & 0o007 != 0;
    if path.metadata().is_ok_and(is_open) {
        let why = "everybody may read it; withdraw that with `chmod o=`";
        return Err(fail(why.to_owned()));
    }
    let token = text.trim();
    if token.len() < TOKEN_MIN || !token.bytes().all(|b| b.is_ascii_alphanumeric()) {
        return Err(fail(format!(
            "expected {TOKEN_MIN} or more letters and digits; without the file, a new token is created"
        )));
    }
    Ok(token.to_owned())
}
