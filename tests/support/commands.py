"""One log through every command that reads logs, in this process."""

import shutil
from functools import cache
from pathlib import Path
from unittest import mock

import typer
from support.cli import Done, tetractl

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


def call(command: str, log: Path, out: Path) -> Done:
    """Run a command in this process; a bug of it is raised."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    words = [word.format(log=log, out=out) for word in COMMANDS[command].split()]
    with mock.patch.object(typer.main, "get_command", _parser):
        return tetractl(out, *words)


def check(command: str, log: Path, out: Path) -> Done:
    """Run a command; AssertionError for output that a terminal would obey, or that is endless."""
    found = call(command, log, out)
    for line in (found.stdout + found.stderr).split("\n"):
        assert line.isprintable(), (command, line[:200])
    assert len(found.stdout) + len(found.stderr) < 1_000_000, command
    assert found.returncode in (0, 1, 2, 3), (command, found.returncode)
    assert found.returncode == 0 or found.stderr or command in TELL_ON_STDOUT
    return found
