"""The client against services that are not what they should be. Every call ends in time, with an error that says why."""

import json
import math
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from conftest import FakeService, answer

from retroflex import BadRequest, Client, NotSettled, Refused, Unreachable, default_socket, frames

TIMEOUT_S = 0.4


@pytest.fixture
def quick():
    """Fails a test whose calls take much longer than their deadlines."""
    began = time.monotonic()
    yield
    assert time.monotonic() - began < 5


def client(fake):
    return Client(fake.path, timeout_s=TIMEOUT_S)


def refusing(code, why):
    def serve(connection, request):
        line = {"v": 1, "id": request["id"], "ok": False, "code": code, "error": why}
        connection.sendall(json.dumps(line).encode() + b"\n")

    return serve


def floods(connection, request):
    while True:
        connection.sendall(b'{"v":1,"event":"frame","t":1.0}\n' * 1000)


def one_endless_line(connection, request):
    while True:
        connection.sendall(b"[" * 65536)


def drips(connection, request):
    for _ in range(200):
        connection.sendall(b" ")
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("serve", "part"),
    [
        (lambda connection, request: None, "does not answer"),
        (floods, "does not answer"),
        (drips, "does not answer"),
        (one_endless_line, "more than 1 MiB"),
        (lambda connection, request: connection.shutdown(socket.SHUT_RDWR), "closed the connection"),
        (lambda connection, request: connection.sendall(b'{"v":1,"id":1,') or connection.shutdown(socket.SHUT_RDWR), "closed"),
        (lambda connection, request: connection.sendall(b"HTTP/1.1 400 Bad Request\r\n"), "HTTP/1.1 400"),
        (lambda connection, request: connection.sendall(b"\xff\x00\x01\n"), "no service of retroflex"),
        (lambda connection, request: connection.sendall(b"[1]\n"), "no service of retroflex"),
        (lambda connection, request: connection.sendall(b"[" * 100_000 + b"\n"), "no service of retroflex"),
        (lambda connection, request: connection.sendall(b'{"v":1,"id":99,"ok":true}\n'), "does not answer"),
        (refusing(3, "the loop is gone"), "the loop is gone"),
    ],
)
def test_a_hostile_service_is_unreachable(fake, quick, serve, part):
    fake(serve)
    with pytest.raises(Unreachable, match=part):
        client(fake).status()


def test_a_service_that_does_not_accept_is_unreachable(short_folder, quick):
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(short_folder / "control.sock"))
    listener.listen(0)
    waiting = []
    with pytest.raises(Unreachable, match="does not answer"):
        for _ in range(8):
            waiting.append(Client(short_folder / "control.sock", timeout_s=TIMEOUT_S))
    with pytest.raises(Unreachable, match="the stop is not confirmed"):
        waiting[0].stop()


def test_a_socket_without_a_service_is_named(short_folder):
    path = short_folder / "control.sock"
    with pytest.raises(Unreachable, match="control.sock: No such file .* is `retroflex run` running"):
        Client(path)
    with pytest.raises(Unreachable, match="too long"):
        Client(short_folder / ("x" * 200))
    socket.socket(socket.AF_UNIX).bind(str(path))
    with pytest.raises(Unreachable, match="refused"):
        Client(path)


@pytest.mark.parametrize(("code", "error"), [(1, Refused), (2, BadRequest), (3, Unreachable), (9, BadRequest), ([], BadRequest)])
def test_errors_have_the_message_of_the_service(fake, code, error):
    fake(refusing(code, "because"))
    with pytest.raises(error, match="^because$"):
        client(fake).arm()


def test_an_answer_without_an_id_is_the_answer(fake):
    fake(lambda connection, request: connection.sendall(b'{"v":1,"id":null,"ok":false,"code":2,"error":"not JSON"}\n'))
    with pytest.raises(BadRequest, match="not JSON"):
        client(fake).status()


def test_events_and_answers_in_pieces_are_read(fake):
    def serve(connection, request):
        line = json.dumps({"v": 1, "id": request["id"], "ok": True, "result": {"mode": "holding", "später": 1}}, ensure_ascii=False)
        for piece in (b'{"v":1,"event":"frame"}\n', line.encode()[:60], line.encode()[60:] + b"\n"):
            connection.sendall(piece)
            time.sleep(0.02)

    fake(serve)
    assert client(fake).status() == {"mode": "holding", "später": 1}


def test_values_that_are_no_json_are_not_sent(fake):
    service = fake()
    tip = client(fake)
    for value in (math.nan, math.inf, object()):
        with pytest.raises(BadRequest, match="bend"):
            tip.bend(value)
    assert service.requests == []


def test_a_closed_connection_is_made_anew(fake):
    service = fake()
    tip = client(fake)
    tip.status()
    service.connections[0].shutdown(socket.SHUT_RDWR)
    time.sleep(0.05)
    tip.status()
    assert len(service.connections) == 2


def test_a_late_answer_is_not_that_of_the_next_request(fake):
    def serve(connection, request):
        if request["cmd"] == "status":
            time.sleep(2 * TIMEOUT_S)
        answer(connection, request, of=request["cmd"])

    fake(serve)
    tip = client(fake)
    with pytest.raises(Unreachable):
        tip.status()
    assert tip.reach() == {"of": "reach"}


def test_a_connection_is_silent_without_delay(fake):
    fake()
    tip = Client(fake.path)
    began = time.monotonic()
    for _ in range(20):
        tip.hold()
    assert time.monotonic() - began < 1


def test_a_request_is_repeated_while_the_pistons_brake(fake):
    def serve(connection, request):
        if request["id"] < 4:
            return refusing(1, "still braking or energising; try again in a moment")(connection, request)
        answer(connection, request)

    service = fake(serve)
    client(fake).relax()
    assert [request["cmd"] for request in service.requests] == ["relax"] * 4


HOLDING = {"mode": "holding", "settled": True, "blocked": False, "stopped": False, "target": {"bend_deg": 30.0, "dir_deg": -90.0}}


def reporting(**status):
    def serve(connection, request):
        answer(connection, request, **({**HOLDING, **status} if request["cmd"] == "status" else {}))

    return serve


def test_bend_waits_and_says_why_the_tip_has_not_settled(fake):
    fake(reporting())
    assert client(fake).bend(30, 270)["settled"] is True
    assert client(fake).bend(-30, 90)["settled"] is True
    with pytest.raises(NotSettled, match="another command replaced this one: the target is 30.0° at -90.0°"):
        client(fake).bend(30, 90)
    with pytest.raises(ValueError):
        client(fake).bend(30, 90, world=True)


@pytest.mark.parametrize(
    ("status", "why"),
    [
        ({"stopped": True}, "stopped"),
        ({"mode": "faulted", "fault": "a piston would have left its travel"}, "left its travel"),
        ({"mode": "relaxing"}, "mode relaxing"),
        ({"blocked": True, "shortfall": "an obstruction holds it"}, "an obstruction holds it"),
        ({"mode": "tracking", "settled": False, "suspicion": "line 2 leaks"}, "mode tracking after 0.2 s; line 2 leaks"),
    ],
)
def test_a_tip_that_does_not_settle(fake, quick, status, why):
    fake(reporting(**status))
    with pytest.raises(NotSettled, match=why) as caught:
        client(fake).bend(30, -90, timeout_s=0.2)
    assert caught.value.status["target"] == HOLDING["target"]


def test_requests_are_those_of_the_protocol(fake):
    service = fake(reporting())
    with client(fake) as tip:
        tip.bend(40, 30, length_mm=21, speed_deg_s=5, world=True, wait=False)
        tip.zero(straight=True)
        tip.record_start("a", owned=True)
        tip.stream(1, 2, t_s=0.5)
        tip.calibrate("short", poses=12)
        tip.follow([(0.1 * k, 10, k, None) for k in range(250)])
    sent = [{k: v for k, v in request.items() if k not in ("v", "id")} for request in service.requests]
    assert sent[0] == {"cmd": "bend", "bend_deg": 40, "dir_deg": 30, "length_mm": 21, "speed_deg_s": 5, "frame": "world"}
    assert sent[2:6] == [
        {"cmd": "zero", "straight": True},
        {"cmd": "record", "action": "start", "name": "a", "owned": True},
        {"cmd": "stream", "bend_deg": 1, "dir_deg": 2, "t_s": 0.5},
        {"cmd": "calibrate", "action": "short", "poses": 12},
    ]
    assert [(len(request["rows"]), request["more"]) for request in sent[6:]] == [(100, True), (100, True), (50, False)]
    assert all(request["v"] == 1 for request in service.requests)


def test_stop_has_a_socket_of_its_own(fake):
    service = fake()
    direct = FakeService(Path(str(fake.path).replace("control.sock", "control.stop.sock")), None)
    threading.Timer(0.05, lambda: direct.connections[0].sendall(b'{"v":1,"id":null,"ok":true,"result":{}}\n')).start()
    client(fake).stop()
    direct.close()
    assert service.requests == []
    # that of another service, or of none: the command socket stops too
    client(fake).stop()
    assert [request["cmd"] for request in service.requests] == ["stop"]


def test_a_stop_that_is_not_confirmed_says_so_within_two_seconds(fake):
    fake(lambda connection, request: None)
    fake(lambda connection, request: None, name="control.stop.sock")
    tip = client(fake)
    began = time.monotonic()
    with pytest.raises(Unreachable, match="if the tip moves, cut the power"):
        tip.stop()
    assert time.monotonic() - began < 2


def test_frames_come_from_the_status_socket_and_end_the_connection(fake):
    def serve(connection, request):
        answer(connection, request)
        for t in range(3):
            connection.sendall(json.dumps({"v": 1, "event": "frame", "t": t, "mode": "holding"}).encode() + b"\n")

    fake()
    service = fake(serve, name="status.sock")
    got = frames(50, path=fake.path, timeout_s=TIMEOUT_S)
    assert [next(got)["t"] for _ in range(3)] == [0, 1, 2]
    got.close()
    assert service.requests == [{"v": 1, "id": 1, "cmd": "subscribe", "rate_hz": 50}]
    with pytest.raises(Unreachable, match="does not answer"):
        list(frames(50, path=fake.path, timeout_s=TIMEOUT_S))
    service.close()
    with pytest.raises(Unreachable):
        list(frames(50, path=fake.path, timeout_s=TIMEOUT_S))


def test_the_socket_is_found_as_the_program_finds_it(monkeypatch, short_folder):
    for name in ("RETROFLEX_SOCKET", "RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR", "STATE_DIRECTORY", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    monkeypatch.setenv("HOME", "/home/a")
    assert default_socket() == "/home/a/.local/state/retroflex/control.sock"
    monkeypatch.setenv("XDG_STATE_HOME", "/s")
    assert default_socket() == "/s/retroflex/control.sock"
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/r")
    assert default_socket() == "/r/retroflex/control.sock"
    monkeypatch.setenv("RUNTIME_DIRECTORY", f"{short_folder}:/other")
    assert default_socket() == f"{short_folder}/control.sock"
    with FakeOnSystemPath(monkeypatch, short_folder) as system:
        assert default_socket() == system
        own = FakeService(short_folder / "control.sock", None)
        with pytest.raises(BadRequest, match="two services are running"):
            default_socket()
        own.close()
    monkeypatch.setenv("RETROFLEX_SOCKET", "/named")
    assert default_socket() == "/named"


class FakeOnSystemPath:
    """A service at the path of the system's."""

    def __init__(self, monkeypatch, folder):
        self.path = folder / "system.sock"
        monkeypatch.setattr("retroflex._client._SYSTEM", self.path)

    def __enter__(self):
        self.service = FakeService(self.path, None)
        return str(self.path)

    def __exit__(self, *_):
        self.service.close()


def test_the_package_needs_only_the_standard_library():
    code = "import sys, retroflex; print({m.split('.')[0] for m in sys.modules} & {'pandas', 'polars', 'numpy', 'mcap'})"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "set()\n"
