//! The documents and the repository agree: every test, file and link that a document names exists.

use crate::common::repo;
use retroflex::model::effects::{Effect, Param, Stage, catalogue};
use std::path::{Path, PathBuf};

/// The documents with their text.
fn documents() -> Vec<(PathBuf, String)> {
    let mut paths = [
        "README.md",
        "ARCHITECTURE.md",
        "CHANGELOG.md",
        "calib/README.md",
    ]
    .map(repo)
    .to_vec();
    let folder = std::fs::read_dir(repo("docs"))
        .unwrap()
        .map(|e| e.unwrap().path());
    paths.extend(folder.filter(|p| p.extension().is_some_and(|e| e == "md")));
    paths
        .into_iter()
        .map(|p| (p.clone(), std::fs::read_to_string(&p).unwrap()))
        .collect()
}

/// What stands between pairs of backticks, code blocks excepted.
fn code(text: &str) -> Vec<&str> {
    let prose = text.split("```").step_by(2);
    prose
        .flat_map(|part| part.split('`').skip(1).step_by(2))
        .collect()
}

#[test]
fn everything_that_the_documents_name_exists() {
    let mut missing = Vec::new();
    for (path, text) in documents() {
        for name in code(&text) {
            let (file, test) = name
                .split_once("::")
                .map_or((name, None), |(f, t)| (f, Some(t)));
            let is_path = [
                "src/",
                "tests/",
                "docs/",
                "boards/",
                "calib/",
                "examples/",
                ".ci/",
                "systemd/",
            ]
            .iter()
            .any(|p| file.starts_with(p));
            if !is_path || file.contains(['*', ' ']) || file.contains("NAME") {
                continue;
            }
            let found = std::fs::read_to_string(repo(file));
            let exists = match test {
                Some(test) => found.is_ok_and(|code| code.contains(&format!("fn {test}("))),
                None => repo(file).exists(),
            };
            if !exists {
                missing.push(format!("{}: {name}", path.display()));
            }
        }
        for link in text
            .split("](")
            .skip(1)
            .filter_map(|rest| rest.split(')').next())
        {
            let file = link.split('#').next().unwrap();
            if !file.is_empty() && !link.contains("://") && !path.with_file_name(file).exists() {
                missing.push(format!("{}: link to {link}", path.display()));
            }
        }
    }
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}

/// An example of the Debian package that imports the Python package finds all of it there.
#[test]
fn what_a_packaged_example_imports_is_packaged() {
    let manifest = std::fs::read_to_string(repo("Cargo.toml")).unwrap();
    let manifest: toml::Table = manifest.parse().unwrap();
    let assets = manifest["package"]["metadata"]["deb"]["assets"].as_array();
    let sources: Vec<&str> = assets
        .unwrap()
        .iter()
        .map(|asset| asset[0].as_str().unwrap())
        .collect();
    let imports = |file: &&&str| {
        let text = std::fs::read_to_string(repo(file)).unwrap_or_default();
        text.lines().any(|line| line == "import retroflex")
    };
    if !sources.iter().any(|file| imports(&file)) {
        return;
    }
    let modules = std::fs::read_dir(repo("python/src/retroflex")).unwrap();
    let modules = modules.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut needed: Vec<String> = modules
        .filter(|name| name.contains('.'))
        .map(|name| format!("src/retroflex/{name}"))
        .collect();
    // the build of the package reads both
    needed.extend(["pyproject.toml", "README.md"].map(str::to_owned));
    for file in needed.iter().map(|file| format!("python/{file}")) {
        let folder = file.rsplit_once('/').unwrap().0;
        let whole = format!("{folder}/*");
        let packaged = sources
            .iter()
            .any(|source| *source == file || *source == whole);
        assert!(packaged, "{file} is in no asset of the Debian package");
    }
}

#[test]
fn the_architecture_lists_the_rooms_of_the_library() {
    let lib = std::fs::read_to_string(repo("src/lib.rs")).unwrap();
    let architecture = std::fs::read_to_string(repo("ARCHITECTURE.md")).unwrap();
    let rooms: Vec<&str> = lib
        .lines()
        .filter_map(|l| l.strip_prefix("//! | [`")?.split('`').next())
        .collect();
    let listed: Vec<&str> = architecture
        .split("## ")
        .next()
        .unwrap()
        .lines()
        .filter_map(|l| l.strip_prefix("| `")?.split('`').next())
        .collect();
    assert!(rooms.len() == 16 && rooms == listed, "{rooms:?} {listed:?}");
}

/// The text of all files below a folder.
fn sources(folder: &Path) -> String {
    let paths = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().path());
    paths
        .map(|p| {
            if p.is_dir() {
                sources(&p)
            } else {
                std::fs::read_to_string(&p).unwrap()
            }
        })
        .collect()
}

/// Every row with an id names a test function, or a row of the drill, and all that it names exist.
#[test]
fn every_control_of_the_safety_file_has_a_test() {
    let text = std::fs::read_to_string(repo("docs/safety.md")).unwrap();
    let drill = sources(&repo("src/drill"));
    let is_test = |name: &str| {
        let Some((file, test)) = name.split_once("::") else {
            return false;
        };
        let code = std::fs::read_to_string(repo(file)).unwrap_or_default();
        let lines: Vec<&str> = code.lines().map(str::trim).collect();
        let at = lines
            .iter()
            .position(|line| line.starts_with(&format!("fn {test}()")));
        at.is_some_and(|at| {
            lines[..at]
                .iter()
                .rev()
                .take_while(|l| l.starts_with("#[") || l.starts_with("//"))
                .any(|l| *l == "#[test]")
        })
    };
    let (mut rows, mut wrong) = (0, Vec::new());
    for line in text.lines().filter(|line| line.starts_with("| H")) {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        assert_eq!(cells.len(), 9, "{line}");
        rows += 1;
        let rating = |cell: &str| cell.parse::<u32>().unwrap_or_else(|_| panic!("{line}"));
        let [severity, before, after] = [4, 5, 6].map(|i| rating(cells[i]));
        assert!(
            [severity, before, after]
                .iter()
                .all(|x| (1..=5).contains(x))
                && after <= before
                && severity * after <= 12,
            "{line}"
        );
        let proofs: Vec<&str> = cells[7].split(", ").collect();
        for proof in &proofs {
            let name = proof.trim_start_matches("drill ").trim_matches('`');
            let exists = if proof.starts_with("drill ") {
                drill.contains(&format!("\"{name}\""))
            } else {
                is_test(name)
            };
            if !exists {
                wrong.push(format!("{}: {proof}", cells[1]));
            }
        }
    }
    assert!(rows > 30, "{rows}");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// `REFRESH=1 cargo test --test library documents::the_catalogue` writes the table anew.
#[test]
fn the_catalogue_in_the_documentation_is_that_of_the_code() {
    let path = repo("docs/gap.md");
    let text = std::fs::read_to_string(&path).unwrap();
    let (before, rest) = text.split_once("<!-- catalogue -->\n").unwrap();
    let (table, after) = rest.split_once("<!-- end of the catalogue -->").unwrap();
    let current = format!("\n{}\n", described_catalogue());
    if std::env::var_os("REFRESH").is_some() {
        let all =
            format!("{before}<!-- catalogue -->\n{current}<!-- end of the catalogue -->{after}");
        return std::fs::write(&path, all).unwrap();
    }
    assert_eq!(table, current);
}

/// The catalogue as a Markdown table.
fn described_catalogue() -> String {
    let mut out =
        "| effect | stage | signature | confused with | separated by | parameters | remedy |\n|---|---|---|---|---|---|---|\n".to_owned();
    for e in catalogue() {
        let (info, stage) = (e.info(), e.stage().name());
        let confused = info
            .confused_with
            .iter()
            .map(|n| format!("`{n}`"))
            .collect::<Vec<_>>()
            .join(", ");
        let (params, remedy) = (summary(e.params()), remedy(*e));
        let row = format!(
            "| `{}` | {stage} | {} | {confused} | {} | {params} | {remedy} |\n",
            e.name(),
            info.signature,
            info.separated_by
        );
        out.push_str(&row);
    }
    out
}

/// What closes the gap of an effect, for people.
fn remedy(e: &dyn Effect) -> &'static str {
    if e.info().is_event() {
        "mend the cause: it happens once"
    } else if e.stage() == Stage::Timing {
        "dead time in the calibration"
    } else if e.sensing_only() {
        "`calibrate imu`"
    } else {
        "feedforward"
    }
}

/// Parameters in one cell of a table: `rate ×3 (1/s), vacuum_ratio, x1 … x13 (deg)`.
fn summary(params: &[Param]) -> String {
    let stem = |p: &Param| p.name.trim_end_matches(|c: char| c.is_ascii_digit());
    let mut groups: Vec<Vec<&Param>> = Vec::new();
    for p in params {
        match groups.iter_mut().find(|group| stem(group[0]) == stem(p)) {
            Some(group) => group.push(p),
            None => groups.push(vec![p]),
        }
    }
    let words = groups.iter().map(|group| {
        let names: Vec<&str> = group.iter().map(|p| p.name).collect();
        let (first, n) = (names[0], names.len());
        let counted = (1..=n).map(|k| format!("{}{k}", stem(group[0])));
        let names = if n > 1 && names.iter().all(|name| *name == first) {
            format!("{first} ×{n}")
        } else if n > 2 && counted.eq(names.iter().copied()) {
            format!("{first} … {}", names[n - 1])
        } else {
            names.join(", ")
        };
        match group[0].shown(0.0).1 {
            "" => names,
            unit => format!("{names} ({unit})"),
        }
    });
    words.collect::<Vec<_>>().join(", ")
}
