//! Real time on Linux: the monotonic clock, absolute sleeps, and real-time settings of a thread.
//!
//! A thread requests SCHED_FIFO (`sched_setscheduler(2)`), locked memory (`mlockall(2)`), a processor
//! (`sched_setaffinity(2)`), exact timers (`prctl(2)`, PR_SET_TIMERSLACK) and shallow idle states
//! (`/dev/cpu_dma_latency`, `Documentation/power/pm_qos_interface`). None of them is required; each
//! makes lateness rarer. A denial is therefore a value to display, not an error.

#![allow(unsafe_code)]

use nix::errno::Errno;
use nix::sched::{CpuSet, sched_setaffinity};
use nix::sys::mman::{MlockAllFlags, mlockall};
use nix::sys::prctl::set_timerslack;
use nix::sys::time::TimeSpec;
use nix::time::{ClockId, ClockNanosleepFlags, clock_nanosleep};
use nix::unistd::Pid;
use std::fmt;
use std::fs::File;
use std::io::{self, Write};
use std::sync::mpsc::channel;
use std::thread::JoinHandle;
use std::time::Duration;

/// Signals whose default action ends a process and that are sent to end it or by a terminal that closes.
const ENDING: [i32; 6] = [
    libc::SIGTERM,
    libc::SIGINT,
    libc::SIGHUP,
    libc::SIGQUIT,
    libc::SIGUSR1,
    libc::SIGUSR2,
];

/// The signals that end this process: each must take the way through the safe state. One that the caller had this process ignore, as
/// `nohup` does, stays ignored.
pub fn ending_signals() -> impl Iterator<Item = i32> {
    ENDING.into_iter().filter(|&signal| {
        // SAFETY: a zeroed sigaction is valid, and the call writes to it and changes nothing
        let (asked, old) = unsafe {
            let mut old: libc::sigaction = std::mem::zeroed();
            (libc::sigaction(signal, std::ptr::null(), &mut old), old)
        };
        asked == 0 && old.sa_sigaction != libc::SIG_IGN
    })
}

/// Reading of CLOCK_MONOTONIC, ns.
pub fn monotonic_ns() -> u64 {
    // CLOCK_MONOTONIC exists on every Linux, so the call cannot fail
    let now = ClockId::CLOCK_MONOTONIC.now();
    now.map_or(0, |now| Duration::from(now).as_nanos() as u64)
}

/// Sleeps until a reading of CLOCK_MONOTONIC; returns at once if it has passed.
pub fn sleep_until_ns(deadline_ns: u64) {
    let deadline = TimeSpec::from_duration(Duration::from_nanos(deadline_ns));
    let (clock, flags) = (ClockId::CLOCK_MONOTONIC, ClockNanosleepFlags::TIMER_ABSTIME);
    while clock_nanosleep(clock, flags, &deadline) == Err(Errno::EINTR) {}
}

/// Waits until a reading of CLOCK_MONOTONIC: sleeps, then polls the clock for the last `spin_ns`.
pub fn wait_until_ns(deadline_ns: u64, spin_ns: u64) {
    let sleep_ns = deadline_ns.saturating_sub(spin_ns);
    if monotonic_ns() < sleep_ns {
        sleep_until_ns(sleep_ns);
    }
    while monotonic_ns() < deadline_ns {
        std::hint::spin_loop();
    }
}

/// The kernel's answer to one request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Grant {
    /// Not requested.
    NotRequested,
    /// Granted.
    Granted,
    /// Denied.
    Denied {
        /// The request.
        request: &'static str,
        /// The kernel's error number.
        errno: i32,
        /// The remedy.
        remedy: &'static str,
    },
}

impl fmt::Display for Grant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotRequested => f.write_str("not requested"),
            Self::Granted => f.write_str("granted"),
            Self::Denied {
                request,
                errno,
                remedy,
            } => {
                let error = io::Error::from_raw_os_error(*errno);
                write!(f, "{request} denied ({error}): {remedy}")
            }
        }
    }
}

/// The answer to a request, if it was made, with its name.
fn grant(
    asked: Option<nix::Result<()>>,
    request: &'static str,
    remedy: &'static str,
) -> (&'static str, Grant) {
    let grant = match asked {
        None => Grant::NotRequested,
        Some(Ok(())) => Grant::Granted,
        Some(Err(error)) => Grant::Denied {
            request,
            errno: error as i32,
            remedy,
        },
    };
    (request, grant)
}

/// What the kernel granted to a thread, each request with its name.
pub type RtStatus = [(&'static str, Grant); 5];

/// The real-time settings that a thread requests.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RtRequest {
    /// SCHED_FIFO priority, 1 to 99; 0 requests no real-time scheduling.
    pub priority: i32,
    /// Processor to stay on.
    pub cpu: Option<usize>,
}

/// Starts a thread with these real-time settings. Returns it with what the kernel has granted.
///
/// # Errors
/// The operating system's, if there is no thread.
pub fn start<T: Send + 'static>(
    name: &str,
    request: RtRequest,
    work: impl FnOnce() -> T + Send + 'static,
) -> io::Result<(JoinHandle<T>, RtStatus)> {
    let (report, reported) = channel();
    let builder = std::thread::Builder::new().name(name.to_owned());
    let thread = builder.spawn(move || {
        let (status, _guard) = enter(&request);
        // the receiver waits below
        let _ = report.send(status);
        work()
    })?;
    let status = reported.recv();
    let status = status.map_err(|_| io::Error::other("the thread ended as it started"))?;
    Ok((thread, status))
}

/// Applies the real-time settings to the calling thread as far as the kernel grants them. The processors stay out of deep idle states
/// until the file is dropped.
pub fn enter(request: &RtRequest) -> (RtStatus, Option<File>) {
    let real_time = request.priority > 0;
    let open = real_time.then(shallow_idle);
    let idle = open.as_ref().map(|open| open.as_ref().map(|_| ()));
    let status = [
        grant(
            real_time.then(|| schedule_fifo(request.priority)),
            "SCHED_FIFO",
            "needs CAP_SYS_NICE or an rtprio limit (`@realtime - rtprio 90` in /etc/security/limits.d, or LimitRTPRIO=90 in the unit)",
        ),
        grant(
            real_time.then(|| mlockall(MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE)),
            "locked memory",
            "needs CAP_IPC_LOCK or a memlock limit (`@realtime - memlock unlimited`, or LimitMEMLOCK=infinity in the unit)",
        ),
        grant(
            request.cpu.map(set_affinity),
            "own processor",
            "name a processor that exists and is allowed (`nproc`, AllowedCPUs= in the unit)",
        ),
        grant(
            // 1 ns; the default is 50 µs
            Some(set_timerslack(1)),
            "exact timers",
            "needs Linux 2.6.28 or newer",
        ),
        grant(
            idle.map(|opened| opened.map_err(|e| Errno::from_raw(e.raw_os_error().unwrap_or(0)))),
            "shallow idle",
            "needs write permission for /dev/cpu_dma_latency (a udev rule, or DeviceAllow= in the unit)",
        ),
    ];
    touch_stack();
    (status, open.and_then(Result::ok))
}

fn schedule_fifo(priority: i32) -> nix::Result<()> {
    let parameter = libc::sched_param {
        sched_priority: priority,
    };
    // SAFETY: 0 means the calling thread; `parameter` is a live sched_param that is only read.
    let done = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &parameter) };
    Errno::result(done).map(drop)
}

/// Binds the calling thread to a processor.
fn set_affinity(cpu: usize) -> nix::Result<()> {
    let mut set = CpuSet::new();
    set.set(cpu)?;
    sched_setaffinity(Pid::from_raw(0), &set)
}

/// Requests a wake-up latency of zero for as long as the file is open.
fn shallow_idle() -> io::Result<File> {
    let mut file = File::options().write(true).open("/dev/cpu_dma_latency")?;
    file.write_all(&0_i32.to_ne_bytes())?;
    Ok(file)
}

/// Touches 64 KiB of the stack, so that no page fault occurs in the middle of a step.
#[inline(never)]
fn touch_stack() {
    let mut stack = [0_u8; 64 * 1024];
    for page in stack.chunks_mut(1024) {
        page[0] = std::hint::black_box(1);
    }
    std::hint::black_box(&stack);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wait_never_ends_early() {
        for spin_ns in [0, 50_000] {
            for _ in 0..20 {
                let until = monotonic_ns() + 200_000;
                wait_until_ns(until, spin_ns);
                assert!(monotonic_ns() >= until);
            }
            wait_until_ns(monotonic_ns() - 1, spin_ns);
        }
    }

    #[test]
    fn a_processor_that_does_not_exist_is_denied_with_a_remedy() {
        for cpu in [1000, 100_000] {
            let (priority, cpu) = (0, Some(cpu));
            let (status, _guard) = enter(&RtRequest { priority, cpu });
            let text = status[2].1.to_string();
            assert!(
                text.contains("own processor denied")
                    && text.contains("name a processor that exists"),
                "{text}"
            );
        }
    }

    #[test]
    fn an_empty_request_changes_nothing_but_the_timers() {
        let (status, _guard) = enter(&RtRequest::default());
        for (name, grant) in status {
            assert_eq!(
                grant,
                if name == "exact timers" {
                    Grant::Granted
                } else {
                    Grant::NotRequested
                },
                "{name}"
            );
        }
    }
}
