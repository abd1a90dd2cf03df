//! What the plant on the host tells the sensor in the guest, over a serial line: the motion of the tip.
//!
//! A frame is two marks, nine numbers of 16 bits (specific force 1e-3 m/s², angular rate 1e-3 rad/s, field
//! 0.01 µT, all in the sensor's axes, little-endian) and the sum of the numbers' bytes. What does not add up
//! is skipped up to the next mark.

use crate::fake_imu::Motion;

const MARKS: [u8; 2] = [0xA5, 0x5A];
/// Bytes of a frame.
pub const FRAME: usize = 21;
/// SI values of one count: force, rate, field.
const UNITS: [f64; 3] = [1e-3, 1e-3, 1e-2];

fn sum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |s: u8, b| s.wrapping_add(*b))
}

/// A motion as a frame.
pub fn encode(motion: &Motion) -> [u8; FRAME] {
    let mut frame = [0; FRAME];
    frame[..2].copy_from_slice(&MARKS);
    let vectors = [motion.acc_m_s2, motion.gyro_rad_s, motion.mag_ut];
    let counts = vectors
        .iter()
        .zip(UNITS)
        .flat_map(|(v, unit)| [v.x, v.y, v.z].map(|x| (x / unit).round() as i16));
    for (at, count) in (2..).step_by(2).zip(counts) {
        frame[at..at + 2].copy_from_slice(&count.to_le_bytes());
    }
    frame[FRAME - 1] = sum(&frame[2..FRAME - 1]);
    frame
}

/// Takes bytes as they come; the newest whole frame among them, if there is one.
#[derive(Debug, Default)]
pub struct Decoder {
    held: Vec<u8>,
}

impl Decoder {
    /// More bytes.
    pub fn take(&mut self, bytes: &[u8]) -> Option<Motion> {
        self.held.extend(bytes);
        let mut newest = None;
        while self.held.len() >= FRAME {
            if self.held[..2] == MARKS && sum(&self.held[2..FRAME - 1]) == self.held[FRAME - 1] {
                newest = Some(motion(&self.held[2..FRAME - 1]));
                self.held.drain(..FRAME);
            } else {
                self.held.remove(0);
            }
        }
        newest
    }
}

fn motion(numbers: &[u8]) -> Motion {
    let count = |i: usize| f64::from(i16::from_le_bytes([numbers[2 * i], numbers[2 * i + 1]]));
    let vector = |k: usize| {
        nalgebra::Vector3::new(count(3 * k), count(3 * k + 1), count(3 * k + 2)) * UNITS[k]
    };
    Motion {
        acc_m_s2: vector(0),
        gyro_rad_s: vector(1),
        mag_ut: vector(2),
        ..Motion::default()
    }
}

#[test]
fn a_motion_comes_through_whatever_surrounds_it() {
    let sent = Motion {
        gyro_rad_s: nalgebra::Vector3::new(-1.5, 0.25, 3.0),
        ..Motion::default()
    };
    let mut decoder = Decoder::default();
    let mut stream = vec![0x00, 0xA5, 0x5A, 0x13];
    stream.extend(encode(&sent));
    stream.extend(&encode(&Motion::default())[..7]);
    let found: Vec<Motion> = stream.iter().filter_map(|b| decoder.take(&[*b])).collect();
    assert_eq!(found.len(), 1);
    assert!(
        (found[0].gyro_rad_s - sent.gyro_rad_s).norm() < 1e-9
            && (found[0].mag_ut - sent.mag_ut).norm() < 1e-9
    );
    assert!((found[0].acc_m_s2 - sent.acc_m_s2).norm() < 1e-9);
}
