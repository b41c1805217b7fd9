"""How well a tracker's rows agree with the truth of a film. Shares no code with any tracker."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from .truth import VIEW_UM, FilmTruth

REACH_UM = 25.0  # a cell is found by a row within half a body of it
APART_UM = 60.0  # positions and axes count where no other cell is nearer than this
TOGETHER_UM = 40.0  # bodies nearer than this are one blob: their names do not count
LASTS_S = 0.5  # a wrong name that is borne for as long as this, or to its end, lasts
LONG_S = 2.0  # least duration of a track whose numbers are scored


@dataclass(slots=True)
class Shown:
    """What a tracker says: rows (R,) in order of `frame`, with integer `name`, x, y [um],
    heading [rad] (NaN where not said) and whether the name is said to be sure. `numbers` holds for
    each name intervals of the `speed` and of `a` (low, high), where said.
    """

    frame: np.ndarray
    name: np.ndarray
    x: np.ndarray
    y: np.ndarray
    heading: np.ndarray
    sure: np.ndarray
    numbers: dict[int, dict[str, tuple[float, float]]] = field(default_factory=dict)

    @classmethod
    def of(cls, followed: Any) -> "Shown":
        """Return what paths say: each has an `identity`, and `sightings` in some `frames`."""
        rows = [
            (frame, path.identity, c.x, c.y, c.heading, c.sure)
            for path in followed.paths
            for frame, c in zip(path.frames.tolist(), path.sightings, strict=True)
        ]
        table = np.array(sorted(rows), float).reshape(-1, 6)
        frame = table[:, 0].astype(int)
        name = table[:, 1].astype(int)
        return cls(frame, name, *table[:, 2:5].T, table[:, 5] > 0)


@dataclass(slots=True)
class FilmScore:
    """Sums over one film, which may be added over films.

    `wrong` says of each wrong name that lasts whether it is called sure, in most of its rows.
    `right` counts the rows of the cell that the name had at first, `covered` those called sure;
    `a` and `speed` say of each interval whether it holds the truth, `strangers` of each of a
    stranger's a whether it leaves out 0.
    """

    film: str = ""
    found: int = 0
    missed: int = 0
    extra: int = 0
    near: int = 0
    place2: float = 0.0
    heading2: float = 0.0
    headings: int = 0
    named: int = 0
    hours: float = 0.0
    wrong: list[bool] = field(default_factory=list)
    right: int = 0
    covered: int = 0
    a: list[bool] = field(default_factory=list)
    speed: list[bool] = field(default_factory=list)
    strangers: list[bool] = field(default_factory=list)

    @property
    def f1(self) -> float:
        return 2 * self.found / max(2 * self.found + self.missed + self.extra, 1)


def score_film(name: str, truth: FilmTruth, tracked: Shown) -> FilmScore:
    """Return how well a film's rows agree with its truth."""
    owner = owners(truth, tracked)
    view = truth.view
    nearest = _nearest(truth)
    score = FilmScore(name)
    true = owner >= 0
    inside = np.zeros(len(owner), bool)
    inside[true] = view[tracked.frame[true], owner[true]]
    span = truth.um_px * truth.side_px - VIEW_UM
    within = (np.minimum(tracked.x, tracked.y) > VIEW_UM) & (
        np.maximum(tracked.x, tracked.y) < span
    )
    score.found = int(inside.sum())
    score.missed = int(view.sum()) - score.found
    score.extra = int((~true & within).sum())
    score.hours = float(view.sum()) * (truth.times[1] - truth.times[0]) / 3600
    rows = np.flatnonzero(inside)
    gaps_um = nearest[tracked.frame[rows], owner[rows]]
    is_apart = gaps_um > APART_UM
    apart = rows[is_apart]
    _errors(score, truth, tracked, owner, apart)
    score.named = _named(tracked, owner, inside)
    is_free = gaps_um > TOGETHER_UM
    free = rows[is_free]
    score.wrong = _wrong(truth, tracked, owner, free)
    first: dict[int, int] = {}  # the cell of each name's first true row
    for name, cell in zip(tracked.name[true].tolist(), owner[true].tolist(), strict=True):
        first.setdefault(name, cell)
    right = true & (owner == np.array([first.get(name, -1) for name in tracked.name.tolist()]))
    score.right = int(right.sum())
    score.covered = int((right & tracked.sure).sum())
    _intervals(score, truth, tracked, owner)
    return score


def owners(truth: FilmTruth, tracked: Shown) -> np.ndarray:
    """Return the individual that each row shows, or -1: the nearest assignment within REACH_UM,
    where a name that was an individual's in the picture before stays so within reach.
    """
    owner = np.full(len(tracked.frame), -1)
    last: dict[int, int] = {}
    starts = np.searchsorted(tracked.frame, np.arange(len(truth.times) + 1))
    for k, (first, end) in enumerate(pairwise(starts.tolist())):
        present = np.flatnonzero(np.isfinite(truth.x[k]))
        if first == end or not len(present):
            continue
        gaps = np.hypot(
            truth.x[k, present][:, None] - tracked.x[None, first:end],
            truth.y[k, present][:, None] - tracked.y[None, first:end],
        )
        cost = np.where(gaps < REACH_UM, gaps - 1e4, 0.0)
        place = {int(i): column for column, i in enumerate(present)}
        for j in range(end - first):
            i = place.get(last.get(int(tracked.name[first + j]), -1))
            if i is not None and gaps[i, j] < REACH_UM:
                cost[i, j] -= 1e3
        for i, j in zip(*linear_sum_assignment(cost), strict=True):
            if gaps[i, j] < REACH_UM:
                owner[first + j] = present[i]
                last[int(tracked.name[first + j])] = int(present[i])
    return owner


def _nearest(truth: FilmTruth) -> np.ndarray:
    """Return the distance of each individual's nearest neighbour (K, M) [um]."""
    nearest_um = np.full(truth.x.shape, np.inf)
    for k in range(len(truth.times)):
        present = np.flatnonzero(np.isfinite(truth.x[k]))
        x = truth.x[k, present]
        y = truth.y[k, present]
        gaps = np.hypot(x[:, None] - x, y[:, None] - y)
        np.fill_diagonal(gaps, np.inf)
        nearest_um[k, present] = gaps.min(axis=1, initial=np.inf)
    return nearest_um


def _errors(score: FilmScore, truth: FilmTruth, tracked: Shown, owner, rows) -> None:
    k = tracked.frame[rows]
    i = owner[rows]
    dx = tracked.x[rows] - truth.x[k, i]
    dy = tracked.y[rows] - truth.y[k, i]
    score.near = len(rows)
    score.place2 = float((dx**2 + dy**2).sum())
    heading = (tracked.heading[rows] - truth.heading[k, i] + np.pi) % (2 * np.pi) - np.pi
    heading = heading[np.isfinite(heading) & ~truth.resting[k, i]]
    score.heading2 = float((heading**2).sum())
    score.headings = len(heading)


def _named(tracked: Shown, owner, inside) -> int:
    """Return the rows that agree if each individual has the one name that suits it best (IDTP)."""
    names, column = np.unique(tracked.name, return_inverse=True)
    if not len(names) or owner.max(initial=-1) < 0:
        return 0
    count = np.zeros((owner.max() + 1, len(names)))
    np.add.at(count, (owner[inside], column[inside]), 1)
    return int(count[linear_sum_assignment(-count)].sum())


def _wrong(truth: FilmTruth, tracked: Shown, owner, free) -> list[bool]:
    """Return whether a name is called sure (in most rows) where one that was one cell's is
    another's for LASTS_S or to its end. A mother's name may be a daughter's.
    """
    wrong = []
    for name in np.unique(tracked.name[free]):
        bears_name = tracked.name[free] == name
        rows = free[bears_name]
        cuts = np.flatnonzero(np.diff(owner[rows])) + 1
        runs = np.split(rows, cuts)
        before = -1
        for number, run in enumerate(runs):
            i = int(owner[run[0]])
            times = truth.times[tracked.frame[run]]
            lasts = times[-1] - times[0] >= LASTS_S or number in (0, len(runs) - 1)
            if not lasts:
                continue
            family = before in (i, truth.parent[i]) or truth.parent[before] == i
            family |= before >= 0 and truth.parent[before] == truth.parent[i] >= 0
            if before >= 0 and not family:
                wrong.append(bool(np.mean(tracked.sure[run]) > 0.5))
            before = i
    return wrong


def _intervals(score: FilmScore, truth: FilmTruth, tracked: Shown, owner) -> None:
    """Score the intervals of names seen for LONG_S by the cell that bears each for longest."""
    for name in np.unique(tracked.name):
        rows = np.flatnonzero(tracked.name == name)
        times = truth.times[tracked.frame[rows]]
        owners = owner[rows]
        is_owned = owners >= 0
        owners_of_rows = owners[is_owned]
        if times[-1] - times[0] < LONG_S or 2 * len(owners_of_rows) < len(rows):
            continue
        i = int(np.bincount(owners_of_rows).argmax())
        said = tracked.numbers.get(int(name), {})
        rows = rows[np.flatnonzero(owners == i)]
        if "speed" in said:
            low, high = said["speed"]
            mean = float(truth.speed[tracked.frame[rows], i].mean())
            score.speed.append(low <= mean <= high)
        if "a" not in said:
            continue
        low, high = said["a"]
        a = float(truth.a[i])
        # what a is while a cell rests is not defined
        if a > 0 and not truth.resting[tracked.frame[rows], i].any():
            score.a.append(low <= a <= high)
        elif a == 0:
            score.strangers.append(not low <= 0 <= high)
