//! Operators between the input and the output of a single channel.
//!
//! For one value η of its only nonlinear parameter, an operator gives columns of a linear regression beside the nominal
//! ones. `v` is the nominal prediction scaled to −1..=1, `m` the moving signal scaled to 0..=1; times are in seconds, or
//! rows if the log has no clock. The state starts with a log and runs through it.

use crate::diagnosis::rig::Nominal;
use crate::log::table::median;
use std::f64::consts::TAU;

/// Signals that an operator acts on.
#[derive(Debug, Clone, PartialEq)]
pub struct Drive {
    /// Nominal prediction, scaled to −1..=1.
    pub v: Vec<f64>,
    /// Moving signal, scaled to 0..=1.
    pub m: Vec<f64>,
    /// Range of the moving signal, in its own unit.
    pub m_range: f64,
    /// Time, s or rows.
    pub t: Vec<f64>,
    /// `v` at an input of zero.
    pub zero: f64,
    /// Parts of `v` due to each input but the first, of several; a time constant changes their weights.
    pub parts: Vec<Vec<f64>>,
}

/// An operator.
#[derive(Debug, Clone, Copy)]
pub struct Operator {
    /// Name in reports.
    pub name: &'static str,
    /// Meaning of η; empty without η.
    pub eta: &'static str,
    /// Grid of η.
    pub grid: fn(&Drive) -> Vec<f64>,
    /// Columns at one η.
    pub columns: fn(&Drive, f64) -> Vec<Vec<f64>>,
    /// Required sign of the first coefficient; 0 for either.
    pub sign: i8,
    /// The coefficients are a state at the start of a log, and not a property of the rig: each log has its own.
    pub is_state: bool,
}

impl Operator {
    /// What takes the place of its terms once the cause is gone: of an effect that takes the answer over, the immediate answer.
    pub fn healed(&self, d: &Drive, terms: usize) -> Vec<Vec<f64>> {
        match self.name {
            "lag" | "delay" => of_each(d, <[f64]>::to_vec),
            name if TAKES_OVER.contains(&name) => vec![d.v.clone(); terms],
            _ => vec![vec![0.0; d.v.len()]; terms],
        }
    }
}

/// What operators that a log may not separate have in common.
pub fn kind(name: &str) -> &'static str {
    match name {
        "play" | "hysteresis" | "bouc_wen" | "coulomb" | "load_friction" => "memory of the path",
        "viscous" | "lag" | "delay" | "creep" | "leak" | "rate_limit" => "memory of the time",
        "cubic" | "asymmetry" | "saturation" | "dead_band" => "curved characteristic",
        "periodic_position" | "periodic_time" => "period",
        _ => "drift",
    }
}

/// Effects whose answer replaces the immediate one of the nominal model.
pub const TAKES_OVER: [&str; 7] = [
    "play",
    "hysteresis",
    "bouc_wen",
    "dead_band",
    "rate_limit",
    "lag",
    "delay",
];

/// Ratio of the time constants of the two elements of a creep.
const SLOWER: f64 = 12.0;

/// Lists operators: a name, `state` if the coefficients are a state, the sign of the first one (0 for either), the meaning of η and its grid
/// if there is an η, and the columns.
macro_rules! operators {
    ($($name:literal $($state:ident)?, $sign:literal $(, $eta:literal in $grid:expr)? => $columns:expr;)+) => {
        [$(Operator {
            name: $name,
            eta: concat!($($eta)?),
            grid: operators!(@grid $($grid)?),
            columns: $columns,
            sign: $sign,
            is_state: operators!(@is_state $($state)?),
        }),+]
    };
    (@grid) => { |_| vec![0.0] };
    (@grid $grid:expr) => { $grid };
    (@is_state) => { false };
    (@is_state state) => { true };
}

/// Operators for a rig with an input.
pub const DRIVEN: [Operator; 18] = operators! {
    // Play operator of one half-width. Separated by nested loops of several sizes.
    "play", 1, "half-width / range" in widths => |d, r| vec![play(&d.v, 2.0 * r)];
    // Prandtl-Ishlinskii: eight weighted plays (Kuhnen 2003). Separated by nested loops of several sizes.
    "hysteresis", 0 => |d, _| (1..=8).map(|k| play(&d.v, 0.12 * f64::from(k))).collect();
    // Bouc-Wen with n = 1 and β = γ (Wen 1976). Separated by nested loops of several sizes.
    "bouc_wen", 0, "yield / range" in widths => |d, r| vec![bouc_wen(&d.v, 2.0 * r)];
    // Sign of the speed. Separated by several speeds, and loops of several sizes.
    "coulomb", 0 => |d, _| vec![sign_of(&d.m, &d.t)];
    // Sign of the speed times the load. Separated by two loads.
    "load_friction", 0 => |d, _| {
        let sign = sign_of(&d.m, &d.t);
        vec![sign.iter().zip(&d.v).map(|(s, v)| s * (v + 1.0)).collect()]
    };
    // Speed. Separated by several speeds.
    "viscous", 0 => |d, _| vec![speed(&d.m, &d.t)];
    // Third power: symmetric stiffening or softening. Separated by several amplitudes.
    "cubic", 0 => |d, _| vec![d.v.iter().map(|v| v * v * v).collect()];
    // Another slope on one side of a corner. Separated by amplitudes to both sides.
    "asymmetry", 0, "corner / range" in |_| (1..10).map(|k| f64::from(k) * 0.1).collect() => |d, c| {
        vec![d.v.iter().map(|v| (v - (2.0 * c - 1.0)).abs()).collect()]
    };
    // No answer to a small input of either sign. Separated by small and large amplitudes.
    "dead_band", 1, "half-width / range" in widths => |d, w| {
        vec![d.v.iter().map(|v| beyond(v - d.zero, 2.0 * w)).collect()]
    };
    // Nothing beyond an end, on either side. Separated by amplitudes to both sides.
    "saturation", -1, "end / half range" in |_| (2..20).map(|k| f64::from(k) * 0.05).collect() => |d, c| {
        let side = |sign: f64| d.v.iter().map(|v| sign * (sign * v - c).max(0.0)).collect();
        vec![side(1.0), side(-1.0)]
    };
    // The speed of a servo is limited. Separated by steps of several sizes.
    "rate_limit", 1, "largest speed, ranges per time" in rates => |d, r| {
        vec![limited(&d.v, &d.t, 2.0 * r)]
    };
    // First order. Separated by a step and a chirp.
    "lag", 1, "time constant" in short_times => |d, tau| of_each(d, |v| follow(v, &d.t, tau));
    // Delayed input. Separated by a chirp: phase that grows with frequency.
    "delay", 1, "dead time" in short_times => |d, tau| of_each(d, |v| late(v, &d.t, tau));
    // Two Kelvin-Voigt elements, a factor [`SLOWER`] apart. Separated by hold, return, hold.
    "creep", 1, "time constant" in |d| times_from(d, 20.0, 0.5 / SLOWER) => |d, tau| {
        vec![follow(&d.v, &d.t, tau), follow(&d.v, &d.t, SLOWER * tau)]
    };
    // Exponential return after an input. Separated by a long hold, then a return to zero.
    "leak", -1, "time constant" in |d| times_from(d, 20.0, 0.5) => |d, tau| {
        vec![follow(&d.v, &d.t, tau)]
    };
    // Sine of position, with a second harmonic. Separated by two speeds.
    "periodic_position", 0, "period" in |d| periods(d.m_range, &d.m, d.m_range) => |d, p| {
        waves(d.m.iter().map(|m| m * d.m_range / p))
    };
    // Sine of time, with a second harmonic. Separated by two speeds.
    "periodic_time" state, 0, "period" in |d| periods(span(d), &d.t, 1.0) => |d, p| {
        waves(d.t.iter().map(|t| t / p))
    };
    // A dependence on time alone: a straight line. Separated by the same motion repeated later.
    "drift", 0 => |d, _| vec![since(&d.t)];
};

/// Operators for a rig without an input.
pub const STILL: [Operator; 3] = operators! {
    // Exponential decay. Separated by two pressures, and a temperature record.
    "leak" state, 0, "time constant" in |d| times_from(d, 3.0, 30.0) => |d, tau| {
        vec![since(&d.t).iter().map(|t| (-t / tau).exp()).collect()]
    };
    // Logarithm of time. Separated by a repetition after a long rest.
    "creep" state, 0, "onset" in |d| times_from(d, 1.0, 0.2) => |d, tau| {
        vec![since(&d.t).iter().map(|t| (1.0 + t / tau).ln()).collect()]
    };
    // As with an input.
    "drift", 0 => |d, _| vec![since(&d.t)];
};

/// Operators for an oscillator: the response to a nonlinear spring force, to first and second order of a perturbation
/// (Nayfeh 1973).
pub const RESONANT: [Operator; 2] = operators! {
    // Spring with a third power (Duffing). Separated by several amplitudes.
    "cubic", 0 => |d, _| spring(d, 3);
    // Spring with a square: stiffer to one side. Separated by amplitudes to both sides.
    "asymmetry", 0 => |d, _| spring(d, 2);
};

/// Operators that apply to a rig; a period in time needs a clock.
pub fn catalogue(nominal: Nominal, clocked: bool) -> Vec<Operator> {
    let mut all = match nominal {
        Nominal::Still => STILL.to_vec(),
        Nominal::Line => DRIVEN.to_vec(),
        Nominal::Resonance => RESONANT.to_vec(),
    };
    all.retain(|o| clocked || o.name != "periodic_time");
    all
}

/// A column of the whole drive, and one of each part of it.
fn of_each(d: &Drive, column: impl Fn(&[f64]) -> Vec<f64>) -> Vec<Vec<f64>> {
    let all = [&d.v].into_iter().chain(&d.parts);
    all.map(|v| column(v)).collect()
}

fn widths(_: &Drive) -> Vec<f64> {
    spread(0.005, 100.0)
}
/// 24 values from the least to a multiple of it, uniform in the logarithm.
fn spread(low: f64, times: f64) -> Vec<f64> {
    let value = |k| low * times.powf(f64::from(k) / 23.0);
    (0..24).map(value).collect()
}
/// Duration of a log.
fn span(d: &Drive) -> f64 {
    d.t[d.t.len() - 1] - d.t[0]
}
/// 24 times from a number of rows to a share of the log, uniform in the logarithm.
fn times_from(d: &Drive, rows: f64, share: f64) -> Vec<f64> {
    let low = rows * span(d) / (d.t.len() - 1) as f64;
    spread(low, (share * span(d)).max(2.0 * low) / low)
}
fn short_times(d: &Drive) -> Vec<f64> {
    times_from(d, 1.0, 0.5)
}
/// Rows that a period has at least.
const ROWS_PER_PERIOD: f64 = 5.0;

/// Periods of which 6 to 150 fit in a range, a quarter apart, and that a signal of this unit passes in five rows or more; fewer than six
/// are a trend. The longest is there in any case.
fn periods(range: f64, x: &[f64], unit: f64) -> Vec<f64> {
    let steps = x.windows(2).map(|w| (w[1] - w[0]).abs() * unit);
    let usual = median(steps.filter(|s| *s > 0.0)).unwrap_or(0.0);
    let period = |k: u32| range * 4.0 / f64::from(k);
    let passed = |k: &u32| *k == 24 || period(*k) >= ROWS_PER_PERIOD * usual;
    (24..=600).filter(passed).map(period).collect()
}
/// Speeds of the nominal prediction, ranges per time: up to what it rarely exceeds, uniform in the logarithm.
fn rates(d: &Drive) -> Vec<f64> {
    let speed = |k: usize| (d.v[k] - d.v[k - 1]).abs() / (d.t[k] - d.t[k - 1]) / 2.0;
    let mut speeds: Vec<f64> = (1..d.v.len()).map(speed).filter(|s| *s > 0.0).collect();
    speeds.sort_by(f64::total_cmp);
    let high = speeds.get(speeds.len() * 99 / 100).copied().unwrap_or(1.0);
    let low = (1.0 / span(d)).min(high / 2.0);
    spread(low, high / low)
}
fn beyond(x: f64, half: f64) -> f64 {
    x - x.clamp(-half, half)
}
/// A state that starts at the first value: `next` gives it from the one before, the new value, and the time since.
fn run(v: &[f64], t: &[f64], next: impl Fn(f64, f64, f64) -> f64) -> Vec<f64> {
    let (mut y, mut before) = (v[0], t[0]);
    let one = |(&x, &now): (&f64, &f64)| {
        y = next(y, x, now - before);
        before = now;
        y
    };
    v.iter().zip(t).map(one).collect()
}
fn limited(v: &[f64], t: &[f64], rate: f64) -> Vec<f64> {
    run(v, t, |y, x, dt| y + (x - y).clamp(-rate * dt, rate * dt))
}
/// The play operator; it starts centred.
pub fn play(v: &[f64], r: f64) -> Vec<f64> {
    let mut w = v[0];
    let one = |&x: &f64| {
        w = w.max(x - r).min(x + r);
        w
    };
    v.iter().map(one).collect()
}
fn bouc_wen(v: &[f64], z0: f64) -> Vec<f64> {
    let (mut z, mut before) = (0.0f64, v[0]);
    let one = |&x: &f64| {
        let dv = x - before;
        before = x;
        let loaded = if dv * z > 0.0 { z.abs() / z0 } else { 0.0 };
        z = (z + dv * (1.0 - loaded)).clamp(-z0, z0);
        z
    };
    v.iter().map(one).collect()
}
/// Speed of the moving signal over five rows, ranges per second.
fn speed(m: &[f64], t: &[f64]) -> Vec<f64> {
    let around = |k: usize| (k.saturating_sub(2), (k + 2).min(m.len() - 1));
    let rate = |(a, b): (usize, usize)| (m[b] - m[a]) / (t[b] - t[a]);
    (0..m.len()).map(|k| rate(around(k))).collect()
}
fn sign_of(m: &[f64], t: &[f64]) -> Vec<f64> {
    let s = speed(m, t);
    let usual = (s.iter().map(|x| x * x).sum::<f64>() / s.len() as f64).sqrt();
    let unit = (0.1 * usual).max(1e-12);
    s.iter().map(|x| (x / unit).tanh()).collect()
}
fn follow(v: &[f64], t: &[f64], tau: f64) -> Vec<f64> {
    run(v, t, |z, x, dt| z + (x - z) * (1.0 - (-dt / tau).exp()))
}
fn late(v: &[f64], t: &[f64], by: f64) -> Vec<f64> {
    let mut a = 0;
    let one = |&now: &f64| {
        let then = now - by;
        while a + 1 < t.len() && t[a + 1] <= then {
            a += 1;
        }
        let b = (a + 1).min(t.len() - 1);
        let share = |b: usize| ((then - t[a]) / (t[b] - t[a])).clamp(0.0, 1.0);
        v[a] + (v[b] - v[a]) * if b > a { share(b) } else { 0.0 }
    };
    t.iter().map(one).collect()
}
fn waves(turns: impl Iterator<Item = f64>) -> Vec<Vec<f64>> {
    let mut out = vec![vec![]; 4];
    for x in turns {
        for harmonic in [1, 2] {
            let (s, c) = (TAU * x * harmonic as f64).sin_cos();
            out[2 * harmonic - 2].push(s);
            out[2 * harmonic - 1].push(c);
        }
    }
    out
}
fn since(t: &[f64]) -> Vec<f64> {
    t.iter().map(|x| x - t[0]).collect()
}

/// The response of an oscillator to a force that is a power of its state.
fn spring(d: &Drive, power: i32) -> Vec<Vec<f64>> {
    // `Scale::drive` stores frequency and damping of the oscillator in the first two samples of `m`
    let swung = |force: Vec<f64>| oscillator(&force, d.m[0], d.m[1]);
    let first = swung(d.v.iter().map(|v| v.powi(power)).collect());
    let slope = |(v, f): (&f64, &f64)| f64::from(power) * v.powi(power - 1) * f;
    let second = swung(d.v.iter().zip(&first).map(slope).collect());
    vec![first, second]
}

/// A linear oscillator `ÿ + 2ζω ẏ + ω² y = ω² u` by the bilinear transform, `wh = 2 tan(ω h / 2)`, at rest at the first value.
pub fn oscillator(u: &[f64], wh: f64, zeta: f64) -> Vec<f64> {
    let (mut u1, mut u2, mut y1, mut y2) = (0.0, 0.0, 0.0, 0.0);
    let one = |&x: &f64| {
        let x = x - u[0];
        let y = oscillator_step([u2, u1, x], [y2, y1], wh, zeta);
        (u2, u1, y2, y1) = (u1, x, y1, y);
        u[0] + y
    };
    u.iter().map(one).collect()
}

/// The next output from the last two inputs and the new one, and the last two outputs.
pub fn oscillator_step(u: [f64; 3], y: [f64; 2], wh: f64, zeta: f64) -> f64 {
    let (k, w2) = (4.0 * zeta * wh, wh * wh);
    (w2 * (u[2] + 2.0 * u[1] + u[0]) - (2.0 * w2 - 8.0) * y[1] - (4.0 - k + w2) * y[0])
        / (4.0 + k + w2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn play_is_dragged_and_stands_within_its_gap() {
        assert_eq!(play(&[0.0, 1.0, 0.5, -1.0], 0.25), [0.0, 0.75, 0.75, -0.75]);
    }

    #[test]
    fn a_lag_trails_a_ramp_by_its_time_constant_and_a_delay_shifts_it() {
        let t: Vec<f64> = (0..200).map(|k| f64::from(k) * 0.01).collect();
        let ramp: Vec<f64> = t.clone();
        assert!((late(&ramp, &t, 0.05)[100] - 0.95).abs() < 1e-9);
        assert!((follow(&ramp, &t, 0.05)[199] - (1.99 - 0.05)).abs() < 0.006);
    }

    #[test]
    fn a_servo_follows_a_step_at_its_speed_and_a_dead_band_keeps_the_slope() {
        let t: Vec<f64> = (0..100).map(|k| f64::from(k) * 0.1).collect();
        let step: Vec<f64> = t.iter().map(|t| f64::from(u8::from(*t >= 1.0))).collect();
        let y = limited(&step, &t, 0.25);
        assert!((y[30] - 0.25 * 2.1).abs() < 1e-9 && (y[99] - 1.0).abs() < 1e-12);
        assert_eq!(
            [-0.5, 0.1, 0.5].map(|x| beyond(x, 0.25)),
            [-0.25, 0.0, 0.25]
        );
    }

    #[test]
    fn no_period_is_under_five_rows_and_a_lag_may_be_half_of_the_log() {
        for (rows, dt) in [(80, 3.0), (200, 1.0), (3000, 0.01)] {
            let t: Vec<f64> = (0..rows).map(|k| f64::from(k) * dt).collect();
            let m: Vec<f64> = t.iter().map(|t| (t / dt * 0.3).sin()).collect();
            let d = Drive {
                v: m.clone(),
                m,
                m_range: 1.0,
                t,
                zero: 0.0,
                parts: vec![],
            };
            for o in DRIVEN {
                let grid = (o.grid)(&d);
                assert!(
                    !grid.is_empty() && grid.iter().all(|x| x.is_finite()),
                    "{}",
                    o.name
                );
                match o.name {
                    "periodic_time" => assert!(grid[1..].iter().all(|p| *p >= 5.0 * dt)),
                    "lag" | "delay" => {
                        let span = f64::from(rows - 1) * dt;
                        assert!((grid[grid.len() - 1] / span - 0.5).abs() < 1e-9);
                    }
                    _ => {}
                }
            }
        }
    }

    #[test]
    fn an_oscillator_passes_a_constant_and_rings_at_its_frequency() {
        assert!(
            oscillator(&[1.0; 50], 0.3, 0.1)
                .iter()
                .all(|y| (y - 1.0).abs() < 1e-12)
        );
        let mut kick = vec![0.0; 2000];
        kick[10] = 1.0;
        let y = oscillator(&kick, 0.1, 0.01);
        let zeros: Vec<usize> = (20..600)
            .filter(|&k| y[k - 1] < 0.0 && y[k] >= 0.0)
            .collect();
        let period = (zeros[zeros.len() - 1] - zeros[0]) as f64 / (zeros.len() - 1) as f64;
        // wh = 2 tan(ω h / 2)
        assert!(
            (period - TAU / (2.0 * (0.1f64 / 2.0).atan())).abs() < 0.3,
            "{period}"
        );
    }
}
