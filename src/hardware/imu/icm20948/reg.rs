//! Register addresses, bank by bank (DS-000189 chapter 7; p. 77 for the AK09916).

/// Any bank: bits 5:4 select the bank.
pub const BANK_SEL: u8 = 0x7F;
/// Bank 0: identity.
pub const WHO_AM_I: u8 = 0x00;
/// Bank 0: internal master enable and reset.
pub const USER_CTRL: u8 = 0x03;
/// Bank 0: duty cycling.
pub const LP_CONFIG: u8 = 0x05;
/// Bank 0: reset, sleep, clock.
pub const PWR_MGMT_1: u8 = 0x06;
/// Bank 0: axis enable.
pub const PWR_MGMT_2: u8 = 0x07;
/// Bank 0: bypass of the internal bus.
pub const INT_PIN_CFG: u8 = 0x0F;
/// Bank 0: status of the internal master.
pub const I2C_MST_STATUS: u8 = 0x17;
/// Bank 0: first byte of the burst.
pub const ACCEL_XOUT_H: u8 = 0x2D;
/// Bank 2: gyroscope rate divider.
pub const GYRO_SMPLRT_DIV: u8 = 0x00;
/// Bank 2: gyroscope range and filter.
pub const GYRO_CONFIG_1: u8 = 0x01;
/// Bank 2: alignment of both sensors' conversions.
pub const ODR_ALIGN_EN: u8 = 0x09;
/// Bank 2: accelerometer rate divider, high byte.
pub const ACCEL_SMPLRT_DIV_1: u8 = 0x10;
/// Bank 2: accelerometer rate divider, low byte.
pub const ACCEL_SMPLRT_DIV_2: u8 = 0x11;
/// Bank 2: accelerometer range and filter.
pub const ACCEL_CONFIG: u8 = 0x14;
/// Bank 3: clock of the internal master.
pub const I2C_MST_CTRL: u8 = 0x01;
/// Bank 3: shadowing of fetched bytes.
pub const I2C_MST_DELAY_CTRL: u8 = 0x02;
/// Bank 3: first of the four registers (address, register, control, data out) of slave 0.
pub const I2C_SLV0_ADDR: u8 = 0x03;
/// Bank 3: slave 0 start register.
pub const I2C_SLV0_REG: u8 = 0x04;
/// Bank 3: slave 0 enable and length.
pub const I2C_SLV0_CTRL: u8 = 0x05;
/// Bank 3: one-shot slave address.
pub const I2C_SLV4_ADDR: u8 = 0x13;
/// Bank 3: one-shot slave register.
pub const I2C_SLV4_REG: u8 = 0x14;
/// Bank 3: one-shot slave start.
pub const I2C_SLV4_CTRL: u8 = 0x15;
/// Bank 3: one-shot slave data out.
pub const I2C_SLV4_DO: u8 = 0x16;
/// Bank 3: one-shot slave data in.
pub const I2C_SLV4_DI: u8 = 0x17;
/// AK09916: identity.
pub const AK_WIA2: u8 = 0x01;
/// AK09916: data ready and overrun.
pub const AK_ST1: u8 = 0x10;
/// AK09916: mode.
pub const AK_CNTL2: u8 = 0x31;
/// AK09916: soft reset.
pub const AK_CNTL3: u8 = 0x32;
