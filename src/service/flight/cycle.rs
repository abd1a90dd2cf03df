//! A cycle as the log holds it: the exact input of the supervisor, and digests of everything that it decided.

use crate::control::tick::Frame;
use crate::estimation::fusion::health::ImuReading;
use crate::model::arc::Shape;
use crate::supervisor::cycle::CycleOutput;
use crate::supervisor::cycle::order::Order;
use crate::supervisor::machine::Sensed;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// One cycle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cycle {
    /// Input from the machine, without the true orientation.
    pub sensed: Sensed,
    /// Order, if any.
    pub order: Option<Order>,
    /// Target of the tip.
    pub target: Shape,
    /// Digests of the decisions: one of all, in four bytes, then, in cycles with a sample of the tip IMU, one of each of [`FIELDS`],
    /// in one byte.
    pub digests: (u32, Vec<u8>),
}

impl From<&CycleOutput> for Cycle {
    fn from(output: &CycleOutput) -> Self {
        let (sensed, target) = (Sensed { truth: None, ..output.sensed }, output.frame.target);
        Self { sensed, order: output.order, target, digests: digests(output) }
    }
}

impl Cycle {
    /// Whether the decisions differ from those of this cycle, and the names of the fields that do: none in a cycle without digests
    /// of the fields. One byte in 256 is equal by chance.
    #[must_use]
    pub fn differences(&self, output: &CycleOutput) -> Option<Vec<&'static str>> {
        let now = digests(output);
        let pairs = now.1.iter().zip(&self.digests.1);
        let named = || FIELDS.iter().zip(pairs).filter(|(_, (a, b))| a != b).map(|(name, _)| *name).collect();
        (now != self.digests).then(named)
    }
}

/// FNV-1a over bytes.
#[must_use]
pub fn fnv(bytes: impl IntoIterator<Item = u8>) -> u64 {
    bytes.into_iter().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

fn field(value: impl Serialize) -> u64 {
    fnv(postcard::to_allocvec(&value).unwrap_or_default())
}

/// The fields with a digest: all of the frame, taken apart so that none is forgotten, and those of the supervisor.
macro_rules! fields {
    ($output:ident: $($name:ident),* | $($own:ident),*) => {
        /// Fields of a cycle with a digest of their own.
        pub const FIELDS: &[&str] = &[$(stringify!($name),)* $(stringify!($own)),*];

        fn digests($output: &CycleOutput) -> (u32, Vec<u8>) {
            // the time is input
            let Frame { t: _, $($name),* } = &$output.frame;
            let all = [$(field($name),)* $(field(&$output.$own)),*];
            let sampled = matches!($output.sensed.imu, ImuReading::Sample(..));
            let each = all.iter().filter(|_| sampled).map(|x| (x >> 56) as u8).collect();
            ((fnv(all.iter().flat_map(|x| x.to_le_bytes())) >> 32) as u32, each)
        }
    };
}

fields! {
    output:
    phase, target, setpoint, estimate, bend_from_pistons, predicted, unexplained, feedback, command, bellow_mm,
    piston_target_mm, steps, k_epsilon, k_lambda_mm, dynamics, cut, at_rest, blocked, hunting, integral_s, saturation, senses,
    base_moved, base_doubted | steps, mode, energise, latched, stopped
}

/// A message with consecutive cycles: number of the first one, length of each cycle in bytes, and the cycles. Those of equal
/// length lie together, their first bytes first, then their second bytes and so on: bytes that change little compress well
/// side by side.
///
/// # Errors
/// Those of `postcard`, in whose format all of it is.
pub fn encode(first: u64, cycles: &[Cycle]) -> postcard::Result<Vec<u8>> {
    let rows = cycles.iter().map(postcard::to_allocvec).collect::<postcard::Result<Vec<_>>>()?;
    let lengths: Vec<usize> = rows.iter().map(Vec::len).collect();
    let mut planes = Vec::new();
    for length in lengths.iter().collect::<BTreeSet<_>>() {
        let equal = || rows.iter().filter(|row| row.len() == *length);
        (0..*length).for_each(|k| planes.extend(equal().map(|row| row[k])));
    }
    postcard::to_allocvec(&(first, lengths, planes))
}

/// The cycles of a message, with the number of the first one.
///
/// # Errors
/// Those of `postcard`, for a damaged message.
pub fn decode(message: &[u8]) -> postcard::Result<(u64, Vec<Cycle>)> {
    let (first, lengths, planes): (u64, Vec<usize>, Vec<u8>) = postcard::from_bytes(message)?;
    if lengths.iter().try_fold(0usize, |sum, n| sum.checked_add(*n)) != Some(planes.len()) {
        return Err(postcard::Error::DeserializeUnexpectedEnd);
    }
    let (mut cycles, mut at) = (vec![None; lengths.len()], 0);
    for length in lengths.iter().collect::<BTreeSet<_>>() {
        let equal: Vec<usize> = (0..lengths.len()).filter(|n| lengths[*n] == *length).collect();
        for (row, n) in equal.iter().enumerate() {
            let bytes: Vec<u8> = (0..*length).map(|k| planes[at + k * equal.len() + row]).collect();
            cycles[*n] = Some(postcard::from_bytes(&bytes)?);
        }
        at += length * equal.len();
    }
    Ok((first, cycles.into_iter().flatten().collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::tick::Command;
    use crate::estimation::fusion::health::{Quality, ReadFault};
    use crate::model::bend::Bend;
    use crate::model::transmission::Line;
    use crate::motion::lines::Inputs;
    use crate::primitives::sample::ImuSample;
    use crate::primitives::units::{Mm, Seconds, Steps};
    use crate::supervisor::machine::{Alarm, Gauges};
    use nalgebra::Vector3;

    /// Cycles with many orders, readings and alarms.
    fn cycles() -> Vec<Cycle> {
        let sample =
            ImuSample { t: Seconds(0.1), gyro_rad_s: Vector3::new(1.0, -0.0, 1e-300), acc_m_s2: Vector3::z(), mag_ut: Some(Vector3::x()) };
        let command = Command { bend: Bend([0.1, 0.2].into()), length: Mm(20.0) };
        let lines = [1.0, 2.0, 3.0].map(|k_epsilon| Line { k_epsilon, k_lambda_mm: 0.5 });
        let orders = [
            None,
            Some(Order::Arm),
            Some(Order::Calibrate(false)),
            Some(Order::Bend(command, None)),
            Some(Order::Bend(command, Some(1.5))),
            Some(Order::Stream(command)),
            Some(Order::Lines(lines)),
        ];
        let readings = [
            ImuReading::Nothing,
            ImuReading::Sample(sample, Quality::default()),
            ImuReading::Nothing,
            ImuReading::Failed(ReadFault::BrownOut),
        ];
        let alarms = [None, Some(Alarm::Late { late_s: 0.5 }), Some(Alarm::Pressure { kpa: f64::NEG_INFINITY }), Some(Alarm::Silent), None];
        let gauges = Gauges { pressure_kpa: Some([1.0, -2.0, 3.0]), tip_c: Some(36.5), tip_warm: true };
        let one = |k: usize| Cycle {
            sensed: Sensed {
                t: Seconds(k as f64 * 1e-3),
                imu: readings[k % 4],
                base_imu: (k % 3 == 1).then_some(sample),
                counted: Steps([k as i32, -7, 1 << (k % 31)]),
                counted_age_s: k as f64 * 1e-4,
                energised: k % 3 == 1,
                inputs: Inputs {
                    emergency_stop: k.is_multiple_of(2),
                    home: [k.is_multiple_of(3), k.is_multiple_of(4), k.is_multiple_of(5)],
                },
                alarm: alarms[k % 5],
                gauges: if k.is_multiple_of(2) { gauges } else { Gauges::default() },
                truth: None,
            },
            order: orders[k % 7],
            target: Shape { bend: Bend([0.1, -0.0].into()), length: Mm(k as f64) },
            digests: (k as u32, vec![k as u8; FIELDS.len()]),
        };
        (0..200).map(one).collect()
    }

    #[test]
    fn cycles_survive_the_round_trip_bit_for_bit() {
        let all = cycles();
        let read = decode(&encode(5, &all).unwrap()).unwrap();
        // a zero and its negative compare equal, so the bytes are compared as well
        assert_eq!(encode(read.0, &read.1).unwrap(), encode(5, &all).unwrap());
        assert_eq!(read, (5, all));
        assert_eq!(decode(&encode(1 << 40, &[]).unwrap()).unwrap(), (1 << 40, vec![]));
    }

    #[test]
    fn a_damaged_message_is_refused_or_read_without_panic() {
        let whole = encode(5, &cycles()).unwrap();
        (0..whole.len()).for_each(|n| assert!(decode(&whole[..n]).is_err()));
        let mut x = 7u64;
        for _ in 0..2000 {
            let mut damaged = whole.clone();
            for _ in 0..3 {
                x = x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                damaged[(x >> 33) as usize % whole.len()] = (x >> 24) as u8;
            }
            let _ = decode(&damaged);
        }
    }
}
