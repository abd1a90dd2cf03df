//! The tip as Foxglove draws it: the frame `tip` in the frame `base`, the arc with its bellows, and the target.

use crate::control::Frame;
use crate::model::{Bend, Geometry, Shape};
use crate::primitives::Mm;
use nalgebra::Vector3;
use serde_json::{Value, json};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Sections of a line that is drawn along the tip.
const SECTIONS: u32 = 8;
/// Poses that differ by less than this, °, are drawn alike.
const RESOLUTION_DEG: f64 = 0.2;
/// Positions are multiples of this, m, and parts of a rotation of this, because that compresses well.
const STEP: f64 = 1.0 / 65536.0;

fn round(x: f64) -> f64 {
    (x / STEP).round() * STEP
}

/// A vector in mm as Foxglove holds it, m.
fn metres(mm: Vector3<f64>) -> Value {
    let m = mm.map(|x| round(x * 1e-3));
    json!({"x": m.x, "y": m.y, "z": m.z})
}

/// A time, ns since 1970, as JSON holds a `google.protobuf.Timestamp`.
pub fn timestamp(unix_ns: u64) -> Value {
    let time = OffsetDateTime::from_unix_timestamp_nanos(unix_ns.into());
    json!(time.ok().and_then(|time| time.format(&Rfc3339).ok()))
}

/// `foxglove.FrameTransform`: the frame `tip` in the frame `base`, m.
pub fn pose(frame: &Frame, unix_ns: u64) -> Option<Value> {
    let estimate = frame.estimate?;
    let shape = Shape::new(estimate.bend.0, frame.setpoint.length.0);
    let q = estimate.r_base_tip.quat().coords.map(round);
    Some(json!({
        "timestamp": timestamp(unix_ns), "parent_frame_id": "base", "child_frame_id": "tip",
        "translation": metres(Geometry::default().position(&shape)), "rotation": {"x": q.x, "y": q.y, "z": q.z, "w": q.w},
    }))
}

/// The lines of a scene: the arc of the estimate with its bellows, and that of the target while the tip is commanded.
pub fn lines(frame: &Frame, commanded: bool) -> Option<Value> {
    let step = RESOLUTION_DEG.to_radians();
    let shown =
        |bend: Bend, length: Mm| Shape::new(bend.0.map(|x| (x / step).round() * step), length.0);
    let tip = shown(frame.estimate?.bend, frame.setpoint.length);
    let mut all = vec![line(&tip, None, [0.1, 0.6, 0.3, 1.0])];
    all.extend((0..3).map(|i| line(&tip, Some(i), [0.7, 0.7, 0.7, 0.6])));
    let target = shown(frame.target.bend, frame.target.length);
    all.extend(commanded.then(|| line(&target, None, [0.9, 0.4, 0.1, 1.0])));
    Some(json!(all))
}

/// `foxglove.SceneUpdate` with these lines.
pub fn update(lines: &Value, unix_ns: u64) -> Value {
    json!({"entities": [{"timestamp": timestamp(unix_ns), "frame_id": "base", "id": "tip", "lines": lines}]})
}

/// The centre line of the tip, or that of a bellow.
fn line(shape: &Shape, bellow: Option<usize>, [r, g, b, a]: [f64; 4]) -> Value {
    let geometry = Geometry::default();
    let spoke = bellow.map_or(Vector3::zeros(), |i| {
        let spoke = Geometry::spoke(i) * geometry.r_mm;
        Vector3::new(spoke.x, -spoke.y, 0.0)
    });
    let point = |k: u32| {
        let part = f64::from(k) / f64::from(SECTIONS);
        let bend = Bend(shape.bend.0 * part);
        let centre = geometry.position(&Shape::new(bend.0, shape.length.0 * part));
        metres(centre + bend.rotation().quat() * spoke)
    };
    let points: Vec<Value> = (0..=SECTIONS).map(point).collect();
    let thickness = round(if bellow.is_some() { 2e-3 } else { 0.7e-3 });
    json!({
        "type": "LINE_STRIP", "thickness": thickness, "points": points, "color": {"r": r, "g": g, "b": b, "a": a},
        "pose": {"position": {}, "orientation": {"w": 1.0}},
    })
}
