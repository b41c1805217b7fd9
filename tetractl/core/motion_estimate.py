"""What a controller has learnt of the robots' motion while they moved.

The filters say it at every control step (`tetractl.control.estimation.filter`). Plans are made with
it, logs keep it, and messages for the operator say what does not fit it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from tetractl.core.poses import Bools, Floats

STANDS_PROBABILITY = 0.9
"""Probability above which a robot counts as standing. Of robots that stuck at 5 and 20 Hz, 170 of
176 stands reached it; where ten pictures a second came 0.06 s late, 3 of 67 false ones did, all
simulated (`benchmarks/unmodelled.py`, `sticking`, `sticking-5hz` and `slow-pictures`)."""

INNOVATIONS = "along-track motion", "cross-track motion", "heading"
"""What the columns of `Estimate.misfit` are about."""
OF_TURNING = INNOVATIONS[2:]
OF_PLACES = INNOVATIONS[:2]
"""Those that a turning rate determines, and the others."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A controller's estimates of N robots while they move, with standard deviations, named
    `..._std`.

    `a` (N,) [rad/s] and `speed` (N,) [length unit/s] are the values used for the plan.
    `heading_bias` (N,) [rad] is the heading that a robot turns to minus the direction sent.
    `dead_time` [s] is the time from the sending of a direction to the moment when it acts, for all
    robots. `heading_bias` and `dead_time` are None if they are not estimated. `misfit` (N, 3) is
    how far from independent the errors of the predictions are, in the order of INNOVATIONS: above
    1, the model does not fit at the level 0.001. None if it is not tested. `side` (N,) is the k of
    a robot that turns by a exp(k) to the left and a exp(-k) to the right, and `saturation`
    (N,) its greatest turning rate over the greater of these. `stands` (N,) is the probability that
    a robot stands although it is sent a direction: it is stuck, or a cell rests, or backs off and
    turns. `own_dead_time` (N,) [s] is the dead time of each robot, which no log has. None if they
    are not estimated.

    A new number of the filters is a field here and of `Forecast`
    (`control/estimation/kernels/filter_state`), which `kernels/bank` and its oracle compute; logs
    keep it as a field of the message in `log/format/tetractl.proto`, written and read in
    `codec.py`.
    """

    a: Floats
    a_std: Floats
    speed: Floats
    speed_std: Floats
    heading_bias: Floats | None = None
    heading_bias_std: Floats | None = None
    dead_time: float | None = None
    dead_time_std: float | None = None
    misfit: Floats | None = None
    side: Floats | None = None
    side_std: Floats | None = None
    saturation: Floats | None = None
    stands: Floats | None = None
    own_dead_time: Floats | None = field(default=None, compare=False)
    own_dead_time_std: Floats | None = field(default=None, compare=False)

    def standing(self, names: Sequence[str]) -> list[str]:
        """Return the robots, of these `names`, that surely stand although they are to drive."""
        probabilities = [] if self.stands is None else self.stands.tolist()
        return [
            name for name, p in zip(names, probabilities, strict=False) if p > STANDS_PROBABILITY
        ]

    def unexplained(self, names: Sequence[str], parts: Sequence[str]) -> set[str]:
        """Return what the model does not explain, such as "heading of red", of the parts OF_TURNING
        or OF_PLACES.

        Where a motion OF_TURNING is not explained, a may be wrong by more than its deviation. Where
        one OF_PLACES is not, deviations have grown by it, and a holds within its own
        (docs/decisions/filter.md).
        """
        if self.misfit is None:
            return set()
        unexplained: set[str] = set()
        for part in parts:
            of_robots = self.misfit[:, INNOVATIONS.index(part)].tolist()
            unexplained |= {
                f"{part} of {name}"
                for name, misfit in zip(names, of_robots, strict=True)
                if misfit > 1
            }
        return unexplained

    def only(self, chosen: Bools) -> "Estimate":
        """Return the estimates of the robots for which `chosen` (N,) is true."""
        if chosen.all():
            return self
        values = {quantity.name: getattr(self, quantity.name) for quantity in fields(self)}
        chosen_values = {name: v[chosen] for name, v in values.items() if isinstance(v, np.ndarray)}
        return replace(self, **chosen_values)
