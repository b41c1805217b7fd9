"""Hostile files through every command: `python benchmarks/hostile.py KIND [--count N] [--seed S]`.

KIND is `logs`, or `tables`: CSV tables, rows, specs and studies. Each case is made from its number
and the seed (tests/support/hostile.py) and read by one command in this process. Prints Markdown: a
row per command, and every finding with its case, which `--only N` repeats. A finding is a
traceback, output that a terminal would obey, a process of more than 1 GB, or more than 30 s of
processor time or 300 s in all.
"""

import argparse
import faulthandler
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tests"))
sys.path.extend(map(str, ROOT.glob("packages/*/tests")))

MEMORY_MB, CPU_S, WALL_S = 1000, 30, 300
BLOCK = 5000  # cases of a process, which ends at the first that takes too much memory


class HangError(BaseException):
    """More processor time than a command may take."""


def examine(kind: str, seed: int, number: int, show: bool = False) -> dict[str, Any]:
    """Run one case; return its command, what was found, its processor time and its peak."""
    from support.hostile import case

    found, began, command = "", time.process_time(), "made"
    signal.setitimer(signal.ITIMER_PROF, CPU_S)
    faulthandler.dump_traceback_later(WALL_S, exit=True)
    try:
        command, run = case(kind, seed, number)
        Path("/proc/self/clear_refs").write_text("5")  # making the file is not the command's peak
        run()
    except HangError:
        found = "hang"
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        found = f"{type(error).__name__} at {Path(last.filename).name}:{last.lineno}: {error}"[:300]
        if show:
            raise
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        faulthandler.cancel_dump_traceback_later()
    status = Path("/proc/self/status").read_text().splitlines()
    memory = next(int(line.split()[1]) for line in status if line.startswith("VmHWM:")) / 1e3
    seconds = time.process_time() - began
    if not found and memory > MEMORY_MB:
        found = f"takes {memory:.0f} MB"
    return {"number": number, "command": command, "found": found, "s": seconds, "mb": memory}


def _hang(*_: object) -> None:
    raise HangError


def child(kind: str, seed: int, numbers: range) -> None:
    """Examine cases, up to one that takes too much memory; print a line of JSON for each."""
    out = os.fdopen(os.dup(1), "w")  # commands write to sys.stdout
    from support.hostile import warm_up

    warm_up(kind)
    limit = 8_000_000_000  # what one case may take of the machine
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    signal.signal(signal.SIGPROF, _hang)
    warnings.simplefilter("error")
    for number in numbers:
        found = examine(kind, seed, number)
        print(json.dumps(found), file=out, flush=True)
        if found["mb"] > MEMORY_MB:
            return


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=["logs", "tables"])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, metavar="N")
    parser.add_argument("--first", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.only is not None:
        print(examine(given.kind, given.seed, given.only, show=True))
        return 0
    if given.child:
        child(given.kind, given.seed, range(given.first, given.first + given.count))
        return 0
    began, results = time.perf_counter(), list[dict[str, Any]]()
    while len(results) < given.count:
        results += block(given, len(results), min(BLOCK, given.count - len(results)))
    return report(given, results, time.perf_counter() - began)


def block(given: Any, first: int, count: int) -> list[dict[str, Any]]:
    """Examine cases in a process of its own; a case in which the process dies is the last."""
    words = [given.kind, "--child", "--seed", str(given.seed), "--first", str(first)]
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, __file__, *words, "--count", str(count)],
            env=os.environ | {"TMPDIR": folder, "COLUMNS": "200"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
        )
    found = [json.loads(line) for line in done.stdout.splitlines()]
    if not found:
        sys.exit(done.stderr)
    if done.returncode:
        why = f"hang, or died with {done.returncode}: {done.stderr[-1500:]}"
        found.append({"number": first + len(found), "command": "?", "found": why, "s": 0, "mb": 0})
    return found


def report(given: Any, results: list[dict[str, Any]], seconds: float) -> int:
    """Print what was found; return 1 if anything was."""
    bad = [one for one in results if one["found"]]
    hangs = sum(one["found"].startswith("hang") for one in bad)
    large = sum(one["mb"] > MEMORY_MB for one in results)
    slowest, most = max(one["s"] for one in results), max(one["mb"] for one in results)
    print(
        f"{len(results)} hostile {given.kind}, seed {given.seed}, {seconds / 60:.1f} min: "
        f"{len(bad) - hangs - large} tracebacks, {large} over {MEMORY_MB} MB, {hangs} hangs; "
        f"at most {slowest:.1f} s and {most:.0f} MB\n"
    )
    print("| command | cases | found | slowest [s] | most [MB] |\n|---|---|---|---|---|")
    for name, count in sorted(Counter(one["command"] for one in results).items()):
        some = [one for one in results if one["command"] == name]
        slowest, most = max(one["s"] for one in some), max(one["mb"] for one in some)
        found = sum(bool(one["found"]) for one in some)
        print(f"| {name} | {count} | {found} | {slowest:.1f} | {most:.0f} |")
    for one in bad:
        print(f"\ncase {one['number']}, {one['command']}: {one['found']}")
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
