"""Which files of a folder are the pictures of a film, and their places in its series of numbers.

Hidden files, such as `._img_0001.png` and `.DS_Store` of macOS, are no pictures. Nor are the few
that are unlike the most: of another format, or named by another pattern. A folder with pictures of
several films or channels has no one order in time.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

from tetractl.core.errors import UsageError, printable

ODD_SHARE = 0.25  # greatest share of the files that are left out as unlike the others
SERIES_SHARE = 0.25  # least share of the steps of a series between which nothing is missing
LISTED = 3  # most names in a remark
TIMES_FILE = "times.csv"  # file of a folder that states the times of its pictures
SECONDS_END = 100  # above the seconds of a time of day, as HHMMSS
SECONDS_MOST = 60  # above the seconds of a minute
DIGITS = re.compile(r"\d+")
SAME = {"jpeg": "jpg", "tiff": "tif"}  # endings that name one format


def picture_names(names: Sequence[str], remarks: list[str]) -> list[str]:
    """Return the pictures among the files of these names, which are in the order of numbers; add
    lines to print.
    """
    chosen = [name for name in names if not name.startswith(".")]
    chosen = _alike(chosen, _format, "of another format than the others", remarks)
    return _alike(chosen, _pattern, "not named like the others", remarks)


def require_one_film(folder: Path, names: Sequence[str]) -> None:
    """Raise UsageError if names are of two formats or patterns, count two numbers, such as the time
    and the channel, or start again: these pictures are not one after the other.
    """
    odd = next((name for name in names if _kind(name) != _kind(names[0])), None)
    # each value of a number in the names occurs with each of another one
    counts = [len(set(column)) for column in _changing(names)]
    if odd is None and len(counts) > 1 and math.prod(counts) == len(names):
        odd = names[1]
    if odd is not None:
        raise UsageError(
            printable(f"{folder}: are {names[0]} and {odd} of one film, and one after the other?"),
            "give a folder with the pictures of one film and channel, or state the time of each in "
            f"{TIMES_FILE}",
        )
    if _starts_again(names):
        raise UsageError(
            printable(f"{folder}: the numbers in the names start again after {names[-1]}"),
            f"rename the pictures in their order, or state the time of each in {TIMES_FILE}",
        )


def _kind(name: str) -> tuple[str, str]:
    return _format(name), _pattern(name)


def _format(name: str) -> str:
    ending = name.rpartition(".")[2].lower()
    return SAME.get(ending, ending)


def _pattern(name: str) -> str:
    """Return a name with its numbers left out."""
    return DIGITS.sub("#", name.rpartition(".")[0])


def _alike(
    names: list[str], kind_of: Callable[[str], str], unlike: str, remarks: list[str]
) -> list[str]:
    """Return the names of the most frequent kind, if the others are few; say what is left out."""
    kinds = Counter(map(kind_of, names))
    if len(kinds) < 2:
        return names
    usual, _ = kinds.most_common(1)[0]
    odd = [name for name in names if kind_of(name) != usual]
    if len(odd) > ODD_SHARE * len(names):
        return names
    listed = ", ".join(odd[:LISTED])
    if len(odd) > LISTED:
        listed += ", ..."
    files = "1 file is" if len(odd) == 1 else f"{len(odd)} files are"
    remarks.append(f"{files} {unlike}, and left out: {listed}")
    return [name for name in names if kind_of(name) == usual]


def places_of(names: Sequence[str], remarks: list[str]) -> list[int] | None:
    """Return the places of files in the series of their numbers, from 0 on; None if they have no
    such series, or none is missing. All steps of a series are multiples of its own. Add lines to
    print.
    """
    numbers = _series(names, remarks)
    if numbers is None:
        return None
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
    gaps = [k for k, (before, after) in enumerate(pairwise(places)) if after > before + 1]
    if not gaps:
        return None
    if _are_times_of_day(numbers, gaps):
        remarks.append("the numbers in the names are times of day: times do not follow them")
        return None
    first = gaps[0]
    missing = places[-1] + 1 - len(places)
    are = "1 picture is" if missing == 1 else f"{missing} pictures are"
    remarks.append(
        f"by the numbers in the names, {are} missing, the first after {names[first]}: times follow "
        "the numbers"
    )
    return places


def _are_times_of_day(numbers: Sequence[int], gaps: Sequence[int]) -> bool:
    """Return whether numbers are times of day as HHMMSS: no seconds are above 59, and all gaps, at
    these places, are where a minute ends."""
    minutes = [number // SECONDS_END for number in numbers]
    ends_minute = all(minutes[k + 1] > minutes[k] for k in gaps)
    return ends_minute and all(number % SECONDS_END < SECONDS_MOST for number in numbers)


def _starts_again(names: Sequence[str]) -> bool:
    """Return whether the numbers of names have gone from their last, as 9999, to their first."""
    numbers = _series(names, [])
    if numbers is None or numbers[0] > 1:
        return False
    missing = numbers[-1] - numbers[0] + 1 - len(numbers)
    return missing > len(numbers) and set(str(numbers[-1])) == {"9"}


def _series(names: Sequence[str], remarks: list[str]) -> list[int] | None:
    """Return the one number that differs in the names, None if none does or several do."""
    differ = _changing(names)
    if len(differ) > 1:
        remarks.append("the names have several numbers that change: times do not follow them")
    if len(differ) != 1:
        return None
    numbers = differ[0]
    return numbers if all(a < b for a, b in pairwise(numbers)) else None


def _changing(names: Sequence[str]) -> list[list[int]]:
    """Return the numbers at each place of the names where they are not all the same; none if the
    names do not have equally many."""
    numbers = [DIGITS.findall(name.rpartition(".")[0]) for name in names]
    if len({len(digits) for digits in numbers}) != 1:
        return []
    columns = [list(map(int, column)) for column in zip(*numbers, strict=True)]
    return [column for column in columns if len(set(column)) > 1]
