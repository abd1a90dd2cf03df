"""The package with the program itself: needs RETROFLEX_BINARY."""

import json
import os
import re
import subprocess
import sys
import threading
import time

import pytest

from retroflex import BadRequest, Client, NotSettled, ProgramError, Refused, Unreachable, diagnose, frames, read_log


@pytest.fixture
def environment(program, tmp_path, monkeypatch):
    """The program is that of the path."""
    folder = tmp_path / "bin"
    folder.mkdir()
    (folder / "retroflex").symlink_to(program)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.delenv("RETROFLEX_BINARY")


def test_a_session_with_the_service(service):
    with Client(service) as tip:
        tip.arm()
        status = tip.bend(30, 45)
        assert status["mode"] == "holding" and abs(status["estimate"]["bend_deg"] - 30) < 1
        assert len(tip.reach()["bend_deg"]) == 72
        recording = tip.record_start("mine")
        began = time.monotonic()
        times = [frame["t"] for _, frame in zip(range(20), tip.frames(100))]
        assert times == sorted(times) and 0.1 < times[-1] - times[0] and time.monotonic() - began < 5
        assert tip.follow([(0.1 * k, 30, 45 + 3 * k, None) for k in range(11)])["time_scale"] >= 1
        began = time.monotonic()
        while tip.status()["path"] is not None or tip.status()["mode"] != "holding":
            assert time.monotonic() - began < 10
            time.sleep(0.02)
        # the path lasts a second, and begins once the pistons are ready
        assert 1 < time.monotonic() - began < 4
        rows = tip.record_stop()["rows"]
        log = read_log(recording["path"])
        assert len(log["time_s"]) == rows and max(log["cmd_bend_deg"]) > 29
        with pytest.raises(BadRequest, match="within ±135°"):
            tip.bend(170)
        with pytest.raises(BadRequest, match="rate_hz"):
            next(frames(1e5, path=service))
        with pytest.raises(Refused, match="not while holding"):
            tip.zero()
        threading.Timer(0.1, tip.stop).start()
        with pytest.raises(NotSettled, match="stopped"):
            tip.bend(60, 45, speed_deg_s=5)
        with pytest.raises(Refused, match="arm"):
            tip.bend(10)
        tip.arm()
        tip.relax()


def test_frames_end_with_the_service(service_process):
    service, process = service_process
    follow = frames(200, path=service, timeout_s=2)
    assert next(follow)["mode"]
    process.terminate()
    with pytest.raises(Unreachable, match="closed"):
        for _ in follow:
            pass


def test_a_flight_log_of_the_service(service):
    pytest.importorskip("mcap")
    with Client(service) as tip:
        tip.arm()
        tip.bend(20)
        time.sleep(1)
        [path] = (service.parent / "state/flights").glob("*.mcap")
        # the service still writes it
        with pytest.warns(UserWarning, match="not closed"):
            log = read_log(path)
    assert {"/angles", "/pistons", "/imu", "/tf"} <= set(log) and "/cycles" not in log
    assert all(len(column) == len(table["time_s"]) for table in log.values() for column in table.values())


def test_the_diagnosis_of_a_leak(program, repository):
    log = repository / "examples/leak.csv.gz"
    result = diagnose(log, repository / "examples/leak.calib.toml", timeout_s=120)
    assert result["verdict"]["names"] == ["leak"] and result["gap"]["explained_deg"] < result["gap"]["recalibrated_deg"]
    leak = result["effects"][0]
    assert leak["name"] == "leak" and leak["stage"] == "transmission" and leak["params"][0]["unit"] == "1/s"


def test_the_diagnosis_of_no_log(program, tmp_path):
    (tmp_path / "a.csv").write_text("time_s,piston1_mm\n0,0\n")
    with pytest.raises(ProgramError, match="a.csv, line 1, column piston2_mm: is missing") as caught:
        diagnose(tmp_path / "a.csv")
    assert caught.value.code == 2


def test_a_plant_in_the_loop(program, repository, tmp_path):
    path = tmp_path / "path.csv"
    path.write_text("t_s,bend_deg,dir_deg\n0,20,0\n1,25,30\n2,20,60\n")
    command = [program, "evaluate", "--calib", repository / "calib/paper.toml", "--track", path, "--json", "-"]
    plant = f"exec:{sys.executable} {repository / 'examples/plant.py'} --param stiffness=0.9"
    done = subprocess.run([*command, "--plant", plant], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr
    assert json.loads(done.stdout)["track"]["rmse_deg"] < 3


def test_both_forms_of_the_plant_are_one(repository):
    requests = "".join(json.dumps({"t": round(0.005 * k, 6), "steps": [k, 0, -k]}) + "\n" for k in range(1, 400))

    def answers(*command):
        done = subprocess.run([sys.executable, *command], cwd=repository, input=requests, capture_output=True, text=True, timeout=60)
        assert (done.stderr, done.returncode) == ("", 0)
        return [json.loads(line) for line in done.stdout.splitlines()]

    assert answers("examples/plant.py", "--param", "seed=7") == answers("examples/foreign_plant.py", "--seed", "7")


def test_the_example_of_the_client(service, environment, repository):
    command = [sys.executable, "examples/client.py", "--socket", service, "--seconds", "1"]
    done = subprocess.run(command, cwd=repository, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "tracking" in done.stdout


def test_every_snippet_of_the_documentation(service, environment, repository, monkeypatch, tmp_path):
    text = (repository / "docs/python.md").read_text()
    snippets = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(snippets) == 5
    monkeypatch.setenv("RETROFLEX_SOCKET", str(service))
    for snippet in snippets:
        done = subprocess.run(
            [sys.executable, "-c", snippet], cwd=repository, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=120
        )
        assert done.returncode == 0, f"{snippet}\n{done.stderr}"


def test_the_notebook(environment, repository):
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("matplotlib")
    notebook = nbformat.read(repository / "examples/log.ipynb", as_version=4)
    nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(repository)}}).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in shown)
    assert "leak" in str(shown)


def test_the_version_is_that_of_the_program(repository):
    def version(path):
        return re.search(r'^version = "(.*)"', (repository / path).read_text(), re.MULTILINE).group(1)

    assert version("python/pyproject.toml") == version("Cargo.toml")
