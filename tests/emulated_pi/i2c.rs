//! An I²C bus behind its device file (`linux/i2c-dev.h`): messages go to register-level fakes of the chips.

use super::fuse::{Answer, Ioctl, long, peek, poke, word};
use crate::fake_imu::Machine;

const I2C_SLAVE: u32 = 0x0703;
const I2C_FUNCS: u32 = 0x0705;
const I2C_RDWR: u32 = 0x0707;
/// I2C_FUNC_I2C and the SMBus emulation, as i2c-bcm2835 reports.
const FUNCTIONS: u64 = 0x0EFF_0009;
const I2C_M_RD: u16 = 1;

/// The bus.
#[derive(Default)]
pub struct Bus {
    /// The chips and their faults.
    pub chips: Machine,
    /// While set, a transfer never ends: a controller that ignores its time limit.
    pub hangs: bool,
    /// Calls that hang.
    pub hanging: Vec<u64>,
    /// Transfers that were answered.
    pub transfers: u64,
    /// I2C_RETRIES, and I2C_TIMEOUT in units of 10 ms, as they were set.
    pub limits: [Option<u64>; 2],
}

impl Bus {
    /// An ioctl on the bus file.
    pub fn ioctl(&mut self, call: &Ioctl<'_>) -> Answer {
        match call.number {
            I2C_FUNCS => match poke(call.thread, call.argument, &FUNCTIONS.to_le_bytes()) {
                true => Answer::Done(0, vec![]),
                false => Answer::Failed(libc::EFAULT),
            },
            I2C_RDWR if self.hangs => {
                self.hanging.push(call.unique);
                Answer::Never
            }
            I2C_RDWR => self.transfer(call),
            0x0701 | 0x0702 => {
                self.limits[call.number as usize - 0x0701] = Some(call.argument);
                Answer::Done(0, vec![])
            }
            0x0704 | 0x0706 | 0x0708 => Answer::Done(0, vec![]),
            I2C_SLAVE => Answer::Done(0, vec![]),
            _ => Answer::Failed(libc::ENOTTY),
        }
    }

    /// I2C_RDWR: a pointer to messages (address, flags, length, pointer) and their number.
    fn transfer(&mut self, call: &Ioctl<'_>) -> Answer {
        self.transfers += 1;
        let mut head = [0_u8; 16];
        if !peek(call.thread, call.argument, &mut head) {
            return Answer::Failed(libc::EFAULT);
        }
        let (messages, n) = (long(&head, 0), word(&head, 8));
        for i in 0..u64::from(n) {
            let mut m = [0_u8; 16];
            if !peek(call.thread, messages + 16 * i, &mut m) {
                return Answer::Failed(libc::EFAULT);
            }
            let half = |at: usize| u16::from_le_bytes([m[at], m[at + 1]]);
            let (address, flags, pointer) = (half(0) as u8, half(2), long(&m, 8));
            let mut bytes = vec![0_u8; usize::from(half(4))];
            let said = if flags & I2C_M_RD != 0 {
                self.chips
                    .read(address, &mut bytes)
                    .map(|()| poke(call.thread, pointer, &bytes))
            } else if peek(call.thread, pointer, &mut bytes) {
                self.chips.write(address, &bytes).map(|()| true)
            } else {
                Ok(false)
            };
            match said {
                Ok(true) => {}
                Ok(false) => return Answer::Failed(libc::EFAULT),
                Err(e) => return Answer::Failed(e.errno()),
            }
        }
        Answer::Done(n as i32, vec![])
    }
}
