//! A diagnosis in words for somebody who has been at the bench since morning.

use crate::diagnosis::decide::VerdictKind;
use crate::diagnosis::document::{Diagnosis, EffectEntry, ParamValue};
use crate::model::effects::by_name;

/// An effect's name as people say it.
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

/// Group of effects that this log cannot tell from `name`, itself included.
fn group<'a>(d: &'a Diagnosis, name: &str) -> Option<&'a Vec<&'static str>> {
    d.verdict.equivalent.iter().find(|g| g.contains(&name))
}

/// The verdict in one sentence.
#[must_use]
pub fn headline(d: &Diagnosis) -> String {
    let g = &d.gap;
    match d.verdict.kind {
        VerdictKind::None => format!(
            "The nominal model suffices: once recalibrated it misses by {:.2}°, and no effect of the catalogue improves on that by what is worth a name.",
            g.recalibrated_deg
        ),
        VerdictKind::Unknown if d.verdict.names.is_empty() => format!(
            "Something is at work that the catalogue does not hold: {:.2}° remain after recalibration, they are not noise ({:.2}°), and no known effect explains them.",
            g.recalibrated_deg, g.noise_floor_deg
        ),
        VerdictKind::Unknown => format!(
            "{} explains a part, from {:.2}° to {:.2}°; what remains is not noise ({:.2}°), and no known effect explains it.",
            capital(&causes(d)),
            g.recalibrated_deg,
            g.explained_deg,
            g.noise_floor_deg
        ),
        VerdictKind::Effects => format!(
            "{} {} the gap: it shrinks from {:.2}° to {:.2}° on parts of the log that no fit has seen; noise alone is {:.2}°.",
            capital(&causes(d)),
            if d.verdict.names.len() > 1 { "together explain" } else { "explains" },
            g.recalibrated_deg,
            g.explained_deg,
            g.noise_floor_deg
        ),
    }
}

/// The verdict's names; a group that cannot be told apart is said as a choice.
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
    let seen = sensor.map_or_else(String::new, |k| {
        format!(
            " It shows most in the {}: {:.2}{} before, {:.2}{} after.",
            k.name,
            k.rmse_deg,
            unit_of(k.name),
            k.explained_deg,
            unit_of(k.name)
        )
    });
    if d.verdict.kind == VerdictKind::None {
        return format!("There is no gap to place.{seen}");
    }
    let merged = d.location.merged.iter().find(|m| m.contains(&first.name));
    let merged = merged.map_or_else(String::new, |m| format!(" This log cannot separate the stages {}.", listed(m, "and")));
    format!("{:.0} % of it is laid to the {} stage.{merged}{seen}", 100.0 * first.share, first.name)
}

/// Unit of a sensor's residual.
#[must_use]
pub fn unit_of(kind: &str) -> &'static str {
    if kind == "gyroscope" { "°/s" } else { "°" }
}

/// What this log cannot tell apart; empty if there is nothing.
#[must_use]
pub fn doubts(d: &Diagnosis) -> Vec<String> {
    let groups = d.verdict.equivalent.iter().map(|g| format!("This log cannot tell {} apart.", listed(g, "from")));
    let mut out: Vec<String> = groups.collect();
    if d.verdict.kind != VerdictKind::None && d.unknown.probability > 0.05 {
        out.push(format!(
            "With a probability of {:.0} % something outside the catalogue has a part in it ({:.2}° are left above the noise).",
            100.0 * d.unknown.probability,
            d.unknown.rmse_deg
        ));
    }
    out
}

/// What to do next, most useful first.
#[must_use]
pub fn next(d: &Diagnosis) -> Vec<String> {
    let design = "`retroflex gap diagnose LOG --save model.toml`, then `retroflex gap excite --like model.toml --out schedule.csv` designs a schedule for it";
    let mut out = Vec::new();
    for g in &d.verdict.equivalent {
        let mut how: Vec<&str> = g.iter().filter_map(|n| by_name(n)).map(|e| e.info().separated_by).collect();
        how.dedup();
        out.push(format!("To tell {} apart: {}; {design}.", listed(g, "from"), how.join("; or ")));
    }
    match d.verdict.kind {
        VerdictKind::None => out.push("Nothing needs to be added to the model. Keep the recalibrated gains.".to_owned()),
        VerdictKind::Unknown => {
            out.push(format!(
                "Look where the map is darkest and when the residual is largest; {design}, on which a cause shows more plainly."
            ));
        }
        VerdictKind::Effects => out.push(
            "Confirm on a fresh log of the same unit: `retroflex gap check model.toml FRESH`. It refits nothing but the base frame."
                .to_owned(),
        ),
    }
    for name in &d.verdict.names {
        if let Some(e) = by_name(name).filter(|_| group(d, name).is_none() && entry(d, name).is_some_and(|e| e.probability < 0.9)) {
            out.push(format!(
                "{} is taken for {} at times: {}.",
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
    fn words_are_joined_as_people_do() {
        assert_eq!(listed(&["a_b"], "and"), "a b");
        assert_eq!(listed(&["a", "b", "c"], "or"), "a, b or c");
        assert_eq!(listed(&[] as &[&str], "or"), "");
    }

    #[test]
    fn numbers_are_short() {
        let got: Vec<String> = [0.0, 0.003_141, -12.345, 1234.0, 0.5, -0.000_000_1].into_iter().map(short).collect();
        assert_eq!(got, ["0", "0.00314", "-12.3", "1234", "0.5", "0"]);
    }
}
