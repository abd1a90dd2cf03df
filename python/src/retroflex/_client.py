"""The socket of the service: commands, status and frames.

Whatever listens on the socket, every call ends in time: a connection and an answer have a deadline, however much comes in
between, and a line has a largest length.
"""

from __future__ import annotations

import json
import math
import os
import socket
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Dict, Iterator, List, Optional, Sequence, Tuple, Type, TypedDict, Union, cast

from ._errors import BadRequest, NotSettled, Refused, Unreachable

_SYSTEM = Path("/run/retroflex/control.sock")
# several times the longest status
_LINE_MAX = 1 << 20
_SILENT = "it does not answer: it hangs, or its computer is overloaded"
# what the service says while pistons brake or drivers energise, and for how long a request is repeated
_BUSY = "still braking or energising"
_BUSY_MAX_S = 1.0
_ALIGNED_MAX_S = 10.0
# longest wait of a stop for each of its two sockets, and for how long both are tried
_STOP_S = 0.2
_STOP_TRIES_S = 0.5
# difference between two targets that are the same: rounding
_SAME_DEG = 0.1
# rows of a path in one request, whose line may have 16 KiB
_PATH_ROWS = 100


class Pose(TypedDict):
    """A bend."""

    bend_deg: float
    """Bend angle β between base and tip, degrees; 0 is straight."""
    dir_deg: float
    """Bend direction δ, degrees."""


class Frame(TypedDict, total=False):
    """What one cycle of the loop says. Keys that are not listed here are there all the same (docs/service.md)."""

    t: float
    """Time on the loop's clock, s."""
    mode: str
    """`aligning`, `disarmed`, `holding`, `tracking`, `calibrating`, `relaxing`, `faulted` or `lost`."""
    target: Optional[Pose]
    setpoint: Pose
    estimate: Optional[Pose]
    sigma_deg: Optional[float]
    """Standard deviation of the estimate, degrees."""
    length_mm: float
    piston_mm: List[float]
    """Displacement of the three pistons as counted, mm; positive elongates the bellow."""
    counted: List[int]
    """The same in microsteps."""
    energised: bool
    at_rest: bool
    blocked: bool
    shortfall: Optional[str]
    """Why the tip gets no closer to its target."""
    stopped: bool
    """A stop is latched."""
    latched: Optional[str]
    """Cause of a fault that has not been reset."""
    fault: Optional[str]
    """The same in words, with the remedy."""
    suspicion: Optional[str]
    k_epsilon: List[float]
    k_lambda_mm: List[float]
    lag_s: float
    delay_s: float


class Status(Frame, total=False):
    """State of the service. Keys that are not listed here are there all the same (docs/service.md)."""

    settled: bool
    """The tip rests at its target."""
    calibrating: Optional[str]
    calibration_failed: Optional[str]
    proposed: Optional[Dict[str, Any]]
    recording: Optional[Dict[str, Any]]
    recording_ended: Optional[str]
    lost: Optional[str]
    """In the mode `lost`: why the position of the pistons is unknown, and what to do."""
    remarks: List[str]


class Reach(TypedDict):
    """How far the tip bends at the rest length."""

    bend_deg: List[float]
    """Largest bend every 5° from direction 0 on, degrees."""
    r_mm: float
    """Distance of the bellows from the centre line, mm."""
    rest_length_mm: float


class Recording(TypedDict, total=False):
    """A bend log that the service writes."""

    path: str
    rows: int
    duration_s: float
    replayable: bool
    remark: Optional[str]


def _folder_of(variable: str) -> Optional[Path]:
    # systemd separates several folders by colons
    folder = Path(os.environ.get(variable, "").split(":")[0])
    return folder if folder.is_absolute() else None


def _runtime_folder() -> Path:
    given = _folder_of("RUNTIME_DIRECTORY")
    if given or os.geteuid() == 0:
        return given or _SYSTEM.parent
    home, state = _folder_of("HOME"), _folder_of("STATE_DIRECTORY")
    user = _folder_of("XDG_RUNTIME_DIR")
    if state and not user:
        return state
    user = user or _folder_of("XDG_STATE_HOME") or (home and home / ".local/state")
    return (user or Path(tempfile.gettempdir())) / "retroflex"


def _listens(path: Path) -> bool:
    try:
        with socket.socket(socket.AF_UNIX) as probe:
            probe.settimeout(0.1)
            probe.connect(str(path))
    except BlockingIOError:
        return True
    except OSError:
        return False
    return True


def default_socket() -> str:
    """The command socket that the program finds: RETROFLEX_SOCKET, or that of this user's service, or that of the system's.

    Raises `BadRequest` if both services are running and RETROFLEX_SOCKET names none.
    """
    named = os.environ.get("RETROFLEX_SOCKET")
    if named:
        return named
    own = _runtime_folder() / "control.sock"
    live = [path for path in dict.fromkeys((own, _SYSTEM)) if _listens(path)]
    if len(live) > 1:
        raise BadRequest(f"two services are running, at {live[0]} and {live[1]}: name one, or set RETROFLEX_SOCKET")
    if live:
        return str(live[0])
    return str(_SYSTEM if _SYSTEM.exists() and not own.exists() else own)


class _Connection:
    """A connection to a socket; `timeout_s` bounds the connection and each answer."""

    def __init__(self, path: str, timeout_s: float) -> None:
        self.path = path
        self.timeout_s = timeout_s
        self.last_id = 0
        self.input = bytearray()
        self.socket = socket.socket(socket.AF_UNIX)
        try:
            self._connect()
        except OSError as problem:
            self.socket.close()
            hint = "is `retroflex run` running, and are you in the group of the socket?"
            why = _SILENT if isinstance(problem, BlockingIOError) else f"{problem.strerror or problem}; {hint}"
            raise Unreachable(f"{path}: {why}") from problem

    def _connect(self) -> None:
        deadline = time.monotonic() + self.timeout_s
        self.socket.settimeout(self.timeout_s)
        while True:
            try:
                return self.socket.connect(self.path)
            except BlockingIOError:
                # the queue of a service that does not accept is full
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.01)

    def has_ended(self) -> bool:
        """True if the service has closed the connection, for example because it was idle for an hour."""
        self.socket.setblocking(False)
        try:
            return not self.socket.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return False
        except OSError:
            return True

    def read(self, deadline: float) -> Dict[str, Any]:
        """The next line. It must be complete at the deadline, on the monotonic clock."""
        searched = 0
        while True:
            end = self.input.find(b"\n", searched)
            if end >= 0:
                line = bytes(self.input[:end])
                del self.input[: end + 1]
                return self._parse(line)
            searched = len(self.input)
            if searched > _LINE_MAX:
                raise self._unreachable("it sends a line of more than 1 MiB, so it is no service of retroflex")
            left = deadline - time.monotonic()
            if left <= 0:
                raise self._unreachable(_SILENT)
            self.socket.settimeout(left)
            try:
                received = self.socket.recv(1 << 16)
            except socket.timeout:
                continue
            except OSError as problem:
                raise self._unreachable(f"it does not answer: {problem.strerror}") from problem
            if not received:
                raise self._unreachable("the service closed the connection")
            self.input += received

    def _parse(self, line: bytes) -> Dict[str, Any]:
        try:
            value = json.loads(line)
        except (ValueError, RecursionError):
            value = None
        if not isinstance(value, dict):
            raise self._unreachable(f"it sent {line[:200]!r}, so it is no service of retroflex")
        return value

    def _unreachable(self, why: str) -> Unreachable:
        return Unreachable(f"{self.path}: {why}")

    def ask(self, cmd: str, arguments: Dict[str, Any]) -> Dict[str, Any]:
        """Sends a request and returns the result of its answer. Frames that arrive in between are skipped."""
        deadline = time.monotonic() + self.timeout_s
        self.last_id += 1
        given = {name: value for name, value in arguments.items() if value is not None}
        try:
            line = json.dumps({**given, "v": 1, "id": self.last_id, "cmd": cmd}, allow_nan=False, default=float)
        except (TypeError, ValueError) as problem:
            raise BadRequest(f"{cmd}: {problem}") from problem
        try:
            self.socket.settimeout(self.timeout_s)
            self.socket.sendall(line.encode() + b"\n")
        except OSError as problem:
            raise self._unreachable(f"it does not answer: {problem.strerror or problem}") from problem
        while True:
            answer = self.read(deadline)
            # a line that the service could not parse has no id in its answer
            if answer.get("id") == self.last_id or ("ok" in answer and answer.get("id") is None):
                return _result(answer)


def _result(answer: Dict[str, Any]) -> Dict[str, Any]:
    if answer.get("ok") is True:
        result = answer.get("result")
        return result if isinstance(result, dict) else {}
    code, why = answer.get("code"), str(answer.get("error", "no reason given"))
    if code == 1:
        raise Refused(why)
    raise Unreachable(why) if code == 3 else BadRequest(why)


class Client:
    """A client of a running service.

    ```python
    with Client() as tip:
        tip.arm()
        tip.bend(40, 30)
        tip.relax()
    ```

    `path` is the command socket, by default `default_socket()`; `timeout_s` bounds the connection and each answer, s.
    A connection that the service has closed is made anew by the next call. If the client disconnects in the middle of a
    motion that it began more than `service.attended_s` (0.25 s) before, the tip holds. A client is used by one thread at a
    time, except `stop`, which any thread may call at any time.

    Every method raises `Refused`, `BadRequest` or `Unreachable` with the message of the service.
    """

    def __init__(self, path: Union[str, "os.PathLike[str]", None] = None, *, timeout_s: float = 10.0) -> None:
        self.path = os.fspath(path) if path is not None else default_socket()
        self.timeout_s = timeout_s
        self._connection: Optional[_Connection] = _Connection(self.path, timeout_s)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], trace: Optional[TracebackType]
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection."""
        if self._connection:
            self._connection.socket.close()
        self._connection = None

    def request(self, cmd: str, **arguments: Any) -> Dict[str, Any]:
        """Sends any request of the protocol (docs/service.md) and returns its result. Arguments that are None are left out.

        While the pistons brake or the drivers energise, it is sent again, for at most 1 s.
        """
        began = time.monotonic()
        while True:
            if self._connection is None or self._connection.has_ended():
                self.close()
                self._connection = _Connection(self.path, self.timeout_s)
            try:
                return self._connection.ask(cmd, arguments)
            except Unreachable:
                self.close()
                raise
            except Refused as refusal:
                if not str(refusal).startswith(_BUSY) or time.monotonic() > began + _BUSY_MAX_S:
                    raise
                time.sleep(_BUSY_MAX_S / 20)

    def status(self) -> Status:
        """State of the service."""
        return cast(Status, self.request("status"))

    def arm(self) -> None:
        """Energises the drivers and holds the present pose, after the end of an alignment, for which the tip must be still for 2 s."""
        deadline = time.monotonic() + _ALIGNED_MAX_S
        while self.status().get("mode") in ("boot", "aligning") and time.monotonic() < deadline:
            time.sleep(0.1)
        self.request("arm")

    def disarm(self) -> None:
        """Accepts no more motion; a bent tip stays energised."""
        self.request("disarm")

    def bend(
        self,
        bend_deg: float,
        dir_deg: float = 0.0,
        *,
        length_mm: Optional[float] = None,
        speed_deg_s: Optional[float] = None,
        world: bool = False,
        wait: bool = True,
        timeout_s: float = 60.0,
    ) -> Status:
        """Moves the tip to a bend in a direction, and waits until it has settled there.

        `length_mm` is that of the centre line, by default the rest length; `speed_deg_s` that of the set-point, if slower than
        the board's. With `world` the tip then keeps the orientation of its axis in the world while the base turns; such a bend
        does not settle, so `wait` must be False. Returns the last status.

        Raises `NotSettled` if the tip does not settle within `timeout_s`: it is obstructed or out of reach, a fault or a stop
        ended the motion, or another command replaced it.
        """
        if world and wait:
            raise ValueError("a bend that is kept in the world does not settle: give wait=False")
        frame = "world" if world else None
        self.request(
            "bend", bend_deg=bend_deg, dir_deg=dir_deg, length_mm=length_mm, speed_deg_s=speed_deg_s, frame=frame
        )
        deadline = time.monotonic() + timeout_s
        while wait:
            time.sleep(0.05)
            status = self.status()
            why = _hindrance(status, bend_deg, dir_deg)
            if why is None and status.get("settled"):
                return status
            if why is None and time.monotonic() > deadline:
                why = f"mode {status.get('mode')} after {timeout_s:g} s"
            if why:
                raise NotSettled("; ".join(filter(None, (why, status.get("suspicion")))), status)
        return self.status()

    def stream(self, bend_deg: float, dir_deg: float = 0.0, *, length_mm: Optional[float] = None, t_s: Optional[float] = None) -> None:
        """One set-point of a stream. The tip stops when the stream pauses for longer than `service.dead_man_s` (0.25 s).

        Through set-points with times `t_s`, s, the tip follows a smooth curve: the first is for now, each may come up to 1 s
        ahead of its time, and the times must increase.
        """
        self.request("stream", bend_deg=bend_deg, dir_deg=dir_deg, length_mm=length_mm, t_s=t_s)

    def follow(self, rows: Sequence[Tuple[float, float, float, Optional[float]]]) -> Dict[str, Any]:
        """Follows the spline through rows (t_s, bend_deg, dir_deg, length_mm or None for the rest length), from the first on.

        Returns `duration_s` and `time_scale`, the factor by which the path is slowed down to what the tip can follow. `path` in
        the status tells where on it the tip is: its `at_s` is 0 while the pistons cross their backlash towards the first
        row, and `path` is None at the end.
        """
        result: Dict[str, Any] = {}
        for begin in range(0, max(len(rows), 1), _PATH_ROWS):
            end = begin + _PATH_ROWS
            result = self.request("path", rows=[list(row) for row in rows[begin:end]], more=end < len(rows))
        return result

    def hold(self) -> None:
        """Comes to rest smoothly and holds."""
        self.request("hold")

    def stop(self) -> None:
        """Brakes at once and latches: nothing moves until the next `arm`. The call ends within about a second.

        It has connections of its own, so that any thread may call it while another waits for the tip.
        """
        direct = f"{os.path.splitext(self.path)[0]}.stop.sock"
        deadline = time.monotonic() + _STOP_TRIES_S
        while True:
            try:
                try:
                    return self._stop_directly(direct)
                except (Unreachable, BadRequest, Refused):
                    return self._stop_by_request()
            except Unreachable as problem:
                if time.monotonic() > deadline or not os.path.exists(self.path):
                    raise Unreachable(
                        f"the stop is not confirmed: if the tip moves, cut the power of its motors: {problem}"
                    ) from problem
            time.sleep(0.01)

    @staticmethod
    def _stop_directly(path: str) -> None:
        connection = _Connection(path, _STOP_S)
        with connection.socket:
            _result(connection.read(time.monotonic() + _STOP_S))

    def _stop_by_request(self) -> None:
        connection = _Connection(self.path, _STOP_S)
        with connection.socket:
            connection.ask("stop", {})

    def relax(self) -> None:
        """Begins to return to rest slowly, open loop, and then to de-energise."""
        self.request("relax")

    def zero(self, *, straight: bool = False) -> None:
        """Defines the present attitude as zero bend.

        With `straight` on your word that the tip is straight, even if no measurement bears it out.
        """
        self.request("zero", straight=straight)

    def reach(self) -> Reach:
        """How far the tip bends in each direction."""
        return cast(Reach, self.request("reach"))

    def record_start(self, name: Optional[str] = None, *, owned: bool = False) -> Recording:
        """Starts to record a bend log, by default under the next free number. An owned one ends with this connection."""
        return cast(Recording, self.request("record", action="start", name=name, owned=owned))

    def record_stop(self) -> Recording:
        """Ends the recording, which `read_log` and `diagnose` then read."""
        return cast(Recording, self.request("record", action="stop"))

    def calibrate(self, action: str = "short", *, poses: Optional[int] = None) -> None:
        """Begins to identify the gains of the transmission (`full`, or `short` with 6 to 24 poses), or decides on the proposal
        (`accept`, `discard`).

        `calibrating`, `calibration_failed` and `proposed` in the status tell the progress and the result.
        """
        self.request("calibrate", action=action, poses=poses)

    def reset_fault(self) -> None:
        """Clears a fault after its cause is repaired."""
        self.request("reset_fault")

    def reload(self) -> Dict[str, Any]:
        """Loads the gains file again without a jump."""
        return self.request("reload")

    def frames(self, rate_hz: float = 20.0) -> Iterator[Frame]:
        """As `frames`, of this service."""
        return frames(rate_hz, path=self.path, timeout_s=self.timeout_s)


def _hindrance(status: Status, bend_deg: float, dir_deg: float) -> Optional[str]:
    """Why the tip will not settle at this bend, or has settled short of it."""
    if status.get("stopped"):
        return "stopped"
    mode, target = status.get("mode"), status.get("target")
    if mode not in ("tracking", "holding"):
        return status.get("fault") or f"mode {mode}"
    if target:
        asked, found = ((b * math.cos(math.radians(d)), b * math.sin(math.radians(d)))
                        for b, d in ((bend_deg, dir_deg), (target["bend_deg"], target["dir_deg"])))
        if math.dist(asked, found) > _SAME_DEG:
            return f"another command replaced this one: the target is {target['bend_deg']}° at {target['dir_deg']}°"
    if status.get("settled") and status.get("blocked"):
        return status.get("shortfall") or "blocked"
    return None


def frames(
    rate_hz: float = 20.0, *, path: Union[str, "os.PathLike[str]", None] = None, timeout_s: float = 10.0
) -> Iterator[Frame]:
    """Frames of the loop, 0.1 to 1000 a second, until the caller stops asking for them.

    `path` is the command socket, by default `default_socket()`; the status socket beside it is used if it is there, which also
    those may open who may not command. A reader that is too slow misses frames. Leaving the loop closes the connection.

    Raises `Unreachable` when the service ends or is silent for `timeout_s` longer than a frame takes.
    """
    control = os.fspath(path) if path is not None else default_socket()
    status = os.path.join(os.path.dirname(control), "status.sock")
    connection = _Connection(status if os.path.exists(status) else control, timeout_s)
    with connection.socket:
        connection.ask("subscribe", {"rate_hz": rate_hz})
        while True:
            line = connection.read(time.monotonic() + timeout_s + 1 / rate_hz)
            if line.get("event") == "frame":
                yield cast(Frame, line)
