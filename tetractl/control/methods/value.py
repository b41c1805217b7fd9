"""Compute the value by which the controller `mpc` compares the options in a control step.

An option, called a candidate, is a plan or a stop. `mpc` takes the candidate with the lowest value.
The value is an error [length unit]:

    V = J + attempt + price t + caution

    J        predicted total error at the candidate's end, f of the paper's (8)
    attempt  the expected cost of disturbances during a new attempt: a plan that leads the robots
             away from the plan under way. It starts at `accept` and doubles every `patience_s`,
             because a long trial is disturbed more. 0 for the plan under way and for a stop
    price t  the price of the time t until the robots stand still at the end
    caution  a penalty if the path touches a margin

`accept` is the spec's `accept_error`, the scale of all terms. A pause and a turn on the spot have
no value: they are what remains if no plan is safe (`mpc` and `turns`).
"""

from dataclasses import dataclass
from typing import ClassVar

from tetractl.core.elementary import LN_2, exp

PATIENCE_S = 80.0
"""Time in which `attempt` doubles [s].

docs/decisions/controller.md compares it with other values.
"""


@dataclass(frozen=True, slots=True)
class CandidateValues:
    """Computes the value of each candidate plan in a control step; the lowest value wins.

    Attributes:
        accept_error: The spec's `accept_error` [length unit].
        leg_time_s: Time since the leg began [s].
        period_s: Duration of each signal [s].
        patience_s: Time in which `attempt` doubles [s].
        time_price: Price of a second, in units of `accept_error`.
        touch_penalty: Penalty if a path touches a margin, in units of `accept_error`.
    """

    accept_error: float
    leg_time_s: float
    period_s: float
    patience_s: float = PATIENCE_S
    time_price: ClassVar[float] = 0.02
    touch_penalty: ClassVar[float] = 2.0

    def plan_value(self, error: float, length: int, is_new: bool, touches: bool = False) -> float:
        """Compute the value of a plan, from its predicted error, its duration and its risks.

        Args:
            error: Total error at the end of the plan [length unit].
            length: Number of signals of the plan.
            is_new: Whether the plan is a new attempt instead of the plan under way.
            touches: Whether the plan's path touches a margin.
        """
        attempt = exp(LN_2 * self.leg_time_s / self.patience_s) if is_new else 0.0
        time_price = self.time_price * self.period_s * length
        caution = self.touch_penalty if touches else 0.0
        return error + self.accept_error * (attempt + time_price + caution)
