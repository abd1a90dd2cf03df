//! Fits the probabilities of the diagnosis (`retroflex::diagnosis::verdict::posterior`) to logs of random machines:
//! `cargo run --release --example gap_train -- --cases cases.jsonl --out posterior.toml`.
//!
//! Units run the catalogue's laws, each multiplied by a random function of the pistons and the time, with small effects of every kind
//! beside them, or a random law that the catalogue lacks. The exam (`retroflex::experiment::exam`) asks about the built-in plant, which has
//! laws of its own. With `--map`, random rigs ([`rig`]) train the probabilities of other rigs.

mod case;
mod deform;
mod fit;
mod rig;
mod signals;
mod unit;

use case::Case;
use clap::Parser;
use miette::{IntoDiagnostic, Result, miette};
use rand::RngExt;
use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use rayon::prelude::*;
use retroflex::cli::output;
use retroflex::diagnosis::Problem;
use retroflex::diagnosis::rig::RigProblem;
use retroflex::diagnosis::tip::TipProblem;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Arguments of the program.
#[derive(Debug, Parser)]
struct Args {
    /// File that keeps every finished log; a run that was stopped goes on from it.
    #[arg(long)]
    cases: PathBuf,
    /// Write the weights (TOML); the program has them as `src/diagnosis/tip/posterior.toml` and `src/diagnosis/rig/posterior.toml`.
    #[arg(long)]
    out: PathBuf,
    /// Random rigs for `gap diagnose --map` in place of tips.
    #[arg(long)]
    map: bool,
    /// Number of logs; 2000 of tips take about 45 minutes on two cores.
    #[arg(long, default_value_t = 2000)]
    logs: u64,
    /// Seed of the first unit; the others follow.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Records and searches the logs that are missing, and writes the weights.
fn main() -> Result<()> {
    let args = Args::parse();
    output::check(&[("out", &args.out)], &[])?;
    let (file, mut cases) = open(&args.cases)?;
    let seeds = args.seed..args.seed.saturating_add(args.logs);
    cases.retain(|c| seeds.contains(&c.seed));
    let known: BTreeSet<u64> = cases.iter().map(|c| c.seed).collect();
    let missing: Vec<u64> = seeds.filter(|s| !known.contains(s)).collect();
    eprintln!(
        "seed {}, {} logs, {} of them in {}",
        args.seed,
        args.logs,
        known.len(),
        args.cases.display()
    );
    let named = |e: std::io::Error| miette!("{}: {e}", args.cases.display());
    let file = Mutex::new(file);
    let bar = output::bar(missing.len() as u64, "{pos} of {len} logs, {eta} left,");
    let one = |seed: &u64| {
        let case = if args.map {
            Case::of_rig(*seed)
        } else {
            Case::of_tip(*seed, &unit::draw(*seed).into_diagnostic()?).into_diagnostic()?
        };
        let line = serde_json::to_string(&case).into_diagnostic()? + "\n";
        let mut file = file
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        file.write_all(line.as_bytes()).map_err(named)?;
        bar.inc(1);
        Ok(case)
    };
    cases.extend(missing.par_iter().map(one).collect::<Result<Vec<Case>>>()?);
    bar.finish_and_clear();
    cases.sort_by_key(|c| c.seed);
    let head = if args.map {
        RigProblem::head()
    } else {
        TipProblem::head()
    };
    let trained = fit::fit(&cases, head.weight.keys().cloned().collect());
    let [fitted, check, lost] = trained.logs;
    let head = format!(
        "# Weights of the posterior (src/diagnosis/verdict/posterior.rs), made by\n# cargo run --release --example gap_train --{} --logs {} --seed {}\n\
         # {fitted} logs fitted; {check} others checked: the truth has {:.2} on the geometric mean; {lost} logs whose true set the search misses.\n",
        if args.map { " --map" } else { "" },
        args.logs,
        args.seed,
        (-trained.loss).exp()
    );
    let text = head + &toml::to_string(&trained.head).into_diagnostic()?;
    output::write(&args.out, text.as_bytes())?;
    output::print(text);
    Ok(())
}

/// Share of the laws outside a catalogue that act beside an effect of it.
const BESIDE: f64 = 0.4;

/// What a training log is to have: effects of a catalogue, and `None` for a law that it lacks. The contents are about as frequent as in an
/// exam.
fn contents<T>(mut catalogue: Vec<T>, rng: &mut StdRng) -> Vec<Option<T>> {
    catalogue.shuffle(rng);
    let (known, foreign) = match rng.random_range(0..32) {
        0..13 => (1, false),
        13..20 => (2, false),
        20 => (3, false),
        21..27 => (0, false),
        _ => (usize::from(rng.random_bool(BESIDE)), true),
    };
    catalogue
        .into_iter()
        .take(known)
        .map(Some)
        .chain(foreign.then_some(None))
        .collect()
}

/// Opens the file of the finished logs, which need not exist, and reads it; a last line that was cut off is removed.
fn open(path: &Path) -> Result<(File, Vec<Case>)> {
    let named = |e: std::io::Error| miette!("{}: {e}", path.display());
    let mut file = File::options()
        .create(true)
        .read(true)
        .append(true)
        .open(path)
        .map_err(named)?;
    let mut text = String::new();
    file.read_to_string(&mut text).map_err(named)?;
    let whole = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
    file.set_len(whole.len() as u64).map_err(named)?;
    let parse = |(n, line): (usize, &str)| {
        serde_json::from_str(line).map_err(|e| {
            miette!(
                "{}, line {}: {e}; remove the file to start anew",
                path.display(),
                n + 1
            )
        })
    };
    Ok((
        file,
        whole
            .lines()
            .enumerate()
            .map(parse)
            .collect::<Result<_>>()?,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_was_cut_off_is_removed_and_the_file_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cases.jsonl");
        let case = |seed| {
            format!(
                "{}\n",
                serde_json::to_string(&Case {
                    seed,
                    truth: None,
                    said: vec![]
                })
                .unwrap()
            )
        };
        std::fs::write(&path, case(1) + &case(2)[..9]).unwrap();
        let (mut file, cases) = open(&path).unwrap();
        file.write_all(case(3).as_bytes()).unwrap();
        let again = open(&path).unwrap().1;
        assert_eq!(
            (
                cases.len(),
                again.iter().map(|c| c.seed).collect::<Vec<_>>()
            ),
            (1, vec![1, 3])
        );
    }
}
