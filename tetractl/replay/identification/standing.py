"""When robots stood though they were sent commands, as one that is stuck or was held.

Places and headings are means over bins of BIN_S, which noise of the camera hardly moves. A robot
stands from one bin to the next if it hardly moves and turns, and it was asked to move if a
direction, or a speed or turning rate as usual, acts then.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Bools, Floats, wrap
from tetractl.replay.identification.tracks import Track, integrals_of_sent

BIN_S = 0.5
STOOD_S = 3.0
"""Least time for which it is said that a robot stood [s]: lost commands stop one for less."""
USUAL = 0.75
"""Quantile of ways from bin to bin that counts as usual: a robot may stand half of the time."""
LITTLE = 0.35
LITTLE_RAD = 0.05
"""Share of the usual way, and turn [rad], from bin to bin below which a robot stands."""
ASKED = 0.5
ASKED_RAD = 0.2
"""Share of the usual way that was sent, and turn that was sent [rad], from bin to bin above which a
robot was asked to move."""
RECENT_S = 1.0
RECENT = 3.0
"""A command acts for RECENT_S [s], or RECENT times the usual time between two."""


@dataclass(frozen=True, slots=True)
class Stood:
    """When a robot stood though it was sent commands, in seconds after the first pose."""

    name: str
    source: str
    begin_s: float
    end_s: float

    def __str__(self) -> str:
        return (
            f"{self.name} stood from {self.begin_s:.1f} to {self.end_s:.1f} s after the first pose "
            f"of {self.source} though it was sent commands: if it was stuck or held, leave this out"
        )


def stands_of(tracks: Sequence[Track], robot: int, dead_time_s: float) -> tuple[Stood, ...]:
    """Return when a robot stood in some tracks though commands acted, which do after a dead time
    [s]."""
    stands: list[Stood] = []
    for track in tracks:
        times = track.exposed[:, robot]
        is_valid = track.valid[:, robot]
        if not is_valid.any() or not len(track.sent):
            continue
        begin_s = float(track.time[0])
        stood = _stood(times[is_valid] - begin_s, track.poses[is_valid, robot])
        middles_s = begin_s - dead_time_s + BIN_S * np.arange(0.5, len(stood) + 1)
        stood &= _is_asked(track, robot, middles_s)
        edges = np.diff(stood.astype(np.int64), prepend=0, append=0)
        for first, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
            if (end - first) * BIN_S >= STOOD_S:
                stood_from_s = BIN_S * (float(first) + 0.5)
                until_s = BIN_S * (float(end) + 0.5)
                stands.append(Stood(track.names[robot], track.source, stood_from_s, until_s))
    return tuple(stands)


def _stood(times: Floats, poses: Floats) -> Bools:
    """Return from which of B bins to the next (B - 1,) a robot with poses (M, 3) at times (M,) [s]
    hardly moves and turns; in bins without a pose nothing is known."""
    bins = (times / BIN_S).astype(np.int64)
    counts = np.maximum(np.bincount(bins), 1e-9)
    x, y, heading = poses.T
    place = (np.bincount(bins, x) + 1j * np.bincount(bins, y)) / counts
    east = np.bincount(bins, np.cos(heading))
    north = np.bincount(bins, np.sin(heading))
    is_known = (counts[1:] >= 1) & (counts[:-1] >= 1)
    ways = np.abs(np.diff(place))
    headings = np.angle(east + 1j * north)
    turns = np.abs(wrap(np.diff(headings)))
    if not is_known.any():
        return is_known
    return is_known & (ways < LITTLE * np.quantile(ways[is_known], USUAL)) & (turns < LITTLE_RAD)


def _is_asked(track: Track, robot: int, middles: Floats) -> Bools:
    """Return from which of B bins to the next (B - 1,) commands ask a robot to move, by the middles
    of the bins (B,), less the dead time [s]."""
    is_sent = np.ones(len(track.sent), dtype=np.bool_)
    if track.twists.size:
        is_sent = np.isfinite(track.twists[:, robot]).all(axis=1)
    sent_s = track.sent[is_sent]
    if len(sent_s) < 2:
        return np.zeros(len(middles) - 1, dtype=np.bool_)
    gaps_s = np.diff(sent_s)
    times = middles[:-1] + BIN_S / 2
    newest = np.searchsorted(sent_s, times, side="right") - 1
    since_s = times - sent_s[np.maximum(newest, 0)]
    recent_s = max(RECENT_S, RECENT * float(np.median(gaps_s)))
    acts = (newest >= 0) & (since_s <= recent_s) & (middles[1:] <= track.until)
    if not track.twists.size:
        return acts
    twists = np.abs(track.twists[is_sent, robot])
    ways, turns = np.diff(integrals_of_sent(sent_s, twists, middles), axis=0).T
    return acts & ((ways > ASKED * np.quantile(ways, USUAL)) | (turns > ASKED_RAD))
