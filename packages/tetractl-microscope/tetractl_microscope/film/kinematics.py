"""The velocities of computer-assisted sperm analysis (CASA), by which swimmers are compared.

Definitions: WHO laboratory manual for the examination and processing of human semen, 6th edition
(2021), section 3.5.2; Mortimer, "A critical assessment of methods used to study sperm kinematics",
in Computer-Aided Sperm Analysis (1990). CASA averages the path over a fixed number of pictures;
here it is one turn of the cell's helix, whatever the film's rate.
"""

import math
from itertools import pairwise

import numpy as np

from tetractl.core.poses import Floats

WINDOW_S = 1.0  # length of the parts of a track, whose velocities are averaged [s]
TURN_S = 0.4  # length of a turn of a helix of unknown frequency [s]


def velocities(times: Floats, places: Floats, helix_hz: float) -> dict[str, float | None]:
    """Return VCL, VAP, VSL [um/s] and LIN of a track: its times (K,) [s] and places (K, 2) [um].

    VCL is the velocity along the path from picture to picture, VAP along the average path, which is
    the running mean over a turn of the helix, and VSL along the straight line from the first place
    to the last one; LIN = VSL / VCL. They are the means over successive parts of WINDOW_S, so that
    long and short tracks can be compared; a shorter track is one part. VCL grows with the noise of
    the places and with the film's rate. A track of one place has none.
    """
    if len(times) < 2:
        return dict.fromkeys(("vcl_um_s", "vap_um_s", "vsl_um_s", "lin"))
    turn = 1 / helix_hz if math.isfinite(helix_hz) and helix_hz > 1 else TURN_S
    average = _smoothed(times, places, turn)
    parts = []
    for first, last in pairwise(_ends(times)):
        lengths = (
            way_um(places[first : last + 1]),
            way_um(average[first : last + 1]),
            way_um(places[[first, last]]),
        )
        parts.append(np.array(lengths) / (times[last] - times[first]))
    vcl, vap, vsl = np.mean(parts, axis=0).tolist()
    return {
        "vcl_um_s": vcl,
        "vap_um_s": vap,
        "vsl_um_s": vsl,
        "lin": vsl / vcl if vcl > 0 else None,
    }


def _ends(times: Floats) -> list[int]:
    """Return the indices of the pictures at which successive parts of a track end, from the first:
    those nearest to each WINDOW_S. What remains after the last of them is no part; a track that is
    shorter is one.
    """
    step = float(np.median(np.diff(times)))
    ends = [0]
    while (due := times[ends[-1]] + WINDOW_S) < times[-1] + step / 2:
        after = int(np.searchsorted(times, due))
        after = min(after, len(times) - 1)
        nearest = after - 1 if due - times[after - 1] < times[after] - due else after
        ends.append(max(nearest, ends[-1] + 1))
    return ends if len(ends) > 1 else [0, len(times) - 1]


def _smoothed(times: Floats, places: Floats, span_s: float) -> Floats:
    """Return the running mean over places within a span of time [s]; of as many before a place as
    after it, so of fewer towards the ends.
    """
    step = float(np.median(np.diff(times)))
    half_s = span_s / 2 + step / 4  # rounds to whole pictures
    index = np.arange(len(times))
    before = index - np.searchsorted(times, times - half_s)
    after = np.searchsorted(times, times + half_s, side="right") - 1 - index
    reach = np.minimum(before, after)
    sums = np.vstack([np.zeros((1, 2)), np.cumsum(places, axis=0)])
    return (sums[index + reach + 1] - sums[index - reach]) / (2 * reach + 1)[:, None]


def way_um(places: Floats) -> float:
    """Return the length [um] of the way along places (K, 2) [um]."""
    steps = np.diff(places, axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())
