//! Other rigs: logs that are diagnosed together, saved models, checks and pages.

use crate::common::flat;
use serde_json::Value;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::Command;
use tempfile::TempDir;

const MAP: &str = "input = \"valve\"\noutput = \"load\"\ntime = \"t\"\ninput_unit = \"mA\"\noutput_unit = \"kN\"\n";

/// A folder with a map, in which commands run.
struct Bench(TempDir);

impl Bench {
    fn new() -> Self {
        let bench = Self(TempDir::new().unwrap());
        std::fs::write(bench.path("map.toml"), MAP).unwrap();
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap()
    }

    /// A log of a drive with play, at 25 Hz: its load follows the valve current with this gain and half-width, mA, from an offset, kN.
    fn log(&self, name: &str, rows: u32, phase: f64, [gain, width, offset]: [f64; 3]) {
        let mut text = "t,valve,load,note\n".to_owned();
        let mut dragged = None;
        for k in 0..rows {
            let t = f64::from(k) * 0.04;
            let u = 12.0 + (3.0 + 2.5 * (0.13 * t + phase).sin()) * (0.7 * t + phase).sin();
            let w = dragged.unwrap_or(u).max(u - width).min(u + width);
            dragged = Some(w);
            let noise = f64::from((k * k * 131 + k * 7919) % 1009) / 1009.0;
            let load = offset + gain * (w + 0.3 * noise);
            let _ = writeln!(text, "{t:.2},{u:.5},{load:.6},x");
        }
        std::fs::write(self.path(name), text).unwrap();
    }

    /// Exit code and what was printed, on one line.
    fn run(&self, args: &str) -> (i32, String) {
        let out = Command::new(env!("CARGO_BIN_EXE_retroflex"))
            .args(args.split(' '))
            .current_dir(self.0.path())
            .env("NO_COLOR", "1")
            .output()
            .unwrap();
        let text = String::from_utf8([out.stdout, out.stderr].concat()).unwrap();
        (out.status.code().unwrap_or(-1), flat(&text))
    }

    /// Runs a command that writes `r.json`, and reads that.
    fn answer(&self, args: &str, expected: i32) -> Value {
        let (code, message) = self.run(&format!("{args} --json r.json"));
        assert_eq!(code, expected, "{message}");
        serde_json::from_str(&self.read("r.json")).unwrap()
    }

    fn refused(&self, args: &str, words: &[&str]) {
        let (code, message) = self.run(args);
        assert_eq!(code, 2, "{message}");
        for word in words {
            assert!(message.contains(word), "`{word}` is not in: {message}");
        }
    }
}

#[test]
fn a_saved_model_of_a_rig_is_checked_on_fresh_logs() {
    let bench = Bench::new();
    bench.log("known.csv", 3000, 0.0, [6.5, 0.8, 40.0]);
    bench.log("same.csv", 2000, 1.0, [6.5, 0.8, -15.0]);
    bench.log("other.csv", 2000, 1.0, [9.0, 0.8, 40.0]);
    bench.log("mended.csv", 2000, 1.0, [6.5, 0.0, 40.0]);
    let (code, message) = bench.run("gap diagnose known.csv --map map.toml --save m.toml");
    assert_eq!(code, 0, "{message}");
    let text = bench.read("m.toml");
    for key in [
        "schema = 1",
        "version = ",
        "input_unit = \"mA\"",
        "name = \"play\"",
        "ci95 = [",
    ] {
        assert!(text.contains(key), "`{key}` is not in: {text}");
    }
    for (log, expected, code) in [
        ("same.csv", "this machine", 0),
        ("other.csv", "another unit", 1),
        ("mended.csv", "worse than nothing", 1),
    ] {
        let c = bench.answer(&format!("gap check m.toml {log}"), code);
        assert_eq!(c["judgement"], expected, "{log}: {c}");
        assert_eq!(c["unit"], "kN");
        let again = bench.answer(&format!("gap check m.toml {log} --map map.toml"), code);
        assert_eq!(c, again);
        let number = |key: &str| c[key].as_f64().unwrap();
        let (before, after) = (number("before"), number("after"));
        assert_eq!(after < before, log != "mended.csv", "{log}: {c}");
        if log == "same.csv" {
            assert!(
                number("closed") > 0.95 && number("refitted") <= 1.05 * after,
                "{c}"
            );
        }
    }
    // a model and a log that do not belong together
    let tip = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/corpus/model.toml");
    let tip = format!("gap check {tip} same.csv --map map.toml");
    bench.refused(&tip, &["model.toml", "model of a tip", "--map"]);
    bench.refused("gap apply m.toml", &["m.toml", "mapped rig", "gap check"]);
    bench.refused("evaluate --plant model:m.toml", &["m.toml", "mapped rig"]);
    bench.refused(
        "gap check m.toml same.csv --board sim",
        &["m.toml", "--board"],
    );
    std::fs::write(bench.path("sum.toml"), MAP.replace("kN", "N")).unwrap();
    bench.refused(
        "gap check m.toml same.csv --map sum.toml",
        &["sum.toml", "m.toml", "differs"],
    );
    // a damaged model
    for (from, to, words) in [
        ("schema = 1", "colour = 1", ["m2.toml, line 1", "colour"]),
        ("\"play\"", "\"ghost\"", ["m2.toml", "effect"]),
        ("half = ", "half = -", ["m2.toml", "nominal.half"]),
        ("sizes = [", "sizes = [1.0, ", ["m2.toml", "1 term"]),
        ("every = 1", "every = 0", ["m2.toml", "every"]),
    ] {
        std::fs::write(bench.path("m2.toml"), text.replacen(from, to, 1)).unwrap();
        bench.refused("gap check m2.toml same.csv", &words);
    }
}

#[test]
fn two_logs_of_a_rig_give_one_effect_with_a_narrower_interval() {
    let bench = Bench::new();
    bench.log("a.csv", 900, 0.0, [0.02, 0.5, 3.0]);
    bench.log("<b>.csv", 1200, 2.0, [0.02, 0.5, -70.0]);
    let one = bench.answer("gap diagnose a.csv --map map.toml", 0);
    let both = bench.answer("gap diagnose a.csv <b>.csv --map map.toml --html r.html", 0);
    let width = |r: &Value| {
        assert_eq!(r["verdict"]["names"][0], "play", "{}", r["verdict"]);
        let width = |v: &Value| v[1].as_f64().unwrap() - v[0].as_f64().unwrap();
        let set = &r["set"][0];
        [&set["closed_ci95"], &set["params"][0]["ci95"]].map(width)
    };
    let (alone, together) = (width(&one), width(&both));
    assert!(
        (0..2).all(|k| 0.0 < together[k] && together[k] < alone[k]),
        "{alone:?} {together:?}"
    );
    let logs = both["logs"].as_array().unwrap();
    assert_eq!((one["logs"].as_array().unwrap().len(), logs.len()), (1, 2));
    for (log, file) in logs.iter().zip(["a.csv", "<b>.csv"]) {
        assert_eq!(log["file"], file);
        assert!(
            log["explained"].as_f64() < log["recalibrated"].as_f64(),
            "{log}"
        );
    }
    let html = bench.read("r.html");
    for word in [
        "&lt;b&gt;.csv",
        "play",
        "Residual over time",
        "Probability",
        "Made from",
        "map.toml",
        "kN",
    ] {
        assert!(html.contains(word), "`{word}` is not on the page");
    }
    for word in ["<b>", "<script", "src=", "href=", "NaN", "inf,"] {
        assert!(!html.contains(word), "`{word}` is on the page");
    }
    assert!(html.trim_end().ends_with("</html>"));
    bench.refused(
        "gap diagnose a.csv a.csv --map map.toml",
        &["a.csv", "given twice"],
    );
    bench.refused(
        "gap diagnose a.csv --map map.toml --board sim",
        &["--map", "--board"],
    );
}

#[test]
fn a_map_whose_values_have_a_wrong_type_is_refused_by_its_key() {
    let bench = Bench::new();
    bench.log("a.csv", 200, 0.0, [1.0, 0.5, 0.0]);
    let keys = "input output motion time rate_hz input_unit output_unit nominal every";
    for key in keys.split(' ') {
        for value in ["3", "true", "[1, 2]", "{ a = 1 }", "\"x\""] {
            let is_number = ["rate_hz", "every"].contains(&key);
            if is_number == (value == "3") && (is_number || value == "\"x\"") {
                continue;
            }
            let others = MAP
                .lines()
                .filter(|line| !line.starts_with(&format!("{key} =")));
            let others: Vec<&str> = others.collect();
            let map = format!("{key} = {value}\n{}", others.join("\n"));
            std::fs::write(bench.path("wrong.toml"), &map).unwrap();
            let (code, message) = bench.run("gap diagnose a.csv --map wrong.toml");
            let clear = message.contains("expected") && message.contains(key);
            assert!(
                code == 2 && clear && !message.contains("variant"),
                "{map}: {message}"
            );
        }
    }
}

#[test]
fn a_column_that_is_named_twice_is_refused_and_names_are_trimmed() {
    let bench = Bench::new();
    bench.log("a.csv", 900, 0.0, [0.02, 0.5, 3.0]);
    let text = bench.read("a.csv");
    let named = |header: &str| {
        let text = text
            .replacen("t,valve,load,note", header, 1)
            .replace(",x\n", ",1\n");
        std::fs::write(bench.path("b.csv"), text).unwrap();
    };
    for (header, places) in [
        ("t,valve,load,valve", "columns 2 and 4"),
        ("t,valve,load, load ", "columns 3 and 4"),
        ("t,t,load,valve", "columns 1 and 2"),
    ] {
        named(header);
        bench.refused(
            "gap diagnose b.csv --map map.toml",
            &["b.csv, line 1", "twice", places],
        );
    }
    // a column that the map does not name may be there twice
    named("\" t\",valve , load,t2");
    let loose = MAP
        .replace("\"valve\"", "\" valve\"")
        .replace("\"t\"", "\"t \"");
    std::fs::write(bench.path("loose.toml"), loose).unwrap();
    let r = bench.answer("gap diagnose b.csv --map loose.toml", 0);
    assert_eq!(r["verdict"]["names"][0], "play", "{}", r["verdict"]);
}
