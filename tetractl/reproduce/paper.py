"""A paper to reproduce: the trials that it needs, and its claims, assessed on these trials.

The arms of a paper are batches of shipped specs with values replaced (`Runs`), or what a function
computes (`Work`). Its claims are a table of `claim.Claim`, whose verdicts `claim.assess` gives.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from tetractl.core.table.table import Table, lengths
from tetractl.reproduce.claim import Claim, NumberKind, Row


@dataclass(frozen=True, slots=True)
class Runs:
    """Trials of a shipped spec with values replaced.

    With `plan_of`, all trials send, open loop, the plan of step 0 of the first trial of that arm;
    with `plans_of`, each trial sends that of another trial.
    """

    example: str
    sets: tuple[str, ...] = ()
    trials: int = 20
    plan_of: str | None = None
    plans_of: str | None = None


@dataclass(frozen=True, slots=True)
class Work:
    """What is computed n times and is no trial of a spec: `once` is called with the root seed and a
    number from 0 on, and returns what JSON can hold."""

    once: Callable[[int, int], dict[str, Any]]
    trials: int = 20


@dataclass(frozen=True, slots=True)
class Paper:
    """A paper: its source, its arms by name, in the order in which they are run, and its claims."""

    source: str
    arms: Mapping[str, Runs | Work]
    claims: Sequence[Claim]


def table(name: str, source: str, rows: Sequence[Row]) -> Table:
    """Return the table of a paper's claims."""
    header = ("figure", "published", "asked", "ours", "n", "95 % interval", "verdict", "why")
    return Table.of_texts(f"{name}: {source}", header, [_texts(row) for row in rows])


def _texts(row: Row) -> tuple[str, ...]:
    """Return the cells of a row."""
    claim = row.claim
    return (
        claim.figure,
        claim.published,
        claim.asked.words,
        _number(row),
        str(row.found.n),
        _interval(row),
        row.verdict,
        claim.why,
    )


def _number(row: Row) -> str:
    """Return our number as text."""
    found = row.found
    count = f"{round(found.value * found.n)} of {found.n}"
    match found.kind:
        case NumberKind.SHARE:
            return count
        case NumberKind.RUNS:
            return f"{count} runs as large"
    text = f"{lengths(found.value)(found.value)} {row.claim.unit}".strip()
    if found.means is None:
        return text
    ours, other = (lengths(mean)(mean) for mean in found.means)
    return f"{text} ({ours} and {other})"


def _interval(row: Row) -> str:
    """Return the interval of our number as text."""
    found = row.found
    if found.kind is NumberKind.SHARE:
        return f"{100 * found.low:.0f} to {100 * found.high:.0f} %"
    if found.kind is NumberKind.RUNS:
        show = lengths(found.high)
        return f"runs: {show(found.low)} to {show(found.high)} {row.claim.unit}"
    if found.low == found.high:
        return "none"
    show = lengths(found.value)
    return f"{show(found.low)} to {show(found.high)}"


def items(row: Row) -> dict[str, Any]:
    """Return the items of JSON that describe a row."""
    claim = row.claim
    return {
        "figure": claim.figure,
        "published": claim.published,
        "asked": claim.asked.words,
        "unit": claim.unit,
        **asdict(row.found),
        "verdict": row.verdict,
        "expected": claim.expected,
        "why": claim.why,
    }
