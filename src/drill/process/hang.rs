//! Suspends one thread of a child process, as a disk or a lock that does not return would.

#![allow(unsafe_code)]

use std::io;
use std::path::Path;

/// A suspended thread; dropping it lets the thread continue.
#[derive(Debug)]
pub struct HungThread(libc::pid_t);

impl HungThread {
    /// Suspends the thread of `pid` with this name; the hub is the first thread. It must be dropped by the thread that suspended it.
    ///
    /// # Errors
    /// No such thread, or no permission to trace it.
    pub fn suspend(pid: u32, name: &str) -> io::Result<Self> {
        let tasks = std::fs::read_dir(format!("/proc/{pid}/task"))?.flatten();
        let numbered = tasks.filter_map(|task| {
            Some((task.path(), task.file_name().to_str()?.parse::<u32>().ok()?))
        });
        let named = |path: &Path| {
            std::fs::read_to_string(path.join("comm")).is_ok_and(|comm| comm.trim() == name)
        };
        let found = numbered.into_iter().find(|(path, tid)| {
            if name == "hub" {
                *tid == pid
            } else {
                named(path)
            }
        });
        let tid = found.and_then(|(_, tid)| libc::pid_t::try_from(tid).ok());
        let tid = tid.ok_or_else(|| io::Error::other(format!("there is no thread `{name}`")))?;
        trace(libc::PTRACE_SEIZE, tid)?;
        let hung = Self(tid);
        trace(libc::PTRACE_INTERRUPT, tid)?;
        // SAFETY: the status is not wanted, and the thread is traced by this one
        unsafe { libc::waitpid(tid, std::ptr::null_mut(), libc::__WALL) };
        Ok(hung)
    }
}

impl Drop for HungThread {
    fn drop(&mut self) {
        // the process may have been killed meanwhile
        let _ = trace(libc::PTRACE_DETACH, self.0);
    }
}

fn trace(request: libc::c_uint, tid: libc::pid_t) -> io::Result<()> {
    let none = std::ptr::null_mut::<libc::c_void>();
    // SAFETY: these requests take no address and no data
    let result = unsafe { libc::ptrace(request, tid, none, none) };
    if result < 0 {
        Err(io::Error::last_os_error())
    } else {
        Ok(())
    }
}
