//! Attackers of a service: threads of the same user that connect to its sockets, or that suspend one of its threads, as a disk or a
//! lock that does not return would.

use super::daemon::Daemon;
use nix::sys::ptrace;
use nix::sys::wait::{WaitPidFlag, waitpid};
use nix::unistd::Pid;
use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::JoinHandle;
use std::time::Duration;

/// What attacks.
#[derive(Debug, Clone, Copy)]
pub enum Attack {
    /// 64 connections to each socket that send this text and never read.
    Keep(&'static str),
    /// Four threads connect as fast as they can and keep their last so many connections.
    Connect(usize),
    /// The same on the socket of `stop`.
    Stop,
    /// So many threads send this text without a pause and read the answers; they connect again when they are thrown out.
    Flood(&'static str, usize),
    /// A thread of the service does not continue.
    Hang(&'static str),
}

/// An attack under way; dropping it ends it.
#[derive(Default)]
pub struct Attackers {
    done: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    kept: Vec<UnixStream>,
    hung: Option<HungThread>,
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
        let [control, status, stop] = daemon.sockets();
        let sockets = [control, status];
        let of = |n: usize| sockets[n % sockets.len()].clone();
        let mut all = Attackers::default();
        match self {
            Self::Keep(text) => {
                let connect = |path: PathBuf| -> io::Result<UnixStream> {
                    let mut stream = UnixStream::connect(path)?;
                    stream.set_write_timeout(Some(Duration::from_millis(100)))?;
                    stream.write_all(text.as_bytes())?;
                    Ok(stream)
                };
                all.kept = (0..64 * sockets.len())
                    .filter_map(|n| connect(of(n)).ok())
                    .collect();
            }
            Self::Stop => (0..4).for_each(|_| all.repeat(connecting(stop.clone(), 0))),
            Self::Connect(keep) => (0..4).for_each(|n| all.repeat(connecting(of(n), keep))),
            Self::Flood(text, threads) => {
                (0..threads).for_each(|n| all.repeat(flooding(of(n), text)))
            }
            Self::Hang(thread) => all.hung = Some(HungThread::suspend(daemon.pid(), thread)?),
        }
        Ok(all)
    }
}

impl Attackers {
    /// Repeats `work` in a thread until the attack ends.
    fn repeat(&mut self, mut work: impl FnMut() + Send + 'static) {
        let done = Arc::clone(&self.done);
        self.threads.push(std::thread::spawn(move || {
            while !done.load(Relaxed) {
                work();
            }
        }));
    }
}

fn connecting(path: PathBuf, keep: usize) -> impl FnMut() {
    let mut kept = VecDeque::new();
    move || {
        kept.extend(UnixStream::connect(&path).ok());
        if kept.len() > keep {
            kept.pop_front();
        }
    }
}

fn flooding(path: PathBuf, text: &'static str) -> impl FnMut() {
    let texts = text.repeat(32);
    let mut stream: Option<UnixStream> = None;
    let mut answers = vec![0u8; 65536];
    move || {
        let Some(open) = &mut stream else {
            stream = UnixStream::connect(&path)
                .and_then(|s| s.set_nonblocking(true).map(|()| s))
                .ok();
            return;
        };
        let over = |result: io::Result<usize>| match result {
            Ok(n) => n == 0,
            Err(e) => e.kind() != io::ErrorKind::WouldBlock,
        };
        if over(open.read(&mut answers)) | over(open.write(texts.as_bytes())) {
            stream = None;
        }
    }
}

/// A suspended thread; dropping it lets the thread continue.
#[derive(Debug)]
struct HungThread(Pid);

impl HungThread {
    /// Suspends the thread of `pid` with this name; the hub is the first thread. It must be dropped by the thread that suspended it.
    ///
    /// # Errors
    /// No such thread, or no permission to trace it.
    fn suspend(pid: Pid, name: &str) -> io::Result<Self> {
        let mut tasks = std::fs::read_dir(format!("/proc/{pid}/task"))?.flatten();
        let found = tasks.find_map(|task| {
            let tid = Pid::from_raw(task.file_name().to_str()?.parse().ok()?);
            let called = std::fs::read_to_string(task.path().join("comm")).ok()?;
            let is_it = match name {
                "hub" => tid == pid,
                _ => called.trim() == name,
            };
            is_it.then_some(tid)
        });
        let tid = found.ok_or_else(|| io::Error::other(format!("there is no thread `{name}`")))?;
        ptrace::seize(tid, ptrace::Options::empty())?;
        let hung = Self(tid);
        ptrace::interrupt(tid)?;
        // how it stands is not wanted
        let _ = waitpid(tid, Some(WaitPidFlag::__WALL));
        Ok(hung)
    }
}

impl Drop for HungThread {
    fn drop(&mut self) {
        // the process may have been killed meanwhile
        let _ = ptrace::detach(self.0, None);
    }
}
