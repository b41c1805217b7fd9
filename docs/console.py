"""Run the `console` blocks of Markdown pages, and tell or mend where their output has changed.

Run `python docs/console.py README.md docs/tutorial.md --write` to put in what the commands print
now; a test fails while a page differs from it.

The blocks of a page are run one after another in one empty folder that holds a copy of
`experiments/`. A fence with `title=NAME` is a file of that name there. Below a command stands what
it prints, stdout and stderr together; without that, it only has to succeed. `...` stands for what
varies: alone on a line for any lines, within a line for anything there. Numbers may differ by 15 %
or 3 of the last digit: another processor rounds differently, and a disturbed trial may then go
another way.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
COLUMNS = 90
TOLERANCE = 0.15
ONCE = "compiling the solver, once on this machine ...\n"  # where the tests come before a run
_FENCE = re.compile(r"^```(\w*)[^\n]*?(?:title=(\S+))?\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_COMMAND = re.compile(r"^\$ ((?:.*\\\n)*.*)\n((?:(?!\$ ).*\n)*)", re.MULTILINE)
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_DONE = "--- the command above ended with"


@dataclass(frozen=True)
class Example:
    """A command with the output that the page shows; `end` is where that ends in the page."""

    command: str
    shown: str
    start: int
    end: int


def examples(page: str) -> Iterator[Example]:
    """Yield the commands of a page in order."""
    for fence in _FENCE.finditer(page):
        if fence[1] != "console":
            continue
        for found in _COMMAND.finditer(fence[3]):
            begin = fence.start(3)
            yield Example(found[1], found[2], begin + found.start(2), begin + found.end(2))


def programs(page: str) -> Iterator[str]:
    """Yield the `python` blocks of a page in order, without those that are files of a name."""
    for fence in _FENCE.finditer(page):
        if fence[1] == "python" and not fence[2]:
            yield fence[3]


def run(page: str) -> list[tuple[Example, str, int]]:
    """Run a page's commands; return each with what it printed and its exit code."""
    asked = list(examples(page))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(ROOT / "experiments", folder / "experiments")
        for fence in _FENCE.finditer(page):
            if fence[2]:
                (folder / fence[2]).write_text(fence[3], encoding="utf-8")
        ends = f'code=$?; echo "{_DONE} $code"; (exit $code)'  # so that `echo $?` tells it
        script = "\n".join(f"{example.command}\n{ends}" for example in asked)
        done = subprocess.run(
            ["bash", "-c", script],
            cwd=folder,
            env=_environment(folder),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
    found = re.findall(rf"(.*?){_DONE} (\d+)\n", done.stdout.replace(ONCE, ""), re.DOTALL)
    assert len(found) == len(asked), done.stdout
    return [(e, printed, int(code)) for e, (printed, code) in zip(asked, found, strict=True)]


def agrees(shown: str, printed: str) -> bool:
    """Whether an output is as a page shows it."""
    return not shown or _same_lines(_plain(shown), _plain(printed))


def mended(page: str) -> str:
    """Return the page with the outputs that no longer agree replaced by what is printed now."""
    for example, printed, _ in reversed(run(page)):
        if not agrees(example.shown, printed):
            now = "\n".join(line.rstrip() for line in printed.strip("\n").splitlines()) + "\n"
            page = page[: example.start] + now + page[example.end :]
    return page


def _plain(text: str) -> list[str]:
    """Take out what only lays text out: empty lines, the widths of gaps and rules."""
    lines = (" ".join(re.sub(r"[─━]+", "─", line).split()) for line in text.splitlines())
    return [line for line in lines if line]


def _same_lines(shown: list[str], printed: list[str]) -> bool:
    if not shown or not printed:
        return not printed and all(line == "..." for line in shown)
    if shown[0] == "...":
        return _same_lines(shown[1:], printed) or _same_lines(shown, printed[1:])
    return _same_line(shown[0], printed[0]) and _same_lines(shown[1:], printed[1:])


def _same_line(shown: str, printed: str) -> bool:
    words = map(re.escape, _NUMBER.split(shown))
    pattern = f"({_NUMBER.pattern})".join(words).replace(r"\.\.\.", ".*?")
    found = re.fullmatch(pattern, printed)
    return found is not None and all(map(_close, _NUMBER.findall(shown), found.groups()))


def _close(shown: str, printed: str) -> bool:
    ours, theirs = float(shown), float(printed)
    last = 10.0 ** -len(shown.partition(".")[2]) if "." in shown else 0.0
    return abs(ours - theirs) <= max(TOLERANCE * abs(ours), 3.001 * last)


def _environment(folder: Path) -> dict[str, str]:
    hidden = ("LINES", "NO_COLOR", "FORCE_COLOR", "MAKEFLAGS")
    kept = {name: value for name, value in os.environ.items() if name not in hidden}
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"
    return kept | {"PATH": path, "COLUMNS": str(COLUMNS), "TERM": "dumb", "PWD": str(folder)}


def main() -> int:
    """Check the pages named, or mend them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--write", action="store_true", help="put in what is printed now")
    asked = parser.parse_args()
    stale = 0
    for path in asked.pages:
        page = path.read_text(encoding="utf-8")
        now = mended(page)
        stale += now != page
        if asked.write:
            path.write_text(now, encoding="utf-8")
        print(f"{path}: {'as printed' if now == page else 'differs'}")
    return int(stale > 0 and not asked.write)


if __name__ == "__main__":
    sys.exit(main())
