"""A paper to reproduce: the trials that it needs, and its claims, assessed on these trials.

The arms of a paper are batches of shipped specs with values replaced (`Runs`), or what a function
computes (`Work`). Its claims are a table of `claim.Claim`, whose verdicts `claim.assess` gives.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from tetractl.tools.table.table import Table, lengths
from tetractl_papers.claim import Claim, NumberKind, OurNumber, Row


@dataclass(frozen=True, slots=True)
class Runs:
    """Trials of a shipped spec with values replaced.

    Attributes:
        example: Name of the spec.
        sets: The replaced values, as for `--set`.
        trials: Number of trials.
        plan_of: An arm. All trials send, open loop, the plan of step 0 of its first trial. None for
            none.
        plans_of: An arm. Each trial sends, open loop, the plan of step 0 of another trial of it.
            None for none.
    """

    example: str
    sets: tuple[str, ...] = ()
    trials: int = 20
    plan_of: str | None = None
    plans_of: str | None = None


@dataclass(frozen=True, slots=True)
class Work:
    """Something that is computed n times and is not a trial of a spec.

    `once` is called with the root seed and a number from 0, and returns what JSON can hold.
    """

    once: Callable[[int, int], dict[str, Any]]
    trials: int = 20


@dataclass(frozen=True, slots=True)
class Paper:
    """A paper: its source, its arms by name, in the order in which they are run, and its claims."""

    source: str
    arms: Mapping[str, Runs | Work]
    claims: Sequence[Claim]


def table(name: str, source: str, rows: Sequence[Row]) -> Table:
    """Return the table of a paper's claims.

    Args:
        name: Name of the paper.
        source: Its reference.
        rows: The claims.
    """
    header = ("figure", "published", "asked", "ours", "n", "95 % interval", "verdict", "why")
    texts = []
    for row in rows:
        claim = row.claim
        cells = (
            claim.figure,
            claim.published,
            claim.asked.words,
            _number(row.ours, claim.unit),
            str(row.ours.n),
            _interval(row.ours),
            row.verdict,
            claim.why,
        )
        texts.append(cells)
    return Table.of_texts(f"{name}: {source}", header, texts)


def _number(number: OurNumber, unit: str) -> str:
    """Return our number as text."""
    if number.kind is NumberKind.SHARE:
        return f"{round(number.value * number.n)} of {number.n}"
    if math.isnan(number.value):  # the deviation of a single trial
        return "unknown"
    text = f"{_length(number.value)} {unit}".strip()
    if number.means is None:
        return text
    ours, subtracted = number.means
    return f"{text} ({_length(ours)} and {_length(subtracted)})"


def _length(value: float) -> str:
    """Return a length with the digits that suit it."""
    return lengths(value)(value)


def _interval(number: OurNumber) -> str:
    """Return the interval of our number as text."""
    if number.kind is NumberKind.SHARE:
        return f"{100 * number.low:.0f} to {100 * number.high:.0f} %"
    if math.isnan(number.low) or number.low == number.high:
        return "none"
    show = lengths(number.value)
    return f"{show(number.low)} to {show(number.high)}"


def items(row: Row) -> dict[str, Any]:
    """Return the items of JSON that describe a row."""
    claim = row.claim
    return {
        "figure": claim.figure,
        "published": claim.published,
        "asked": claim.asked.words,
        "unit": claim.unit,
        **asdict(row.ours),
        "verdict": row.verdict,
        "expected": claim.expected,
        "why": claim.why,
    }
