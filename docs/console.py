"""Run the `console` blocks of Markdown pages, and tell or mend where their output has changed.

Run `python docs/console.py README.md docs/tutorial.md --write` to put in what the commands print
now; a test fails while a page differs from it.

The blocks of a page are run one after another in one empty folder that holds a copy of
`experiments/`, with the examples of the packages among them. A fence with `title=NAME` is a file
of that name there. Below a command stands what it prints, stdout and stderr together; without that,
it only has to succeed. `...` stands for what varies from run to run, such as a time: alone on a
line for any lines, within a line for anything there. Everything else is compared to the last digit.

A trial is the same on every x86-64 processor. But another version of a library, or another kind of
processor, may round differently, and a trial then goes another way: a search follows another
particle. So the last line of a page whose numbers come from trials says what they were printed on.
Anywhere else only nine in ten of the words, in their order, must come; `--write` there replaces
every output, so that all numbers of a page come from one place.
"""

import argparse
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import cache
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).parents[1]
COLUMNS = 90
ALIKE = 0.9  # share of the words shown that must come where numbers are others
ONCE = re.compile(r"^compil(ing for|ed in) .*\n", re.M)  # where the tests come before a run
_FENCE = re.compile(r"^```(\w*)[^\n]*?(?:title=(\S+))?\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_COMMAND = re.compile(r"^\$ ((?:.*\\\n)*.*)\n((?:(?!\$ ).*\n)*)", re.MULTILINE)
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_PRINTED_ON = re.compile(r"\n*<!-- numbers printed on (.*) -->\n*\Z")
_ROUNDING = ("numba", "llvmlite", "numpy", "scipy")  # whose versions may change a last digit
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


def run(page: str, programs_in: Path | None = None) -> list[tuple[Example, str, int]]:
    """Run a page's commands; return each with what it printed and its exit code.

    Args:
        page: The text of the page.
        programs_in: The folder of the programs of an environment without a checkout. Examples then
            come from `tetractl init --example`. None if the present environment is to be used.
    """
    asked = list(examples(page))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = _environment(folder, programs_in or Path(sys.executable).parent)
        if programs_in is not None:
            write_examples(page, folder, programs_in)
        else:
            for specs in (ROOT / "experiments", *ROOT.glob("packages/*/tetractl_*/examples")):
                shutil.copytree(specs, folder / "experiments", dirs_exist_ok=True)
        for fence in _FENCE.finditer(page):
            if fence[2]:
                (folder / fence[2]).write_text(fence[3], encoding="utf-8")
        ends = f'code=$?; echo "{_DONE} $code"; (exit $code)'  # so that `echo $?` tells it
        script = "\n".join(f"{example.command}\n{ends}" for example in asked)
        done = subprocess.run(
            ["bash", "-c", script],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
    found = re.findall(rf"(.*?){_DONE} (\d+)\n", ONCE.sub("", done.stdout), re.DOTALL)
    assert len(found) == len(asked), done.stdout
    return [(e, printed, int(code)) for e, (printed, code) in zip(asked, found, strict=True)]


@cache
def here() -> str:
    """Return what decides how numbers are rounded: kind of processor, and libraries."""
    versions = (f"{name} {metadata.version(name)}" for name in _ROUNDING)
    return ", ".join([platform.machine(), *versions])


def printed_on(page: str) -> str:
    """Return what the numbers of a page were printed on, "" where they are the same everywhere."""
    found = _PRINTED_ON.search(page)
    return found[1] if found else ""


def exact(page: str) -> bool:
    """Whether a page's numbers must be printed here to the last digit."""
    return printed_on(page) in ("", here())


def agrees(shown: str, printed: str, exact: bool) -> bool:
    """Whether an output is as a page shows it: `exact`, or most of its words."""
    if not shown:
        return True
    return _same_lines(_plain(shown), _plain(printed)) if exact else _like(shown, printed)


def _like(shown: str, printed: str) -> bool:
    ours, theirs = (re.findall(r"[^\W\d]+", text) for text in (shown, printed))
    matcher = SequenceMatcher(None, ours, theirs, autojunk=False)
    return sum(block.size for block in matcher.get_matching_blocks()) >= ALIKE * len(ours)


def mended(page: str) -> str:
    """Return the page with the outputs that no longer agree replaced by what is printed now.

    Where its numbers were printed elsewhere all are replaced: kept ones would be of another run
    than the new ones, and contradict them. `...` stays.
    """
    here_before, before = exact(page), page
    for example, printed, _ in reversed(run(page)):
        if example.shown and not (here_before and agrees(example.shown, printed, True)):
            now = _with_dots(example.shown.splitlines(), printed)
            page = page[: example.start] + now + page[example.end :]
    if page == before and here_before:
        return page
    return _PRINTED_ON.sub("", page).rstrip("\n") + f"\n\n<!-- numbers printed on {here()} -->\n"


def _with_dots(shown: list[str], printed: str) -> str:
    """Return what is printed with `...` where the page leaves lines or parts of lines out.

    The lines that the page shows between two `...` are found again in the printed ones by what
    they look like, apart from numbers. If one cannot be found, every printed line is returned.
    """
    lines = [line.rstrip() for line in printed.strip("\n").splitlines()]
    kept = _where_shown(shown, lines) if "..." in shown else None
    inside = [line for line in shown if "..." in line and line.strip() != "..."]
    parts = lines if kept is None else ["..." if row is None else lines[row] for row in kept]
    return "\n".join(_dotted(line, inside) for line in parts) + "\n"


def _where_shown(shown: list[str], lines: list[str]) -> list[int | None] | None:
    """Find the rows of `lines` that look like those of a page.

    Args:
        shown: The lines of the page, among them `...` for any number of lines.
        lines: The lines that a command printed.

    Returns:
        A row for each line of the page, and None for each `...`; or None if a line of the page
        looks like none that is left.
    """
    rows: list[int | None] = []
    row = 0
    for at, text in enumerate(shown):
        if text == "...":
            rows.append(None)
            continue
        after_dots = at > 0 and shown[at - 1] == "..."
        ends_the_page = after_dots and at + 1 == len(shown)
        pattern = _pattern(text)
        found = [i for i in range(row, len(lines)) if pattern.fullmatch(lines[i])]
        if not found or (not after_dots and found[0] != row):
            return None
        row = found[-1] if ends_the_page else found[0]
        rows.append(row)
        row += 1
    return rows


def _dotted(line: str, shown: list[str]) -> str:
    """Return a printed line with the `...` of the line of the page that looks like it."""
    for found in filter(None, (_pattern(other).fullmatch(line) for other in shown)):
        for i in range(found.re.groups, 0, -1):
            line = f"{line[: found.start(i)]}...{line[found.end(i) :]}"
        break
    return line


def _pattern(shown: str) -> re.Pattern[str]:
    """Return a pattern of the lines that look like one of a page, with a group for each `...`."""
    return re.compile("(.*?)".join(map(_loose, shown.rstrip().split("..."))))


def _loose(text: str) -> str:
    """Return a pattern, without groups, of texts that differ only in their numbers and gaps."""
    words = (re.sub(r"(\\ )+", r"\\s+", re.escape(word)) for word in _NUMBER.split(text))
    return _NUMBER.pattern.join(words)


def _plain(text: str) -> list[str]:
    """Take out what only lays text out: empty lines, the widths of gaps and rules."""
    lines = (" ".join(re.sub(r"[─━]+", "─", line).split()) for line in text.splitlines())
    return [line for line in lines if line]


def _same_lines(shown: list[str], printed: list[str]) -> bool:
    if not shown or not printed:
        return not printed and all(line == "..." for line in shown)
    if shown[0] == "...":
        return _same_lines(shown[1:], printed) or _same_lines(shown, printed[1:])
    pattern = re.escape(shown[0]).replace(r"\.\.\.", ".*?")
    same = re.fullmatch(pattern, printed[0]) is not None
    return same and _same_lines(shown[1:], printed[1:])


def write_examples(page: str, folder: Path, programs_in: Path) -> None:
    """Write the examples whose files a page names, by the `tetractl` in a folder of programs."""
    for name in sorted(set(re.findall(r"experiments/([\w/-]+)\.yaml", page))):
        command = [programs_in / "tetractl", "init", "--example", name]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)


def _environment(folder: Path, programs_in: Path) -> dict[str, str]:
    hidden = ("LINES", "NO_COLOR", "FORCE_COLOR", "MAKEFLAGS")
    kept = {name: value for name, value in os.environ.items() if name not in hidden}
    path = f"{programs_in}{os.pathsep}{os.environ.get('PATH', '')}"
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
