"""The problems of a spec: one line each, with its location."""

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tetractl.core.errors import SpecError, printable

Loc = tuple[str | int, ...]
"""A location in a spec, as keys and list indices: ("robots", 0, "start")."""

SHOWN_PROBLEMS = 100
SHOWN_LENGTH = 60
NEAR_FILES = 3  # file names suggested in the place of a missing one
SUFFIXES = (".yaml", ".yml")
MICRO = str.maketrans({"\N{MICRO SIGN}": "u", "\N{GREEK SMALL LETTER MU}": "u"})  # both read as u


@dataclass(frozen=True, slots=True)
class SpecProblem:
    """One problem of a spec, to be fixed by its author.

    Attributes:
        origin: The spec's file name, or `--set PATH=VALUE` for a value from that option.
        message: What is wrong.
        line: The line, from 1. None if unknown.
        column: The column, from 1. None if unknown.
        field: Path of the field.
        value: The value as written. None if unknown.
    """

    origin: str
    message: str
    line: int | None = None
    column: int | None = None
    field: str = ""
    value: str | None = None

    @property
    def where(self) -> str:
        """The location as `origin:line:column`, which editors and terminals can follow.

        It is only the origin if the line is unknown.
        """
        return self.origin if self.line is None else f"{self.origin}:{self.line}:{self.column}"

    def __str__(self) -> str:
        return ": ".join(filter(None, [self.where, self.field, self.value, self.message]))


class InvalidSpecError(SpecError):
    """An error: a spec has problems.

    The message lists them, one per line, and `problems` contains them.
    """

    def __init__(self, problems: Iterable[SpecProblem], hint: str | None = None) -> None:
        self.problems = tuple(sorted(problems, key=lambda p: (p.line is None, p.line, p.column)))
        lines = self.lines()
        super().__init__("\n".join(lines), hint)

    def __str__(self) -> str:
        lines = super().__str__().split("\n")
        return "\n".join(_in_python(line) for line in lines)

    def lines(self) -> list[str]:
        """Return one line per problem.

        After SHOWN_PROBLEMS of them, one line says that there are more.
        """
        lines = [str(problem) for problem in self.problems[:SHOWN_PROBLEMS]]
        if len(self.problems) > SHOWN_PROBLEMS:
            lines.append(f"{self.problems[0].origin}: there are more problems; correct these first")
        return lines


def _in_python(line: str) -> str:
    """Adapt the line of a problem for Python, where a setting is an argument of `load_spec`.

    A line about `--set` then starts with "setting". Other lines stay the same.
    """
    setting = line.removeprefix("--set ")
    return line if setting == line else f"setting {setting}"


def dotted(loc: Loc) -> str:
    """Return a location as a path for `--set`, such as `robots.0.start`, cut to 200 characters."""
    return printable(".".join(map(str, loc)), 200)


def did_you_mean(word: str, choices: Sequence[str]) -> str:
    """Return a suggestion, such as `; did you mean 'heading'?`, or "" if no choice is close."""
    lower = {choice.lower(): choice for choice in choices}
    plain = word[:SHOWN_LENGTH].lower().translate(MICRO)
    close = difflib.get_close_matches(plain, lower, n=1)
    return f"; did you mean '{lower[close[0]]}'?" if close else ""


def near_files(path: Path) -> str:
    """Suggest specs in the folder of a missing one with similar names.

    The text is like `; did you mean 'mine.yaml'?`, or empty if there is no similar name.
    """
    try:
        names = sorted(file.name for file in path.parent.iterdir() if file.suffix in SUFFIXES)
    except OSError:
        return ""
    close = difflib.get_close_matches(path.name[:SHOWN_LENGTH], names, n=NEAR_FILES)
    texts = [f"'{printable(name)}'" for name in close]
    return f"; did you mean {' or '.join(texts)}?" if texts else ""
