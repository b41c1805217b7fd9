"""The places of a folder's pictures in the series of the numbers in their names.

A folder with pictures of several films or channels has no one order in time, and is refused.
"""

import math
import re
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from tetractl.core.errors import UsageError, printable

SERIES_SHARE = 0.25  # least share of the steps of a series between which nothing is missing
TIMES_FILE = "times.csv"  # file of a folder that states the times of its pictures
DIGITS = re.compile(r"\d+")
SAME = {"jpeg": "jpg", "tiff": "tif"}  # endings that name one format


def require_one_film(folder: Path, names: Sequence[str]) -> None:
    """Raise UsageError if names are of two formats or patterns, or count two numbers, such as the
    time and the channel: these pictures are not one after the other.
    """
    kinds = [_kind(name) for name in names]
    usual, _ = Counter(kinds).most_common(1)[0]
    odd = next((name for name, kind in zip(names, kinds, strict=True) if kind != usual), None)
    # each value of a number in the names occurs with each of another one
    counts = [len(set(column)) for column in _changing(names)]
    if odd is None and len(counts) > 1 and math.prod(counts) == len(names):
        odd = names[1]
    if odd is not None:
        like_most = next(name for name in names if name != odd and _kind(name) == usual)
        raise UsageError(
            printable(f"{folder}: are {like_most} and {odd} of one film, and one after the other?"),
            "give a folder with the pictures of one film and channel, or state the time of each in "
            f"{TIMES_FILE}",
        )


def places_of(folder: Path, names: Sequence[str], remarks: list[str]) -> list[int] | None:
    """Return the places of files in the series of their numbers, from 0 on; None if they have no
    such series, or none is missing. All steps of a series are multiples of its own. Add lines to
    print. UsageError if more are missing than there are: the numbers may have started again.
    """
    columns = _changing(names)
    if len(columns) > 1:
        remarks.append("the names have several numbers that change: times do not follow them")
    if len(columns) != 1:
        return None
    (numbers,) = columns
    steps = [after - before for before, after in pairwise(numbers)]
    step = math.gcd(*steps)
    if steps.count(step) < SERIES_SHARE * len(steps):
        remarks.append("the numbers in the names are no even series: times do not follow them")
        return None
    if step > 1:
        remarks.append(
            f"the numbers in the names go up by {step}: pictures are taken as one period apart"
        )
    places = [(number - numbers[0]) // step for number in numbers]
    missing = places[-1] + 1 - len(places)
    if not missing:
        return None
    gap = next(k for k, (before, after) in enumerate(pairwise(places)) if after > before + 1)
    are = "1 picture is" if missing == 1 else f"{missing} pictures are"
    said = f"by the numbers in the names, {are} missing, the first after {names[gap]}"
    if missing > len(names):
        raise UsageError(
            printable(f"{folder}: {said}: have the numbers started again?"),
            f"rename the pictures in their order, or state the time of each in {TIMES_FILE}",
        )
    remarks.append(f"{said}: times follow the numbers")
    return places


def _kind(name: str) -> tuple[str, str]:
    """Return the format of a file by its name, and the name with its numbers left out."""
    stem, _, ending = name.lower().rpartition(".")
    return SAME.get(ending, ending), DIGITS.sub("#", stem)


def _changing(names: Sequence[str]) -> list[list[int]]:
    """Return the numbers at each place of the names where they are not all the same; none if the
    names do not have equally many."""
    numbers = [DIGITS.findall(name.rpartition(".")[0]) for name in names]
    if len({len(digits) for digits in numbers}) != 1:
        return []
    columns = [list(map(int, column)) for column in zip(*numbers, strict=True)]
    return [column for column in columns if len(set(column)) > 1]
