//! Errors of opening the hardware, each with a remedy.

use crate::hardware::imu::ImuError;
use crate::hardware::pins::PinError;
use crate::hardware::stepper::StartError;
use crate::primitives::Invalid;
use std::path::PathBuf;

/// Why a machine could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum HardwareError {
    /// Another program drives the pins.
    #[error("{} is locked: another retroflex (`run`, `jog`, `home`, `commission`, `bench rt` or `release`) drives the pins; end it first", .0.display())]
    InUse(PathBuf),
    /// The pins.
    #[error(transparent)]
    Pins(#[from] PinError),
    /// The step thread.
    #[error(transparent)]
    Stepper(#[from] StartError),
    /// There is no such bus: its path.
    #[error(
        "no I²C bus at {0}: enable it (dtparam=i2c_arm=on in config.txt, then `modprobe i2c-dev`), or set imu.bus to one of `ls /dev/i2c-*`"
    )]
    NoBus(String),
    /// The bus may not be opened: its path.
    #[error(
        "no permission for {0}: add this user to the group i2c (`sudo usermod -aG i2c $USER`, then log in again) or run as the service"
    )]
    BusPermission(String),
    /// The bus cannot be used for another reason: its path, and the message of the library.
    #[error("{0} cannot be used as an I²C bus: {1}")]
    Bus(String, String),
    /// The set-up of the sensor takes longer than any working bus needs: path of the bus, and the time limit, s.
    #[error(
        "{0} hangs: no answer within {1} s; cycle the power of the IMU, then look for a short on SDA or SCL"
    )]
    BusHangs(String, f64),
    /// The sensor: path of its bus, and the error of its driver.
    #[error("IMU on {0}: {1}")]
    Imu(String, #[source] ImuError),
    /// The part does not support a setting.
    #[error(transparent)]
    Setting(#[from] Invalid),
    /// The operating system did not create the thread of this name.
    #[error("the {0} thread could not be started: {1}")]
    Thread(String, #[source] std::io::Error),
}

impl HardwareError {
    /// True for an invalid board file (exit code 2), false for hardware that does not answer (exit code 3).
    pub fn is_config(&self) -> bool {
        matches!(
            self,
            Self::Pins(PinError::Config(_))
                | Self::Stepper(StartError::Config(_))
                | Self::Setting(_)
        )
    }
}
