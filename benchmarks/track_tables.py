"""How often intervals of tracks of other programs hold: a, speed and bias of simulated swimmers.

    python benchmarks/track_tables.py --count 60

Each swimmer turns by equation (3) in a field that changes every
1.5 s; places are rounded and noisy.
"""

import argparse
import math
from pathlib import Path

import numpy as np
from tetractl_microscope.film.field_file import FieldRecord
from tetractl_microscope.film.fit_cell import fit_tracks
from tetractl_microscope.foreign_tracks import SpotTrack
from tetractl_microscope.organisms import named
from tetractl_microscope.track_cells import swimming_tracks

# rate of pictures [Hz], duration [s], noise [um], helix [1/s, um], walk of the heading
KINDS = {
    "20 Hz": (20.0, 30.0, 0.25, (0.0, 0.0), 0.0),
    "10 Hz": (10.0, 30.0, 1.0, (0.0, 0.0), 0.0),
    "30 Hz, helix": (30.0, 20.0, 0.5, (2.5, 8.0), 0.0),
    "20 Hz, heading walks": (20.0, 30.0, 0.5, (0.0, 0.0), 0.05),
}
STEP_S = 1e-3
FIELD_S = 1.5
UM_PX = 2.5


def swimmer(random, a, speed, bias, kind):
    """Return rows of time, x, y (K, 3) of a swimmer, and the field."""
    hz, seconds, noise_um, (helix_hz, helix_um), walk = kind
    count = int(seconds / STEP_S)
    times = np.arange(count) * STEP_S
    changes = np.arange(0, seconds, FIELD_S)
    sent = random.uniform(-np.pi, np.pi, len(changes))
    heading = np.empty(count)
    now = random.uniform(-3, 3)
    acting = sent[np.searchsorted(changes, times, side="right") - 1]
    walked = random.normal(0, walk * math.sqrt(STEP_S), count)
    for k in range(count):
        heading[k] = now
        now += a * math.sin(acting[k] - now - bias) * STEP_S + walked[k]
    along = speed * STEP_S * np.exp(1j * heading)
    places = np.cumsum(along) - along
    aside = helix_um * np.cos(random.uniform(0, 6.28) + math.tau * helix_hz * times)
    places += 1j * np.exp(1j * heading) * aside
    shown = np.round(np.arange(0, seconds, 1 / hz) / STEP_S).astype(int)
    x = places.real[shown] + random.normal(0, noise_um, len(shown))
    y = places.imag[shown] + random.normal(0, noise_um, len(shown))
    rounded = np.round(np.column_stack([x, y]) / UM_PX, 3) * UM_PX
    rows = np.column_stack([times[shown], rounded])
    return rows, FieldRecord(changes, sent)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=60)
    count = parser.parse_args().count
    random = np.random.default_rng(7)
    for name, kind in KINDS.items():
        held = np.zeros(3, int)
        off = []
        for _ in range(count):
            a = random.uniform(2, 6)
            speed = random.uniform(200, 600)
            bias = random.uniform(-0.2, 0.2)
            rows, field = swimmer(random, a, speed, bias, kind)
            cells = swimming_tracks(Path("simulated"), [SpotTrack(1.0, rows)], True)
            (cell,) = fit_tracks(cells.paths, named("tetrahymena"), field, cells.timing)
            pairs = ((cell.a, a), (cell.speed, speed), (cell.bias, bias))
            held += [value.low <= true <= value.high for value, true in pairs]
            off.append(cell.a.value / a - 1)
        mean = 100 * np.mean(off)
        half = 196 * np.std(off) / math.sqrt(count)
        print(f"{name}: a, speed, bias held in {held.tolist()} of {count}; a {mean:+.2f} %", end="")
        print(f" [{mean - half:+.2f}, {mean + half:+.2f}]", flush=True)


if __name__ == "__main__":
    main()
