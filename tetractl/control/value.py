"""What a candidate of a control step is worth: the one value by which `mpc` decides.

The value of a candidate is an error [length unit], the less the better:

    V = J + attempt + price t + caution

    J        predicted total error at the candidate's end, f of the paper's (8)
    attempt  what disturbances make of a new attempt, in other words of a plan that leads the robots
             away from the plan under way: `accept` at first. It doubles every PATIENCE_S, because a
             trial that lasts long is disturbed much. 0 for the plan under way and for a stop
    price t  the price of the time t until the robots stand at the end
    caution  if the path touches a margin, or if robots that receive nothing might touch something

`accept` is the spec's `accept_error`, the scale of all of them.
"""

from dataclasses import dataclass

PATIENCE_S = 80.0  # time in which `attempt` doubles
PRICE = 0.02  # price of a second, in units of `accept`
TOUCHES, UNHEARD = 2.0, 1.5  # caution, in units of `accept`


@dataclass(frozen=True, slots=True)
class Worth:
    """The values of the candidates of a control step `spent_s` after the leg began; each signal
    lasts `period_s`.
    """

    accept: float
    spent_s: float
    period_s: float

    def plan(
        self, error: float, length: int, new: bool, touches: bool = False, unheard: bool = False
    ) -> float:
        """Return the value of a plan of `length` signals that ends with the total `error`."""
        attempt = 2 ** (self.spent_s / PATIENCE_S) if new else 0.0
        caution = TOUCHES * touches + UNHEARD * unheard
        return error + self.accept * (attempt + PRICE * self.period_s * length + caution)

    def rest(self, length: int, wait_s: float) -> float:
        """Return the value of a rest that ends with a plan of `length` signals in `wait_s`; whether
        robots of that plan keep clear is not known."""
        return self.plan(0.0, length, True, unheard=True) + self.accept * PRICE * wait_s
