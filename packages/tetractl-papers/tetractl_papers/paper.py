"""A published paper to reproduce: its claims, and the trials that are needed to check them.

An *arm* is a named group of trials with the same conditions: a batch of a shipped spec with
replaced values (`Runs`), or n results of a function (`Work`). Each claim is a `claim.Claim`, which
`claim.assess` judges.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from tetractl.tools.table.table import Table, create_length_format
from tetractl_papers.claim import AssessedClaim, Claim, NumberKind, OurNumber


@dataclass(frozen=True, slots=True)
class Runs:
    """An arm of a paper: trials of a shipped spec with replaced values.

    Attributes:
        example: Name of the shipped spec.
        sets: Settings that replace values of the spec, such as "controller.period=0.1".
        trials: Number of trials.
        plan_of: Name of another arm. All trials send, in open loop, the plan of step 0 of that
            arm's first trial. None for closed-loop trials.
        plans_of: Name of another arm. Each trial sends, in open loop, the plan of step 0 of one of
            that arm's trials. None for closed-loop trials.
    """

    example: str
    sets: tuple[str, ...] = ()
    trials: int = 20
    plan_of: str | None = None
    plans_of: str | None = None


@dataclass(frozen=True, slots=True)
class Work:
    """An arm of a paper: results of a function instead of trials of a spec.

    Attributes:
        once: Function that computes one result from the root seed and an index from 0. The result
            must contain only values that JSON can represent.
        trials: Number of times that the function is called.
    """

    once: Callable[[int, int], dict[str, Any]]
    trials: int = 20


@dataclass(frozen=True, slots=True)
class Paper:
    """A published paper that `tetractl reproduce` can reproduce.

    Attributes:
        source: Reference of the paper.
        arms: Groups of trials by name, in the order in which they are run.
        claims: The claims of the paper, each with the arm that checks it.
    """

    source: str
    arms: Mapping[str, Runs | Work]
    claims: Sequence[Claim]


def create_claims_table(name: str, source: str, rows: Sequence[AssessedClaim]) -> Table:
    """Create the table that shows the claims of a paper next to our numbers and the verdicts.

    Args:
        name: Name of the paper.
        source: Reference of the paper.
        rows: The claims with our numbers and verdicts.
    """
    header = ("figure", "published", "asked", "ours", "n", "95 % interval", "verdict", "why")
    table_rows = []
    for row in rows:
        claim = row.claim
        cells = (
            claim.figure,
            claim.published,
            claim.asked.words,
            _format_number(row.ours, claim.unit),
            str(row.ours.n),
            _format_interval(row.ours),
            row.verdict,
            claim.why,
        )
        table_rows.append(cells)
    return Table.of_texts(f"{name}: {source}", header, table_rows)


def _format_number(number: OurNumber, unit: str) -> str:
    """Format a number from our trials with its unit, or as "k of n" if it is a fraction of trials.

    NaN is shown as "unknown". The two means of a difference follow in brackets.
    """
    if number.kind is NumberKind.SHARE:
        return f"{round(number.value * number.n)} of {number.n}"
    if math.isnan(number.value):  # the deviation of a single trial
        return "unknown"
    text = f"{_format_value(number.value)} {unit}".strip()
    if number.means is None:
        return text
    ours, subtracted = number.means
    return f"{text} ({_format_value(ours)} and {_format_value(subtracted)})"


def _format_value(value: float) -> str:
    """Format a number with a precision that suits its size."""
    return create_length_format(value)(value)


def _format_interval(number: OurNumber) -> str:
    """Format the 95 % interval of a number from our trials, in percent for a fraction of trials.

    The result is "none" if the interval is unknown or a point.
    """
    if number.kind is NumberKind.SHARE:
        return f"{100 * number.low:.0f} to {100 * number.high:.0f} %"
    if math.isnan(number.low) or number.low == number.high:
        return "none"
    format_bound = create_length_format(number.value)
    return f"{format_bound(number.low)} to {format_bound(number.high)}"


def convert_to_json(row: AssessedClaim) -> dict[str, Any]:
    """Convert a judged claim to a JSON object.

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
