"""Which files of a folder are the pictures of a film, and their places in its series of numbers.

Hidden files, such as `._img_0001.png` and `.DS_Store` of macOS, are no pictures. Nor are the few
that are unlike the most: of another format, or named by another pattern.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

ODD_SHARE = 0.25  # greatest share of the files that are left out as unlike the others
SERIES_SHARE = 0.25  # least share of the steps of a series between which nothing is missing
LISTED = 3  # most names in a remark
DIGITS = re.compile(r"\d+")
SAME = {"jpeg": "jpg", "tiff": "tif"}  # endings that name one format


@dataclass(frozen=True, slots=True)
class PictureNames:
    """The names of a film's pictures in order, their `places` in the series of their numbers, from
    0 on, None if no number is missing or they are no series; and lines to print.
    """

    names: list[str]
    places: list[int] | None
    remarks: list[str]


def picture_names(names: Sequence[str]) -> PictureNames:
    """Return the pictures among the files of these names, which are in the order of numbers."""
    remarks: list[str] = []
    kept = [name for name in names if not name.startswith(".")]
    kept = _alike(kept, _format, "of another format than the others", remarks)
    kept = _alike(kept, _pattern, "not named like the others", remarks)
    places = _places(kept, remarks)
    return PictureNames(kept, places, remarks)


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
    listed = ", ".join(odd[:LISTED]) + ", ..." * (len(odd) > LISTED)
    files = "1 file is" if len(odd) == 1 else f"{len(odd)} files are"
    remarks.append(f"{files} {unlike}, and left out: {listed}")
    return [name for name in names if kind_of(name) == usual]


def _places(names: Sequence[str], remarks: list[str]) -> list[int] | None:
    """Return the places of files in the series of their numbers, None if they have no such series,
    or none is missing. All steps of a series are multiples of its own.
    """
    numbers = _series(names)
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
    missing = places[-1] + 1 - len(places)
    if not missing:
        return None
    first = next(k for k, (a, b) in enumerate(pairwise(places)) if b > a + 1)
    are = "1 picture is" if missing == 1 else f"{missing} pictures are"
    remarks.append(
        f"by the numbers in the names, {are} missing, the first after {names[first]}: times follow "
        "the numbers"
    )
    return places


def _series(names: Sequence[str]) -> list[int] | None:
    """Return the one number that differs in the names, None if none does or several do."""
    found = [DIGITS.findall(name.rpartition(".")[0]) for name in names]
    if len({len(digits) for digits in found}) != 1 or len(names) < 2:
        return None
    columns = list(zip(*found, strict=True))
    differ = [column for column in columns if len(set(map(int, column))) > 1]
    if len(differ) != 1:
        return None
    numbers = [int(digits) for digits in differ[0]]
    return numbers if all(a < b for a, b in pairwise(numbers)) else None
