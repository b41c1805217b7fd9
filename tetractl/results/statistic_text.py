"""Makes text and JSON of the values of statistics; tables of every format are made of this text."""

from collections.abc import Iterable
from typing import Any

from tetractl.core.plan import Outcome
from tetractl.results.estimate import percent
from tetractl.results.statistic_value import (
    AboveBound,
    Count,
    Mean,
    Number,
    OutcomeCounts,
    Scalar,
    Share,
    StatisticValue,
    Unknown,
    Worded,
)
from tetractl.tools.table.table import NONE, lengths


def full_text(number: Number) -> str:
    """Return a number as text, with its interval."""
    match number:
        case Count(value):
            return str(value)
        case Share():
            return _share(number)
        case Mean():
            return _mean(number)
        case Scalar():
            return _scalar(number)
        case OutcomeCounts(counts):
            return "; ".join(f"{n} {way.value} ({way.meaning})" for way, n in counts.most_common())
        case AboveBound(tail):
            return tail.text()
        case Worded(_, text):
            return text
        case Unknown(reason):
            return f"{NONE} ({reason})" if reason else NONE


def brief_text(number: Number) -> str:
    """Return a number as text that has room next to the same number of other batches."""
    match number:
        case Share(counting=counting) if counting:
            return f"{count_text(number)} ({counting})"
        case OutcomeCounts(counts):
            return ", ".join(f"{n} {way.value}" for way, n in counts.most_common())
        case _:
            return full_text(number)


def count_text(number: Share) -> str:
    """Return how many trials of how many, such as "3 of 20"."""
    return f"{number.count} of {number.n}"


def _share(number: Share) -> str:
    counting = f", counting {number.counting}" if number.counting else ""
    return f"{count_text(number)}{percent(number.ci95)}{counting}"


def _mean(number: Mean) -> str:
    values = number.distribution
    show = lengths(values.mean)
    n = f"n {values.n}, " if number.states_n else ""
    return f"{show(values.mean)} ({n}95 % interval {values.ci95.text(show)})"


def _scalar(number: Scalar) -> str:
    if number.value is None:
        return NONE
    text = number.show(number.value)
    return text if number.n is None else f"{text} (n {number.n})"


def json_items(values: Iterable[StatisticValue]) -> dict[str, Any]:
    """Return the items of a JSON object for values of statistics, in their order."""
    items: dict[str, Any] = {}
    for value in values:
        holder = items.setdefault(value.within, {}) if value.within else items
        holder |= _items(value.key, value.number)
    return items


def _items(key: str, number: Number) -> dict[str, Any]:
    """Return the items of one number."""
    match number:
        case Share(count):
            return {key: count, f"{key}_ci95": number.ci95.ends}
        case Mean(distribution):
            return {key: distribution.as_dict()}
        case OutcomeCounts(counts):
            return {key: {way.value: counts[way] for way in Outcome}}
        case Count(value) | Scalar(value) | Worded(value):
            return {key: value}
        case Unknown():
            return {key: None}
        case AboveBound():
            return {}
