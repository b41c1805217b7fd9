"""A paper to reproduce: its claims, and the trials that are needed to check them.

An *arm* is a named group of trials with the same conditions: a batch of a shipped spec with
replaced values (`Runs`), or n results of a function (`Work`). The claims are a table of
`claim.Claim`, which `claim.assess` judges.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from tetractl.tools.table.table import Table, create_length_format
from tetractl_papers.claim import Claim, NumberKind, OurNumber, Row


@dataclass(frozen=True, slots=True)
class Runs:
    """An arm: trials of a shipped spec with replaced values.

    Attributes:
        example: Name of the shipped spec.
        sets: Settings that replace values, such as "controller.period=0.1".
        trials: Number of trials.
        plan_of: Name of an arm. All trials send, open loop, the plan of step 0 of that arm's first
            trial. None for closed-loop trials.
        plans_of: Name of an arm. Each trial sends, open loop, the plan of step 0 of one of that
            arm's trials. None for closed-loop trials.
    """

    example: str
    sets: tuple[str, ...] = ()
    trials: int = 20
    plan_of: str | None = None
    plans_of: str | None = None


@dataclass(frozen=True, slots=True)
class Work:
    """An arm that is computed by a function instead of running a spec.

    Attributes:
        once: Called with the root seed and an index from 0. Returns values that JSON can represent.
        trials: How many times it is called.
    """

    once: Callable[[int, int], dict[str, Any]]
    trials: int = 20


@dataclass(frozen=True, slots=True)
class Paper:
    """A paper that can be reproduced.

    Attributes:
        source: Its reference.
        arms: Its arms by name, in the order in which they are run.
        claims: Its claims.
    """

    source: str
    arms: Mapping[str, Runs | Work]
    claims: Sequence[Claim]


def table(name: str, source: str, rows: Sequence[Row]) -> Table:
    """Create the table of a paper's judged claims.

    Args:
        name: Name of the paper.
        source: Its reference.
        rows: The claims with our numbers and verdicts.
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
    """Format our number with its unit, or as "k of n" if it is a fraction of trials.

    NaN is shown as "unknown". The two means of a difference follow in brackets.
    """
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
    """Format a number with the digits that suit its size."""
    return create_length_format(value)(value)


def _interval(number: OurNumber) -> str:
    """Format the interval of our number, in percent if it is a fraction of trials.

    The text is "none" if the interval is unknown or a point.
    """
    if number.kind is NumberKind.SHARE:
        return f"{100 * number.low:.0f} to {100 * number.high:.0f} %"
    if math.isnan(number.low) or number.low == number.high:
        return "none"
    show = create_length_format(number.value)
    return f"{show(number.low)} to {show(number.high)}"


def items(row: Row) -> dict[str, Any]:
    """Return a judged claim as a JSON object.

    Returns:
        The keys "figure", "published", "asked", "unit", the fields of `OurNumber`, "verdict",
        "expected" and "why".
    """
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
