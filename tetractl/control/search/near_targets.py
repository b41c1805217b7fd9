"""Replace targets that are so close together that two robots might touch there.

A robot that misses a command leaves its course by up to `lost_command_deviation`, however precisely
its motion is known, and two robots may do so towards each other. Where there is enough space,
robots keep their separation plus twice this deviation (`tetractl.control.search.margins`). Targets
that are closer together are replaced by points at that distance (`spread_targets`), about equally
far from each target. Robots then end near their targets, instead of trying again and again to reach
positions that they could not keep.
"""

from tetractl.core import elementwise
from tetractl.core.poses import Floats
from tetractl.spec.section_abilities import Clearance

LOST_FRACTION = 0.75
"""Deviation of a robot after a lost command, as a fraction of the path driven meanwhile; chosen."""
ROUNDS = 100
"""Number of passes in which `spread_targets` moves all pairs of targets apart.

Example: for eight robots with targets in a row, 100 mm apart where 110 mm are kept, the two nearest
targets are 109.9 mm apart afterwards.
"""


def lost_command_deviation(speed: Floats, held_s: float) -> Floats:
    """Compute how far robots may leave their courses because of a lost command [length unit].

    Args:
        speed: Speeds [length unit/s], shape (N,).
        held_s: How long robots follow each command [s].
    """
    return LOST_FRACTION * speed * held_s


def target_separation(collision: Clearance, speed: Floats, held_s: float) -> float:
    """Compute the minimum distance between two targets, so that robots there do not touch.

    Args:
        collision: The distances that plans keep.
        speed: Speeds [length unit/s], shape (N,).
        held_s: How long robots follow each command [s].

    Returns:
        The distance [length unit]. It is 0 if robots may meet (`separation` 0), or if margins are
        not adapted to uncertainty (`adaptive` false).
    """
    if collision.separation == 0 or not collision.adaptive:
        return 0.0
    return collision.separation + 2 * float(lost_command_deviation(speed, held_s).max())


def spread_targets(targets: Floats, distance_min: float) -> Floats:
    """Move targets apart that are too close together, and return all targets, shape (N, 2).

    Each of two targets is moved by half of the missing distance. All pairs are moved in each of
    ROUNDS passes, so in a crowd the distances may stay slightly too small. Targets at the same
    point stay there, because no direction would be better than another.

    Args:
        targets: The targets, shape (N, 2). The array stays unchanged.
        distance_min: The minimum distance between two targets [length unit].
    """
    moved = targets.copy()
    for _ in range(ROUNDS):
        for i in range(1, len(moved)):
            for k in range(i):
                difference = moved[i] - moved[k]
                distance = float(elementwise.hypot(*difference))
                if 0 < distance < distance_min:
                    shift = (distance_min / distance - 1) / 2 * difference
                    moved[i] += shift
                    moved[k] -= shift
    return moved
