"""Converts a field's direction and strength to the currents of two orthogonal coil pairs, and back.

Along its own axis a coil pair adds gain * current to the ambient field, `offset`: with the x pair's
axis turned by `rotation` from the spec's x axis and c the field in the axes of the coils,

    c = offset + gain * current,    field = R(rotation) c.
"""

import math
from dataclasses import dataclass

Pair = tuple[float, float]  # x and y, in the coils' axes for currents and in the spec's for fields


@dataclass(frozen=True, slots=True)
class Coils:
    """Two orthogonal coil pairs: `gain` [mT/A], negative if a winding is reversed, and `offset`,
    the ambient field along each axis [mT]; `rotation` [rad]; greatest current of each [A], at least
    enough to cancel the ambient field.
    """

    gain: Pair
    offset: Pair
    rotation: float
    current_max_a: float

    def reach(self, direction: float) -> float:
        """Return the greatest strength [mT] in a direction [rad] within the current limit."""
        strength = math.inf
        for axis, gain, offset in zip(self._axes(direction), self.gain, self.offset, strict=True):
            room = abs(gain) * self.current_max_a + math.copysign(offset, offset * axis)
            if axis:
                strength = min(strength, room / abs(axis))
        return strength

    def least_reach(self) -> float:
        """Return the strength [mT] that is available in every direction."""
        rooms = zip(self.gain, self.offset, strict=True)
        return min(abs(gain) * self.current_max_a - abs(offset) for gain, offset in rooms)

    def currents(self, direction: float, strength: float) -> Pair:
        """Return the currents [A] of a field: direction [rad], strength [mT].

        If a current would exceed its limit, the strength is reduced and the direction kept.
        """
        strength = min(strength, self.reach(direction))
        x, y = (
            (strength * axis - offset) / gain
            for axis, gain, offset in zip(
                self._axes(direction), self.gain, self.offset, strict=True
            )
        )
        return x, y

    def field(self, currents: Pair) -> Pair:
        """Return the field of two currents [A] in the spec's axes [mT]."""
        x, y = (
            offset + gain * current
            for gain, offset, current in zip(self.gain, self.offset, currents, strict=True)
        )
        cos, sin = math.cos(self.rotation), math.sin(self.rotation)
        return cos * x - sin * y, sin * x + cos * y

    def _axes(self, direction: float) -> Pair:
        """Return the unit vector of a direction in the axes of the coils."""
        return math.cos(direction - self.rotation), math.sin(direction - self.rotation)


def approach(now: Pair, wished: Pair, step: float) -> Pair:
    """Return `now` moved along a straight line towards `wished`, each component by at most
    `step`.
    """
    dx, dy = wished[0] - now[0], wished[1] - now[1]
    peak = max(abs(dx), abs(dy))
    if peak <= step:
        return wished
    return now[0] + dx * step / peak, now[1] + dy * step / peak
