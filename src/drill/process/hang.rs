//! Suspends one thread of a child process, as a disk or a lock that does not return would.

use nix::sys::ptrace;
use nix::sys::wait::{WaitPidFlag, waitpid};
use nix::unistd::Pid;
use std::io;

/// A suspended thread; dropping it lets the thread continue.
#[derive(Debug)]
pub struct HungThread(Pid);

impl HungThread {
    /// Suspends the thread of `pid` with this name; the hub is the first thread. It must be dropped by the thread that suspended it.
    ///
    /// # Errors
    /// No such thread, or no permission to trace it.
    pub fn suspend(pid: Pid, name: &str) -> io::Result<Self> {
        let mut tasks = std::fs::read_dir(format!("/proc/{pid}/task"))?.flatten();
        let found = tasks.find_map(|task| {
            let tid = Pid::from_raw(task.file_name().to_str()?.parse().ok()?);
            let is_it = match name {
                "hub" => tid == pid,
                _ => {
                    std::fs::read_to_string(task.path().join("comm"))
                        .ok()?
                        .trim()
                        == name
                }
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
