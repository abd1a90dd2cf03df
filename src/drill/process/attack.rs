//! Attackers of a service: threads of the same user that connect to its sockets.

use super::daemon::Daemon;
use super::hang::HungThread;
use crate::service::protocol::{Request, request_line};
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::JoinHandle;
use std::time::Duration;

/// What attacks.
#[derive(Debug, Clone, Copy)]
pub enum Attack {
    /// 64 connections to each socket that never send anything.
    Silent,
    /// Four threads connect and close as fast as they can.
    Connects,
    /// Four threads connect to the command socket and keep their last 200 connections.
    Hoards,
    /// Clients that send this request without a pause and read the answers.
    Floods(fn() -> Request, usize),
    /// Clients of both sockets that take 1000 frames a second.
    Readers,
    /// Readers that never read.
    Deaf,
    /// Lines that are no requests.
    Garbage,
    /// A thread of the service that does not continue.
    Hang(&'static str),
}

/// An attack under way; dropping it ends it.
pub struct Attackers {
    done: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    _kept: Vec<UnixStream>,
    _hung: Option<HungThread>,
}

impl Drop for Attackers {
    fn drop(&mut self) {
        self.done.store(true, Relaxed);
        for thread in self.threads.drain(..) {
            // an attacker that panicked attacks no more
            let _ = thread.join();
        }
    }
}

impl Attack {
    /// Starts the attack.
    ///
    /// # Errors
    /// A thread that cannot be suspended.
    pub fn start(self, daemon: &Daemon) -> io::Result<Attackers> {
        let (control, status) = (daemon.socket().to_owned(), daemon.socket().with_file_name("status.sock"));
        let mut all = Attackers { done: Arc::default(), threads: Vec::new(), _kept: Vec::new(), _hung: None };
        match self {
            Self::Silent => {
                let both = [&control, &status].into_iter().flat_map(|path| std::iter::repeat_n(path, 64));
                all._kept = both.filter_map(|path| UnixStream::connect(path).ok()).collect();
            }
            Self::Connects => [&control, &control, &status, &status].iter().for_each(|path| all.repeat(path, 0)),
            Self::Hoards => (0..4).for_each(|_| all.repeat(&control, 200)),
            Self::Floods(request, clients) => (0..clients).for_each(|_| all.flood(&control, request_line(1, &request()))),
            Self::Garbage => (0..4).for_each(|_| all.flood(&control, "{\"v\":1,\"cmd\":\"fly\"}\n".to_owned())),
            Self::Readers => {
                let line = request_line(1, &Request::Subscribe { rate_hz: 1000.0 });
                [&control, &status].into_iter().for_each(|path| (0..8).for_each(|_| all.listen(path, &line)));
            }
            Self::Deaf => {
                let line = request_line(1, &Request::Subscribe { rate_hz: 1000.0 });
                let deaf = |path: &PathBuf| -> io::Result<UnixStream> {
                    let mut stream = UnixStream::connect(path)?;
                    stream.write_all(line.as_bytes())?;
                    Ok(stream)
                };
                all._kept = [&control, &status].into_iter().flat_map(|p| std::iter::repeat_n(p, 16)).filter_map(|p| deaf(p).ok()).collect();
            }
            Self::Hang(thread) => all._hung = Some(HungThread::suspend(daemon.pid(), thread)?),
        }
        Ok(all)
    }
}

impl Attackers {
    /// Repeats `work` until the attack ends.
    fn spawn(&mut self, mut work: impl FnMut() + Send + 'static) {
        let done = Arc::clone(&self.done);
        self.threads.push(std::thread::spawn(move || {
            while !done.load(Relaxed) {
                work();
            }
        }));
    }

    /// Connects again and again, and keeps the last `keep` connections.
    fn repeat(&mut self, path: &Path, keep: usize) {
        let (path, mut kept) = (path.to_owned(), std::collections::VecDeque::new());
        self.spawn(move || {
            kept.extend(UnixStream::connect(&path).ok());
            if kept.len() > keep {
                kept.pop_front();
            }
        });
    }

    /// Sends a line without a pause and reads the answers; connects again when it is thrown out.
    fn flood(&mut self, path: &Path, line: String) {
        let (path, lines) = (path.to_owned(), line.repeat(32));
        let mut stream: Option<UnixStream> = None;
        self.spawn(move || {
            let connect = || {
                let stream = UnixStream::connect(&path)?;
                stream.set_nonblocking(true)?;
                io::Result::Ok(stream)
            };
            let Some(open) = &mut stream else {
                stream = connect().ok();
                return;
            };
            let mut answers = [0u8; 65536];
            let read = open.read(&mut answers);
            let written = open.write(lines.as_bytes());
            let over = |result: &io::Result<usize>| match result {
                Ok(n) => *n == 0,
                Err(e) => e.kind() != io::ErrorKind::WouldBlock,
            };
            if over(&read) || over(&written) {
                stream = None;
            }
        });
    }

    /// Sends one line and reads whatever comes.
    fn listen(&mut self, path: &Path, line: &str) {
        let Ok(mut stream) = UnixStream::connect(path) else { return };
        // a reader that is thrown out has nothing to read any more
        let _ = stream.write_all(line.as_bytes());
        let _ = stream.set_read_timeout(Some(Duration::from_millis(100)));
        let mut frames = vec![0u8; 65536];
        self.spawn(move || {
            if stream.read(&mut frames).is_ok_and(|n| n == 0) {
                std::thread::sleep(Duration::from_millis(10));
            }
        });
    }
}
