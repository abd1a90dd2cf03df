//! How a command ends: good, not good enough, or with an error, and how that is printed: one line that says what is wrong, the place in
//! the file where there is one, and what to do. Lines are not wrapped, so that they can be searched and copied.

use crate::cli::output::printable;
use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};
use miette::{Report, SourceSpan};
use std::fmt;
use std::io::{IsTerminal, stderr};

/// How a command ended, other than by an error: true, unless its answer is "not good enough".
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CommandOutcome(pub bool);

impl From<()> for CommandOutcome {
    fn from((): ()) -> Self {
        Self(true)
    }
}

impl From<bool> for CommandOutcome {
    fn from(good: bool) -> Self {
        Self(good)
    }
}

/// Hardware or a service that does not answer. Anywhere in the chain of a report it makes the exit code 3.
///
/// Convert it to a `Report` with `?` or `Report::from`; `into_diagnostic` would hide its type.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error("{0}")]
pub struct Unreachable(String);

impl Unreachable {
    /// The report about a device, bus or service that does not answer: the system's reason, and the remedy.
    pub fn report(what: &str, why: impl fmt::Display) -> Report {
        Self(format!("{what} cannot be reached: {why}")).into()
    }
}

/// A "no" that a command says in its own words on standard error: what the service refuses, or a motion that ended early. Anywhere in
/// the chain of a report it makes the exit code 1.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[error("{0}")]
pub struct Refused(pub String);

impl Refused {
    /// The report of what is refused, and why.
    pub fn report(why: impl fmt::Display) -> Report {
        Self(format!("refused: {why}")).into()
    }
}

/// Prints an error to standard error, in colour on a terminal unless `NO_COLOR` is set.
pub fn print(report: &Report) {
    let colour = stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none();
    eprintln!("{}", rendered(report, colour));
}

fn rendered(report: &Report, colour: bool) -> String {
    let renderer = if colour {
        Renderer::styled()
    } else {
        Renderer::plain()
    };
    let causes = report.chain().skip(1).map(|cause| format!(": {cause}"));
    let title: String = std::iter::once(report.to_string()).chain(causes).collect();
    let title = String::from_utf8_lossy(&printable(title.as_bytes())).into_owned();
    if report.is::<Refused>() {
        return title;
    }
    let title = Level::ERROR.primary_title(title);
    let place = quoted(report);
    let mut group = match &place {
        Some((text, line, span)) => title.element(
            Snippet::source(text)
                .line_start(*line)
                .annotation(AnnotationKind::Primary.span(span.clone())),
        ),
        None => Group::with_title(title),
    };
    if let Some(help) = report.help() {
        group = group.element(Level::HELP.message(help.to_string()));
    }
    renderer.render(&[group])
}

/// The lines of the file that an error points into, the number of the first of them, and the place within them.
fn quoted(report: &Report) -> Option<(String, usize, std::ops::Range<usize>)> {
    let label = report.labels()?.next()?;
    let span = *label.inner();
    let read = report.source_code()?.read_span(&span, 1, 1).ok()?;
    let text = String::from_utf8_lossy(read.data()).into_owned();
    let from = span.offset() - SourceSpan::offset(read.span());
    let to = (from + span.len()).min(text.len());
    Some((text, read.line() + 1, from.min(to)..to))
}
