//! A diagnosis in words.

use crate::diagnosis::tip::observed::Depends;
use crate::diagnosis::tip::{
    Diagnosis, EffectEntry, ParamValue, Remedy, confused_with, separated_by,
};
use crate::diagnosis::verdict::{StatementEntry, Verdict, VerdictKind};

/// Name of an effect without underscores.
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

/// The entries of the effects that the verdict names.
pub(super) fn named(d: &Diagnosis) -> impl Iterator<Item = &EffectEntry> {
    let named = |e: &&EffectEntry| d.verdict.names.contains(&e.name);
    d.effects.iter().filter(named)
}

/// The entry of an effect.
fn entry<'a>(d: &'a Diagnosis, name: &str) -> Option<&'a EffectEntry> {
    d.effects.iter().find(|e| e.name == name)
}

/// Group of effects that this log cannot separate from `name`, itself included.
fn group<'a>(d: &'a Diagnosis, name: &str) -> Option<&'a Vec<&'static str>> {
    d.verdict.equivalent.iter().find(|g| g.contains(&name))
}

/// The group of an effect as a choice.
fn choice(d: &Diagnosis, name: &str) -> Option<String> {
    group(d, name).map(|group| format!("either {}", listed(group, "or")))
}

/// The verdict in one sentence for who stands at the machine: cause, place, size, share of the gap, certainty, what to do next.
pub fn opening(d: &Diagnosis) -> String {
    let percent = closed_percent(d);
    let sure = format!("probability {:.2}", d.verdict.probability);
    let (was, many) = (d.gap.recalibrated_deg, d.verdict.names.len() > 1);
    let sized: Vec<String> = d.verdict.names.iter().map(|name| sized(d, name)).collect();
    let (causes, close) = (listed(&sized, "and"), if many { "close" } else { "closes" });
    match d.verdict.kind {
        VerdictKind::None => {
            format!("No effect ({sure}): the recalibrated model leaves {was:.2}°; keep its gains.")
        }
        VerdictKind::Unknown if sized.is_empty() => format!(
            "Unknown cause ({sure}): {was:.2}° remain, and no known effect explains them; record a schedule of `gap excite`."
        ),
        VerdictKind::Unknown => format!(
            "Unknown cause ({sure}), of which {causes} {close} {percent:.0} % of the gap; record a schedule of `gap excite`."
        ),
        VerdictKind::Effects => {
            let (causes, together) = (capital(&causes), if many { "together " } else { "" });
            let asked = asked(d);
            format!("{causes} {together}{close} {percent:.0} % of the gap ({sure}): {asked}.")
        }
    }
}

/// Part of the gap that the verdict closes, percent.
fn closed_percent(d: &Diagnosis) -> f64 {
    let gap = &d.gap;
    let [was, is, noise] =
        [gap.recalibrated_deg, gap.explained_deg, gap.noise_floor_deg].map(|x| x * x);
    100.0 * ((was - is) / (was - noise).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0)
}

/// An effect, or its group as a choice, with the lines that have it and its largest parameter.
fn sized(d: &Diagnosis, name: &'static str) -> String {
    if let Some(choice) = choice(d, name) {
        return choice;
    }
    let params = entry(d, name).map_or(&[][..], |e| &e.params);
    // the parameter that is known best, in the line that has most of it
    let known = |p: &&ParamValue| (p.value / (p.ci95[1] - p.ci95[0]).max(1e-12)).abs();
    let best = params.iter().max_by(|a, b| known(a).total_cmp(&known(b)));
    let best = best.map(|p| p.name);
    let same = || params.iter().filter(|p| Some(p.name) == best);
    let size = |p: &&ParamValue| p.value.abs();
    let Some(p) = same().max_by(|a, b| size(a).total_cmp(&size(b))) else {
        return plain(name);
    };
    let has = |q: &&ParamValue| q.channel > 0 && 2.0 * q.value.abs() >= p.value.abs();
    let lines: Vec<String> = same().filter(has).map(|q| q.channel.to_string()).collect();
    let place = match lines.len() {
        0 => String::new(),
        1 => format!(" of line {}", lines[0]),
        3 => " of all lines".to_owned(),
        _ => format!(" of lines {}", listed(&lines, "and")),
    };
    let ([low, high], name) = (p.ci95.map(short), plain(name));
    format!("{name}{place} ({}, 95 %: {low} to {high})", quantity(p))
}

/// What to do about the effects of the verdict: first tell those of a group apart.
fn asked(d: &Diagnosis) -> String {
    if let Some(group) = d.verdict.equivalent.first() {
        let how = group.first().map_or("", |name| separated_by(name));
        let group = listed(group, "and");
        return format!("record this manoeuvre to tell {group} apart: {how}");
    }
    let mut all: Vec<&str> = Vec::new();
    for remedy in d.verdict.names.iter().filter_map(|n| Remedy::named(n)) {
        let advice = remedy.advice();
        if !all.contains(&advice) {
            all.push(advice);
        }
    }
    all.join("; ")
}

/// The verdict in one sentence.
pub fn headline(d: &Diagnosis) -> String {
    let gap = &d.gap;
    let (was, is, noise) = (gap.recalibrated_deg, gap.explained_deg, gap.noise_floor_deg);
    let (causes, many) = (capital(&causes(d)), d.verdict.names.len() > 1);
    let explain = if many { "explain" } else { "explains" };
    match d.verdict.kind {
        VerdictKind::None => format!(
            "The nominal model suffices: its error after recalibration is {was:.2}°, and no effect of the catalogue reduces it by a relevant amount."
        ),
        VerdictKind::Unknown if d.verdict.names.is_empty() => format!(
            "The cause is not in the catalogue: {was:.2}° remain after recalibration, more than noise ({noise:.2}°), and no known effect explains them."
        ),
        VerdictKind::Unknown => format!(
            "{causes} {explain} a part of the gap, from {was:.2}° to {is:.2}°; the remainder is more than noise ({noise:.2}°), and no known effect explains it."
        ),
        VerdictKind::Effects => {
            let together = if many { "together " } else { "" };
            format!(
                "{causes} {together}{explain} the gap: it shrinks from {was:.2}° to {is:.2}° on parts of the log that the fit has not seen; noise alone is {noise:.2}°."
            )
        }
    }
}

/// Names of the verdict; a group of equivalent effects reads as a choice.
fn causes(d: &Diagnosis) -> String {
    let one = |name: &&'static str| choice(d, name).unwrap_or_else(|| plain(name));
    let mut words: Vec<String> = d.verdict.names.iter().map(one).collect();
    words.dedup();
    listed(&words, "and")
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    let first = letters.next().into_iter().flat_map(char::to_uppercase);
    first.chain(letters).collect()
}

/// Where the gap lies, in one sentence.
pub fn place(d: &Diagnosis) -> String {
    let Some(first) = d.location.stages.first() else {
        return String::new();
    };
    let kinds = d.location.kinds.iter();
    let sensor = kinds.max_by(|a, b| a.rmse_deg.total_cmp(&b.rmse_deg));
    let largest = sensor.map_or_else(String::new, |k| {
        let (name, unit, before, after) = (k.name, unit_of(k.name), k.rmse_deg, k.explained_deg);
        format!(" It is largest in the {name}: {before:.2}{unit} before, {after:.2}{unit} after.")
    });
    if d.verdict.kind == VerdictKind::None {
        return format!("There is no gap to locate.{largest}");
    }
    let merged = d.location.merged.iter().find(|m| m.contains(&first.name));
    let merged = merged.map_or_else(String::new, |m| {
        format!(" This log cannot separate the stages {}.", listed(m, "and"))
    });
    let (percent, name) = (100.0 * first.share, first.name);
    format!("{percent:.0} % of the gap is attributed to the {name} stage.{merged}{largest}")
}

/// Unit of a sensor's residual.
pub fn unit_of(kind: &str) -> &'static str {
    if kind == "gyroscope" { "°/s" } else { "°" }
}

/// Limits of the verdict: equivalent effects and the probability of another cause.
pub fn limits(d: &Diagnosis) -> Vec<String> {
    let groups = d.verdict.equivalent.iter().map(|g| listed(g, "and"));
    let groups = groups.map(|g| format!("This log cannot separate {g}."));
    let mut out: Vec<String> = groups.collect();
    if d.verdict.kind != VerdictKind::None && d.unknown.probability > 0.05 {
        let (percent, rest) = (100.0 * d.unknown.probability, d.unknown.rmse_deg);
        out.push(format!("The probability of a cause outside the catalogue is {percent:.0} % ({rest:.2}° remain above the noise)."));
        out.extend(d.unknown.goes_with.first().map(goes_with));
    }
    if d.verdict.conformal.len() > 1 {
        let one = |s: &StatementEntry| match s.kind {
            VerdictKind::None => format!("no effect ({:.2})", s.probability),
            VerdictKind::Unknown => format!("a cause outside the catalogue ({:.2})", s.probability),
            VerdictKind::Effects => format!("{} ({:.2})", listed(&s.names, "with"), s.probability),
        };
        let said: Vec<String> = d.verdict.conformal.iter().map(one).collect();
        let said = said.join("; ");
        out.push(format!("With 95 % it is one of these: {said}."));
    }
    out
}

/// What the remainder goes with.
pub(super) fn goes_with(d: &Depends) -> String {
    let (name, percent) = (&d.name, 100.0 * d.share);
    format!("What remains goes with the {name}, which predicts {percent:.0} % of it in one sensor.")
}

/// Next steps, most useful first.
pub fn next(d: &Diagnosis) -> Vec<String> {
    let design = "`retroflex gap diagnose LOG --save model.toml`, then `retroflex gap excite --like model.toml --out schedule.csv` designs a schedule for it";
    let mut out = Vec::new();
    for g in &d.verdict.equivalent {
        let mut how: Vec<&str> = g.iter().map(|name| separated_by(name)).collect();
        how.dedup();
        let (names, how) = (listed(g, "and"), how.join("; or "));
        out.push(format!("To separate {names}: {how}; {design}."));
    }
    out.push(match d.verdict.kind {
        VerdictKind::None => "The model needs no addition. Keep the recalibrated gains.".to_owned(),
        VerdictKind::Unknown => format!(
            "Examine where the map is darkest and when the residual is largest; {design}, on which the cause is more visible."
        ),
        VerdictKind::Effects => "Confirm on a fresh log of the same unit: `retroflex gap check model.toml FRESH`. It fits only the base frame again.".to_owned(),
    });
    for name in &d.verdict.names {
        let doubtful = entry(d, name).is_some_and(|e| e.probability < 0.9);
        if group(d, name).is_none() && doubtful {
            let how = format!("To separate them: {}.", separated_by(name));
            let (name, others) = (capital(&plain(name)), listed(confused_with(name), "or"));
            out.push(format!("{name} may be confused with {others}. {how}"));
        }
    }
    out
}

/// Name, value and unit.
fn quantity(p: &ParamValue) -> String {
    let text = format!("{} {} {}", plain(p.name), short(p.value), p.unit);
    text.trim_end().to_owned()
}

/// `rate 0.0031 1/s (0.0029 to 0.0033), channel 2`.
pub fn value(p: &ParamValue) -> String {
    let channel = match p.channel {
        0 => String::new(),
        n => format!(", channel {n}"),
    };
    let ([low, high], quantity) = (p.ci95.map(short), quantity(p));
    format!("{quantity} ({low} to {high}){channel}")
}

/// Three significant digits.
pub fn short(x: f64) -> String {
    let size = match x.abs().log10().floor() {
        size if size.is_finite() => size,
        _ => 0.0,
    };
    let mut text = format!("{x:.*}", (2.0 - size).clamp(0.0, 6.0) as usize);
    if text.contains('.') {
        text = text.trim_end_matches('0').trim_end_matches('.').to_owned();
    }
    if text == "-0" { "0".to_owned() } else { text }
}

/// A verdict and the effects that it names, in one line.
pub fn verdict(verdict: &Verdict) -> String {
    let between = if verdict.names.is_empty() { "" } else { ": " };
    let names = verdict.names.join(" and ");
    format!("verdict {}{between}{names}", verdict.kind.name())
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
        let got: Vec<String> = [0.0, 0.003_141, -12.345, 1234.0, 0.5, -0.000_000_1]
            .into_iter()
            .map(short)
            .collect();
        assert_eq!(got, ["0", "0.00314", "-12.3", "1234", "0.5", "0"]);
    }
}
