"""Where robots are led whose targets are so near to each other that bodies might touch there.

However well its motion is known, a robot that misses a command comes off its course by up to
`lost_way`, and two robots may do so towards each other. They keep `separation + 2 lost_way` from
each other where there is room for it (`tetractl.control.search.margins`). Targets that are nearer
are taken for places so far apart (`parted`), each about as far from its target as the others:
robots end there, near their targets, and do not try again and again for what they cannot keep.
"""

from tetractl.core import elementwise
from tetractl.core.poses import Floats
from tetractl.spec.section_abilities import Clearance

LOST_SHARE = 0.75
"""Deviation by a lost command, as a fraction of the path that it was to act for; chosen."""
ROUNDS = 100
"""Number of times that all pairs of targets are moved apart: of eight robots whose targets stand in
a row, 100 mm apart where 110 are kept, the nearest two are 109.9 mm apart then."""


def lost_way(speed: Floats, heard_s: float) -> Floats:
    """Return how far (N,) robots may come off their courses by a lost command, if they follow each
    for `heard_s` [length unit]."""
    return LOST_SHARE * speed * heard_s


def kept_apart(collision: Clearance, speed: Floats, heard_s: float) -> float:
    """Return the least distance of two targets at which robots are led to them, 0 if they may meet
    or are to be led there at any risk [length unit]."""
    if collision.separation == 0 or not collision.adaptive:
        return 0.0
    return collision.separation + 2 * float(lost_way(speed, heard_s).max())


def parted(targets: Floats, least: float) -> Floats:
    """Return targets (N, 2), of which two that are nearer than `least` are moved apart, each by
    half of what is missing. Targets at one point stay: no direction would be better than another.
    """
    places = targets.copy()
    for _ in range(ROUNDS):
        for i in range(1, len(places)):
            for k in range(i):
                way = places[i] - places[k]
                distance = float(elementwise.hypot(*way))
                if 0 < distance < least:
                    change = (least / distance - 1) / 2 * way
                    places[i] += change
                    places[k] -= change
    return places
