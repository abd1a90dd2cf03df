"""Bend logs and flight logs."""

import gzip
import json
import math

import pytest

from retroflex import LogError, read_log

HEAD = "time_s,piston1_mm,piston2_mm,piston3_mm,note,extra,acc_x_m_s2\n"
ROWS = "0.01,0,0,0,hello,1,9.8\n0.02,1,-2,3.5,,,\n"


@pytest.fixture
def log(tmp_path):
    def write(content, name="log.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.mark.parametrize(
    "content",
    [
        HEAD + ROWS,
        (HEAD + ROWS).rstrip("\n"),
        (HEAD + ROWS).replace("\n", "\r\n"),
        ("\ufeff" + HEAD + ROWS).encode(),
        (HEAD + ROWS).replace(",", " , "),
        gzip.compress((HEAD + ROWS).encode()),
        gzip.compress(HEAD.encode()) + gzip.compress(ROWS.encode()),
    ],
)
def test_a_log_is_read_in_every_form(log, content):
    columns = read_log(log(content))
    assert list(columns) == HEAD.strip().split(",")
    assert list(columns["piston3_mm"]) == [0, 3.5] and list(columns["time_s"]) == [0.01, 0.02]
    assert [str(text).strip() for text in columns["note"]] in (["hello", "None"], ["hello", ""])
    assert columns["extra"][0] == 1 and math.isnan(columns["extra"][1]) and math.isnan(columns["acc_x_m_s2"][1])


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "log.csv: is empty"),
        (HEAD, "log.csv: has no rows"),
        ("time_s,piston1_mm\n0,0\n", "line 1, column piston2_mm: is missing; the header names time_s, piston1_mm"),
        (HEAD.replace("note", "extra") + ROWS, "line 1, column extra: is there twice"),
        (HEAD + "0.01,0,0,0,,,9.8\n0.02,0,x,0,,,9.8\n", "line 3, column piston2_mm: `x` is not a finite number"),
        (HEAD + "0.01,0,0,0,,,inf\n", "line 2, column acc_x_m_s2: `inf`"),
        (HEAD + "0.01,0,0,0,,,1_0\n", "line 2, column acc_x_m_s2: `1_0`"),
        (HEAD + "0.01,0,0,,,,9.8\n", "line 2, column piston3_mm: `` is not a number; this column must not have gaps"),
        (HEAD + "0.01,0,nan,0,,,9.8\n", "line 2, column piston2_mm: `nan` is not a number"),
        (HEAD + ROWS + "0.02,0,0,0,,,\n", "line 4, column time_s: 0.02 s does not come after 0.02 s"),
        (HEAD + ROWS + "0.03,0,0,0,,\n", "line 4, column acc_x_m_s2: the line has 6 fields where the header has 7"),
        (HEAD + ROWS + "0.03,0,0,0,,,,,\n", "line 4, column acc_x_m_s2: the line has 9 fields"),
        (gzip.compress((HEAD + ROWS).encode())[:-9], "cut short or damaged"),
        (gzip.compress((HEAD + ROWS).encode())[:15], "cut short or damaged"),
        (b"\x1f\x8bgarbage", "cut short or damaged"),
        ((HEAD + ROWS).encode("utf-16"), "line 1: this is UTF-16 text"),
        ((HEAD + ROWS).encode("utf-16-le"), "line 1: this is UTF-16 text"),
        ((HEAD + ROWS).replace("hello", "größe").encode("latin-1"), "not UTF-8 text"),
        ((HEAD + ROWS).replace(",", ";"), "separated by semicolons"),
        ((HEAD + ROWS).replace(",", "\t"), "separated by tabs"),
    ],
)
def test_a_file_that_is_no_log_is_refused(log, content, why):
    path = log(content)
    with pytest.raises(LogError) as caught:
        read_log(path)
    assert str(caught.value).startswith(str(path)) and why in str(caught.value)


def test_errors_far_into_a_log_name_their_line(log):
    rows = [f"{k},0,0,0,,,{k % 7}" for k in range(10_000)]
    rows[9_000] = rows[9_000].replace(",0,0,0", ",0,?,0")
    with pytest.raises(LogError, match="line 9002, column piston2_mm"):
        read_log(log(HEAD + "\n".join(rows)))
    long = gzip.compress((HEAD + "\n".join(f"{k},0,0,0,,,{k * 7919 % 1000}" for k in range(20_000))).encode())
    with pytest.raises(LogError, match=r"line \d\d+: cannot be read"):
        read_log(log(long[: len(long) // 2]))


def test_files_that_cannot_be_opened(tmp_path):
    with pytest.raises(LogError, match="No such file"):
        read_log(tmp_path / "none.csv")
    with pytest.raises(LogError, match="directory"):
        read_log(tmp_path)


def test_engines(log, repository):
    pandas, polars = pytest.importorskip("pandas"), pytest.importorskip("polars")
    path = log(HEAD + ROWS)
    frame = read_log(path, engine="pandas")
    assert isinstance(frame, pandas.DataFrame) and frame["acc_x_m_s2"].isna().tolist() == [False, True]
    frame = read_log(path, engine="polars")
    assert isinstance(frame, polars.DataFrame)
    assert frame["acc_x_m_s2"].to_list() == [9.8, None] and frame["note"].to_list() == ["hello", None]
    with pytest.raises(ValueError, match="'arrow'"):
        read_log(path, engine="arrow")
    leak = read_log(repository / "examples/leak.csv.gz", engine="pandas")
    assert leak.shape == (26077, 16) and (leak.dtypes == float).all()


def test_an_engine_that_is_not_installed_is_named(log, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(ImportError, match="pip install pandas"):
        read_log(log(HEAD + ROWS), engine="pandas")


@pytest.fixture
def flight(tmp_path):
    """Writes a flight log of five messages on two topics, and one on a topic that is no JSON."""
    writer_of = pytest.importorskip("mcap.writer").Writer
    path = tmp_path / "flight.mcap"
    with open(path, "wb") as file:
        writer = writer_of(file)
        writer.start()
        schema = writer.register_schema("retroflex.Angles", "jsonschema", b'{"type":"object"}')
        angles = writer.register_channel("/angles", "json", schema)
        mode = writer.register_channel("/mode", "json", schema)
        tick = writer.register_channel("/tick", "postcard", schema)
        for k in range(4):
            target = {"bend_deg": 10.0 * k, "dir_deg": 0.0} if k else None
            data = json.dumps({"target": target, "piston_mm": [k, 0, -k], "sigma_deg": None}).encode()
            writer.add_message(angles, k * 10**9, data, k * 10**9)
        writer.add_message(mode, 10**9, b'{"mode":"holding","energised":true}', 10**9)
        writer.add_message(tick, 10**9, b"\x00\x01", 10**9)
        writer.finish()
    return path


def test_a_flight_log_is_read_by_topic(flight):
    log = read_log(flight)
    assert list(log) == ["/angles", "/mode"]
    angles = log["/angles"]
    assert list(angles) == ["time_s", "piston_mm.1", "piston_mm.2", "piston_mm.3", "sigma_deg", "target.bend_deg", "target.dir_deg"]
    assert list(angles["time_s"]) == [0, 1, 2, 3] and list(angles["piston_mm.3"]) == [0, -1, -2, -3]
    assert math.isnan(angles["target.bend_deg"][0]) and angles["target.bend_deg"][3] == 30
    assert log["/mode"]["energised"] == [True]
    pytest.importorskip("pandas")
    assert read_log(flight, engine="pandas")["/angles"]["target.bend_deg"].max() == 30


@pytest.mark.filterwarnings("ignore:.*was not closed")
def test_a_flight_log_that_was_not_closed_or_is_damaged(flight, tmp_path):
    content = flight.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[:40])
    with pytest.warns(UserWarning, match="was not closed"):
        assert read_log(cut) == {}
    for k in range(30, len(content), 7):
        damaged = bytearray(content)
        damaged[k] ^= 0xFF
        cut.write_bytes(damaged)
        try:
            read_log(cut)
        except LogError as problem:
            assert str(cut) in str(problem)
