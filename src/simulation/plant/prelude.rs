//! What the file of an effect is written with; every effect imports all of it.

pub(crate) use crate::primitives::Invalid;
pub(crate) use crate::simulation::plant::imu::stimulus::{GRAVITY_M_S2, Stimulus};
pub(crate) use crate::simulation::plant::law::{
    BellowState, Law, Moment, PlantEffect, SectionState, UnitData,
};
pub(crate) use crate::simulation::plant::memory::{DeadTime, Decay, Wander};
pub(crate) use crate::simulation::plant::parameters::{directed, effect, parameters};
pub(crate) use crate::simulation::plant::rng::{PlantRng, Stream};
pub(crate) use crate::simulation::plant::shape::arc::toward;
pub(crate) use nalgebra::{Matrix2, UnitQuaternion, Vector2, Vector3};
