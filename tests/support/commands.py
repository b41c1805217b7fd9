"""One log through every command that reads logs, in this process, and what it cost."""

import resource
import shutil
import sys
import time
from functools import cache
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import typer
from support.cli import tetractl

COMMANDS = {
    "info": "info {log}",
    "info --json": "info {log} --json",
    "replay": "replay {log}",
    "plot": "plot {log} -o {out}/t.png",
    "plot convergence": "plot {log} --kind convergence -o {out}/c.png",
    "plot error": "plot {log} --kind error -o {out}/e.png",
    "plot timing": "plot {log} --kind timing -o {out}/s.png",
    "stats": "stats {log}",
    "stats --json": "stats {log} --format json",
    "stats --csv": "stats {log} --format csv",
    "verify": "verify {log}",
    "export": "export {log} -o {out}/tables",
    "report": "report {log} -o {out}/report.html",
    "recover": "recover {log} -o {out}/r.mcap",
    "export --parquet": "export {log} -o {out}/tables --format parquet",
    "identify": "identify {log}",
    "plot swarm": "plot {log} --kind swarm -o {out}/w.png",
    "plot errors": "plot {log} --kind errors -o {out}/es.png",
    "plot arms": "plot {log} --kind arms -o {out}/a.png",
    "plot ecdf": "plot {log} --kind ecdf -o {out}/ec.png",
    "plot scatter": "plot {log} --kind scatter -o {out}/sc.png",
    "plot estimate": "plot {log} --kind estimate -o {out}/es.png",
    "plot video": "plot {log} --kind video -o {out}/v.gif",
}


COSTLY = ("info", "info --json", "replay", "plot", "stats", "stats --csv", "verify", "recover")
READERS = ("info", "replay", "stats", "verify", "recover")
"""One command for each way to read a log."""
LOGS = tuple(COMMANDS)
STUDIES = ("study stats", "study stats --json", "study report", "study --dry-run")
SPECS = ("validate", "run --dry-run")
STUDY_FILES = ("validate", "study --dry-run of a file")
COMMANDS |= {
    "validate": "validate {log}",
    "run --dry-run": "run {log} --dry-run",
    "study --dry-run of a file": "study {log} --dry-run --out {out}/study",
    "identify tables": "identify {log}/poses.csv {log}/steps.csv",
    "study stats": "stats {log}/out",
    "study stats --json": "stats {log}/out --format json",
    "study report": "report {log}/out -o {out}/report.html",
    "study --dry-run": "study {log}/study.yaml --dry-run --out {log}/out",
}
TELL_ON_STDOUT = ("verify", "info", "info --json", "recover", "validate")
SLOW = {name for name in COMMANDS if name.partition(" ")[0] in ("plot", "report")}
SLOW |= {"study report"}

_parser = cache(typer.main.get_command)  # made for each call it takes longer than most commands


class Cost(NamedTuple):
    """What a command said, its exit code, its processor time [s], and its most memory [MB]."""

    out: str
    err: str
    code: int
    seconds: float
    memory_mb: float


def call(command: str, log: Path, out: Path) -> Cost:
    """Run a command in this process; a bug of it is raised."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    words = [word.format(log=log, out=out) for word in COMMANDS[command].split()]
    began = time.process_time()
    with mock.patch.object(typer.main, "get_command", _parser):
        done = tetractl(out, *words)
    seconds = time.process_time() - began
    return Cost(done.stdout, done.stderr, done.returncode, seconds, _most_memory_mb())


def _most_memory_mb() -> float:
    """Return the most memory that this process has had.

    Linux counts the memory of who started a process among its `ru_maxrss`, but not in VmHWM.
    """
    status = Path("/proc/self/status")
    if status.exists():
        (line,) = (row for row in status.read_text().splitlines() if row.startswith("VmHWM"))
        return float(line.split()[1]) / 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def check(command: str, log: Path, out: Path) -> Cost:
    """Run a command; AssertionError for output that a terminal would obey, or that is endless."""
    found = call(command, log, out)
    for line in (found.out + found.err).split("\n"):
        assert line.isprintable(), (command, line[:200])
    assert len(found.out) + len(found.err) < 1_000_000, command
    assert found.code in (0, 1, 2, 3), (command, found.code)
    assert found.code == 0 or found.err or command in TELL_ON_STDOUT
    return found


if __name__ == "__main__":  # FOLDER COMMAND,... LOG...: a line for each log and command
    out, *logs = (Path(name).absolute() for name in (sys.argv[1], *sys.argv[3:]))
    for log in logs:
        for name in sys.argv[2].split(","):
            cost = check(name, log, out)
            print(f"{log.name} {name}\t{cost.seconds:.2f}\t{cost.memory_mb:.0f}")
