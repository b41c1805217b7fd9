"""The rows of text of one batch's description, which tables of any format show below its errors."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from tetractl.log.read.trial_log import Origin
from tetractl.results.describe import BatchStatistics, ScaledError
from tetractl.results.mean_difference import MeanDifference
from tetractl.results.open_batch import GIVEN_DIRECTIONS, directions_given
from tetractl.results.statistic_text import brief_text, full_text
from tetractl.tools.table.table import NONE, digits, lengths

PUBLISHED = "difference from published"
"""Label of the difference from the published result."""
TINY = 1e-6
"""Errors below this share of the arena are tiny, however many times the median they are."""


@dataclass(frozen=True, slots=True)
class BatchRow:
    """A row: `text` stands alone, `brief` next to those of other batches; if it is "", the row is
    left out there. A reader must see an `unusual` row; the others are shown with `--full` only.
    """

    label: str
    text: str
    unusual: bool
    brief: str


def batch_rows(group: BatchStatistics) -> list[BatchRow]:
    """Return the rows of a batch, in their order in a table."""
    return [
        *_plant(group),
        _usual("valid trials", f"{group.counted} of {len(group.batch.trials)}"),
        _tail(group),
        *(_with_others(group) if group.counted else ()),
        *_statistics(group),
        _count("earlier attempts, excluded", group.attempts),
        _count("logs that cannot be read", len(group.batch.lost)),
    ]


def texts_by_label(group: BatchStatistics) -> dict[str, str]:
    """Return the texts of the rows of a batch."""
    return {row.label: row.text for row in batch_rows(group)}


def _usual(label: str, text: str) -> BatchRow:
    return BatchRow(label, text, False, text)


def _unusual(label: str, text: str) -> BatchRow:
    return BatchRow(label, text, True, text)


def _count(label: str, count: int) -> BatchRow:
    """Return a row of what there should be none of."""
    return BatchRow(label, str(count), count > 0, str(count))


def _plant(group: BatchStatistics) -> Iterator[BatchRow]:
    """Yield what the trials were run on, and by what."""
    yield _usual("plant", str(group.origin))
    if directions_given(group.experiment):
        yield _unusual(GIVEN_DIRECTIONS, "no controller decided; not ranked with controllers")
    if group.origin is Origin.DISTURBED:
        # the title of several batches says so
        yield BatchRow("disturbances", "assumed in the spec, not measured", True, "")


def _tail(group: BatchStatistics) -> BatchRow:
    """Return how many errors are far above the others."""
    arena = group.experiment.arena
    tail = group.total.tail
    tiny = group.total.max < TINY * max(arena.width, arena.height)
    text = tail.text(group.unit)
    return BatchRow(tail.label, text, tail.above > 0 and not tiny, text)


def _with_others(group: BatchStatistics) -> Iterator[BatchRow]:
    """Yield how the errors compare with those published and of robots of another kind."""
    if group.from_published is not None:
        yield _usual(PUBLISHED, published_text(group.from_published, group))
    if group.scaled is not None:
        yield from _scaled(group.scaled)


def published_text(difference: MeanDifference, group: BatchStatistics) -> str:
    """Return the difference of a batch's mean error from the published one as text."""
    if not group.origin.comparable:
        return f"{NONE} (not real robots)"
    text = difference.text(group.unit, lengths(difference.value), difference.p_value)
    return f"{text} (Welch's t)"


def _scaled(scaled: ScaledError) -> Iterator[BatchRow]:
    """Yield the error of a robot of another kind, and the published one."""
    scale = scaled.scale
    show = lengths(scaled.mean)
    yield _usual(f"robot error scaled to {scale.name} [{scale.unit}]", show(scaled.mean))
    yield _usual(f"  its 95 % interval [{scale.unit}]", scaled.ci95.text(show))
    yield _usual("  in body lengths", digits(scaled.body_lengths))
    published = scaled.published_mean
    if math.isfinite(published):
        bodies = digits(scaled.published_body_lengths)
        text = f"{lengths(published)(published)} ({bodies} body lengths)"
        yield _usual(f"  published error scaled [{scale.unit}]", text)


def _statistics(group: BatchStatistics) -> Iterator[BatchRow]:
    for value in group.values:
        if value.label:
            text = full_text(value.number)
            yield BatchRow(value.label, text, value.unusual, brief_text(value.number))
