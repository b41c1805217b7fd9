"""The controller's estimate of how the robots move, which it learns while they move.

The filters (`tetractl.control.estimation.filter`) update the estimate at every control step. Plans
use it, logs contain it, and the operator gets a message if the robots' motion contradicts it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from tetractl.core.poses import Bools, Floats

STANDS_PROBABILITY = 0.9
"""Probability above which a robot counts as standing still.

In simulations, 170 of 176 robots that stuck at frame rates of 5 and 20 Hz reached this probability.
If ten images a second arrived 0.06 s late, 3 of 67 false alarms reached it
(`benchmarks/unmodelled.py`: `sticking`, `sticking-5hz` and `slow-pictures`).
"""

INNOVATIONS = "along-track motion", "cross-track motion", "heading"
"""The prediction errors in the columns of `Estimate.misfit`.

They are the errors of the position along and across the course, and of the heading.
"""
TURNING_INNOVATIONS = INNOVATIONS[2:]
"""The innovation of the heading, which depends on a robot's turning rate."""
POSITION_INNOVATIONS = INNOVATIONS[:2]
"""The innovations of the position."""
LAG_ERROR_S = 0.02
"""Minimum error of the spec's wheel lag that is reported to the operator [s].

docs/decisions/plant.md shows what such an error costs.
"""


@dataclass(frozen=True, slots=True)
class PredictionErrors:
    """The recent differences between the measured and the predicted poses of N robots.

    Attributes:
        ahead_s: Maximum time by which the poses were predicted in advance [s].
        mean: Mean deviations of a robot from its prediction, shape (N, 3), in the order of
            INNOVATIONS: ahead of it and to the left of it [length unit], and turned to the left of
            it [rad].
        rms: Root mean squares of the same deviations, shape (N, 3).
        late_s: By how much each robot turns later than predicted [s], shape (N,). NaN if a delay
            does not explain the deviations of its heading.
        extra_turn: Fraction by which each robot turns more than predicted, shape (N,). NaN if that
            does not explain the deviations of its heading.
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

    def list_standing(self, names: Sequence[str]) -> list[str]:
        """List the names of robots that almost certainly stand still although they should drive.

        The list is empty if `stands` is not estimated.

        Args:
            names: Names of the robots.
        """
        probabilities = [] if self.stands is None else self.stands.tolist()
        return [
            name
            for name, probability in zip(names, probabilities, strict=False)
            if probability > STANDS_PROBABILITY
        ]

    @property
    def fits(self) -> bool:
        """Whether the model explains all parts of the motion. True if the fit is not tested."""
        return self.misfit is None or bool((self.misfit <= 1).all())

    def list_unexplained(self, names: Sequence[str], parts: Sequence[str]) -> set[str]:
        """List the parts of the motion that the model fails to explain, such as "heading of red".

        If the heading is unexplained, the turning rate `a` may be wrong by more than its standard
        deviation. If the position is unexplained, the standard deviations already include that
        error (docs/decisions/filter.md). The result is empty if the fit is not tested.

        Args:
            names: Names of the robots.
            parts: The parts to consider: TURNING_INNOVATIONS or POSITION_INNOVATIONS.
        """
        if self.misfit is None:
            return set()
        unexplained: set[str] = set()
        for part in parts:
            misfits = self.misfit[:, INNOVATIONS.index(part)].tolist()
            unexplained |= {
                f"{part} of {name}"
                for name, misfit in zip(names, misfits, strict=True)
                if misfit > 1
            }
        return unexplained

    def select_robots(self, chosen: Bools) -> "Estimate":
        """Return the estimate for some of the robots.

        Quantities that are unknown, or common to all robots, stay as they are.

        Args:
            chosen: Which robots to keep, shape (N,).
        """
        if chosen.all():
            return self
        values = {quantity.name: getattr(self, quantity.name) for quantity in fields(self)}
        chosen_values = {
            name: value[chosen] for name, value in values.items() if isinstance(value, np.ndarray)
        }
        return replace(self, **chosen_values)
