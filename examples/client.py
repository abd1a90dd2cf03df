#!/usr/bin/env python3
"""Bends the tip of a running service from Python.

    pip install ./python                      # installed from the Debian package: /usr/share/retroflex/python
    retroflex run &
    python3 examples/client.py
    python3 examples/client.py --socket /tmp/tip.sock --bend 30 --toward 120

Angles are degrees, lengths mm. `docs/service.md` has the protocol, for other languages.
"""
import argparse
import math
import sys

import retroflex


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--socket", help="by default that of the running service")
    parser.add_argument("--bend", type=float, default=40.0, help="degrees")
    parser.add_argument("--toward", type=float, default=90.0, help="degrees")
    parser.add_argument("--seconds", type=float, default=3.0, help="time to watch the tip")
    args = parser.parse_args()
    if not all(map(math.isfinite, (args.bend, args.toward, args.seconds))):
        sys.exit("--bend, --toward and --seconds must be finite numbers")
    try:
        with retroflex.Client(args.socket) as tip:
            tip.arm()
            tip.bend(args.bend, args.toward, wait=False)
            begin, printed = None, -1
            for frame in tip.frames(rate_hz=20):
                begin = frame["t"] if begin is None else begin
                elapsed, estimate = frame["t"] - begin, frame["estimate"]
                if estimate and int(elapsed * 2) > printed:
                    printed = int(elapsed * 2)
                    print(f"{elapsed:4.1f} s  bend {estimate['bend_deg']:5.1f}°  toward {estimate['dir_deg']:6.1f}°  {frame['mode']}")
                if elapsed >= args.seconds:
                    break
            # brakes and latches: nothing moves until the next arm, which `relax` needs too
            tip.stop()
            tip.arm()
            tip.relax()
    except retroflex.Refused as refusal:
        sys.exit(f"refused: {refusal}")
    except retroflex.Error as problem:
        sys.exit(str(problem))


if __name__ == "__main__":
    main()
