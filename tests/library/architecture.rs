//! The structure of `src/`: the order of the rooms, no import circles, purity, and the size of files and functions.
//!
//! The table in `src/lib.rs` is the plan; these tests read it and the code.

use crate::common::repo;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use syn::spanned::Spanned;
use syn::visit::Visit;

/// Longest source file, in lines of code as [`lines_of_code`] counts them.
const FILE_MAX: usize = 350;
/// Longest function, in the same lines.
const FUNCTION_MAX: usize = 60;

/// A room of the table: its name and what its code may use beyond pure computation.
struct Room {
    name: String,
    may_use: String,
}

fn rooms_in(table: &str) -> Vec<Room> {
    let rows = table.lines().filter_map(|l| l.strip_prefix("//! | [`"));
    rows.map(|row| {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        Room {
            name: cells[0].trim_end_matches("`]").to_owned(),
            may_use: cells[2].to_owned(),
        }
    })
    .collect()
}

fn rooms() -> Vec<Room> {
    rooms_in(&std::fs::read_to_string(repo("src/lib.rs")).unwrap())
}

fn rust_files(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            rust_files(&path, into);
        } else if path.extension().is_some_and(|e| e == "rs") {
            into.push(path);
        }
    }
}

/// One source file: its module path below the crate, and its code without tests.
struct Source {
    path: PathBuf,
    module: Vec<String>,
    code: Code,
}

/// What the tests need of a parsed file.
#[derive(Default)]
struct Code {
    /// Lines of code without the unit tests.
    lines: usize,
    /// Paths that the file names, resolved to the crate's root; `true` for a re-export.
    paths: Vec<(Vec<String>, bool)>,
    /// Name and lines of code of each function.
    functions: Vec<(String, usize)>,
    /// Every path as written, for the search of forbidden names.
    written: Vec<String>,
    /// Items that the file re-exports: public name and the path it stands for.
    reexports: Vec<(String, Vec<String>)>,
}

/// Lines that say something: not blank, not a comment, not brackets alone, which the formatter adds and removes.
fn lines_of_code<'a>(lines: impl Iterator<Item = &'a str>) -> usize {
    let says = |l: &&str| !l.trim_start().starts_with("//") && l.contains(char::is_alphanumeric);
    lines.filter(says).count()
}

struct Reader<'t> {
    text: &'t str,
    module: Vec<String>,
    names: BTreeMap<String, Vec<String>>,
    code: Code,
}

fn is_test(attributes: &[syn::Attribute]) -> bool {
    attributes.iter().any(|a| {
        a.path().is_ident("cfg")
            && a.parse_args::<syn::Path>()
                .is_ok_and(|p| p.is_ident("test"))
    })
}

fn leaves(tree: &syn::UseTree, prefix: &[String], into: &mut Vec<(String, Vec<String>)>) {
    let with = |name: &syn::Ident| [prefix, &[name.to_string()]].concat();
    match tree {
        syn::UseTree::Path(p) => leaves(&p.tree, &with(&p.ident), into),
        syn::UseTree::Name(n) if n.ident == "self" => {
            into.push((prefix.last().unwrap().clone(), prefix.to_vec()))
        }
        syn::UseTree::Name(n) => into.push((n.ident.to_string(), with(&n.ident))),
        syn::UseTree::Rename(r) => into.push((r.rename.to_string(), with(&r.ident))),
        syn::UseTree::Glob(_) => into.push(("*".to_owned(), prefix.to_vec())),
        syn::UseTree::Group(g) => g.items.iter().for_each(|t| leaves(t, prefix, into)),
    }
}

impl Reader<'_> {
    /// From the path as written to the path below the crate; `None` for a path into another crate.
    fn resolve(&self, path: &[String]) -> Option<Vec<String>> {
        let mut here = self.module.clone();
        let mut rest = path;
        match rest.first()?.as_str() {
            "crate" => return Some(rest[1..].to_vec()),
            "self" => rest = &rest[1..],
            "super" => {
                while rest.first().is_some_and(|s| s == "super") {
                    here.pop();
                    rest = &rest[1..];
                }
            }
            first => {
                return self
                    .names
                    .get(first)
                    .map(|full| [full, &rest[1..]].concat());
            }
        }
        here.extend_from_slice(rest);
        Some(here)
    }
}

impl<'a> Visit<'a> for Reader<'_> {
    fn visit_item_mod(&mut self, item: &'a syn::ItemMod) {
        if is_test(&item.attrs) {
            self.code.lines -= self.lines_in(item.span());
        } else {
            syn::visit::visit_item_mod(self, item);
        }
    }
    fn visit_item_use(&mut self, item: &'a syn::ItemUse) {
        if is_test(&item.attrs) {
            return;
        }
        let mut found = Vec::new();
        leaves(&item.tree, &[], &mut found);
        let public = !matches!(item.vis, syn::Visibility::Inherited);
        for (name, path) in found {
            self.code.written.push(path.join("::"));
            if let Some(full) = self.resolve(&path) {
                self.code.paths.push((full.clone(), public));
                if public {
                    self.code.reexports.push((name.clone(), full.clone()));
                }
                self.names.insert(name, full);
            }
        }
    }
    fn visit_item_fn(&mut self, item: &'a syn::ItemFn) {
        if is_test(&item.attrs) {
            return;
        }
        self.measure(item.sig.ident.to_string(), item.span());
        syn::visit::visit_item_fn(self, item);
    }
    fn visit_impl_item_fn(&mut self, item: &'a syn::ImplItemFn) {
        if is_test(&item.attrs) {
            return;
        }
        self.measure(item.sig.ident.to_string(), item.block.span());
        syn::visit::visit_impl_item_fn(self, item);
    }
    fn visit_path(&mut self, path: &'a syn::Path) {
        let written: Vec<String> = path.segments.iter().map(|s| s.ident.to_string()).collect();
        self.code.written.push(written.join("::"));
        if written.len() > 1
            && let Some(full) = self.resolve(&written)
        {
            self.code.paths.push((full, false));
        }
        syn::visit::visit_path(self, path);
    }
}

impl Reader<'_> {
    fn measure(&mut self, name: String, span: proc_macro2::Span) {
        let lines = self.lines_in(span);
        self.code.functions.push((name, lines));
    }

    fn lines_in(&self, span: proc_macro2::Span) -> usize {
        let (from, to) = (span.start().line - 1, span.end().line);
        lines_of_code(self.text.lines().take(to).skip(from))
    }
}

fn module_of(inside: &Path) -> Vec<String> {
    let mut parts: Vec<String> = inside
        .with_extension("")
        .components()
        .map(|c| c.as_os_str().to_string_lossy().into_owned())
        .collect();
    if matches!(
        parts.last().map(String::as_str),
        Some("mod" | "lib" | "main")
    ) {
        parts.pop();
    }
    parts
}

fn read(module: Vec<String>, text: &str) -> Code {
    let file = syn::parse_file(text).unwrap();
    let mut names = BTreeMap::new();
    // child modules are names of their parent
    for item in &file.items {
        if let syn::Item::Mod(m) = item {
            names.insert(
                m.ident.to_string(),
                [module.as_slice(), &[m.ident.to_string()]].concat(),
            );
        }
    }
    let lines = lines_of_code(text.lines());
    let code = Code {
        lines,
        ..Code::default()
    };
    let mut reader = Reader {
        text,
        module,
        names,
        code,
    };
    reader.visit_file(&file);
    reader.code
}

fn sources() -> Vec<Source> {
    let mut files = Vec::new();
    rust_files(&repo("src"), &mut files);
    files.sort();
    let test_only = |p: &Path| {
        p.file_name().is_some_and(|n| n == "tests.rs")
            || p.components().any(|c| c.as_os_str() == "tests")
    };
    files
        .into_iter()
        .filter(|p| !test_only(p.strip_prefix(repo("src")).unwrap()))
        .map(|path| {
            let text = std::fs::read_to_string(&path).unwrap();
            let module = module_of(path.strip_prefix(repo("src")).unwrap());
            Source {
                code: read(module.clone(), &text),
                path,
                module,
            }
        })
        .collect()
}

#[test]
fn the_table_lists_every_room() {
    let text = std::fs::read_to_string(repo("src/lib.rs")).unwrap();
    let table: BTreeSet<String> = rooms().into_iter().map(|r| r.name).collect();
    let modules: BTreeSet<String> = text
        .lines()
        .filter_map(|l| l.strip_prefix("pub mod ")?.strip_suffix(';'))
        .map(str::to_owned)
        .collect();
    assert_eq!(
        table, modules,
        "the table in src/lib.rs and its modules differ"
    );
    assert_eq!(table.len(), 16);
    let loose: Vec<PathBuf> = std::fs::read_dir(repo("src"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| p.is_file())
        .collect();
    assert_eq!(
        loose.len(),
        2,
        "only lib.rs and main.rs lie outside a room: {loose:?}"
    );
}

#[test]
fn imports_follow_the_room_order() {
    let rooms = rooms();
    let place = |name: &str| rooms.iter().position(|r| r.name == name);
    let mut judged = 0;
    for source in sources() {
        let Some(here) = source.module.first().and_then(|m| place(m)) else {
            continue;
        };
        for (path, _) in &source.code.paths {
            let Some(there) = place(&path[0]) else {
                continue;
            };
            assert!(
                there <= here,
                "{}: imports {}, a later room",
                source.path.display(),
                path.join("::")
            );
            judged += 1;
        }
    }
    assert!(judged > 1000, "only {judged} imports were read");
}

/// Files that a file depends on, within its room: the longest module prefix of a path that is a file, looked up through the
/// re-exports of that file.
fn edges(sources: &[Source]) -> BTreeMap<usize, BTreeSet<usize>> {
    let by_module: BTreeMap<&[String], usize> = sources
        .iter()
        .enumerate()
        .map(|(i, s)| (s.module.as_slice(), i))
        .collect();
    let file_of = |path: &[String]| {
        (1..=path.len())
            .rev()
            .find_map(|n| by_module.get(&path[..n]).map(|&i| (i, n)))
    };
    let mut graph: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    for (i, source) in sources.iter().enumerate() {
        for (path, reexport) in source
            .code
            .paths
            .iter()
            .filter(|(p, _)| p.first() == source.module.first())
        {
            let mut path = path.clone();
            for _ in 0..4 {
                let Some((file, n)) = file_of(&path) else {
                    break;
                };
                let through = path.get(n).and_then(|item| {
                    sources[file]
                        .code
                        .reexports
                        .iter()
                        .find(|(name, _)| name == item)
                });
                match through {
                    Some((_, target)) if file != i => {
                        path = [target.as_slice(), &path[n + 1..]].concat()
                    }
                    _ => break,
                }
            }
            if let Some((file, _)) = file_of(&path)
                && file != i
                && !reexport
            {
                graph.entry(i).or_default().insert(file);
            }
        }
    }
    graph
}

/// Sets of files that import each other in a circle.
fn circles(graph: &BTreeMap<usize, BTreeSet<usize>>) -> Vec<Vec<usize>> {
    let reached = |start: usize| {
        let (mut seen, mut todo) = (BTreeSet::new(), vec![start]);
        while let Some(at) = todo.pop() {
            for &next in graph.get(&at).into_iter().flatten() {
                if seen.insert(next) {
                    todo.push(next);
                }
            }
        }
        seen
    };
    let reach: BTreeMap<usize, BTreeSet<usize>> = graph.keys().map(|&k| (k, reached(k))).collect();
    let mut found: Vec<Vec<usize>> = Vec::new();
    for (&a, from_a) in &reach {
        let set: Vec<usize> = from_a
            .iter()
            .copied()
            .filter(|b| reach.get(b).is_some_and(|from_b| from_b.contains(&a)))
            .collect();
        if !set.is_empty() && !found.contains(&set) {
            found.push(set);
        }
    }
    found
}

#[test]
fn no_import_circles_inside_a_room() {
    let sources = sources();
    let graph = edges(&sources);
    assert!(
        graph.values().map(BTreeSet::len).sum::<usize>() > 200,
        "the graph is read"
    );
    let names = |set: &Vec<usize>| {
        set.iter()
            .map(|&i| sources[i].path.display().to_string())
            .collect::<Vec<_>>()
            .join(" ")
    };
    let found: Vec<String> = circles(&graph).iter().map(names).collect();
    assert!(found.is_empty(), "import circles:\n{}", found.join("\n"));
}

/// What code of a room may not name, by the third column of the table.
fn forbidden(may_use: &str) -> Vec<&'static str> {
    let all = [
        "std::fs",
        "std::net",
        "std::os",
        "std::process",
        "std::thread",
        "std::env",
        "Instant",
        "SystemTime",
        "OffsetDateTime",
        "rayon",
    ];
    let allowed: &[&str] = match may_use {
        "nothing" => &[],
        "files" => &["std::fs"],
        "threads" => &["rayon", "std::thread", "std::fs"],
        "child processes" => &["std::process", "std::thread", "Instant"],
        "devices" | "processes" | "everything" | "threads, files, sockets" => return Vec::new(),
        other => panic!("src/lib.rs: `{other}` in the third column has no meaning here"),
    };
    all.into_iter().filter(|a| !allowed.contains(a)).collect()
}

#[test]
fn rooms_are_pure() {
    let rooms = rooms();
    let mut found = Vec::new();
    for source in sources() {
        let Some(room) = rooms
            .iter()
            .find(|r| Some(&r.name) == source.module.first())
        else {
            continue;
        };
        for name in forbidden(&room.may_use) {
            // a child process has options of its operating system
            let child = room.may_use == "child processes";
            let hit = |written: &&String| {
                if child && written.starts_with("std::os::unix::process") {
                    false
                } else if name.contains("::") {
                    written.starts_with(name)
                } else {
                    written.split("::").any(|s| s == name)
                }
            };
            if let Some(written) = source.code.written.iter().find(hit) {
                found.push(format!(
                    "{}: `{written}`, but the room `{}` may use {}",
                    source.path.display(),
                    room.name,
                    room.may_use
                ));
            }
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn every_dependency_states_what_it_is_for() {
    let manifest = std::fs::read_to_string(repo("Cargo.toml")).unwrap();
    let manifest: toml::Table = toml::from_str(&manifest).unwrap();
    let page = std::fs::read_to_string(repo("ARCHITECTURE.md")).unwrap();
    let (_, section) = page.split_once("## Dependencies").unwrap();
    let (section, _) = section.split_once("\n## ").unwrap();
    let rows = section.lines().filter(|line| line.starts_with("| `"));
    let named: BTreeSet<&str> = rows
        .flat_map(|row| row.split('|').nth(1).unwrap().split('`').skip(1).step_by(2))
        .collect();
    let used = manifest["dependencies"].as_table().unwrap();
    assert_eq!(
        used.keys().map(String::as_str).collect::<BTreeSet<_>>(),
        named
    );
}

#[test]
fn files_and_functions_stay_short() {
    let mut long = Vec::new();
    for source in sources() {
        if source.code.lines > FILE_MAX {
            long.push(format!(
                "{}: {} lines, at most {FILE_MAX}",
                source.path.display(),
                source.code.lines
            ));
        }
        for (name, lines) in source
            .code
            .functions
            .iter()
            .filter(|(_, n)| *n > FUNCTION_MAX)
        {
            long.push(format!(
                "{}: fn {name} has {lines} lines, at most {FUNCTION_MAX}",
                source.path.display()
            ));
        }
    }
    assert!(long.is_empty(), "{}", long.join("\n"));
}

#[test]
fn the_checks_notice_what_they_check_for() {
    let table = "//! | room | contents | may use |\n//! | [`a`] | x | nothing |\n//! | [`b`] | y | files |\n";
    let names: Vec<(String, String)> = rooms_in(table)
        .into_iter()
        .map(|r| (r.name, r.may_use))
        .collect();
    assert_eq!(
        names,
        [
            ("a".to_owned(), "nothing".to_owned()),
            ("b".to_owned(), "files".to_owned())
        ]
    );
    let code = read(
        vec!["a".to_owned(), "m".to_owned()],
        "use crate::b::{C, d::{self, E}};\nuse super::n;\nmod k;\nfn f() {\n    n::g();\n    d::h();\n    std::fs::read(\"\");\n}\n#[cfg(test)]\nmod tests { use crate::z::Q; }\n",
    );
    let paths: Vec<String> = code.paths.iter().map(|(p, _)| p.join("::")).collect();
    assert_eq!(
        paths,
        ["b::C", "b::d", "b::d::E", "a::n", "a::n::g", "b::d::h"]
    );
    assert_eq!(code.functions, [("f".to_owned(), 4)]);
    // two imports, a module and the function; neither the bracket nor the tests
    assert_eq!(code.lines, 7);
    assert!(code.written.iter().any(|w| w == "std::fs::read"));
    let graph = BTreeMap::from([
        (0, BTreeSet::from([1])),
        (1, BTreeSet::from([2, 3])),
        (3, BTreeSet::from([1])),
    ]);
    assert_eq!(circles(&graph), [vec![1, 3]]);
    assert!(circles(&BTreeMap::from([(0, BTreeSet::from([1]))])).is_empty());
}
