"""The results of the newest images that a camera searched, and statistics of its stream. No I/O."""

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from tetractl.core.clock import SECOND
from tetractl.lab.camera_stream import RATE_MIN_HZ, compute_rate_hz

KEPT_SEARCHES = 20  # number of last pictures whose results are kept

S = TypeVar("S")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class PictureSearch(Generic[S]):
    """The search of one image for robots, with its time and its result.

    Attributes:
        number: Number of the image.
        received_ns: When the image arrived [ns].
        search_ns: Duration of the search [ns].
        result: What the search found.
    """

    number: int
    received_ns: int
    search_ns: int
    result: S


def drop_none(values: Iterable[T | None]) -> list[T]:
    """Return values without None, in their order."""
    return [value for value in values if value is not None]


def compute_median_search_ms(searches: Sequence[PictureSearch[Any]]) -> float:
    """Compute the median time that the search of one image took [ms], for one or more searches."""
    return statistics.median(search.search_ns for search in searches) / 1e6


def compute_image_rate_hz(searches: Sequence[PictureSearch[Any]]) -> float | None:
    """Compute the rate of images [Hz] from their numbers, including images that were not searched.

    The result is None if it is unknown.
    """
    received_ns = [search.received_ns for search in searches]
    return compute_rate_hz([search.number for search in searches], received_ns)


def describe_stream(
    searches: Sequence[PictureSearch[Any]],
    source: str,
    end_reason: str,
    now_ns: int,
    declared_hz: float | None,
    damaged: int,
) -> tuple[list[str], list[str]]:
    """Describe the problems and warnings of a stream of images for display.

    Args:
        searches: The searches of the newest images.
        source: Name of the source.
        end_reason: Why the source has ended. Empty if it has not.
        now_ns: The present time [ns].
        declared_hz: The source's declared rate [Hz]. None if unknown.
        damaged: Number of damaged images.

    Returns:
        The problems and the warnings.
    """
    problems: list[str] = []
    warnings: list[str] = []
    if end_reason:
        problems.append(end_reason)
    elif not searches or now_ns - searches[-1].received_ns > SECOND // 2:
        problems.append(f"no images come from {source} any more")
    rate = compute_image_rate_hz(searches)
    if rate is not None and declared_hz is not None and rate < 0.8 * declared_hz:
        warnings.append(
            f"only {rate:.0f} images per second come instead of {declared_hz:.0f}: is there too "
            "little light for short exposures, or is the cable too slow?"
        )
    elif rate is not None and rate < RATE_MIN_HZ:
        warnings.append(
            f"only {rate:.0f} images per second come, but at least {RATE_MIN_HZ:.0f} are needed"
        )
    came = searches[-1].number - searches[0].number + 1 if searches else 0
    if came > len(searches):
        warnings.append(
            f"{came - len(searches)} of the last {came} images were not searched, because "
            f"searching one takes {compute_median_search_ms(searches):.0f} ms"
        )
    if damaged:
        warnings.append(f"{damaged} images were damaged")
    return problems, warnings
