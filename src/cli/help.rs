//! The command line as `clap` describes it: commands by task, examples, completions and man pages.

use crate::cli::{ResultFile, output};
use crate::config::shipped;
use crate::drill::list;
use crate::estimation::fusion::FilterName;
use crate::estimation::fusion::estimator::EstimatorName;
use clap::builder::PossibleValuesParser;
use clap::{Arg, Command, ValueHint};
use clap_complete::Shell;
use miette::{Result, bail, miette};
use std::any::TypeId;
use std::path::PathBuf;

/// The commands by task, as `--help` lists them.
pub const GROUPS: [(&str, &str); 7] = [
    (
        "Move",
        "run arm bend stream play steer page hold stop relax disarm status monitor subscribe reset-fault reload",
    ),
    (
        "Bring up",
        "accept board doctor release jog home commission bench",
    ),
    ("Calibrate", "zero calibrate imu"),
    ("Diagnose", "record log replay foxglove gap fleet"),
    ("Simulate", "demo evaluate"),
    ("Prove", "drill"),
    ("Other", "completions man help"),
];

/// Two examples of each command that has arguments. A command with commands of its own stands for all of them.
const EXAMPLES: &str = include_str!("examples.txt");

const TEMPLATE: &str =
    "{about-with-newline}\n{usage-heading} {usage}\n{after-help}\n\nOptions:\n{options}";

/// The commands with examples, in their order, with the two of each.
fn all_examples() -> Vec<(&'static str, [&'static str; 2])> {
    let lines: Vec<&str> = EXAMPLES.lines().collect();
    let named = |pair: &[&'static str; 2]| Some((pair[0].split(' ').next()?, *pair));
    lines.as_chunks().0.iter().filter_map(named).collect()
}

/// Two examples of a command, without the name of the program.
pub fn examples(name: &str) -> [String; 2] {
    match all_examples().into_iter().find(|e| e.0 == name) {
        Some((_, lines)) => lines.map(str::to_owned),
        None => [name.to_owned(), format!("{name} --socket /tmp/tip.sock")],
    }
}

/// A command line with its commands grouped by task, and with examples.
pub fn explained(cli: Command) -> Command {
    let mut text = String::new();
    for (task, names) in GROUPS {
        text += &format!("\n{task}:\n");
        for name in names.split(' ') {
            let about = cli.find_subcommand(name).and_then(Command::get_about);
            let about = about.map_or("Print help for a command.".to_owned(), ToString::to_string);
            text += &format!("  {name:<13} {about}\n");
        }
        let mut own = all_examples();
        own.retain(|e| names.split(' ').any(|name| name == e.0) && e.1[0].contains(' '));
        let Some((_, [first, second])) = own.first() else {
            continue;
        };
        let second = own.get(1).map_or(second, |other| &other.1[0]);
        text += &format!("  For example:\n    retroflex {first}\n    retroflex {second}\n");
    }
    let numbers = |c: Command| c.allow_negative_numbers(true);
    let with_examples = |c: Command| {
        let [first, second] = examples(c.get_name());
        let text = format!("Examples:\n  retroflex {first}\n  retroflex {second}");
        numbers(c).mut_subcommands(numbers).after_help(text)
    };
    cli.mut_subcommands(with_examples)
        .help_template(TEMPLATE)
        .after_help(text.trim_end().to_owned())
}

/// A usage error without the terms of the Rust library.
pub fn plain(text: &str) -> String {
    const WORDS: [(&str, &str); 7] = [
        (
            "invalid socket address syntax",
            "expected an address and a port, for example 192.168.1.20:8088",
        ),
        ("..=", " to "),
        ("invalid float literal", "expected a number"),
        ("cannot parse float from empty string", "expected a number"),
        (
            "invalid digit found in string",
            "expected a whole number, not negative",
        ),
        ("unrecognized subcommand", "there is no command"),
        ("a similar subcommand exists", "did you mean"),
    ];
    let plainer = |text: String, (from, to): &(&str, &str)| text.replace(from, to);
    WORDS.iter().fold(text.to_owned(), plainer)
}

/// Arguments of `completions`.
#[derive(Debug, clap::Args)]
pub struct CompletionsArgs {
    /// Shell that the script is for.
    #[arg(value_enum)]
    shell: Shell,
}

/// Names of the boards of the program.
fn boards() -> [&'static str; shipped::BOARDS.len()] {
    shipped::BOARDS.map(|(name, _)| name)
}

/// Prints a completion script of a command line on standard output.
pub fn completions(args: &CompletionsArgs, command: Command) -> Result<()> {
    let (mut command, mut script) = (completed(command), Vec::new());
    clap_complete::generate(args.shell, &mut command, "retroflex", &mut script);
    let boards = boards().join(" ");
    let mut script = String::from_utf8_lossy(&script).into_owned();
    // a board may be a file, too; bash tries files when no name fits
    let with_files = format!("{{compadd {boards}; _files}}");
    script = script.replace(&format!("({boards})"), &with_files);
    let in_fish = format!("-f -a \"{}\\t", shipped::BOARDS[0].0);
    output::print(script.replace(&in_fish, &in_fish.replacen("-f", "-F", 1)));
    Ok(())
}

/// A command line, only for completion, in which boards, filters and faults of the drill have their names as values, and the files of
/// results complete as paths.
fn completed(command: Command) -> Command {
    let names = |arg: &Arg, of: &str| -> Option<Vec<&'static str>> {
        match (arg.get_id().as_str(), of) {
            ("board", _) => Some(boards().into()),
            ("filter", "score") => Some(FilterName::ALL.map(FilterName::name).into()),
            ("filter", _) => Some(EstimatorName::NAMES.into()),
            ("only", "drill") => Some(list::specs().iter().map(|spec| spec.name).collect()),
            _ => None,
        }
    };
    let of = command.get_name().to_owned();
    let complete = |arg: Arg| match names(&arg, &of) {
        Some(names) => arg.value_parser(PossibleValuesParser::new(names)),
        None if arg.get_value_parser().type_id() == TypeId::of::<ResultFile>() => {
            arg.value_hint(ValueHint::AnyPath)
        }
        None => arg,
    };
    command.mut_args(complete).mut_subcommands(completed)
}

/// Arguments of `man`.
#[derive(Debug, clap::Args)]
pub struct ManArgs {
    /// Folder for the pages, one for each command.
    folder: PathBuf,
}

/// Writes the man pages of a command line.
///
/// # Errors
/// A report that names the folder.
pub fn man(args: &ManArgs, command: Command) -> Result<()> {
    let folder = args.folder.display();
    if !args.folder.is_dir() {
        bail!("{folder}: this is no folder; create one and name it");
    }
    clap_mangen::generate_to(command, &args.folder).map_err(|e| miette!("{folder}: {e}"))
}
