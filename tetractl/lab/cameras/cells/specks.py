"""Specks: objects in a dish that are followed until they swim and are thus known to be cells."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from tetractl.core.poses import Floats
from tetractl.model.organisms import Organism

SPECKS = 120  # largest number of specks that are followed
BORN = 5  # number of successive blobs after which a speck may be a cell
SWIM_UM = 12.0  # least distance of a cell over these blobs
STRAY_UM = 5.0  # largest distance of these blobs from a straight line
ALONG = 0.75  # least cosine between a cell's axis and its path
ROUND = 1.3  # ratio of length to width below which a blob has no axis
EVEN = 0.2  # relative variation of a cell's size
NEAR_UM = 40.0  # a new blob this near to a cell is part of it, unless seen NEAR_BORN times
NEAR_BORN = 7
FROM_UM = 80.0  # a cell first seen this near to another cell had shared its blob or divided from it
REACH_UM = 25.0  # radius of search around a speck's expected position
FIRST_UM = 40.0  # radius of search for a speck whose path is too short to predict
MISSED = 3  # pictures without a blob after which a speck is hidden or dropped
HIDDEN = 90  # pictures for which a hidden speck is remembered: a cell may cover it

Entry = tuple[float, float, float, float, float, float]
"""A blob: time [s], x, y [um], axis [rad], length and width [um]."""


@dataclass(slots=True)
class Speck:
    """An object that may be a cell: its newest blobs in `path`, the track of the cell near which it
    was first seen (None if none was near), and the number of pictures since its last blob.
    """

    path: list[Entry]
    beside: int | None = None
    missed: int = 0

    def ahead(self, seconds: float) -> tuple[float, float]:
        """Return the position x, y [um] that the speck's last motion predicts for a time [s]."""
        if len(self.path) < 2:
            return self.path[-1][1], self.path[-1][2]
        first, last = self.path[max(0, len(self.path) - 4)], self.path[-1]
        ratio = (seconds - last[0]) / max(last[0] - first[0], 1e-3)
        return last[1] + (last[1] - first[1]) * ratio, last[2] + (last[2] - first[2]) * ratio

    def swims(self, needed: int, organism: Organism) -> bool:
        """Return whether the speck's last blobs, at least `needed` of them, have the organism's
        size and move fast, straight and along their axis.
        """
        entries = self.path[-max(needed, BORN) :]
        first, last = entries[0], entries[-1]
        moved = math.hypot(last[1] - first[1], last[2] - first[2])
        passed = max(last[0] - first[0], 1e-3)
        if len(entries) < needed or moved < SWIM_UM or moved / passed < organism.slowest_um_s:
            return False
        path = np.array(entries)
        long, wide = np.median(path[:, 4:6], axis=0).tolist()
        (short, longest), (thin, thick) = organism.outline_long_um, organism.outline_wide_um
        if not (short < long < longest and thin < wide < thick):
            return False
        (vx, vy), fitted = straight(path)
        strayed = np.sqrt(np.mean(np.square(path[:, 1:3] - fitted)))
        sway = np.abs(np.cos(path[:, 3] - math.atan2(vy, vx)))
        even = bool((path[:, 4:6].std(axis=0) < (EVEN * long, EVEN * wide)).all())
        along = long < ROUND * wide or np.median(sway) > ALONG  # a round blob has no axis
        return bool(even and strayed < STRAY_UM and along)


def straight(path: Floats) -> tuple[tuple[float, float], Floats]:
    """Fit uniform motion to a path (M, >= 3) of time [s], x and y [um], by least squares.

    Returns the velocity [um/s] and the fitted positions (M, 2) [um].
    """
    middle = path[:, :3].mean(axis=0)
    times, off = path[:, 0] - middle[0], path[:, 1:3] - middle[1:]
    vx, vy = (times @ off / (times @ times)).tolist()
    return (vx, vy), middle[1:] + times[:, None] * (vx, vy)


@dataclass(slots=True)
class Specks:
    """All specks that are followed, and the organism that cells are."""

    organism: Organism
    all: list[Speck] = field(default_factory=list)

    @property
    def places(self) -> Floats:
        """Last positions of specks seen in the last few pictures (S, 2) [um]."""
        recent = [speck for speck in self.all if speck.missed <= MISSED]
        return np.array([speck.path[-1][1:3] for speck in recent]).reshape(-1, 2)

    @property
    def next_to(self) -> set[int | None]:
        """Tracks of the cells near which the newest specks appeared."""
        return {speck.beside for speck in self.all if len(speck.path) <= NEAR_BORN}

    @property
    def hidden(self) -> Floats:
        """Last positions of specks not seen in the last few pictures (S, 2) [um]."""
        gone = [speck for speck in self.all if speck.missed > MISSED]
        return np.array([speck.path[-1][1:3] for speck in gone]).reshape(-1, 2)

    def follow(
        self, places: Floats, cells: Floats, tracks: Sequence[int], seconds: float
    ) -> list[Speck]:
        """Take the blobs that belong to no cell, and return the specks that now swim.

        `places` (B, 5) are the blobs' x, y [um], axis [rad], length and width [um]; `cells` (C, 2)
        are the positions of the cells [um], `tracks` (C,) the numbers of their tracks.
        """
        found = self._found(places, seconds)
        taken = set(found.values())
        for s, speck in enumerate(self.all):
            speck.missed = 0 if s in taken else speck.missed + 1
        fresh: list[Speck] = []
        swimming: list[Speck] = []
        for b, place in enumerate(places):
            x, y, axis, long, wide = place.tolist()
            entry = (seconds, x, y, axis, long, wide)
            gaps = np.linalg.norm(cells - place[:2], axis=1)
            nearest = float(gaps.min(initial=np.inf))
            if b not in found:
                fresh.append(Speck([entry], tracks[gaps.argmin()] if nearest < FROM_UM else None))
                continue
            speck = self.all[found[b]]
            speck.path = [*speck.path[-2 * NEAR_BORN :], entry]
            if speck.swims(NEAR_BORN if nearest < NEAR_UM else BORN, self.organism):
                swimming.append(speck)
        kept = [
            speck
            for speck in self.all
            if speck.missed <= (HIDDEN if len(speck.path) > 2 * NEAR_BORN else MISSED)
        ]
        begun = [id(speck) for speck in swimming]
        self.all = ([speck for speck in kept if id(speck) not in begun] + fresh)[:SPECKS]
        return swimming

    def _found(self, places: Floats, seconds: float) -> dict[int, int]:
        """Match blobs to specks by the specks' expected positions; return {blob: speck}."""
        if not len(places) or not self.all:
            return {}
        before = np.array([speck.ahead(seconds) for speck in self.all])
        apart = np.linalg.norm(before[:, None] - places[None, :, :2], axis=-1)
        reach = [REACH_UM if len(speck.path) > 2 else FIRST_UM for speck in self.all]
        own, blob = linear_sum_assignment(np.minimum(apart, 1e6))
        pairs = zip(own.tolist(), blob.tolist(), strict=True)
        return {b: s for s, b in pairs if apart[s, b] < reach[s]}
