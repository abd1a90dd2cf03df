//! The four frames of the tip, as types, so that a wrong composition does not compile.
//!
//! * [`World`]: z up, x along the horizontal part of the magnetic field (north, unknown to a map).
//! * [`Base`]: the bellows' proximal plate. At the alignment rest it coincides with the tip.
//! * [`Tip`]: the distal plate that carries camera and IMU.
//! * [`Sensor`]: the axes printed on the IMU; the mount turns them into the tip's.
//!
//! `Rotation<A, B>` takes coordinates in `B` to coordinates in `A`; a product exists only where the
//! inner frames meet, so `r_base_world * r_world_tip` is a `Rotation<Base, Tip>` and nothing else.

use nalgebra::{UnitQuaternion, Vector3};
use std::f64::consts::FRAC_PI_2;
use std::marker::PhantomData;
use std::ops::Mul;

/// Earth-fixed frame, z up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct World;
/// Proximal plate of the bending section.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Base;
/// Distal plate of the bending section.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tip;
/// Axes of the IMU package.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensor;

/// Orientation of frame `B` in frame `A`: maps coordinates of `B` to coordinates of `A`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Rotation<A, B> {
    q: UnitQuaternion<f64>,
    frames: PhantomData<(A, B)>,
}

impl Rotation<World, Sensor> {
    /// Turns an orientation from east-north-up to the world frame (north-west-up).
    pub fn from_enu(r_enu_sensor: UnitQuaternion<f64>) -> Self {
        let r_world_enu = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -FRAC_PI_2);
        Self::assert_frames(r_world_enu * r_enu_sensor)
    }
}

impl<A, B> Rotation<A, B> {
    /// Frames that coincide.
    pub fn identity() -> Self {
        Self::assert_frames(UnitQuaternion::identity())
    }
    /// The one place where a bare quaternion is *asserted* to link two frames.
    pub fn assert_frames(q: UnitQuaternion<f64>) -> Self {
        Self {
            q,
            frames: PhantomData,
        }
    }
    /// The quaternion without its frames, for arithmetic that has its own bookkeeping.
    pub fn quat(&self) -> UnitQuaternion<f64> {
        self.q
    }
    /// Coordinates in `A` of a vector given in `B`.
    pub fn apply(&self, v: &Vector3<f64>) -> Vector3<f64> {
        self.q * v
    }
    /// `B` seen from `A` turned round: `A` in `B`.
    pub fn inverse(&self) -> Rotation<B, A> {
        Rotation::assert_frames(self.q.inverse())
    }
    /// Angle between two orientations of the same frames, radians in 0..=pi.
    pub fn angle_to(&self, other: &Self) -> f64 {
        self.q.angle_to(&other.q)
    }
}

impl<A, B, C> Mul<Rotation<B, C>> for Rotation<A, B> {
    type Output = Rotation<A, C>;
    fn mul(self, rhs: Rotation<B, C>) -> Rotation<A, C> {
        Rotation::assert_frames(self.q * rhs.q)
    }
}
