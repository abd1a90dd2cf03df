//! The score of an exam of the diagnosis, in words and tables.

use crate::experiment::exam::{Count, Counts, ExamScore, Method, ReliabilityBin};
use crate::report::table::table;
use comfy_table::Table;

fn share(c: &Count) -> String {
    match c.of {
        0 => "–".to_owned(),
        of => format!("{:.0} % of {of}", c.share() * 100.0),
    }
}

/// The score for people.
pub fn summary(s: &ExamScore) -> String {
    format!(
        "{}\n{}\ncalibration error: effects {:.3}, unknown {:.3}; a 95 % set has {:.1} statements\n{}\nanswers that differ from the truth:\n{}",
        own(s),
        reliability(s),
        s.effects.error,
        s.unknown.error,
        s.conformal_size,
        comparison(s),
        mistakes(s).join("\n")
    )
}

/// Table of the diagnosis alone.
fn own(s: &ExamScore) -> Table {
    let both = |name: &str, lab: String, field: String| [name.to_owned(), lab, field];
    let row = |name: &str, r: &Counts| both(name, share(&r.lab), share(&r.field));
    let all = |name: &str, count: &Count| both(name, share(count), String::new());
    let [lab, field] = s.fresh_closed.map(|x| format!("{:.0} %", x * 100.0));
    let rows = [
        row("single effect named", &s.diagnosis.single),
        row("stage with the largest share", &s.stage),
        row("both of two named, nothing else", &s.diagnosis.pair),
        row("three of three named, nothing else", &s.diagnosis.triple),
        row("effect-free logs with a claim", &s.diagnosis.alarm),
        row("outside the catalogue: unknown", &s.outside),
        row("of them, not too small to be claimed", &s.outside_visible),
        row("removed from the catalogue: unknown", &s.left_out),
        row("95 % sets of statements that hold", &s.conformal),
        row("stated intervals that hold", &s.coverage),
        all("known effects called unknown", &s.known_called_unknown),
        all("logs with a group of equivalent effects", &s.grouped),
        both("gap closed on a fresh log, median", lab, field),
    ];
    table("|lab|field", 1..3, rows)
}

/// Table of stated probabilities and frequencies.
fn reliability(s: &ExamScore) -> Table {
    let row = |what: &str, b: &ReliabilityBin| {
        let [low, high] = b.ci95.map(|share| share * 100.0);
        let within = format!("{low:.0} to {high:.0} %");
        [
            what.to_owned(),
            format!("{:.2}", b.stated),
            share(&b.count),
            within,
        ]
    };
    let effects = s.effects.bins.iter().map(|b| row("an effect", b));
    let rows = effects.chain(s.unknown.bins.iter().map(|b| row("unknown", b)));
    table("statement|stated|true|95 %", 1..4, rows)
}

/// Table of the diagnosis beside the other methods.
fn comparison(s: &ExamScore) -> Table {
    let row = |(name, m): (&str, &Method)| {
        let (lab, field) = (&m.alarm.lab, &m.alarm.field);
        let alarms = Count {
            right: lab.right + field.right,
            of: lab.of + field.of,
        };
        let (single, pair) = (&m.single, &m.pair);
        let counts = [&single.lab, &single.field, &pair.lab, &pair.field, &alarms];
        // the numbers of logs stand in the table of the diagnosis
        let percent = |c: &Count| share(c).split(" of ").next().unwrap_or_default().to_owned();
        let (name, f1) = (name.to_owned(), format!("{:.2}", m.macro_f1));
        [vec![name], counts.map(percent).into(), vec![f1]].concat()
    };
    let methods = [
        ("diagnosis", &s.diagnosis),
        ("in-sample BIC", &s.bic),
        ("sparse regression", &s.sparse),
        ("nearest signature", &s.nearest),
    ];
    let header = "method|single lab|field|pair lab|field|false alarms|macro F1";
    table(header, 1..7, methods.map(row))
}

fn mistakes(s: &ExamScore) -> Vec<String> {
    let wrong = |truth: &str, answer: &str| {
        answer != truth && !(answer == "unknown" && truth.starts_with("unknown"))
    };
    let mut all = Vec::new();
    for (truth, answers) in &s.confusion {
        let answers = answers.iter().filter(|(answer, _)| wrong(truth, answer));
        all.extend(answers.map(|(answer, n)| format!("  {truth} → {answer} ({n})")));
    }
    all
}
