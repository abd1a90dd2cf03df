//! `cyclictest` (package rt-tests) as a reference: the kernel's wake-up latency at a priority.
//!
//! With `-q -h` it prints one line per microsecond, `latency count`, and then `# Max Latencies:`.

use crate::hardware::bench_rt::Load;
use std::process::{Command, Stdio};

/// The result of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cyclictest {
    /// Latency that one wake-up in a thousand exceeds, µs.
    pub p999_us: f64,
    /// Longest latency, µs.
    pub max_us: f64,
}

/// Longest latency with a bucket of its own, µs.
const BUCKETS: u32 = 20_000;

/// Runs `cyclictest` for `duration_s` with one thread at `priority` that wakes `rate_hz` times a second,
/// under a load of `load_threads` threads.
///
/// # Errors
/// A message: not installed, not permitted, or an unexpected output.
pub fn run(priority: i32, rate_hz: f64, duration_s: f64, load_threads: usize) -> Result<Cyclictest, String> {
    let _load = Load::start(load_threads);
    let interval_us = (1e6 / rate_hz).round().max(50.0);
    let out = Command::new("cyclictest")
        .args(["-q", "-m", "-t", "1", "-p", &priority.max(1).to_string(), "-i", &interval_us.to_string()])
        .args(["-D", &format!("{}s", duration_s.ceil()), "-h", &BUCKETS.to_string()])
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .map_err(|e| format!("cannot be run ({e}); install the package rt-tests to compare"))?;
    if !out.status.success() {
        return Err("did not complete; it needs the right to real-time scheduling".to_owned());
    }
    read(&String::from_utf8_lossy(&out.stdout)).ok_or_else(|| "its output is not the expected histogram".to_owned())
}

/// Reads the output.
fn read(text: &str) -> Option<Cyclictest> {
    let field = |name: &str| text.lines().find_map(|l| l.strip_prefix(name)?.split_whitespace().next()?.parse::<f64>().ok());
    let max_us = field("# Max Latencies:")?;
    let row = |line: &str| {
        let (latency_us, count) = line.split_once(char::is_whitespace)?;
        Some((latency_us.parse::<f64>().ok()?, count.trim().parse::<u64>().ok()?))
    };
    let rows: Vec<(f64, u64)> = text.lines().filter_map(row).collect();
    let overflows = field("# Histogram Overflows:").unwrap_or(0.0) as u64;
    let total: u64 = rows.iter().map(|r| r.1).sum::<u64>() + overflows;
    let rank = (total as f64 * 0.999).ceil() as u64;
    let mut below = 0;
    let reaches_rank = |r: &&(f64, u64)| {
        below += r.1;
        below >= rank
    };
    let p999_us = rows.iter().find(reaches_rank).map_or(max_us, |r| r.0);
    (total > 0).then_some(Cyclictest { p999_us, max_us })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_histogram_is_read() {
        let text = "# /dev/cpu_dma_latency set to 0us\n# Histogram\n000002 000900\n000003 000097\n000011 000002\n000012 000001\n\
                    # Min Latencies: 00002\n# Avg Latencies: 00002\n# Max Latencies: 00012\n# Histogram Overflows: 00000\n";
        assert_eq!(read(text), Some(Cyclictest { p999_us: 11.0, max_us: 12.0 }));
        assert_eq!(read("nothing"), None);
    }
}
