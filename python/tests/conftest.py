"""Fixtures: the repository, the program, a service of it, and a fake service."""

import json
import os
import socket
import subprocess
import tempfile
import threading
import time
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def repository():
    return REPOSITORY


@pytest.fixture(scope="session")
def program():
    """The program named by RETROFLEX_BINARY."""
    named = os.environ.get("RETROFLEX_BINARY")
    if not named:
        pytest.skip("RETROFLEX_BINARY names no program")
    return str(Path(named).resolve())


@pytest.fixture
def short_folder():
    """A folder whose name is short enough for that of a socket."""
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        yield Path(folder)


@pytest.fixture
def service_process(program, short_folder):
    """A service on the built-in plant: its command socket and its process."""
    control = short_folder / "control.sock"
    command = [program, "run", "--socket", control, "--state", short_folder / "state"]
    running = subprocess.Popen(command, cwd=short_folder, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 10
    while not control.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    yield control, running
    running.terminate()
    try:
        running.wait(20)
    except subprocess.TimeoutExpired:
        running.kill()
        running.wait()
        raise


@pytest.fixture
def service(service_process):
    """The command socket of a service on the built-in plant."""
    return service_process[0]


class FakeService:
    """Listens on a socket; `serve(connection, request)` handles each line of each connection."""

    def __init__(self, path, serve, backlog=8):
        self.requests, self.connections, self.serve = [], [], serve
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.bind(str(path))
        self.socket.listen(backlog)
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                connection, _ = self.socket.accept()
            except OSError:
                return
            self.connections.append(connection)
            threading.Thread(target=self._talk, args=(connection,), daemon=True).start()

    def _talk(self, connection):
        try:
            for line in connection.makefile("rb"):
                request = json.loads(line)
                self.requests.append(request)
                self.serve(connection, request)
        except OSError:
            pass

    def close(self):
        for one in (self.socket, *self.connections):
            try:
                # ends a call that waits in another thread
                one.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
            one.close()


def answer(connection, request, **result):
    line = {"v": 1, "id": request["id"], "ok": True, "result": result}
    connection.sendall(json.dumps(line).encode() + b"\n")


@pytest.fixture
def fake(short_folder):
    """Starts fake services: `fake(serve)` gives the service, at `fake.path`."""
    services = []

    def start(serve=lambda connection, request: answer(connection, request), name="control.sock"):
        services.append(FakeService(short_folder / name, serve))
        return services[-1]

    start.path = short_folder / "control.sock"
    yield start
    for one in services:
        one.close()
