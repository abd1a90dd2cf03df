//! The tape: the exact input of the supervisor in every cycle, and a digest of its decisions.
//!
//! A tape lies beside its bend log (`NAME.csv.tape`). It begins with a JSON header line that holds the configuration.
//! One record per cycle follows, little-endian: the input, field by field with a tag byte before every optional part,
//! and the digest. A replay must reproduce every digest; otherwise the software has changed.

use crate::control::tick::RestartState;
use crate::estimation::fusion::health::ImuReading;
use crate::motion::lines::Inputs;
use crate::primitives::units::{Seconds, Steps};
use crate::service::belief::Belief;
use crate::service::tape_code::{AlarmCode, Code};
use crate::supervisor::cycle::CycleOutput;
use crate::supervisor::cycle::order::Order;
use crate::supervisor::machine::{Gauges, Sensed};
use serde::{Deserialize, Serialize};

/// First line of a tape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// Version of the format: 1.
    pub tape: u32,
    /// Version of the program that wrote it.
    pub program: String,
    /// Texts of board, gains, calibration file and, with a feedforward, its model.
    pub texts: Vec<String>,
    /// Name of the machine.
    pub machine: String,
    /// Period of a cycle, s.
    pub period_s: f64,
    /// Piston travel per microstep, mm.
    pub step_mm: f64,
    /// Bellow length at rest, mm.
    pub rest_length_mm: f64,
    /// k_ε and k_λ (mm) of channels 1 to 3 at the start.
    pub lines: [[f64; 2]; 3],
    /// Lag and dead time at the start, s.
    pub dynamics: [f64; 3],
    /// State that the supervisor started from.
    #[serde(alias = "kept")]
    pub restart: Option<RestartState>,
    /// Trust in the position of that state.
    #[serde(default = "certain")]
    pub belief: Belief,
}

fn certain() -> Belief {
    Belief::Certain
}

/// One cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record {
    /// Input from the machine, without the true orientation.
    pub sensed: Sensed,
    /// Order, if any.
    pub order: Option<Order>,
    /// Digest of the decisions.
    pub digest: u64,
}

/// FNV-1a over the bits of everything that was decided in a cycle.
#[must_use]
pub fn digest(output: &CycleOutput) -> u64 {
    let f = &output.frame;
    let estimate = f.estimate.map_or([f64::NAN; 2], |x| x.bend.0.into());
    let numbers =
        [f.setpoint.bend.0.x, f.setpoint.bend.0.y, f.setpoint.length.0, f.unexplained.x, f.unexplained.y, f.feedback.x, f.feedback.y];
    let pistons: [f64; 3] = f.piston_target_mm.into();
    let floats = numbers.iter().chain(&estimate).chain(&pistons).chain(&f.k_epsilon).map(|x| x.to_bits());
    let integers = output.steps.0.map(|n| n as u64).into_iter().chain([output.mode as u64, u64::from(output.energise)]);
    floats.chain(integers).flat_map(u64::to_le_bytes).fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

/// Appends a record.
pub fn write(out: &mut Vec<u8>, record: &Record) {
    let s = &record.sensed;
    s.t.0.put(out);
    s.imu.put(out);
    s.base_imu.put(out);
    s.counted.0.put(out);
    s.counted_age_s.put(out);
    let bits = [s.energised, s.inputs.emergency_stop, s.inputs.home[0], s.inputs.home[1], s.inputs.home[2]];
    bits.iter().rev().fold(0u8, |byte, bit| byte << 1 | u8::from(*bit)).put(out);
    AlarmCode(s.alarm).put(out);
    record.order.put(out);
    record.digest.put(out);
}

fn read(input: &mut &[u8]) -> Option<Record> {
    let t = Seconds(f64::get(input)?);
    let imu = ImuReading::get(input)?;
    let base_imu = Option::get(input)?;
    let counted = Steps(<[i32; 3]>::get(input)?);
    let counted_age_s = f64::get(input)?;
    let bits = u8::get(input)?;
    let bit = |n: u8| bits >> n & 1 == 1;
    let inputs = Inputs { emergency_stop: bit(1), home: [bit(2), bit(3), bit(4)] };
    let alarm = AlarmCode::get(input)?.0;
    let (gauges, truth) = (Gauges::default(), None);
    let sensed = Sensed { t, imu, base_imu, counted, counted_age_s, energised: bit(0), inputs, alarm, gauges, truth };
    Some(Record { sensed, order: Option::get(input)?, digest: u64::get(input)? })
}

/// Reads records one by one. It ends at the end of the tape or where the tape is damaged.
#[derive(Debug, Clone, Copy)]
pub struct Reader<'a> {
    input: &'a [u8],
}

impl<'a> Reader<'a> {
    /// Reads what follows the header line.
    #[must_use]
    pub fn new(records: &'a [u8]) -> Self {
        Self { input: records }
    }

    /// True when everything was read.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.input.is_empty()
    }
}

impl Iterator for Reader<'_> {
    type Item = Record;
    fn next(&mut self) -> Option<Record> {
        read(&mut self.input)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::tick::Command;
    use crate::estimation::fusion::health::Quality;
    use crate::model::bend::Bend;
    use crate::model::transmission::Line;
    use crate::primitives::sample::ImuSample;
    use crate::primitives::units::Mm;
    use crate::service::tape_code::{FAULTS, PLAIN};
    use crate::supervisor::machine::Alarm;
    use nalgebra::Vector3;

    #[test]
    fn records_survive_the_round_trip_bit_for_bit() {
        let sample =
            ImuSample { t: Seconds(0.1), gyro_rad_s: Vector3::new(1.0, -0.0, 1e-300), acc_m_s2: Vector3::z(), mag_ut: Some(Vector3::x()) };
        let command = Command { bend: Bend([0.1, 0.2].into()), length: Mm(20.0) };
        let lines = [1.0, 2.0, 3.0].map(|k_epsilon| Line { k_epsilon, k_lambda_mm: 0.5 });
        let orders = PLAIN.into_iter().chain([
            Order::Bend(command, None),
            Order::Bend(command, Some(1.5)),
            Order::Stream(command),
            Order::Lines(lines),
        ]);
        let readings =
            [ImuReading::Nothing, ImuReading::Sample(sample, Quality::default())].into_iter().chain(FAULTS.map(ImuReading::Failed));
        let alarms = [
            None,
            Some(Alarm::Late { late_s: 0.5 }),
            Some(Alarm::Underrun),
            Some(Alarm::Discontinuity { jump_mm: 1.0 }),
            Some(Alarm::Pins),
            Some(Alarm::Dead),
            Some(Alarm::Pressure { kpa: 50.0 }),
            Some(Alarm::Hot { temp_c: 43.0 }),
            Some(Alarm::Silent),
        ];
        let mut records = Vec::new();
        for (k, (order, (imu, alarm))) in orders.map(Some).chain([None]).zip(readings.cycle().zip(alarms.into_iter().cycle())).enumerate() {
            let inputs = Inputs { emergency_stop: k % 2 == 0, home: [k % 3 == 0, k % 4 == 0, k % 5 == 0] };
            let base_imu = (k % 3 == 1).then_some(sample);
            let sensed = Sensed {
                t: Seconds(k as f64),
                imu,
                base_imu,
                counted: Steps([k as i32, -7, 1 << 30]),
                counted_age_s: k as f64 * 1e-4,
                energised: k % 3 == 1,
                inputs,
                alarm,
                gauges: Gauges::default(),
                truth: None,
            };
            records.push(Record { sensed, order, digest: k as u64 });
        }
        let mut tape = Vec::new();
        records.iter().for_each(|r| write(&mut tape, r));
        let mut reader = Reader::new(&tape);
        for r in &records {
            assert_eq!(reader.next().as_ref(), Some(r));
        }
        assert!(reader.next().is_none() && reader.is_done());
    }

    #[test]
    fn noise_does_not_panic() {
        let mut x = 7u64;
        for _ in 0..2000 {
            let noise: Vec<u8> = (0..300)
                .map(|_| {
                    x = x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    (x >> 56) as u8 % 24
                })
                .collect();
            let _ = Reader::new(&noise).count();
        }
    }
}
