//! Binary form of the values on a tape, little-endian.

use crate::control::tick::Command;
use crate::estimation::fusion::health::{ImuReading, Quality, ReadFault};
use crate::model::bend::Bend;
use crate::model::transmission::Line;
use crate::primitives::sample::ImuSample;
use crate::primitives::units::{Mm, Seconds};
use crate::supervisor::cycle::order::Order;
use crate::supervisor::machine::Alarm;
use nalgebra::Vector3;

/// Binary form of a value.
pub trait Code: Sized {
    /// Appends the value.
    fn put(&self, out: &mut Vec<u8>);
    /// Reads a value and advances the input; `None` at its end or for an invalid tag.
    fn get(input: &mut &[u8]) -> Option<Self>;
}

macro_rules! little_endian {
    ($($number:ty),*) => {$(
        impl Code for $number {
            fn put(&self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_le_bytes());
            }
            fn get(input: &mut &[u8]) -> Option<Self> {
                let (bytes, rest) = input.split_first_chunk()?;
                *input = rest;
                Some(Self::from_le_bytes(*bytes))
            }
        }
    )*};
}
little_endian!(u8, i32, u64, f64);

impl<T: Code + Copy + Default, const N: usize> Code for [T; N] {
    fn put(&self, out: &mut Vec<u8>) {
        self.iter().for_each(|x| x.put(out));
    }
    fn get(input: &mut &[u8]) -> Option<Self> {
        let mut all = [T::default(); N];
        for x in &mut all {
            *x = T::get(input)?;
        }
        Some(all)
    }
}

impl<T: Code> Code for Option<T> {
    fn put(&self, out: &mut Vec<u8>) {
        u8::from(self.is_some()).put(out);
        self.iter().for_each(|x| x.put(out));
    }
    fn get(input: &mut &[u8]) -> Option<Self> {
        if u8::get(input)? == 0 { Some(None) } else { T::get(input).map(Some) }
    }
}

impl Code for Vector3<f64> {
    fn put(&self, out: &mut Vec<u8>) {
        <[f64; 3]>::from(*self).put(out);
    }
    fn get(input: &mut &[u8]) -> Option<Self> {
        <[f64; 3]>::get(input).map(Self::from)
    }
}

impl Code for ImuSample {
    fn put(&self, out: &mut Vec<u8>) {
        self.t.0.put(out);
        [self.gyro_rad_s, self.acc_m_s2].iter().for_each(|v| v.put(out));
        self.mag_ut.put(out);
    }
    fn get(input: &mut &[u8]) -> Option<Self> {
        let (t, gyro_rad_s, acc_m_s2) = (Seconds(f64::get(input)?), Code::get(input)?, Code::get(input)?);
        Some(Self { t, gyro_rad_s, acc_m_s2, mag_ut: Option::get(input)? })
    }
}

/// Read faults by code, from 2 on.
pub(super) const FAULTS: [ReadFault; 5] = [ReadFault::Nack, ReadFault::ShortRead, ReadFault::Bus, ReadFault::WrongId, ReadFault::BrownOut];

impl Code for ImuReading {
    fn put(&self, out: &mut Vec<u8>) {
        match self {
            Self::Nothing => 0u8.put(out),
            Self::Sample(sample, q) => {
                1u8.put(out);
                sample.put(out);
                [q.gyro_load, q.acc_load].put(out);
                (u8::from(q.mag_overflow) | u8::from(q.expect_noise) << 1).put(out);
            }
            Self::Failed(fault) => (2 + FAULTS.iter().position(|f| f == fault).unwrap_or(0) as u8).put(out),
        }
    }
    fn get(input: &mut &[u8]) -> Option<Self> {
        Some(match u8::get(input)? {
            0 => Self::Nothing,
            1 => {
                let sample = ImuSample::get(input)?;
                let ([gyro_load, acc_load], bits) = (<[f64; 2]>::get(input)?, u8::get(input)?);
                Self::Sample(sample, Quality { gyro_load, acc_load, mag_overflow: bits & 1 == 1, expect_noise: bits & 2 == 2 })
            }
            n => Self::Failed(*FAULTS.get(usize::from(n) - 2)?),
        })
    }
}

/// An alarm as a tag and a number, which is zero where the alarm has none.
#[derive(Debug)]
pub struct AlarmCode(pub Option<Alarm>);

impl Code for AlarmCode {
    fn put(&self, out: &mut Vec<u8>) {
        let (tag, x) = match self.0 {
            None => (0u8, 0.0),
            Some(Alarm::Late { late_s }) => (1, late_s),
            Some(Alarm::Underrun) => (2, 0.0),
            Some(Alarm::Discontinuity { jump_mm }) => (3, jump_mm),
            Some(Alarm::Pins) => (4, 0.0),
            Some(Alarm::Dead) => (5, 0.0),
            Some(Alarm::Pressure { kpa }) => (6, kpa),
            Some(Alarm::Hot { temp_c }) => (7, temp_c),
            Some(Alarm::Silent) => (8, 0.0),
        };
        tag.put(out);
        x.put(out);
    }
    fn get(input: &mut &[u8]) -> Option<Self> {
        let (tag, x) = (u8::get(input)?, f64::get(input)?);
        Some(Self(match tag {
            0 => None,
            1 => Some(Alarm::Late { late_s: x }),
            2 => Some(Alarm::Underrun),
            3 => Some(Alarm::Discontinuity { jump_mm: x }),
            4 => Some(Alarm::Pins),
            5 => Some(Alarm::Dead),
            6 => Some(Alarm::Pressure { kpa: x }),
            7 => Some(Alarm::Hot { temp_c: x }),
            8 => Some(Alarm::Silent),
            _ => return None,
        }))
    }
}

impl Code for Command {
    fn put(&self, out: &mut Vec<u8>) {
        [self.bend.0.x, self.bend.0.y, self.length.0].put(out);
    }
    fn get(input: &mut &[u8]) -> Option<Self> {
        let [x, y, length] = Code::get(input)?;
        Some(Self { bend: Bend([x, y].into()), length: Mm(length) })
    }
}

/// Orders without an argument, by code.
pub(super) const PLAIN: [Order; 10] = [
    Order::Arm,
    Order::Disarm,
    Order::Hold,
    Order::Stop,
    Order::Relax,
    Order::Zero,
    Order::Reset,
    Order::Calibrate(true),
    Order::Calibrate(false),
    Order::AssertStraight,
];

impl Code for Order {
    fn put(&self, out: &mut Vec<u8>) {
        match self {
            Self::Bend(command, speed) => {
                20u8.put(out);
                command.put(out);
                speed.put(out);
            }
            Self::Stream(command) => {
                21u8.put(out);
                command.put(out);
            }
            Self::Lines(lines) => {
                22u8.put(out);
                lines.map(|l| [l.k_epsilon, l.k_lambda_mm]).put(out);
            }
            plain => (PLAIN.iter().position(|p| p == plain).unwrap_or(0) as u8).put(out),
        }
    }
    fn get(input: &mut &[u8]) -> Option<Self> {
        Some(match u8::get(input)? {
            20 => Self::Bend(Command::get(input)?, Option::get(input)?),
            21 => Self::Stream(Command::get(input)?),
            22 => Self::Lines(<[[f64; 2]; 3]>::get(input)?.map(|[k_epsilon, k_lambda_mm]| Line { k_epsilon, k_lambda_mm })),
            n => *PLAIN.get(usize::from(n))?,
        })
    }
}
