//! A diagnosis in words.

use crate::diagnosis::decide::VerdictKind;
use crate::diagnosis::document::{Diagnosis, EffectEntry, ParamValue};
use crate::model::effects::by_name;

/// Name of an effect without underscores.
#[must_use]
pub fn plain(name: &str) -> String {
    name.replace('_', " ")
}

fn listed(names: &[impl AsRef<str>], last: &str) -> String {
    let words: Vec<String> = names.iter().map(|n| plain(n.as_ref())).collect();
    match words.as_slice() {
        [] => String::new(),
        [one] => one.clone(),
        [most @ .., end] => format!("{} {last} {end}", most.join(", ")),
    }
}

/// The entry of an effect.
fn entry<'a>(d: &'a Diagnosis, name: &str) -> Option<&'a EffectEntry> {
    d.effects.iter().find(|e| e.name == name)
}

/// Group of effects that this log cannot separate from `name`, itself included.
fn group<'a>(d: &'a Diagnosis, name: &str) -> Option<&'a Vec<&'static str>> {
    d.verdict.equivalent.iter().find(|g| g.contains(&name))
}

/// The verdict in one sentence.
#[must_use]
pub fn headline(d: &Diagnosis) -> String {
    let g = &d.gap;
    match d.verdict.kind {
        VerdictKind::None => format!(
            "The nominal model suffices: its error after recalibration is {:.2}°, and no effect of the catalogue reduces it by a relevant amount.",
            g.recalibrated_deg
        ),
        VerdictKind::Unknown if d.verdict.names.is_empty() => format!(
            "The cause is not in the catalogue: {:.2}° remain after recalibration, more than noise ({:.2}°), and no known effect explains them.",
            g.recalibrated_deg, g.noise_floor_deg
        ),
        VerdictKind::Unknown => format!(
            "{} {} a part of the gap, from {:.2}° to {:.2}°; the remainder is more than noise ({:.2}°), and no known effect explains it.",
            capital(&causes(d)),
            if d.verdict.names.len() > 1 { "explain" } else { "explains" },
            g.recalibrated_deg,
            g.explained_deg,
            g.noise_floor_deg
        ),
        VerdictKind::Effects => format!(
            "{} {} the gap: it shrinks from {:.2}° to {:.2}° on parts of the log that the fit has not seen; noise alone is {:.2}°.",
            capital(&causes(d)),
            if d.verdict.names.len() > 1 { "together explain" } else { "explains" },
            g.recalibrated_deg,
            g.explained_deg,
            g.noise_floor_deg
        ),
    }
}

/// Names of the verdict; a group of equivalent effects reads as a choice.
fn causes(d: &Diagnosis) -> String {
    let one = |name: &&'static str| group(d, name).map_or_else(|| plain(name), |g| format!("either {}", listed(g, "or")));
    let mut words: Vec<String> = d.verdict.names.iter().map(one).collect();
    words.dedup();
    listed(&words, "and")
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |c| c.to_uppercase().chain(letters).collect())
}

/// Where the gap lies, in one sentence.
#[must_use]
pub fn place(d: &Diagnosis) -> String {
    let Some(first) = d.location.stages.first() else { return String::new() };
    let sensor = d.location.kinds.iter().max_by(|a, b| a.rmse_deg.total_cmp(&b.rmse_deg));
    let largest = sensor.map_or_else(String::new, |k| {
        format!(
            " It is largest in the {}: {:.2}{} before, {:.2}{} after.",
            k.name,
            k.rmse_deg,
            unit_of(k.name),
            k.explained_deg,
            unit_of(k.name)
        )
    });
    if d.verdict.kind == VerdictKind::None {
        return format!("There is no gap to locate.{largest}");
    }
    let merged = d.location.merged.iter().find(|m| m.contains(&first.name));
    let merged = merged.map_or_else(String::new, |m| format!(" This log cannot separate the stages {}.", listed(m, "and")));
    format!("{:.0} % of the gap is attributed to the {} stage.{merged}{largest}", 100.0 * first.share, first.name)
}

/// Unit of a sensor's residual.
#[must_use]
pub fn unit_of(kind: &str) -> &'static str {
    if kind == "gyroscope" { "°/s" } else { "°" }
}

/// Limits of the verdict: equivalent effects and the probability of another cause.
#[must_use]
pub fn limits(d: &Diagnosis) -> Vec<String> {
    let groups = d.verdict.equivalent.iter().map(|g| format!("This log cannot separate {}.", listed(g, "and")));
    let mut out: Vec<String> = groups.collect();
    if d.verdict.kind != VerdictKind::None && d.unknown.probability > 0.05 {
        out.push(format!(
            "The probability of a cause outside the catalogue is {:.0} % ({:.2}° remain above the noise).",
            100.0 * d.unknown.probability,
            d.unknown.rmse_deg
        ));
    }
    out
}

/// Next steps, most useful first.
#[must_use]
pub fn next(d: &Diagnosis) -> Vec<String> {
    let design = "`retroflex gap diagnose LOG --save model.toml`, then `retroflex gap excite --like model.toml --out schedule.csv` designs a schedule for it";
    let mut out = Vec::new();
    for g in &d.verdict.equivalent {
        let mut how: Vec<&str> = g.iter().filter_map(|n| by_name(n)).map(|e| e.info().separated_by).collect();
        how.dedup();
        out.push(format!("To separate {}: {}; {design}.", listed(g, "and"), how.join("; or ")));
    }
    match d.verdict.kind {
        VerdictKind::None => out.push("The model needs no addition. Keep the recalibrated gains.".to_owned()),
        VerdictKind::Unknown => {
            out.push(format!(
                "Examine where the map is darkest and when the residual is largest; {design}, on which the cause is more visible."
            ));
        }
        VerdictKind::Effects => out.push(
            "Confirm on a fresh log of the same unit: `retroflex gap check model.toml FRESH`. It fits only the base frame again."
                .to_owned(),
        ),
    }
    for name in &d.verdict.names {
        if let Some(e) = by_name(name).filter(|_| group(d, name).is_none() && entry(d, name).is_some_and(|e| e.probability < 0.9)) {
            out.push(format!(
                "{} may be confused with {}. To separate them: {}.",
                capital(&plain(name)),
                listed(e.info().confused_with, "or"),
                e.info().separated_by
            ));
        }
    }
    out
}

/// `rate 0.0031 1/s (0.0029 to 0.0033), channel 2`.
#[must_use]
pub fn value(p: &ParamValue) -> String {
    let channel = if p.channel == 0 { String::new() } else { format!(", channel {}", p.channel) };
    let unit = if p.unit.is_empty() { String::new() } else { format!(" {}", p.unit) };
    format!("{} {}{unit} ({} to {}){channel}", plain(p.name), short(p.value), short(p.ci95[0]), short(p.ci95[1]))
}

/// Three significant digits.
#[must_use]
pub fn short(x: f64) -> String {
    let size = if x == 0.0 || !x.is_finite() { 0.0 } else { x.abs().log10().floor() };
    let text = format!("{x:.*}", (2.0 - size).clamp(0.0, 6.0) as usize);
    let trimmed = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text };
    if trimmed == "-0" { "0".to_owned() } else { trimmed }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_joined_with_commas_and_a_conjunction() {
        assert_eq!(listed(&["a_b"], "and"), "a b");
        assert_eq!(listed(&["a", "b", "c"], "or"), "a, b or c");
        assert_eq!(listed(&[] as &[&str], "or"), "");
    }

    #[test]
    fn numbers_have_three_significant_digits() {
        let got: Vec<String> = [0.0, 0.003_141, -12.345, 1234.0, 0.5, -0.000_000_1].into_iter().map(short).collect();
        assert_eq!(got, ["0", "0.00314", "-12.3", "1234", "0.5", "0"]);
    }
}
