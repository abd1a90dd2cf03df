//! A cycle as the log holds it: the exact input of the supervisor, and digests of everything that it decided.

use crate::control::Frame;
use crate::model::Shape;
use crate::primitives::ImuReading;
use crate::supervisor::{CycleOutput, Order, Sensed};
use postcard::ser_flavors::Flavor;
use serde::{Deserialize, Serialize};
use std::mem::take;

/// One cycle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cycle {
    /// Input from the machine, without the true orientation.
    pub sensed: Sensed,
    /// Order, if any.
    pub order: Option<Order>,
    /// Target of the tip.
    pub target: Shape,
    /// Digests of the decisions: one of all, in two bytes, then, in some cycles, one of each of [`FIELDS`], in one byte.
    pub digests: (u16, Vec<u8>),
}

impl Cycle {
    /// A cycle with a digest of all decisions, and, if `each`, one of each field.
    pub fn new(output: &CycleOutput, each: bool) -> Self {
        let sensed = Sensed {
            truth: None,
            ..output.sensed
        };
        Self {
            sensed,
            order: output.order,
            target: output.frame.target,
            digests: digests(output, each),
        }
    }

    /// Whether the decisions differ from those of this cycle, and the names of the fields that do: none in a cycle without digests
    /// of the fields. A difference that lasts one cycle has equal digests by chance once in 65,536 times, a field once in 256.
    pub fn differences(&self, output: &CycleOutput) -> Option<Vec<&'static str>> {
        let now = digests(output, !self.digests.1.is_empty());
        let pairs = now.1.iter().zip(&self.digests.1);
        let different = FIELDS.iter().zip(pairs).filter(|(_, (a, b))| a != b);
        let names = || different.map(|(name, _)| *name).collect();
        (now != self.digests).then(names)
    }
}

/// FNV-1a over bytes.
pub fn fnv(bytes: impl IntoIterator<Item = u8>) -> u64 {
    bytes.into_iter().fold(0xcbf2_9ce4_8422_2325, |h, b| {
        (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3)
    })
}

/// The hash of what `postcard` writes: a number at a time, because a replay hashes every frame.
struct Hash(u64);

impl Hash {
    fn mix(&mut self, word: u64) {
        let mixed = (self.0 ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = mixed ^ (mixed >> 32);
    }
}

impl Flavor for Hash {
    type Output = u64;

    fn try_extend(&mut self, data: &[u8]) -> postcard::Result<()> {
        match data.try_into() {
            Ok(word) => self.mix(u64::from_le_bytes(word)),
            Err(_) => data.iter().for_each(|byte| self.mix((*byte).into())),
        }
        Ok(())
    }

    fn try_push(&mut self, data: u8) -> postcard::Result<()> {
        self.mix(data.into());
        Ok(())
    }

    fn finalize(self) -> postcard::Result<u64> {
        Ok(self.0)
    }
}

fn field(value: impl Serialize) -> u64 {
    postcard::serialize_with_flavor(&value, Hash(0)).unwrap_or_default()
}

/// The fields with a digest: all of the frame, taken apart so that none is forgotten, and those of the supervisor.
macro_rules! fields {
    ($output:ident: $($name:ident),* | $($own:ident),*) => {
        /// Fields of a cycle with a digest of their own.
        pub const FIELDS: &[&str] = &[$(stringify!($name),)* $(stringify!($own)),*];

        fn digests($output: &CycleOutput, each: bool) -> (u16, Vec<u8>) {
            // the time is input
            let Frame { t: _, $($name),* } = &$output.frame;
            let all = [$(field($name),)* $(field(&$output.$own)),*];
            let each = all.iter().filter(|_| each).map(|x| (x >> 56) as u8).collect();
            ((field(all) >> 48) as u16, each)
        }
    };
}

fields! {
    output:
    phase, target, setpoint, estimate, bend_from_pistons, predicted, unexplained, feedback, command, bellow_mm,
    piston_target_mm, steps, k_epsilon, k_lambda_mm, dynamics, cut, at_rest, blocked, belief, saturation, senses,
    base_moved, base_doubted | steps, mode, energise, latched, stopped
}

/// What a message holds: the numbers of all cycles that change all the time and their digests, each kind side by side, because
/// that compresses well, and the cycles without them.
#[derive(Serialize, Deserialize)]
struct Message {
    /// Number of the first cycle.
    first: u64,
    /// Times of the cycles and of the samples: the first bytes of all, then the second bytes of all, and so on.
    times: [Vec<u8>; 2],
    /// The other columns of [`visit_numbers`].
    values: [Numbers; 4],
    digests: Vec<(u16, Vec<u8>)>,
    cycles: Vec<Cycle>,
}

/// Numbers that may all be multiples of one, as those of a chip are.
#[derive(Serialize, Deserialize)]
enum Numbers {
    Any(Vec<f64>),
    Multiples(f64, Vec<i32>),
}

impl Numbers {
    fn new(values: Vec<f64>) -> Self {
        let mut sorted: Vec<f64> = values.iter().map(|x| x.abs()).collect();
        sorted.sort_by(f64::total_cmp);
        let largest = sorted.last().copied().unwrap_or(0.0);
        let gaps = sorted.windows(2).map(|w| w[1] - w[0]);
        let gaps = gaps.filter(|gap| *gap > 1e-9 * largest);
        // the smallest gap tells how many multiples the largest number is, and that the unit, but for its last bits
        let unit = largest / (largest / gaps.fold(largest, f64::min)).round();
        let multiples = |unit: f64| -> Option<Vec<i32>> {
            let multiple = |x: &f64| {
                let n = (x / unit).round() as i32;
                ((f64::from(n) * unit).to_bits() == x.to_bits()).then_some(n)
            };
            values.iter().map(multiple).collect()
        };
        let mut units = [unit, unit.next_up(), unit.next_down()].into_iter();
        let found = units.find_map(|unit| Some(Self::Multiples(unit, multiples(unit)?)));
        found.unwrap_or(Self::Any(values))
    }

    fn values(self) -> Vec<f64> {
        match self {
            Self::Any(values) => values,
            Self::Multiples(unit, counts) => {
                counts.into_iter().map(|n| f64::from(n) * unit).collect()
            }
        }
    }
}

/// Visits the numbers of a cycle that change all the time, each with its column: the times of the cycle and of the sample,
/// gyroscope, accelerometer, magnetometer, loads.
fn visit_numbers(cycle: &mut Cycle, visit: &mut dyn FnMut(usize, &mut f64)) {
    visit(0, &mut cycle.sensed.t.0);
    let ImuReading::Sample(sample, quality) = &mut cycle.sensed.imu else {
        return;
    };
    visit(1, &mut sample.t.0);
    sample.gyro_rad_s.iter_mut().for_each(|x| visit(2, x));
    sample.acc_m_s2.iter_mut().for_each(|x| visit(3, x));
    sample.mag_ut.iter_mut().flatten().for_each(|x| visit(4, x));
    visit(5, &mut quality.gyro_load);
    visit(5, &mut quality.acc_load);
}

/// A message with consecutive cycles from this number on.
///
/// # Errors
/// Those of `postcard`, in whose format all of it is.
pub fn encode(first: u64, cycles: &[Cycle]) -> postcard::Result<Vec<u8>> {
    let (mut cycles, mut columns) = (cycles.to_vec(), [const { Vec::new() }; 6]);
    let mut digests = Vec::with_capacity(cycles.len());
    for cycle in &mut cycles {
        visit_numbers(cycle, &mut |n, x| columns[n].push(take(x)));
        digests.push(take(&mut cycle.digests));
    }
    let [t, sample_t, values @ ..] = columns;
    let times = [t, sample_t].map(|all: Vec<f64>| {
        let bytes = |k: usize| all.iter().map(move |t| t.to_le_bytes()[k]);
        (0..8).flat_map(bytes).collect()
    });
    postcard::to_allocvec(&Message {
        first,
        times,
        values: values.map(Numbers::new),
        digests,
        cycles,
    })
}

/// The cycles of a message, with the number of the first one.
///
/// # Errors
/// Those of `postcard`, for a damaged message.
pub fn decode(message: &[u8]) -> postcard::Result<(u64, Vec<Cycle>)> {
    let message: Message = postcard::from_bytes(message)?;
    let (first, mut cycles) = (message.first, message.cycles);
    let time = |bytes: &Vec<u8>, n: usize| {
        f64::from_le_bytes(std::array::from_fn(|k| bytes[k * (bytes.len() / 8) + n]))
    };
    let times = |bytes: Vec<u8>| (0..bytes.len() / 8).map(|n| time(&bytes, n)).collect();
    let [t, sample_t] = message.times.map(times);
    let [gyro, acc, mag, loads] = message.values.map(Numbers::values);
    let mut columns = [t, sample_t, gyro, acc, mag, loads].map(Vec::into_iter);
    let mut whole = first.checked_add(cycles.len() as u64).is_some();
    whole &= message.digests.len() >= cycles.len();
    for (cycle, digests) in cycles.iter_mut().zip(message.digests) {
        visit_numbers(cycle, &mut |n, x| match columns[n].next() {
            Some(next) => *x = next,
            None => whole = false,
        });
        cycle.digests = digests;
    }
    let cut = postcard::Error::DeserializeUnexpectedEnd;
    whole.then_some((first, cycles)).ok_or(cut)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::bend::Bend;
    use crate::model::transmission::Line;
    use crate::motion::lines::Inputs;
    use crate::motion::machine::{Alarm, Gauges};
    use crate::primitives::sample::ImuSample;
    use crate::primitives::units::{Mm, Seconds, Steps};
    use crate::primitives::{Quality, ReadFault};
    use nalgebra::Vector3;

    /// Cycles with many orders, readings and alarms.
    fn cycles() -> Vec<Cycle> {
        let sample = ImuSample {
            t: Seconds(0.1),
            gyro_rad_s: Vector3::new(1.0, -0.0, 1e-300),
            acc_m_s2: Vector3::z(),
            mag_ut: Some(Vector3::x()),
        };
        let command = Shape {
            bend: Bend([0.1, 0.2].into()),
            length: Mm(20.0),
        };
        let lines = [1.0, 2.0, 3.0].map(|k_epsilon| Line {
            k_epsilon,
            k_lambda_mm: 0.5,
        });
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
        let alarms = [
            None,
            Some(Alarm::Late { late_s: 0.5 }),
            Some(Alarm::Pressure {
                kpa: f64::NEG_INFINITY,
            }),
            Some(Alarm::Silent),
            None,
        ];
        let gauges = Gauges {
            pressure_kpa: Some([1.0, -2.0, 3.0]),
            tip_c: Some(36.5),
            tip_warm: true,
        };
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
                    home: [
                        k.is_multiple_of(3),
                        k.is_multiple_of(4),
                        k.is_multiple_of(5),
                    ],
                },
                alarm: alarms[k % 5],
                gauges: if k.is_multiple_of(2) {
                    gauges
                } else {
                    Gauges::default()
                },
                truth: None,
            },
            order: orders[k % 7],
            target: Shape {
                bend: Bend([0.1, -0.0].into()),
                length: Mm(k as f64),
            },
            digests: (k as u16, vec![k as u8; FIELDS.len()]),
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
        assert_eq!(
            decode(&encode(1 << 40, &[]).unwrap()).unwrap(),
            (1 << 40, vec![])
        );
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
