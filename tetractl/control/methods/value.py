"""What a candidate of a control step is worth: the one value by which `mpc` decides.

The value of a candidate is an error [length unit], the less the better:

    V = J + attempt + price t + caution

    J        predicted total error at the candidate's end, f of the paper's (8)
    attempt  what disturbances make of a new attempt, in other words of a plan that leads the robots
             away from the plan under way: `accept` at first. It doubles every `patience_s`, because
             a trial that lasts long is disturbed much. 0 for the plan under way and for a stop
    price t  the price of the time t until the robots stand at the end
    caution  if the path touches a margin

`accept` is the spec's `accept_error`, the scale of all of them. A rest and a turn on the spot have
no value: they are what is left if no plan is safe (`mpc`, and `turns` on the spot).
"""

from dataclasses import dataclass
from typing import ClassVar

from tetractl.core.elementary import LN_2, exp

PATIENCE_S = 80.0
"""Time in which `attempt` doubles [s]; docs/decisions/controller.md has trials with others."""


@dataclass(frozen=True, slots=True)
class Worth:
    """The values of the candidates of a control step `spent_s` after the leg began; each signal
    lasts `period_s`. `attempt` doubles in `patience_s`."""

    accept: float
    spent_s: float
    period_s: float
    patience_s: float = PATIENCE_S
    price: ClassVar[float] = 0.02  # of a second, in units of `accept`
    touch: ClassVar[float] = 2.0  # caution if a path touches a margin, in units of `accept`

    def plan(self, error: float, length: int, new: bool, touches: bool = False) -> float:
        """Return the value of a plan of `length` signals that ends with the total `error`."""
        attempt = exp(LN_2 * self.spent_s / self.patience_s) if new else 0.0
        price = self.price * self.period_s * length
        caution = self.touch if touches else 0.0
        return error + self.accept * (attempt + price + caution)
