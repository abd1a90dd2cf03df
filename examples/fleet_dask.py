"""Diagnoses the logs of a fleet on many machines, with Dask (`pip install distributed`).

    fleet_dask.py LOGS ROWS.parquet [--parts N] [--scheduler ADDRESS] [-- OPTIONS of `retroflex gap diagnose`]

Dask rather than Ray, because its scheduler and workers are plain Python programs of a few megabytes that run wherever Python does, and
the work of a part is a program of its own, which needs none of Ray's shared memory.

Every part is one run of `retroflex gap diagnose --shard K/N` by some worker. The workers share the folder of the logs and that of
the table. If a worker dies, Dask gives its part to another one, which keeps the rows that are there and diagnoses the rest. Without
--scheduler, two workers are started on this machine.
"""

import argparse
import ctypes
import os
import pathlib
import signal
import subprocess
import sys

from distributed import Client, LocalCluster

PROGRAM = os.environ.get("RETROFLEX", "retroflex")


def die_with_worker():
    """Ends the program if its worker is killed."""
    parent_death = 1
    ctypes.CDLL(None).prctl(parent_death, signal.SIGKILL)


def run(*arguments):
    """Runs the program; returns its exit code and what it says."""
    # a worker has one thread, and so has what it runs
    one = {**os.environ, "RAYON_NUM_THREADS": "1"}
    done = subprocess.run([PROGRAM, *arguments], capture_output=True, text=True, preexec_fn=die_with_worker, env=one)
    return done.returncode, done.stderr + done.stdout


def diagnose(logs, table, part, parts, options):
    """Diagnoses a part; returns its table, or nothing if there are fewer logs than parts."""
    code, text = run("gap", "diagnose", logs, "--rows", table, "--shard", f"{part}/{parts}", *options)
    if "no log to diagnose" in text:
        return None
    if code != 0:
        raise RuntimeError(text)
    print(text, end="", flush=True)
    return table


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs")
    parser.add_argument("rows", type=pathlib.Path)
    parser.add_argument("--parts", type=int, default=8)
    parser.add_argument("--scheduler")
    parser.add_argument("options", nargs="*")
    args = parser.parse_args()
    logs, rows = os.path.abspath(args.logs), args.rows.absolute()
    client = Client(args.scheduler) if args.scheduler else Client(LocalCluster(n_workers=2, threads_per_worker=1))
    tables = [str(rows.with_suffix(f".{part}.parquet")) for part in range(1, args.parts + 1)]
    tasks = [
        client.submit(diagnose, logs, table, part, args.parts, args.options, pure=False)
        for part, table in enumerate(tables, 1)
    ]
    tables = [table for table in client.gather(tasks) if table]
    code, text = run("fleet", *tables, "--merged", str(rows))
    print(text, end="")
    return code


if __name__ == "__main__":
    sys.exit(main())
