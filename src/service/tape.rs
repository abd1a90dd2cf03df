//! The tape: everything the pilot was told, bit for bit, and a digest of what it decided.
//!
//! A tape lies beside its bend log (`NAME.csv.tape`): a JSON header line with the configuration, then
//! one record a turn, little-endian: a tag byte for what is there, the numbers, a digest. Replaying it
//! through the pilot must give every digest again; if not, the software has changed.

use crate::control::tick::{Command, RestartState};
use crate::estimation::fusion::health::{ImuReading, Quality, ReadFault};
use crate::model::bend::Bend;
use crate::model::transmission::Line;
use crate::motion::lines::Inputs;
use crate::primitives::sample::ImuSample;
use crate::primitives::units::{Mm, Seconds, Steps};
use crate::supervisor::cycle::CycleOutput;
use crate::supervisor::cycle::order::Order;
use crate::supervisor::machine::{Alarm, Sensed};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// First line of a tape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// Version of the format: 1.
    pub tape: u32,
    /// Version of the program that wrote it.
    pub program: String,
    /// Board, gains and calibration, as texts.
    pub texts: [String; 3],
    /// Name of the machine.
    pub machine: String,
    /// Period of a turn, s.
    pub period_s: f64,
    /// Piston travel per microstep, mm.
    pub step_mm: f64,
    /// Bellow length at rest, mm.
    pub rest_length_mm: f64,
    /// k_ε and k_λ in use at the start.
    pub lines: [[f64; 2]; 3],
    /// Lag and dead time in use at the start, s.
    pub dynamics: [f64; 2],
    /// What was remembered, if anything.
    pub kept: Option<RestartState>,
    /// Nothing that is remembered was to be believed.
    pub doubted: bool,
}

/// One turn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record {
    /// What the machine said, without the truth.
    pub sensed: Sensed,
    /// What the pilot was ordered.
    pub order: Option<Order>,
    /// Of what it decided.
    pub digest: u64,
}

/// FNV-1a over the bits of everything that was decided.
#[must_use]
pub fn digest(turned: &CycleOutput) -> u64 {
    let f = &turned.frame;
    let estimate = f.estimate.map_or([f64::NAN; 2], |x| x.bend.0.into());
    let numbers = [f.setpoint.bend.0.x, f.setpoint.bend.0.y, f.setpoint.length.0, f.error.x, f.error.y, f.feedback.x, f.feedback.y];
    let pistons: [f64; 3] = f.piston_target_mm.into();
    let floats = numbers.iter().chain(&estimate).chain(&pistons).chain(&f.k_epsilon).map(|x| x.to_bits());
    let rest = turned.steps.0.map(|n| n as u64).into_iter().chain([turned.mode as u64, u64::from(turned.energise)]);
    floats.chain(rest).flat_map(u64::to_le_bytes).fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

/// Appends a turn.
pub fn write(into: &mut Vec<u8>, record: &Record) {
    let s = &record.sensed;
    let mut w = Writer(into);
    w.f64(s.t.0);
    w.imu(&s.imu);
    w.option(s.base_imu.as_ref(), Writer::sample);
    s.counted.0.iter().for_each(|&n| w.i32(n));
    let home = s.inputs.home;
    w.u8(u8::from(s.energised)
        | u8::from(s.inputs.emergency_stop) << 1
        | u8::from(home[0]) << 2
        | u8::from(home[1]) << 3
        | u8::from(home[2]) << 4);
    w.alarm(s.alarm);
    w.option(record.order.as_ref(), Writer::order);
    w.0.extend_from_slice(&record.digest.to_le_bytes());
}

struct Writer<'a>(&'a mut Vec<u8>);

impl Writer<'_> {
    fn u8(&mut self, x: u8) {
        self.0.push(x);
    }
    fn f64(&mut self, x: f64) {
        self.0.extend_from_slice(&x.to_bits().to_le_bytes());
    }
    fn i32(&mut self, x: i32) {
        self.0.extend_from_slice(&x.to_le_bytes());
    }
    fn vector(&mut self, v: &Vector3<f64>) {
        v.iter().for_each(|&x| self.f64(x));
    }
    fn option<T>(&mut self, x: Option<&T>, write: impl FnOnce(&mut Self, &T)) {
        self.u8(u8::from(x.is_some()));
        if let Some(x) = x {
            write(self, x);
        }
    }
    fn sample(&mut self, s: &ImuSample) {
        self.f64(s.t.0);
        self.vector(&s.gyro_rad_s);
        self.vector(&s.acc_m_s2);
        self.option(s.mag_ut.as_ref(), Self::vector);
    }
    fn imu(&mut self, outcome: &ImuReading) {
        match outcome {
            ImuReading::Nothing => self.u8(0),
            ImuReading::Sample(s, q) => {
                self.u8(1);
                self.sample(s);
                self.f64(q.gyro_load);
                self.f64(q.acc_load);
                self.u8(u8::from(q.mag_overflow) | u8::from(q.expect_noise) << 1);
            }
            ImuReading::Failed(fault) => self.u8(2 + FAULTS.iter().position(|f| f == fault).unwrap_or(0) as u8),
        }
    }
    fn alarm(&mut self, alarm: Option<Alarm>) {
        let (tag, x) = match alarm {
            None => (0, 0.0),
            Some(Alarm::Late { late_s }) => (1, late_s),
            Some(Alarm::Underrun) => (2, 0.0),
            Some(Alarm::Discontinuity { jump_mm }) => (3, jump_mm),
            Some(Alarm::Pins) => (4, 0.0),
            Some(Alarm::Dead) => (5, 0.0),
        };
        self.u8(tag);
        self.f64(x);
    }
    fn command(&mut self, c: &Command) {
        [c.bend.0.x, c.bend.0.y, c.length.0].into_iter().for_each(|x| self.f64(x));
    }
    fn order(&mut self, order: &Order) {
        match order {
            Order::Bend(command, speed) => {
                self.u8(20);
                self.command(command);
                self.option(speed.as_ref(), |w, x| w.f64(*x));
            }
            Order::Stream(command) => {
                self.u8(21);
                self.command(command);
            }
            Order::Lines(lines) => {
                self.u8(22);
                lines.iter().flat_map(|l| [l.k_epsilon, l.k_lambda_mm]).for_each(|x| self.f64(x));
            }
            plain => self.u8(PLAIN.iter().position(|p| p == plain).unwrap_or(0) as u8),
        }
    }
}

const FAULTS: [ReadFault; 5] = [ReadFault::Nack, ReadFault::ShortRead, ReadFault::Bus, ReadFault::WrongId, ReadFault::BrownOut];
const PLAIN: [Order; 9] = [
    Order::Arm,
    Order::Disarm,
    Order::Hold,
    Order::Stop,
    Order::Relax,
    Order::Zero,
    Order::Reset,
    Order::Calibrate(true),
    Order::Calibrate(false),
];

/// Reads turns off a tape, one by one.
#[derive(Debug, Clone, Copy)]
pub struct Reader<'a> {
    left: &'a [u8],
}

impl<'a> Reader<'a> {
    /// What follows the header line.
    #[must_use]
    pub fn new(records: &'a [u8]) -> Self {
        Self { left: records }
    }

    /// The next turn; `None` at the end, or where the tape is cut.
    pub fn turn(&mut self) -> Option<Record> {
        let t = Seconds(self.f64()?);
        let imu = self.imu()?;
        let base_imu = if self.u8()? == 0 { None } else { Some(self.sample()?) };
        let counted = Steps([self.i32()?, self.i32()?, self.i32()?]);
        let bits = self.u8()?;
        let bit = |n: u8| bits >> n & 1 == 1;
        let inputs = Inputs { emergency_stop: bit(1), home: [bit(2), bit(3), bit(4)] };
        let alarm = self.alarm()?;
        let order = if self.u8()? == 0 { None } else { Some(self.order()?) };
        let digest = u64::from_le_bytes(self.take()?);
        Some(Record { sensed: Sensed { t, imu, base_imu, counted, energised: bit(0), inputs, alarm, truth: None }, order, digest })
    }

    /// True when everything was read.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.left.is_empty()
    }

    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, tail) = self.left.split_first_chunk::<N>()?;
        self.left = tail;
        Some(*head)
    }
    fn u8(&mut self) -> Option<u8> {
        self.take::<1>().map(|b| b[0])
    }
    fn f64(&mut self) -> Option<f64> {
        self.take().map(|b| f64::from_bits(u64::from_le_bytes(b)))
    }
    fn i32(&mut self) -> Option<i32> {
        self.take().map(i32::from_le_bytes)
    }
    fn vector(&mut self) -> Option<Vector3<f64>> {
        Some(Vector3::new(self.f64()?, self.f64()?, self.f64()?))
    }
    fn sample(&mut self) -> Option<ImuSample> {
        let (t, gyro_rad_s, acc_m_s2) = (Seconds(self.f64()?), self.vector()?, self.vector()?);
        let mag_ut = if self.u8()? == 0 { None } else { Some(self.vector()?) };
        Some(ImuSample { t, gyro_rad_s, acc_m_s2, mag_ut })
    }
    fn imu(&mut self) -> Option<ImuReading> {
        Some(match self.u8()? {
            0 => ImuReading::Nothing,
            1 => {
                let sample = self.sample()?;
                let (gyro_load, acc_load, bits) = (self.f64()?, self.f64()?, self.u8()?);
                ImuReading::Sample(sample, Quality { gyro_load, acc_load, mag_overflow: bits & 1 == 1, expect_noise: bits & 2 == 2 })
            }
            n => ImuReading::Failed(*FAULTS.get(usize::from(n) - 2)?),
        })
    }
    fn alarm(&mut self) -> Option<Option<Alarm>> {
        let (tag, x) = (self.u8()?, self.f64()?);
        Some(match tag {
            0 => None,
            1 => Some(Alarm::Late { late_s: x }),
            2 => Some(Alarm::Underrun),
            3 => Some(Alarm::Discontinuity { jump_mm: x }),
            4 => Some(Alarm::Pins),
            5 => Some(Alarm::Dead),
            _ => return None,
        })
    }
    fn command(&mut self) -> Option<Command> {
        let (x, y, length) = (self.f64()?, self.f64()?, self.f64()?);
        Some(Command { bend: Bend([x, y].into()), length: Mm(length) })
    }
    fn order(&mut self) -> Option<Order> {
        Some(match self.u8()? {
            20 => Order::Bend(self.command()?, if self.u8()? == 0 { None } else { Some(self.f64()?) }),
            21 => Order::Stream(self.command()?),
            22 => {
                let mut line = || Some(Line { k_epsilon: self.f64()?, k_lambda_mm: self.f64()? });
                Order::Lines([line()?, line()?, line()?])
            }
            n => *PLAIN.get(usize::from(n))?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_come_back_bit_for_bit() {
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
        let outcomes =
            [ImuReading::Nothing, ImuReading::Sample(sample, Quality::default())].into_iter().chain(FAULTS.map(ImuReading::Failed));
        let alarms = [
            None,
            Some(Alarm::Late { late_s: 0.5 }),
            Some(Alarm::Underrun),
            Some(Alarm::Discontinuity { jump_mm: 1.0 }),
            Some(Alarm::Pins),
            Some(Alarm::Dead),
        ];
        let mut records = Vec::new();
        for (k, (order, (imu, alarm))) in orders.map(Some).chain([None]).zip(outcomes.cycle().zip(alarms.into_iter().cycle())).enumerate() {
            let inputs = Inputs { emergency_stop: k % 2 == 0, home: [k % 3 == 0, k % 4 == 0, k % 5 == 0] };
            let base_imu = (k % 3 == 1).then_some(sample);
            let sensed = Sensed {
                t: Seconds(k as f64),
                imu,
                base_imu,
                counted: Steps([k as i32, -7, 1 << 30]),
                energised: k % 3 == 1,
                inputs,
                alarm,
                truth: None,
            };
            records.push(Record { sensed, order, digest: k as u64 });
        }
        let mut tape = Vec::new();
        records.iter().for_each(|r| write(&mut tape, r));
        let mut reader = Reader::new(&tape);
        for r in &records {
            assert_eq!(reader.turn().as_ref(), Some(r));
        }
        assert!(reader.turn().is_none() && reader.is_done());
    }

    #[test]
    fn noise_is_no_panic() {
        let mut x = 7u64;
        for _ in 0..2000 {
            let noise: Vec<u8> = (0..300)
                .map(|_| {
                    x = x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    (x >> 56) as u8 % 24
                })
                .collect();
            let mut reader = Reader::new(&noise);
            while reader.turn().is_some() {}
        }
    }
}
