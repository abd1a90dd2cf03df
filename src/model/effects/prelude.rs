//! What the file of an effect is written with; every effect imports all of it.

pub use crate::model::effects::param::{MODE_PARAMS, join};
pub use crate::model::effects::smooth::{
    magnitude, onset, overshoot, positive, share, sign, smoothstep,
};
pub use crate::model::effects::{
    Effect, EffectInfo, ImuPrediction, Memory, Moment, Param, Pose, Stage, Starts,
};
pub use nalgebra::{Matrix2, UnitQuaternion, Vector2, Vector3};

/// The method that gives the catalogue entry of an effect: the fields of [`EffectInfo`] in their order. Without `events` there are
/// none, and without `starts` the default one.
macro_rules! info {
    (
        name: $name:literal,
        stage: $stage:expr,
        signature: $signature:literal,
        confused_with: $confused_with:expr,
        separated_by: $separated_by:literal,
        $(events: $events:literal,)?
        params: $params:expr,
        $(starts: &[$($start:expr),+ $(,)?],)?
    ) => {
        fn info(&self) -> &'static EffectInfo {
            const INFO: EffectInfo = EffectInfo {
                name: $name,
                stage: $stage,
                signature: $signature,
                confused_with: $confused_with,
                separated_by: $separated_by,
                events: [$($events,)? 0][0],
                params: $params,
                starts: &[$($($start),+)?],
            };
            &INFO
        }
    };
}
pub(crate) use info;
