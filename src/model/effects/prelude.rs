//! What the file of an effect is written with; every effect imports all of it.

pub use crate::model::effects::param::{MODE_PARAMS, join};
pub use crate::model::effects::smooth::{
    magnitude, onset, overshoot, positive, share, sign, smoothstep,
};
pub use crate::model::effects::{
    Effect, EffectInfo, ImuPrediction, Memory, Moment, Param, Pose, Stage, Starts,
};
pub use nalgebra::{Matrix2, UnitQuaternion, Vector2, Vector3};

/// The method that gives the description of an effect, `INFO` in its file.
macro_rules! info {
    () => {
        fn info(&self) -> &'static EffectInfo {
            &INFO
        }
    };
}
pub(crate) use info;
