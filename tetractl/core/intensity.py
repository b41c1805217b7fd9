"""The intensity of the common signal: what a controller may choose besides the direction."""

from math import inf
from typing import NamedTuple


class Intensity(NamedTuple):
    """The intensity that a controller may choose, from `low` to `high` [`unit`]: the strength of
    the field, or the frequency with which it rotates, as its `name` says.

    Motions take an intensity over the `reference` [unit]: the strength at which robots turn at the
    rates a of the spec, 1 for a frequency. `gain` is the greatest turning rate over that a, inf if
    robots follow a direction at once.
    """

    name: str
    unit: str
    low: float
    high: float
    reference: float = 1.0
    gain: float = inf
