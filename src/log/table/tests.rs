//! Tables as people and their programs write them, and how each error names its place.

use super::*;
use crate::primitives::file::text;
use std::io::Write;

const SCHEMA: Schema<'_> = Schema {
    required: &["t", "x"],
    known: &|name| name != "note",
    rows_min: 1,
};

fn parse(text: &str) -> Result<Table, ReadError> {
    Table::parse("folder/t.csv", text.as_bytes(), &SCHEMA)
}

fn error(text: &str) -> String {
    parse(text)
        .and_then(|t| t.clock("t").map(|_| ()))
        .unwrap_err()
        .to_string()
}

#[test]
fn empty_and_nan_fields_are_missing_values_and_other_text_is_ignored_by_name() {
    let t = parse("t, x ,note\n0,1,hello\n1,,\n2,nan,x\n").unwrap();
    assert_eq!((t.rows(), t.clock("t").unwrap()), (3, &[0.0, 1.0, 2.0][..]));
    assert!(t.column("x").unwrap()[1].is_nan() && t.column("x").unwrap()[2].is_nan());
    assert!(t.column("y").is_none() && t.vectors(["a", "b", "c"]).unwrap().is_none());
    assert!(
        t.vectors(["t", "x", "y"]).is_err(),
        "a vector needs all its components"
    );
}

#[test]
fn errors_name_file_line_and_column() {
    for (text, expected) in [
        ("t,x\n", "folder/t.csv: has no rows"),
        ("", "folder/t.csv: has no rows"),
        (
            "t,y\n0,0\n",
            "folder/t.csv, line 1, column x: is missing; the header names t, y",
        ),
        (
            "t,x\n0\n",
            "folder/t.csv, line 2, column x: the line has 1 fields where the header has 2",
        ),
        ("t,x\n0,0,0\n", "line 2, column x: the line has 3 fields"),
        (
            "t,x\n0,a\n",
            "folder/t.csv, line 2, column x: `a` is not a finite number",
        ),
        ("t,x\n0,inf\n", "line 2, column x: `inf`"),
        ("t,x\n0,0\n,0\n", "line 3, column t: `` is not a number"),
        ("t,x\nNaN,0\n", "line 2, column t: `nan` is not a number"),
        (
            "t,x\n0,0\n1e-320,0\n1,0\n2,0\n",
            "line 3, column t: 1e-320 s does not come after 0 s",
        ),
        (
            "t,x\n1700000000,0\n1700000005,0\n1700000005.0000004,0\n1700000010,0\n",
            "line 4, column t",
        ),
        (
            "t,x\n1e5,0\n0,0\n",
            "line 3, column t: 0 s does not come after 100000 s",
        ),
        (
            "t,x\n0,-1e20\n",
            "line 2, column x: `-1e20` is not a number from",
        ),
        (
            "t,x\n0,1\n,\n2,1\n",
            "line 3, column t: `` is not a row with",
        ),
        (
            "t,x\n0,0\n1,0\n2,0\n1.7e9,0\n1700000001,0\n",
            "line 5, column t: `1700000000` is not at most 86402 s, which is 86400 s after the row before",
        ),
        (
            "t,x\n0,0\n600,0\n1200,0\n7e6,0\n",
            "split the table where the clock jumps",
        ),
        (
            "t,x\n0,0\n0,0\n",
            "folder/t.csv, line 3, column t: 0 s does not come after 0 s",
        ),
    ] {
        let message = error(text);
        assert!(
            message.starts_with("folder/t.csv") && message.contains(expected),
            "{message}"
        );
    }
}

/// One table in the notations of other programs.
#[test]
fn another_encoding_or_separator_is_named_with_the_mend() {
    let table = "t,x\n0,1\n1,2\n";
    let wide = |big: bool, mark: bool| -> Vec<u8> {
        let units = mark
            .then_some(0xfeff)
            .into_iter()
            .chain(table.encode_utf16());
        let bytes = |unit: u16| {
            if big {
                unit.to_be_bytes()
            } else {
                unit.to_le_bytes()
            }
        };
        units.flat_map(bytes).collect()
    };
    let (semicolons, tabs) = (
        table.replace(',', ";").replace('1', "1,5"),
        table.replace(',', "\t"),
    );
    let latin = b"t,x,gr\xf6\xdfe\n0,1,2\n".to_vec();
    for (bytes, part) in [
        (wide(false, true), "UTF-16"),
        (wide(true, true), "UTF-16"),
        (wide(false, false), "UTF-16"),
        (wide(true, false), "UTF-16"),
        (semicolons.into_bytes(), "semicolons"),
        (tabs.into_bytes(), "tabs"),
        (latin, "Latin-1"),
    ] {
        let why = Table::parse("x.csv", &bytes[..], &SCHEMA)
            .unwrap_err()
            .to_string();
        assert!(
            why.starts_with("x.csv, line 1: ") && why.contains(part),
            "{why}"
        );
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(&bytes).unwrap();
        let told = text(file.path()).map_err(|e| why_unreadable(file.path(), &e));
        let is_encoding = ["UTF-16", "Latin-1"].contains(&part);
        assert_eq!(told.is_err_and(|why| why.contains(part)), is_encoding);
    }
    let marked = [b"\xef\xbb\xbf".as_slice(), table.as_bytes()].concat();
    assert_eq!(
        Table::parse("x.csv", &marked[..], &SCHEMA).unwrap().rows(),
        2
    );
}

/// Whichever components are missing, a vector is there as a whole or not at all.
#[test]
fn a_vector_is_complete_or_missing() {
    let fields = ["1", "", "nan"];
    for k in 0..27 {
        let [x, y, z] = [k % 3, k / 3 % 3, k / 9].map(|n| fields[n]);
        let t = parse(&format!("t,x,y,z\n0,{x},{y},{z}\n")).unwrap();
        let v = t.vectors(["x", "y", "z"]).unwrap().unwrap()[0];
        let missing = v.iter().filter(|x| x.is_nan()).count();
        assert_eq!(missing, if k == 0 { 0 } else { 3 }, "{x} {y} {z}");
    }
    let clocks = ["0,1,0,0,0\n1,nan,0,0,0\n", "0,0,0,0,0\n1,1,0,0,0\n"];
    for (text, present) in clocks.iter().zip([[false, false], [false, true]]) {
        let t = parse(&format!("t,x,a,b,c\n{text}")).unwrap();
        let q = t.quaternions(["x", "a", "b", "c"]).unwrap().unwrap();
        assert_eq!([q[0].is_some() && present[0], q[1].is_some()], present);
    }
}

#[test]
fn endless_text_is_refused() {
    let zeros = Table::parse("zeros.csv", io::repeat(0), &SCHEMA)
        .unwrap_err()
        .to_string();
    assert!(
        zeros.starts_with("zeros.csv, line 1: ") && zeros.contains("longer than 64 KiB"),
        "{zeros}"
    );
    let late = io::Cursor::new("t,x\n0,0\n").chain(io::repeat(b'1'));
    let late = Table::parse("late.csv", late, &SCHEMA)
        .unwrap_err()
        .to_string();
    assert!(
        late.starts_with("late.csv, line 3: ") && late.contains("longer than 64 KiB"),
        "{late}"
    );
    assert_eq!(
        text(Path::new("/dev/zero")).unwrap_err().kind(),
        io::ErrorKind::FileTooLarge
    );
}

#[test]
fn gzip_is_recognised_by_its_bytes_and_a_truncated_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plain_name.csv");
    let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    let rows: String = (0..5000)
        .map(|k| format!("{k},{}\n", k * 7919 % 1000))
        .collect();
    gz.write_all(format!("t,x\n{rows}").as_bytes()).unwrap();
    let bytes = gz.finish().unwrap();
    std::fs::write(&path, &bytes).unwrap();
    assert_eq!(Table::open(&path, &SCHEMA).unwrap().rows(), 5000);
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let message = Table::open(&path, &SCHEMA).unwrap_err().to_string();
    assert!(
        message.contains("cut short") && message.contains("line "),
        "{message}"
    );
    let none = Table::open(&folder.path().join("none.csv"), &SCHEMA);
    assert!(none.is_err_and(|e| e.to_string().contains("there is no such file")));
}

#[test]
fn a_column_of_interest_is_named_once() {
    for (text, name) in [("t,x,x\n0,1,2\n", "x"), ("x,t,y,t\n0,1,2,3\n", "t")] {
        let found = error(text);
        let expected = format!("folder/t.csv, line 1, column {name}: the header names it twice");
        assert!(found.starts_with(&expected), "{found}");
    }
    assert!(parse("t,note,x,note\n0,a,1,b\n").is_ok());
}
