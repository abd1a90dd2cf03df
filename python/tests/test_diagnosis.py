"""`diagnose` with fakes of the program."""

import json
import sys

import pytest

from retroflex import ProgramError, diagnose

RESULT = {"schema": 1, "gap": {"explained_deg": 0.2}, "effects": [], "verdict": {"kind": "none", "names": []}, "new": 1}


@pytest.fixture
def fake_program(tmp_path, monkeypatch):
    def make(body):
        path = tmp_path / "retroflex"
        path.write_text(f"#!{sys.executable}\nimport json, sys, time\n{body}\n")
        path.chmod(0o755)
        monkeypatch.setenv("RETROFLEX_BINARY", str(path))
        return tmp_path

    return make


def test_the_result_and_the_arguments(fake_program, monkeypatch):
    folder = fake_program(f"open({str('/dev/stderr')!r}, 'a'); r = {RESULT!r}; r['arguments'] = sys.argv[1:]; print(json.dumps(r))")
    result = diagnose(folder / "a.csv", "c.toml", save="m.toml", seed=0)
    assert result["verdict"]["kind"] == "none" and result["new"] == 1
    log = str(folder / "a.csv")
    assert result["arguments"] == ["gap", "diagnose", log, "--json", "-", "--calib", "c.toml", "--save", "m.toml", "--seed", "0"]
    assert diagnose(["a", "b"])["arguments"] == ["gap", "diagnose", "a", "b", "--json", "-"]
    monkeypatch.delenv("RETROFLEX_BINARY")
    monkeypatch.setenv("PATH", str(folder))
    assert diagnose("a")["schema"] == 1


@pytest.mark.parametrize(
    ("body", "code", "why"),
    [
        ("print('error: a.csv, line 3: cut short', file=sys.stderr); sys.exit(2)", 2, "error: a.csv, line 3: cut short"),
        ("sys.exit(1)", 1, "exit code 1"),
        ("print('no JSON')", 2, "'no JSON"),
        ("import os; os.kill(os.getpid(), 9)", -9, "exit code -9"),
        ("time.sleep(60)", 3, "has not ended within 0.5 s"),
    ],
)
def test_failures_have_the_message_of_the_program(fake_program, body, code, why):
    fake_program(body)
    with pytest.raises(ProgramError) as caught:
        diagnose("a.csv", timeout_s=0.5 if code == 3 else None)
    assert why in str(caught.value) and caught.value.code == code


def test_a_program_that_is_not_there(monkeypatch):
    monkeypatch.setenv("RETROFLEX_BINARY", "/nowhere/retroflex")
    with pytest.raises(ProgramError, match="there is no program /nowhere/retroflex"):
        diagnose("a.csv")
