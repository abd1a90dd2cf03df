//! Why hardware could not be brought up, in words that say what to do.

use crate::hardware::imu::{ConfigError as ImuConfigError, ImuError};
use crate::hardware::pins::OpenError;
use crate::hardware::stepper::StartError;

/// Why a machine could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum HardwareError {
    /// The pins.
    #[error(transparent)]
    Pins(#[from] OpenError),
    /// The step thread.
    #[error(transparent)]
    Stepper(#[from] StartError),
    /// There is no such bus.
    #[error(
        "no I²C bus at {path}: enable it (dtparam=i2c_arm=on in config.txt, then `modprobe i2c-dev`), or set imu.bus to one of `ls /dev/i2c-*`"
    )]
    NoBus {
        /// The path tried.
        path: String,
    },
    /// The bus may not be opened.
    #[error(
        "no permission for {path}: add this user to the group i2c (`sudo usermod -aG i2c $USER`, then log in again) or run as the service"
    )]
    BusPermission {
        /// The path tried.
        path: String,
    },
    /// The bus cannot be used for another reason.
    #[error("{path} cannot be used as an I²C bus: {why}")]
    Bus {
        /// The path tried.
        path: String,
        /// What the library said.
        why: String,
    },
    /// The bus took longer than it ever may.
    #[error("{path} hangs: nothing came back within {limit_s} s; power-cycle the IMU, then look for a short on SDA or SCL")]
    BusHangs {
        /// The path tried.
        path: String,
        /// How long was waited, s.
        limit_s: f64,
    },
    /// The sensor.
    #[error("IMU on {path}: {source}")]
    Imu {
        /// The bus.
        path: String,
        /// What the driver said.
        source: ImuError,
    },
    /// A setting that the part does not have.
    #[error(transparent)]
    ImuConfig(#[from] ImuConfigError),
    /// The operating system gave no thread.
    #[error("the IMU thread could not be started: {0}")]
    Thread(#[from] std::io::Error),
    /// The program was built without the feature `hw`.
    #[error("this program was built without hardware support: build with `--features hw`")]
    NotBuilt,
}

impl HardwareError {
    /// True for a wrong board file (exit code 2), false for hardware that does not answer (exit code 3).
    #[must_use]
    pub fn is_config(&self) -> bool {
        matches!(self, Self::Pins(OpenError::Config(_)) | Self::Stepper(StartError::Config(_)) | Self::ImuConfig(_))
    }
}
