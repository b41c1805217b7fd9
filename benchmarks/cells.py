"""How well cells are distinguished after a merge, by the difference of a.

    python benchmarks/cells.py

How well cells are found and followed in films is measured by benchmarks/films.py. Every picture is
synthetic. Seeds from 9000 on are those of the published figures; smaller ones were used in
development. --count says how many pairs of cells.
"""

import argparse
import math
import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))
sys.path.extend(map(str, Path(__file__).parents[1].glob("packages/*/tests")))
from filmworld.rows import share
from tetractl_microscope.cells.cell import BodySize
from tetractl_microscope.cells.cell_tracks import CellTrack
from tetractl_microscope.cells.helix import HelixFilter
from tetractl_microscope.cells.names import Names

from tetractl.model.swimmers import Swimmers, bodies

FIRST_SEED = 9000
STEP_S = 1 / 240
STEPS_OF_A_PICTURE = 8
MERGE_S = 10.0


def identity(count: int) -> None:
    """Two cells leave a full merge at one place and heading, alike but for a; blobs of usual noise.

    Before the merge each is followed for 10 s by itself. The field changes every 0.3 to 1.2 s.
    """
    for apart, limit in ((0.3, 1.5), (0.15, 3.0), (0.05, 3.0)):
        right = sure_wrong = sure = 0
        for pair in range(count):
            order, probability = after_merge(FIRST_SEED + pair, apart, limit)
            right += order == (0, 1)
            if probability > 0.9:
                sure += 1
                sure_wrong += order != (0, 1)
        wrong = share(sure_wrong, max(sure, 1))
        print(
            f"a apart by {100 * apart:g} %, {limit:g} s after a full merge: right "
            f"{share(right, count)}; stated above 0.9 in {sure}, wrong in {wrong}"
        )


def alike_pair(random: np.random.Generator, apart: float) -> Swimmers:
    """Two cells that differ in nothing but a, by a share `apart` of it."""
    cells = Swimmers.drawn(random, 2)
    a = random.uniform(3.0, 5.0)
    cells.a[:] = a * (1 + apart / 2), a * (1 - apart / 2)
    for name in ("speed", "length", "width", "helix_um", "helix_hz", "bias", "phase", "heading"):
        values = getattr(cells, name)
        values[1] = values[0]
    cells.bias[:] = 0.0
    return cells


class FollowedPair:
    """Two cells as a tracker follows them: the estimates of their helices, and their names."""

    def __init__(self, cells: Swimmers) -> None:
        self.cells = cells
        self.bank = HelixFilter(True)
        self.rows = np.array(
            [self.bank.add(0.0, 0.0, cells.heading[i], cells.speed[i]) for i in range(2)]
        )
        self.tracks = [
            CellTrack(
                number=i,
                row=int(self.rows[i]),
                size=BodySize(cells.length[i], cells.width[i]),
                last=np.zeros(2),
                identity=i,
            )
            for i in range(2)
        ]
        self.names = Names(self.bank, 52.3, splits=False)

    def merge(self, t: float) -> None:
        """Let both be at one place with one heading, and part at once."""
        cells = self.cells
        cells.x[:] = 0.0
        cells.y[:] = 0.0
        cells.heading[1] = cells.heading[0]
        cells.phase[1] = cells.phase[0]
        mean = self.bank.mean
        mean[self.rows, :2] = 0.0
        mean[self.rows, 2] = cells.heading[0]
        mean[self.rows[1], 4:6] = mean[self.rows[0], 4:6]
        self.names.meet(self.tracks, t, False)
        places = {i: mean[self.rows[i], :3].copy() for i in range(2)}
        self.names.part(places, [], t + STEP_S)

    def swim(self, direction: float, random: np.random.Generator) -> None:
        field = (math.cos(direction), math.sin(direction))
        self.cells.swim(field, STEP_S, random)
        self.bank.predict([(STEP_S, *field)])

    def see(self, t: float, random: np.random.Generator) -> None:
        """Give the tracker a picture of both, with noise."""
        shown_bodies = bodies(self.cells)
        blobs = np.column_stack([shown_bodies.x, shown_bodies.y, shown_bodies.axis])
        blobs += random.normal(0, 1, (2, 3)) * (0.4, 0.4, 0.02)
        for track, blob in zip(self.tracks, blobs, strict=True):
            question = track.question
            rows_asked = track.rows
            blobs_asked = np.tile(blob, (len(rows_asked), 1))
            deviations = np.tile((0.86, 0.86, 0.04), (len(rows_asked), 1))
            likelihood, _ = self.bank.update(np.array(rows_asked, int), blobs_asked, deviations)
            if question is not None:
                question.add(track, likelihood, None, t)


def after_merge(seed: int, apart: float, limit: float) -> tuple[tuple[int, ...], float]:
    """The likeliest order of two cells and its probability, `limit` seconds after their merge."""
    random = np.random.default_rng(seed)
    pair = FollowedPair(alike_pair(random, apart))
    direction = 0.0
    remaining_s = 0.0
    merged = False
    for k in range(round((MERGE_S + limit) / STEP_S)):
        t = k * STEP_S
        if remaining_s <= 0:
            direction = random.uniform(-math.pi, math.pi)
            remaining_s = random.uniform(0.3, 1.2)
        if not merged and t >= MERGE_S:
            pair.merge(t)
            merged = True
        pair.swim(direction, random)
        remaining_s -= STEP_S
        if (k + 1) % STEPS_OF_A_PICTURE == 0:
            pair.see(t, random)
    question = pair.tracks[0].question
    assert question is not None
    order, shares = question.best()
    return order, float(shares.min())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--count", type=int, default=10)
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    identity(chosen.count)
