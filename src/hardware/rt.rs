//! Real time on Linux: the clock, absolute sleeps, and what the kernel grants a thread.
//!
//! Asked for are SCHED_FIFO (`sched_setscheduler(2)`), locked memory (`mlockall(2)`), a processor of
//! one's own (`sched_setaffinity(2)`), exact timers (`prctl(2)`, PR_SET_TIMERSLACK) and shallow idle
//! states (`/dev/cpu_dma_latency`, `Documentation/power/pm_qos_interface`). None of them is needed to
//! run, each makes lateness rarer; so every refusal is a value that is shown, not an error.

#![allow(unsafe_code)]

use std::fmt;
use std::fs::File;
use std::io::{self, Write};

/// Now, ns of CLOCK_MONOTONIC.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `now` is a live timespec to write to. CLOCK_MONOTONIC exists on every Linux, so the call
    // cannot fail.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &mut now) };
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// Sleeps until a reading of CLOCK_MONOTONIC; returns at once when it has passed.
pub fn sleep_until_ns(deadline_ns: u64) {
    let deadline =
        libc::timespec { tv_sec: (deadline_ns / 1_000_000_000) as libc::time_t, tv_nsec: (deadline_ns % 1_000_000_000) as libc::c_long };
    loop {
        // SAFETY: `deadline` is a valid timespec; with TIMER_ABSTIME the remainder pointer is not used
        // and may be null.
        let result = unsafe { libc::clock_nanosleep(libc::CLOCK_MONOTONIC, libc::TIMER_ABSTIME, &deadline, std::ptr::null_mut()) };
        if result != libc::EINTR {
            return;
        }
    }
}

/// A clock one can wait on.
pub trait Clock {
    /// Now, ns.
    fn now_ns(&self) -> u64;
    /// Waits until a time; returns at once when it has passed.
    fn wait_until(&self, deadline_ns: u64);
}

/// CLOCK_MONOTONIC: sleeps, then looks at the clock for the last `spin_ns`.
#[derive(Debug, Clone, Copy, Default)]
pub struct Monotonic {
    /// How long before the deadline sleeping ends and looking begins, ns.
    pub spin_ns: u64,
}

impl Clock for Monotonic {
    fn now_ns(&self) -> u64 {
        monotonic_ns()
    }

    fn wait_until(&self, deadline_ns: u64) {
        let sleep_ns = deadline_ns.saturating_sub(self.spin_ns);
        if monotonic_ns() < sleep_ns {
            sleep_until_ns(sleep_ns);
        }
        while monotonic_ns() < deadline_ns {
            std::hint::spin_loop();
        }
    }
}

/// What the kernel said to one wish.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Grant {
    /// Nobody asked.
    #[default]
    NotAsked,
    /// Granted.
    Granted,
    /// Refused.
    Refused(Refusal),
}

/// A wish the kernel refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{wish} refused ({}): {mend}", io::Error::from_raw_os_error(*.errno))]
pub struct Refusal {
    /// What was wished for.
    pub wish: &'static str,
    /// What the kernel said.
    pub errno: i32,
    /// What would help.
    pub mend: &'static str,
}

impl fmt::Display for Grant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAsked => f.write_str("not asked"),
            Self::Granted => f.write_str("granted"),
            Self::Refused(refusal) => refusal.fmt(f),
        }
    }
}

impl Grant {
    /// From the result of a call that returns 0 or sets errno.
    fn from_call(result: i32, wish: &'static str, mend: &'static str) -> Self {
        if result == 0 {
            return Self::Granted;
        }
        let errno = io::Error::last_os_error().raw_os_error().unwrap_or(0);
        Self::Refused(Refusal { wish, errno, mend })
    }

    /// The refusal, if it is one.
    #[must_use]
    pub fn refusal(&self) -> Option<&Refusal> {
        if let Self::Refused(refusal) = self { Some(refusal) } else { None }
    }
}

/// What a thread got of what it wished for.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RtStatus {
    /// SCHED_FIFO.
    pub scheduling: Grant,
    /// All memory locked.
    pub memory: Grant,
    /// On one processor.
    pub affinity: Grant,
    /// Timers exact to the nanosecond instead of 50 µs.
    pub timer_slack: Grant,
    /// Processors kept out of deep sleep.
    pub idle_states: Grant,
}

impl RtStatus {
    /// All five with their names, for a status page.
    #[must_use]
    pub fn rows(&self) -> [(&'static str, &Grant); 5] {
        [
            ("SCHED_FIFO", &self.scheduling),
            ("locked memory", &self.memory),
            ("own processor", &self.affinity),
            ("exact timers", &self.timer_slack),
            ("shallow idle", &self.idle_states),
        ]
    }
}

/// What a thread wishes for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RtRequest {
    /// SCHED_FIFO priority 1 to 99; 0 does not ask.
    pub priority: i32,
    /// Processor to stay on.
    pub cpu: Option<usize>,
}

/// Keeps processors out of deep sleep as long as it lives.
#[derive(Debug)]
pub struct IdleGuard {
    _open: Option<File>,
}

/// Makes the calling thread as real-time as the kernel allows. Keep the guard.
#[must_use]
pub fn enter(wish: &RtRequest) -> (RtStatus, IdleGuard) {
    let asked = wish.priority > 0;
    let (idle_states, guard) = if asked { stay_awake() } else { (Grant::NotAsked, IdleGuard { _open: None }) };
    let status = RtStatus {
        memory: if asked { lock_memory() } else { Grant::NotAsked },
        scheduling: if asked { schedule_fifo(wish.priority) } else { Grant::NotAsked },
        affinity: wish.cpu.map_or(Grant::NotAsked, stay_on),
        timer_slack: exact_timers(),
        idle_states,
    };
    touch_stack();
    (status, guard)
}

fn schedule_fifo(priority: i32) -> Grant {
    let parameter = libc::sched_param { sched_priority: priority };
    // SAFETY: 0 means the calling thread; `parameter` is a live sched_param that is only read.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &parameter) };
    Grant::from_call(
        result,
        "SCHED_FIFO",
        "needs CAP_SYS_NICE or an rtprio limit (`@realtime - rtprio 90` in /etc/security/limits.d, or LimitRTPRIO=90 in the unit)",
    )
}

fn lock_memory() -> Grant {
    // SAFETY: no pointers are passed; locking pages has no effect on what they hold.
    let result = unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) };
    Grant::from_call(
        result,
        "locking memory",
        "needs CAP_IPC_LOCK or a memlock limit (`@realtime - memlock unlimited`, or LimitMEMLOCK=infinity in the unit)",
    )
}

fn stay_on(cpu: usize) -> Grant {
    const WISH: &str = "staying on one processor";
    const MEND: &str = "name a processor that exists and is allowed (`nproc`, AllowedCPUs= in the unit)";
    if cpu >= libc::CPU_SETSIZE as usize {
        return Grant::Refused(Refusal { wish: WISH, errno: libc::EINVAL, mend: MEND });
    }
    // SAFETY: all zeros is the empty set.
    let mut set: libc::cpu_set_t = unsafe { std::mem::zeroed() };
    // SAFETY: `cpu` is below CPU_SETSIZE, so the bit lies within the set.
    unsafe { libc::CPU_SET(cpu, &mut set) };
    // SAFETY: 0 means the calling thread; `set` is live, only read, and its true size is given.
    let result = unsafe { libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &set) };
    Grant::from_call(result, WISH, MEND)
}

fn exact_timers() -> Grant {
    // SAFETY: PR_SET_TIMERSLACK takes one integer, 1 ns, and no pointers.
    let result = unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1 as libc::c_ulong) };
    Grant::from_call(result, "exact timers", "the kernel is older than 2.6.28")
}

/// Holds a request for no wake-up latency open.
fn stay_awake() -> (Grant, IdleGuard) {
    let opened = File::options().write(true).open("/dev/cpu_dma_latency").and_then(|mut f| {
        f.write_all(&0_i32.to_ne_bytes())?;
        Ok(f)
    });
    match opened {
        Ok(f) => (Grant::Granted, IdleGuard { _open: Some(f) }),
        Err(e) => {
            let errno = e.raw_os_error().unwrap_or(0);
            let mend = "needs write permission for /dev/cpu_dma_latency (a udev rule, or DeviceAllow= in the unit)";
            (Grant::Refused(Refusal { wish: "shallow idle states", errno, mend }), IdleGuard { _open: None })
        }
    }
}

/// Touches a good part of the stack, so that none of it is fetched in the middle of a step.
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
    fn waiting_never_ends_early() {
        for spin_ns in [0, 50_000] {
            let clock = Monotonic { spin_ns };
            for _ in 0..20 {
                let until = clock.now_ns() + 200_000;
                clock.wait_until(until);
                assert!(clock.now_ns() >= until);
            }
            let past = clock.now_ns() - 1;
            clock.wait_until(past);
        }
    }

    #[test]
    fn a_processor_that_is_not_there_is_refused_with_advice() {
        for cpu in [1000, 100_000] {
            let refusal = stay_on(cpu).refusal().cloned().unwrap();
            assert!(refusal.to_string().contains("name a processor that exists"), "{refusal}");
        }
    }

    #[test]
    fn nothing_asked_nothing_changed() {
        let (status, _guard) = enter(&RtRequest::default());
        assert_eq!((status.scheduling, status.memory, status.affinity), (Grant::NotAsked, Grant::NotAsked, Grant::NotAsked));
    }
}
