#!/usr/bin/env python3
"""Bends the tip of a running service from Python, using only the standard library.

    retroflex run &
    python3 examples/client.py
    python3 examples/client.py --socket /tmp/tip.sock --bend 30 --toward 120

The service speaks one JSON object a line over a Unix socket. A request has `v`, an `id` of its own and a `cmd`; its
answer has the same `id`. After `subscribe`, frames arrive between the answers. Angles are degrees, lengths mm.
"""
import argparse
import json
import math
import os
import socket
import sys
import time


def default_socket():
    """The socket that `retroflex run` opens without options."""
    if "RETROFLEX_SOCKET" in os.environ:
        return os.environ["RETROFLEX_SOCKET"]
    home = os.path.expanduser("~")
    folders = [os.environ.get("RUNTIME_DIRECTORY"), os.path.join(os.environ.get("XDG_RUNTIME_DIR", home), "retroflex"),
               os.path.join(os.environ.get("XDG_STATE_HOME", os.path.join(home, ".local/state")), "retroflex")]
    sockets = [os.path.join(folder, "control.sock") for folder in folders if folder]
    return next(filter(os.path.exists, sockets), "/run/retroflex/control.sock")


class Refused(Exception):
    """The service understood a request and refused it; the text says why and what to do."""


class Tip:
    """A connection to the service."""

    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(10)
        self.socket.connect(path)
        self.lines = self.socket.makefile("r", encoding="utf-8")
        self.id = 0

    def read(self):
        """The next line: an answer, or a frame of a subscription."""
        line = self.lines.readline()
        if not line:
            raise ConnectionError("the service has closed the connection")
        return json.loads(line)

    def ask(self, cmd, **arguments):
        """Sends a request and returns the result of its answer."""
        self.id += 1
        request = {"v": 1, "id": self.id, "cmd": cmd, **arguments}
        self.socket.sendall(json.dumps(request).encode() + b"\n")
        while True:
            answer = self.read()
            if answer.get("id") == self.id:
                if not answer["ok"]:
                    raise Refused(answer["error"])
                return answer["result"]

    def frames(self, rate_hz):
        """Frames of the loop, until the caller stops asking for them."""
        self.ask("subscribe", rate_hz=rate_hz)
        while True:
            line = self.read()
            if line.get("event") == "frame":
                yield line


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--socket", default=default_socket())
    parser.add_argument("--bend", type=float, default=40.0, help="degrees")
    parser.add_argument("--toward", type=float, default=90.0, help="degrees")
    parser.add_argument("--seconds", type=float, default=3.0, help="time to watch the tip")
    args = parser.parse_args()
    if not all(map(math.isfinite, (args.bend, args.toward, args.seconds))):
        sys.exit("--bend, --toward and --seconds must be finite numbers")
    try:
        commands, watch = Tip(args.socket), Tip(args.socket)
        deadline = time.monotonic() + 15
        while commands.ask("status")["mode"] == "aligning" and time.monotonic() < deadline:
            time.sleep(0.1)
        commands.ask("arm")
        commands.ask("bend", bend_deg=args.bend, dir_deg=args.toward)
        begin, printed = None, -1
        for frame in watch.frames(rate_hz=20):
            begin = frame["t"] if begin is None else begin
            elapsed = frame["t"] - begin
            estimate = frame["estimate"]
            if estimate and int(elapsed * 2) > printed:
                printed = int(elapsed * 2)
                print(f"{elapsed:4.1f} s  bend {estimate['bend_deg']:5.1f}°  toward {estimate['dir_deg']:6.1f}°  {frame['mode']}")
            if elapsed >= args.seconds:
                break
        # brakes and latches: nothing moves until the next arm, which `relax` needs too
        commands.ask("stop")
        commands.ask("arm")
        commands.ask("relax")
    except Refused as refusal:
        sys.exit(f"refused: {refusal}")
    except OSError as problem:
        sys.exit(f"{args.socket}: {problem}; is `retroflex run` running?")


if __name__ == "__main__":
    main()
