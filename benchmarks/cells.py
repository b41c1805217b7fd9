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
from scipy.stats import beta

sys.path.append(str(Path(__file__).parents[1] / "tests"))
sys.path.extend(map(str, Path(__file__).parents[1].glob("packages/*/tests")))
from tetractl_microscope.cells.cell import BodySize
from tetractl_microscope.cells.cell_tracks import CellTrack
from tetractl_microscope.cells.helix import HelixFilter
from tetractl_microscope.cells.names import Names

from tetractl.model.swimmers import Swimmers, bodies

FIRST_SEED = 9000
STEP_S = 1 / 240


def share(hits: int, count: int) -> str:
    """A share with its interval after Clopper and Pearson."""
    low = beta.ppf(0.025, hits, count - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, count - hits) if hits < count else 1.0
    return f"{hits}/{count} = {hits / max(count, 1):.4f} [{low:.4f}, {high:.4f}]"


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


def after_merge(seed: int, apart: float, limit: float) -> tuple[tuple[int, ...], float]:
    """The likeliest order of two cells and its probability, `limit` seconds after their merge."""
    random = np.random.default_rng(seed)
    cells = Swimmers.drawn(random, 2)
    a = random.uniform(3.0, 5.0)
    cells.a[:] = a * (1 + apart / 2), a * (1 - apart / 2)
    for name in ("speed", "length", "width", "helix_um", "helix_hz", "bias", "phase", "heading"):
        getattr(cells, name)[1] = getattr(cells, name)[0]
    cells.bias[:] = 0.0
    bank = HelixFilter(True)
    deviation = np.tile((0.86, 0.86, 0.04), (2, 1))
    rows = np.array([bank.add(0.0, 0.0, cells.heading[i], cells.speed[i]) for i in range(2)])
    tracks = [
        CellTrack(
            number=i,
            row=int(rows[i]),
            size=BodySize(cells.length[i], cells.width[i]),
            last=np.zeros(2),
            identity=i,
        )
        for i in (0, 1)
    ]
    names = Names(bank, 52.3, splits=False)
    direction = 0.0
    remaining_s = 0.0
    frame = 0
    merged = False
    for k in range(round((10.0 + limit) / STEP_S)):
        t = k * STEP_S
        if remaining_s <= 0:
            direction = random.uniform(-math.pi, math.pi)
            remaining_s = random.uniform(0.3, 1.2)
        if not merged and t >= 10.0:  # at one place with one heading
            cells.x[:] = 0.0
            cells.y[:] = 0.0
            cells.heading[1] = cells.heading[0]
            cells.phase[1] = cells.phase[0]
            bank.mean[rows, :2] = 0.0
            bank.mean[rows, 2] = cells.heading[0]
            bank.mean[rows[1], 4:6] = bank.mean[rows[0], 4:6]
            names.meet(tracks, t, False)
            places = {i: bank.mean[rows[i], :3].copy() for i in (0, 1)}
            names.part(places, [], t + STEP_S)
            merged = True
        field = (math.cos(direction), math.sin(direction))
        cells.swim(field, STEP_S, random)
        bank.predict([(STEP_S, *field)])
        remaining_s -= STEP_S
        frame += 1
        if frame % 8:
            continue
        shown_bodies = bodies(cells)
        blobs = np.column_stack([shown_bodies.x, shown_bodies.y, shown_bodies.axis])
        blobs += random.normal(0, 1, (2, 3)) * (0.4, 0.4, 0.02)
        for track, blob in zip(tracks, blobs, strict=True):
            open_question = track.question
            rows_asked = track.rows
            blobs_asked = np.tile(blob, (len(rows_asked), 1))
            deviations = np.tile(deviation[0], (len(rows_asked), 1))
            likelihood, _ = bank.update(np.array(rows_asked, int), blobs_asked, deviations)
            if open_question is not None:
                open_question.add(track, likelihood, None, t)
    question = tracks[0].question
    assert question is not None
    order, shares = question.best()
    return order, float(shares.min())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--count", type=int, default=10)
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    identity(chosen.count)
