"""Points to steer to instead of targets that are so close together that robots might touch.

A robot that misses a command leaves its course by up to `lost_way`, however precisely its motion is
known, and two robots may do so towards each other. Where there is enough space, they keep
`separation + 2 lost_way` apart (`tetractl.control.search.margins`). Targets that are closer
together are replaced by points at that distance (`spread_apart`), about equally far from each
target. Robots then end near their targets, instead of trying again and again to reach positions
that they could not keep.
"""

from tetractl.core import elementwise
from tetractl.core.poses import Floats
from tetractl.spec.section_abilities import Clearance

LOST_SHARE = 0.75
"""How far a robot deviates because of a lost command, as a fraction of the commanded path.

The path is what the robot drives while it should follow the command. The value is chosen.
"""
ROUNDS = 100
"""Number of times that all pairs of targets are moved apart.

Example: for eight robots with targets in a row, 100 mm apart where 110 mm are kept, the two nearest
targets are 109.9 mm apart afterwards.
"""


def lost_way(speed: Floats, heard_s: float) -> Floats:
    """Compute how far robots may leave their courses because of a lost command [length unit].

    Args:
        speed: Speeds [length unit/s], shape (N,).
        heard_s: How long robots follow each command [s].
    """
    return LOST_SHARE * speed * heard_s


def kept_apart(collision: Clearance, speed: Floats, heard_s: float) -> float:
    """Compute the distance that two targets need for robots to be steered to both.

    Args:
        collision: The distances that plans keep.
        speed: Speeds [length unit/s], shape (N,).
        heard_s: How long robots follow each command [s].

    Returns:
        The distance [length unit]. It is 0 if robots may meet (`separation` 0), or if margins are
        not adapted to uncertainty (`adaptive` false).
    """
    if collision.separation == 0 or not collision.adaptive:
        return 0.0
    return collision.separation + 2 * float(lost_way(speed, heard_s).max())


def spread_apart(targets: Floats, least: float) -> Floats:
    """Return targets of which those that are too close together are moved apart.

    Each of two targets is moved by half of the missing distance. All pairs are treated ROUNDS
    times, so in a crowd the distances may stay slightly too small. Targets at the same point stay
    there, because no direction would be better than another.

    Args:
        targets: The targets, shape (N, 2). The array stays unchanged.
        least: The minimum distance [length unit].
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
