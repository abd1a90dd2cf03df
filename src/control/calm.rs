//! Calm corrections: once the set-point has rested for a while, the pistons move slowly.
//!
//! What is left to correct then is small, and a quick correction costs more than it gains: a piston that reverses crosses a backlash
//! that is known to a few percent only, and the tip jumps by what is wrong. A piston that crosses it slowly is stopped by the feedback
//! as soon as the tip answers. A large error, which an obstruction that gives way or a disturbance leaves, is corrected faster.

use crate::parameters;

parameters! {
    /// Slow corrections of a set-point that rests.
    pub struct CalmConfig: Copy {
        /// Time after which a set-point that rests is corrected slowly. A larger value corrects quickly for longer, and more poses are
        /// left by the jump of a late reversal.
        after_s: f64 = 0.75, "s", 0.0..=60.0, "0.75 lets a nominal line make its corrections";
        /// Speed of the tip that each piston may then cause. A larger value corrects sooner and jumps further.
        speed_deg_s: f64 = 1.0, "deg/s", 0.01..=1000.0, "1 moves the tip by 0.1° before a line with 0.1 s of lag answers";
        /// Error above which that speed rises. A larger value corrects disturbances more slowly.
        large_deg: f64 = 2.0, "deg", 0.0..=180.0, "2 is more than a learned pose leaves";
    }
}
