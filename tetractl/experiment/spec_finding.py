"""What a rule finds in a spec: where it is, in which words, and whether it is an error.

Two lists of rules make findings. `tetractl.experiment.consistency` finds errors: a spec with one is
refused when it is loaded. `tetractl.run.plausibility` finds warnings, in specs without errors.
"""

from dataclasses import dataclass
from enum import StrEnum

from tetractl.experiment.yaml.problems import Loc


class Severity(StrEnum):
    """Whether a spec can be run nevertheless."""

    ERROR = "error"
    WARNING = "warning"


@dataclass(frozen=True, slots=True)
class SpecFinding:
    """One thing that is wrong with a spec, at the location `where`.

    `text` goes on after the name and the value of the field at that location: "is outside the
    arena". `hint` says what to do; an error says that in its text.
    """

    where: Loc
    text: str
    severity: Severity
    hint: str = ""


def error(where: Loc, text: str) -> SpecFinding:
    """Return a finding for which a spec is refused."""
    return SpecFinding(where, text, Severity.ERROR)


def warning(where: Loc, text: str, hint: str) -> SpecFinding:
    """Return a finding for which a spec is not refused."""
    return SpecFinding(where, text, Severity.WARNING, hint)
