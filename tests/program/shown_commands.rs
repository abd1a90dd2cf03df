//! Every command that the documents and the program's messages show exists, and what they print in a `console` block is what the program prints.
//!
//! In `console` blocks a line after `$` is executed and the lines below it are compared: `…` stands for any text, and
//! numbers may differ. The commands of all other blocks, and those of tables that start with `retroflex`, are parsed.

use crate::common::repo;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

fn documents() -> Vec<(String, String)> {
    let folder = std::fs::read_dir(repo("docs"))
        .unwrap()
        .map(|e| e.unwrap().path());
    let pages = folder.filter(|p| p.extension().is_some_and(|e| e == "md"));
    let paths = std::iter::once(repo("README.md")).chain(pages);
    paths
        .map(|p| {
            (
                p.file_name().unwrap().to_string_lossy().into_owned(),
                std::fs::read_to_string(p).unwrap(),
            )
        })
        .collect()
}

/// Code blocks with their language.
fn blocks(text: &str) -> Vec<(&str, &str)> {
    text.split("```")
        .skip(1)
        .step_by(2)
        .filter_map(|b| b.split_once('\n'))
        .collect()
}

/// Command lines of this program without comments, redirections and placeholders, and whether they stand in a sentence, where
/// the name of a command or of its option is enough.
fn shown(text: &str) -> Vec<(String, bool)> {
    let in_blocks = blocks(text).into_iter().flat_map(|(_, body)| body.lines());
    let prose = text.split("```").step_by(2);
    let inline = prose
        .flat_map(|part| part.split('`').skip(1).step_by(2))
        .filter(|c| !c.contains('\n'));
    let ours = |line: &str| {
        let line = line
            .trim()
            .trim_start_matches("$ ")
            .split(" #")
            .next()
            .unwrap()
            .trim();
        let line = line
            .trim_end_matches('&')
            .split(" 2>")
            .next()
            .unwrap()
            .split(['>', '|'])
            .next()
            .unwrap()
            .trim()
            .to_owned();
        let line = line
            .strip_prefix("cargo run --release -- ")
            .map_or(line.clone(), |rest| format!("retroflex {rest}"));
        let placeholder = ['[', '…', '<', '=', '{'].iter().any(|c| line.contains(*c))
            || line.split(' ').any(|w| w == "N" || w == "HOURS");
        (line.starts_with("retroflex ") && !placeholder).then_some(line)
    };
    in_blocks
        .filter_map(|l| Some((ours(l)?, false)))
        .chain(inline.filter_map(|l| Some((ours(l)?, true))))
        .collect()
}

/// The texts in the program's source, file by file: what it says to people, and more.
fn messages() -> Vec<(String, String)> {
    let mut folders = vec![repo("src")];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for path in std::fs::read_dir(folder).unwrap() {
            let path = path.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") && !path.ends_with("tests.rs") {
                files.push(path);
            }
        }
    }
    let literal = |path: PathBuf| {
        let code = std::fs::read_to_string(&path).unwrap();
        let code = code.split("#[cfg(test)]\nmod tests").next().unwrap();
        let lines = code
            .lines()
            .filter(|line| !line.trim_start().starts_with("//"));
        let code = lines.collect::<Vec<_>>().join("\n").replace("\\\"", "'");
        // a quotation mark as a character is none
        let code = code.replace("'\"'", "");
        let texts: Vec<String> = code
            .split('"')
            .skip(1)
            .step_by(2)
            .map(str::to_owned)
            .collect();
        let name = path
            .strip_prefix(repo("src"))
            .unwrap()
            .display()
            .to_string();
        texts.into_iter().map(move |text| (name.clone(), text))
    };
    files.into_iter().flat_map(literal).collect()
}

#[test]
fn every_shown_command_is_understood() {
    let mut wrong = Vec::new();
    let mut count = 0;
    for (name, text) in documents().into_iter().chain(messages()) {
        for (line, in_sentence) in shown(&text) {
            count += 1;
            let words = shlex::split(&line).unwrap();
            if let Err(e) = retroflex::cli::command().try_get_matches_from(&words) {
                use clap::error::ErrorKind as Kind;
                let missing = [
                    Kind::DisplayHelpOnMissingArgumentOrSubcommand,
                    Kind::MissingRequiredArgument,
                    Kind::MissingSubcommand,
                ];
                let bare_option = e.kind() == Kind::InvalidValue
                    && e.to_string().contains("but none was supplied");
                if e.kind() != Kind::DisplayHelp
                    && !(in_sentence && (missing.contains(&e.kind()) || bare_option))
                {
                    wrong.push(format!("{name}: {line}: {e}"));
                }
            }
        }
    }
    assert!(count > 60, "{count}");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_example_of_the_help_is_understood_and_names_what_exists() {
    fn examples(command: &clap::Command, into: &mut Vec<String>) {
        let text = command.get_after_help().map(ToString::to_string);
        let text = text.unwrap_or_default();
        let lines = text.lines().map(str::trim);
        into.extend(
            lines
                .filter(|l| l.starts_with("retroflex "))
                .map(str::to_owned),
        );
        command
            .get_subcommands()
            .for_each(|inner| examples(inner, into));
    }
    let mut all = Vec::new();
    examples(&retroflex::cli::command(), &mut all);
    assert!(all.len() > 60, "{}", all.len());
    let faults = retroflex::drill::list::specs();
    let boards = retroflex::config::shipped::BOARDS;
    for line in &all {
        let words = shlex::split(line).unwrap();
        if let Err(e) = retroflex::cli::command().try_get_matches_from(&words) {
            panic!("{line}: {e}");
        }
        let value = |option: &str| {
            let at = words.iter().position(|word| word == option)?;
            words.get(at + 1).cloned()
        };
        if let Some(text) = value("--only").filter(|_| words[1] == "drill") {
            assert!(
                faults.iter().any(|fault| fault.name.contains(&text)),
                "{line}"
            );
        }
        if let Some(board) = value("--board") {
            let named = boards.iter().any(|(name, _)| *name == board);
            assert!(named || repo(&board).exists(), "{line}");
        }
    }
}

/// A text as a pattern: numbers may differ, spaces and the ends of lines do not count.
fn alike(printed: &str, expected: &str) -> bool {
    let plain = |text: &str| {
        let digits: String = text
            .chars()
            .map(|c| if c.is_ascii_digit() { '0' } else { c })
            .collect();
        let mut words: Vec<String> = digits
            .split_whitespace()
            .map(|w| w.replace('-', ""))
            .collect();
        words.iter_mut().for_each(|w| {
            while w.contains("00") {
                *w = w.replace("00", "0")
            }
        });
        words.join(" ")
    };
    let printed = plain(printed);
    let mut rest = printed.as_str();
    let parts: Vec<String> = expected.split('…').map(plain).collect();
    for (i, part) in parts.iter().enumerate() {
        match rest.find(part.as_str()) {
            Some(at) if at == 0 || i > 0 => rest = &rest[at + part.len()..],
            _ => return false,
        }
    }
    parts.last().is_some_and(String::is_empty) || rest.trim().is_empty()
}

/// The processes that a block leaves in the background.
struct Background(Vec<Child>);

impl Drop for Background {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = Command::new("kill").arg(child.id().to_string()).status();
            let _ = child.wait();
        }
    }
}

struct Session {
    folder: tempfile::TempDir,
    path: String,
    background: Background,
}

impl Session {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for name in ["examples", "boards", "calib"] {
            std::os::unix::fs::symlink(repo(name), folder.path().join(name)).unwrap();
        }
        let programs = Path::new(env!("CARGO_BIN_EXE_retroflex"))
            .parent()
            .unwrap()
            .to_owned();
        let path =
            std::env::join_paths([programs, PathBuf::from("/usr/bin"), PathBuf::from("/bin")])
                .unwrap();
        Self {
            folder,
            path: path.into_string().unwrap(),
            background: Background(vec![]),
        }
    }

    fn command(&self, line: &str) -> Command {
        let mut command = Command::new("bash");
        let home = self.folder.path();
        command.args(["-c", line]).current_dir(home).env_clear();
        command.env("RETROFLEX_SOCKET", home.join("control.sock"));
        command
            .env("PATH", &self.path)
            .env("HOME", home)
            .env("NO_COLOR", "1")
            .stdin(Stdio::null());
        command
    }

    /// Runs a line; returns what it prints on both outputs.
    fn run(&mut self, line: &str) -> String {
        if let Some(line) = line.strip_suffix('&') {
            // `exec`, so that the process is the program and not a shell
            let line = line.replacen(
                "retroflex run",
                "exec retroflex run --socket control.sock --state state",
                1,
            );
            self.background.0.push(self.command(&line).spawn().unwrap());
            let ready = Instant::now();
            while ready.elapsed() < Duration::from_secs(20)
                && !self.run("retroflex status").contains("disarmed")
            {
                std::thread::sleep(Duration::from_millis(100));
            }
            return String::new();
        }
        let out = self.command(line).output().unwrap();
        String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr)
    }
}

#[test]
fn what_the_documents_print_is_what_the_program_prints() {
    let mut sessions = 0;
    for (name, text) in documents() {
        let mut session = Session::new();
        for (_, body) in blocks(&text)
            .into_iter()
            .filter(|(language, _)| *language == "console")
        {
            for step in body.split("$ ").skip(1) {
                let (line, expected) = step.split_once('\n').unwrap();
                if line.ends_with("# long") {
                    continue;
                }
                let printed = session.run(line.trim());
                assert!(
                    alike(&printed, expected),
                    "{name}: $ {line}\nexpected:\n{expected}\nprinted:\n{printed}"
                );
            }
            sessions += 1;
        }
    }
    assert!(sessions >= 2, "{sessions}");
}

#[test]
fn numbers_may_differ_and_words_may_not() {
    assert!(alike("bend 60.0° of 61°\nmore\n", "bend 59.9° of 60°\n…\n"));
    assert!(!alike("bend 60.0° of 61°\nmore\n", "bend 59.9° of 60°\n"));
    assert!(!alike("tilt 60°\n", "bend 60°\n") && alike("", ""));
}
