"""The controller's estimate of how the robots move, which it learns while they move.

The filters update the estimate at every control step (`tetractl.control.estimation.filter`). Plans
use it, logs contain it, and the operator gets a message if something contradicts it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from tetractl.core.poses import Bools, Floats

STANDS_PROBABILITY = 0.9
"""Probability above which a robot counts as standing still.

In simulations, 170 of 176 robots that stuck at frame rates of 5 and 20 Hz reached it. Where ten
images a second arrived 0.06 s late, 3 of 67 false alarms reached it (`benchmarks/unmodelled.py`:
`sticking`, `sticking-5hz` and `slow-pictures`).
"""

INNOVATIONS = "along-track motion", "cross-track motion", "heading"
"""What the columns of `Estimate.misfit` are about: motion along and across the course, heading."""
OF_TURNING = INNOVATIONS[2:]
OF_PLACES = INNOVATIONS[:2]
"""The innovations of the position. OF_TURNING is the one that a turning rate determines."""
LAG_ERROR_S = 0.02
"""Minimum error of the spec's lag of the wheels that is reported [s].

docs/decisions/plant.md shows what such an error costs.
"""


@dataclass(frozen=True, slots=True)
class PredictionErrors:
    """How far N robots have lately been from where the model predicted them.

    Attributes:
        ahead_s: Time over which they were predicted, at most [s].
        mean: Mean deviations of a robot from its prediction, shape (N, 3), in the order of
            INNOVATIONS: ahead of it and to the left of it [length unit], and turned to the left of
            it [rad].
        rms: Root mean squares of the same deviations, shape (N, 3).
        late_s: By how much a robot turns later than predicted [s], shape (N,). NaN if that does not
            explain the deviations of its heading.
        extra_turn: Fraction by which a robot turns more than predicted, shape (N,). NaN likewise.
    """

    ahead_s: float
    mean: Floats
    rms: Floats
    late_s: Floats
    extra_turn: Floats


@dataclass(frozen=True, slots=True)
class Estimate:
    """A controller's estimate of the motion of N robots.

    Fields that end in `_std` are standard deviations. Except for `a` and `speed`, a field is None
    if its quantity is not estimated.

    Attributes:
        a: Turning rates used for the plan [rad/s], shape (N,).
        speed: Speeds used for the plan [length unit/s], shape (N,).
        heading_bias: Heading that each robot turns to, minus the direction sent [rad], shape (N,).
        dead_time: Time from sending a direction until it acts [s], the same for all robots.
        misfit: How strongly the prediction errors deviate from independence, shape (N, 3), in the
            order of INNOVATIONS. Above 1, the model does not fit at the level 0.001. None if it is
            not tested.
        side: The k of robots that turn by a exp(k) to the left and a exp(-k) to the right, shape
            (N,).
        saturation: Maximum turning rate, divided by the larger of these two rates, shape (N,).
        stands: Probability that a robot stands still although it receives a direction, shape (N,).
            It may be stuck; a cell may also rest, or back off and turn.
        lag: Time constant with which the wheels of each robot follow commands [s], shape (N,).
        own_dead_time: Dead time of each robot [s], shape (N,). Logs do not contain it.
        predictions: How far predictions have been off lately. None if the model has always fitted.
            Logs do not contain it.

    To add a quantity to the filters, add a field here and to `Forecast`
    (`control/estimation/kernels/filter_state`), and compute it in `kernels/bank` and its oracle. To
    log it, add a field to the message in `log/format/tetractl.proto`, and write and read it in
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
    lag: Floats | None = None
    lag_std: Floats | None = None
    own_dead_time: Floats | None = field(default=None, compare=False)
    own_dead_time_std: Floats | None = field(default=None, compare=False)
    predictions: PredictionErrors | None = field(default=None, compare=False)

    @property
    def common_lag(self) -> float | None:
        """Lag of the wheels that a host should assume for all robots [s].

        It is the mean of the robots' lags. None if the lag is not estimated.
        """
        return None if self.lag is None else float(self.lag.mean())

    def standing(self, names: Sequence[str]) -> list[str]:
        """List the names of robots that almost certainly stand still though they should drive.

        The list is empty if `stands` is not estimated.

        Args:
            names: Names of the robots.
        """
        probabilities = [] if self.stands is None else self.stands.tolist()
        return [
            name for name, p in zip(names, probabilities, strict=False) if p > STANDS_PROBABILITY
        ]

    @property
    def fits(self) -> bool:
        """Whether the model explains all parts of the motion, or the fit is not tested."""
        return self.misfit is None or bool((self.misfit <= 1).all())

    def unexplained(self, names: Sequence[str], parts: Sequence[str]) -> set[str]:
        """List the parts of the motion that the model fails to explain, as "heading of red".

        If a part OF_TURNING is unexplained, a may be wrong by more than its standard deviation. If
        a part OF_PLACES is unexplained, the standard deviations already include that error
        (docs/decisions/filter.md). The result is empty if the fit is not tested.

        Args:
            names: Names of the robots.
            parts: The parts to consider: OF_TURNING or OF_PLACES.
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
        """Return the estimates of the robots for which `chosen` (N,) is true.

        Quantities that are unknown, or are not per robot, stay as they are.
        """
        if chosen.all():
            return self
        values = {quantity.name: getattr(self, quantity.name) for quantity in fields(self)}
        chosen_values = {name: v[chosen] for name, v in values.items() if isinstance(v, np.ndarray)}
        return replace(self, **chosen_values)
