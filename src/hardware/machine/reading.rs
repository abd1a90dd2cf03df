//! A thread that reads sensors, which no other thread waits for once it runs.

use crate::hardware::machine::error::HardwareError;
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;

/// Starts a thread that sends the result of its set-up and then fills a ring of readings until the ring is dropped. Waits for that
/// result, for `setup_max` at most.
///
/// # Errors
/// [`HardwareError`]: that of the set-up, no thread, or a bus that hangs.
pub(super) fn start<R: Send + 'static, T: Send + 'static>(
    name: &str,
    bus: &str,
    setup_max: Duration,
    capacity: usize,
    run: impl FnOnce(Producer<R>, Sender<Result<T, HardwareError>>) + Send + 'static,
) -> Result<(Consumer<R>, T), HardwareError> {
    let (output, readings) = RingBuffer::new(capacity);
    let (sender, started) = channel();
    std::thread::Builder::new()
        .name(name.to_lowercase())
        .spawn(move || run(output, sender))
        .map_err(|e| HardwareError::Thread(name.to_owned(), e))?;
    let bus = bus.to_owned();
    let silent = |e| match e {
        RecvTimeoutError::Timeout => HardwareError::BusHangs(bus, setup_max.as_secs_f64()),
        RecvTimeoutError::Disconnected => {
            HardwareError::Bus(bus, format!("the {name} thread ended as it started"))
        }
    };
    let ready = started.recv_timeout(setup_max).map_err(silent)??;
    Ok((readings, ready))
}
