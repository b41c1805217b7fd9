"""Measures how often the intervals of `tetractl track` contain the truth, for simulated cells.

    python benchmarks/track_intervals.py --cells 60 --seed 1

The intervals are those of speeds and turning rates. Cells swim on helices for 10 s, with the spread
of a culture, while the field turns at random times. Their tracks have the cells' true identities,
and their positions have normal errors, so that only the fit is judged. The fit approximates the
model of a swimming cell that is simulated.
"""

import argparse
import math
import time

import numpy as np
from tetractl_microscope.cells.field_record import FieldRecord
from tetractl_microscope.organisms import TETRAHYMENA
from tetractl_microscope.tracks.fit_track import CellPath, CellSummary, fit_tracks

from tetractl.model.swimmers import Swimmers, bodies
from tetractl.statistics.estimate import proportion_interval

SECONDS = 10.0
STEP_HZ = 240  # steps of the simulation [1/s]
TURNS = 12  # of the field
ROWS = ((30, 2.0), (30, 0.5), (10, 2.0))
"""Images per second, and standard deviation of places [um]."""


def simulated(
    count: int, rate_hz: int, noise_um: float, rng: np.random.Generator
) -> tuple[Swimmers, list[CellPath], FieldRecord]:
    """Simulate cells, their tracks, and the field."""
    cells = Swimmers.drawn(rng, count)
    since = np.sort(rng.uniform(0.0, SECONDS, TURNS))
    since[0] = 0.0
    field = FieldRecord(since, rng.uniform(-math.pi, math.pi, TURNS))
    shown = []
    every = STEP_HZ // rate_hz
    for step in range(round(SECONDS * STEP_HZ)):
        if step % every == 0:
            now = bodies(cells)
            shown.append(np.column_stack([now.x, now.y]) + rng.normal(0, noise_um, (count, 2)))
        acts = complex(field.field_at(np.array([step / STEP_HZ]))[0])
        cells.swim((acts.real, acts.imag), 1 / STEP_HZ, rng)
    places = np.array(shown)
    times = np.arange(len(places)) / rate_hz
    return cells, [CellPath(cell, times, places[:, cell]) for cell in range(count)], field


def held(name: str, fits: tuple[CellSummary, ...], truth: np.ndarray, unit: str) -> str:
    """Describe how many intervals contain the truth, and how wide they are."""
    intervals = [getattr(fit, name) for fit in fits]
    hits = sum(ci.low <= true <= ci.high for ci, true in zip(intervals, truth, strict=True))
    ends = proportion_interval(hits, len(fits))
    width = float(np.median([ci.high - ci.low for ci in intervals]))
    values = np.array([ci.value for ci in intervals])
    error = math.sqrt(np.mean(np.square(values - truth)))
    return (
        f"{hits} of {len(fits)} ({ends.low:.2f} to {ends.high:.2f}), "
        f"{width:.3g} {unit}, {error:.2g} {unit}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cells", type=int, default=60, help="in each row")
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    rng = np.random.default_rng(chosen.seed)
    print("| images per second, noise | speed: holds, width, error | a: holds, width, error |")
    print("|---|---|---|")
    for rate_hz, noise_um in ROWS:
        cells, paths, field = simulated(chosen.cells, rate_hz, noise_um, rng)
        began_s = time.process_time()
        fits = fit_tracks(paths, TETRAHYMENA, field, 1 / rate_hz)
        used_s = time.process_time() - began_s
        speed = held("speed_um_s", fits, cells.speed, "um/s")
        a = held("a_rad_s", fits, cells.a, "rad/s")
        print(f"| {rate_hz} Hz, {noise_um:g} um | {speed} | {a} |", flush=True)
    print(f"\nfitting the last row took {used_s:.1f} s of processor time")


if __name__ == "__main__":
    main()
