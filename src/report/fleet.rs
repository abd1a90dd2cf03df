//! What the rows of a fleet tell, in words and as a page.

use crate::diagnosis::fleet::{Finding, Lot, Spread, Survey};
use crate::report::bars::{self, Bar};
use crate::report::{Ink, Page, table};

/// A finding in words.
fn words(f: &Finding) -> String {
    let is_gain = f.what.starts_with("k_") || f.what == "lag_s";
    let [here, elsewhere] = [f.here, f.elsewhere].map(|x| {
        if is_gain {
            format!("{x:.3}")
        } else {
            format!("{:.0} %", x * 100.0)
        }
    });
    let lot = f.lot.as_ref();
    let lot = lot.map_or("each lot".to_owned(), |lot| format!("lot {lot}"));
    let [half, others] = if f.drifts {
        ["the later half of ", "the earlier"]
    } else {
        ["", "the others"]
    };
    format!(
        "{}: {here} in {half}{lot}, {elsewhere} in {others} (p = {:.1e})",
        f.what, f.p
    )
}

/// The survey in words.
pub fn summary(survey: &Survey) -> String {
    let row = |lot: &Lot| {
        let share = |(name, share): &(String, f64)| format!("{name} {:.0} %", share * 100.0);
        let shares: Vec<String> = lot.shares.iter().take(4).map(share).collect();
        [lot.name.clone(), lot.logs.to_string(), shares.join(", ")]
    };
    let table = table("lot|logs|verdicts", 1..2, survey.lots.iter().map(row));
    let mut text = format!("{table}\n");
    for (name, Spread { n, median, sigma }) in &survey.gains {
        text +=
            &format!("{name}: {median:.3} ± {sigma:.3} for the next unit, from {n} sound logs\n");
    }
    if survey.findings.is_empty() {
        text += "no lot differs from the others, and nothing drifts\n";
    }
    text.extend(survey.findings.iter().map(|f| words(f) + "\n"));
    if survey.refused > 0 {
        let refused = survey.refused;
        text += &format!("{refused} logs cannot be diagnosed; the column `refused` says why\n");
    }
    text
}

/// The survey as a page.
pub fn page(survey: &Survey) -> Page {
    let mut page = Page::new("Fleet");
    page.heading("Findings");
    page.output(&summary(survey));
    page.quiet("p is the probability of a difference as large by chance, corrected for the number of comparisons; from 0.01 on nothing is claimed.");
    page.heading("Verdicts by lot");
    let bar = |(name, share): &(String, f64)| Bar {
        name: name.clone(),
        share: *share,
        interval: None,
        strong: true,
    };
    let chart = |lot: &Lot| {
        let bars: Vec<Bar> = lot.shares.iter().map(bar).collect();
        let drawing = bars::svg(&lot.name, Ink::GREEN, &bars);
        (drawing, format!("{} logs", lot.logs))
    };
    page.charts(survey.lots.iter().map(chart));
    page
}
