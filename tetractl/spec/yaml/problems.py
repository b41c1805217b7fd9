"""The problems of a spec: one line each, with its location."""

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tetractl.core.errors import SpecError, printable

Loc = tuple[str | int, ...]
"""A location in a spec, as keys and list indices: ("robots", 0, "start")."""

SHOWN_PROBLEMS = 100
"""Maximum number of problems that an error lists."""
SHOWN_LENGTH = 60
"""Maximum number of characters of a value in a message."""
NEAR_FILES = 3
"""Maximum number of file names that are suggested for a missing file."""
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
    def location(self) -> str:
        """The location as `origin:line:column`, which editors and terminals can follow.

        It is only the origin if the line is unknown.
        """
        return self.origin if self.line is None else f"{self.origin}:{self.line}:{self.column}"

    def __str__(self) -> str:
        return ": ".join(filter(None, [self.location, self.field, self.value, self.message]))


class InvalidSpecError(SpecError):
    """A spec has problems. The message lists them, one per line.

    Attributes:
        problems: The problems, in the order of their lines.
    """

    def __init__(self, problems: Iterable[SpecProblem], hint: str | None = None) -> None:
        self.problems = tuple(sorted(problems, key=lambda p: (p.line is None, p.line, p.column)))
        lines = self.lines()
        super().__init__("\n".join(lines), hint)

    def __str__(self) -> str:
        lines = super().__str__().split("\n")
        return "\n".join(_in_python(line) for line in lines)

    def lines(self) -> list[str]:
        """Format the problems as one line each.

        If there are more than SHOWN_PROBLEMS, a last line says so.
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


def format_loc(loc: Loc) -> str:
    """Format a location as a path for `--set`, such as `robots.0.start`.

    The path is cut to 200 characters.
    """
    return printable(".".join(map(str, loc)), 200)


def suggest_similar(word: str, choices: Sequence[str]) -> str:
    """Suggest the choice that is most similar to a word, such as `; did you mean 'heading'?`.

    The result is "" if no choice is similar.
    """
    choice_by_lower = {choice.lower(): choice for choice in choices}
    searched = word[:SHOWN_LENGTH].lower().translate(MICRO)
    matches = difflib.get_close_matches(searched, choice_by_lower, n=1)
    return f"; did you mean '{choice_by_lower[matches[0]]}'?" if matches else ""


def suggest_files(path: Path) -> str:
    """Suggest specs with similar names in the folder of a missing spec.

    The result is like `; did you mean 'mine.yaml'?`, or empty if there is no similar name.
    """
    try:
        names = sorted(file.name for file in path.parent.iterdir() if file.suffix in SUFFIXES)
    except OSError:
        return ""
    matches = difflib.get_close_matches(path.name[:SHOWN_LENGTH], names, n=NEAR_FILES)
    quoted_names = [f"'{printable(name)}'" for name in matches]
    return f"; did you mean {' or '.join(quoted_names)}?" if quoted_names else ""
