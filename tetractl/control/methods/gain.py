"""Check during a leg whether driving on still brings the robots nearer to their targets.

Every plan promises a small error at its end. If the model is wrong, the promise does not come true,
and new plans would be tried until the time limit. So the time of a leg is divided into windows, in
each of which a plan could lead to the targets. At the end of a window, what was promised is
compared with what came:

    promised = least error of all earlier windows - least error that plans have promised
    came     = least error of all earlier windows - least error in the window

Once robots have stood still, only errors at rest count, because a trial ends at rest. A window in
which they do not stand still then reaches nothing.

A window fails if less than half of the promise came true, and the robots do not follow the model:
the model did not fit and predictions were far off at some time after the first window. (In the
first one, the filters still learn.) After FAILED_MAX failed windows in a row, nothing is expected
of new plans: the robots stop as near as they came before, or at the end of their plan.

Lost commands and stuck robots also spoil plans. The filters recognise them, so that the model fits.

Lengths are in the spec's unit.
"""

from dataclasses import dataclass, replace
from math import inf

FAILED_MAX = 2
"""Number of windows in a row that have to fail until nothing is expected of new plans; chosen."""
WINDOW_MIN_S = 5.0
"""Minimum length of a window [s]: the time of one detour; chosen."""
CAME_TRUE = 0.5
"""Minimum fraction of a promise that has to come true; chosen."""
FAR_OFF = 3.0
"""Minimum deviation from predictions that is far off, in units of the spec's `accept_error`.

It is chosen. The deviations of all robots count together. Where a and speed wander by 10 %, they
are up to 2.5 times `accept_error`. Where the model has a wrong shape, they are mostly 3 to 7 times
(`benchmarks/wrong_shapes.py`).
"""


@dataclass(frozen=True, slots=True)
class Follows:
    """How robots follow the model in a control step.

    Attributes:
        fits: Whether the model fits.
        is_far_off: Whether they are far off their predictions.
    """

    fits: bool
    is_far_off: bool


@dataclass(frozen=True, slots=True)
class Gain:
    """The gain of a leg so far.

    Attributes:
        window_s: Length of each window [s]. 0 before the first step.
        ends_s: Time of the leg at which the present window ends [s].
        promised: Least error that a plan has promised in the present window.
        least: Least error in the present window while robots drove.
        least_at_rest: Least error in the present window while they stood still. inf if they did
            not.
        has_rested: Whether they stood still in an earlier window.
        was_far_off: Whether predictions were far off at some time after the first window.
        has_misfit: Whether the model did not fit at some time after the first window.
        least_before: Least error in all earlier windows. inf in the first one.
        failed: How many windows have failed, without one in between that did not fail. It stays
            FAILED_MAX once it is reached.
    """

    window_s: float = 0.0
    ends_s: float = 0.0
    promised: float = inf
    least: float = inf
    least_at_rest: float = inf
    has_rested: bool = False
    was_far_off: bool = False
    has_misfit: bool = False
    least_before: float = inf
    failed: int = 0

    @property
    def is_over(self) -> bool:
        """Whether nothing is expected of new plans."""
        return self.failed >= FAILED_MAX

    def begun(self, now_s: float, plan_s: float) -> "Gain":
        """Return the gain of a leg that begins now.

        Args:
            now_s: Time of the leg [s].
            plan_s: Time of the shortest plan that could lead to the targets [s].
        """
        window_s = max(plan_s, WINDOW_MIN_S)
        return Gain(window_s=window_s, ends_s=now_s + window_s)

    def after(
        self, now_s: float, error: float, rests: bool, promised: float, follows: Follows
    ) -> "Gain":
        """Return the gain after a control step.

        Args:
            now_s: Time of the leg [s].
            error: Total error of the robots now.
            rests: Whether they stand still now.
            promised: Total error that the step's plan promises at its end.
            follows: How they follow the model.
        """
        if self.is_over:
            return self
        is_first = self.least_before == inf
        present = replace(
            self,
            promised=min(self.promised, promised),
            least=min(self.least, inf if rests else error),
            least_at_rest=min(self.least_at_rest, error if rests else inf),
            was_far_off=self.was_far_off or (follows.is_far_off and not is_first),
            has_misfit=self.has_misfit or not (follows.fits or is_first),
        )
        if now_s < self.ends_s:
            return present
        rests_first = present.least_at_rest < inf and not self.has_rested
        return Gain(
            window_s=self.window_s,
            ends_s=self.ends_s + self.window_s,
            has_rested=self.has_rested or rests_first,
            was_far_off=present.was_far_off,
            has_misfit=present.has_misfit,
            least_before=min(present.reached, inf if rests_first else self.least_before),
            failed=self.failed + 1 if present.is_failure else 0,
        )

    @property
    def reached(self) -> float:
        """The error that the present window has reached."""
        stood = self.has_rested or self.least_at_rest < inf
        return self.least_at_rest if stood else self.least

    @property
    def is_failure(self) -> bool:
        """Whether the present window fails if it ends now."""
        if not (self.was_far_off and self.has_misfit):
            return False
        came = self.least_before - self.reached
        return came < CAME_TRUE * (self.least_before - self.promised)

    def describe(self, unit: str) -> str:
        """Describe why nothing is expected of new plans, with lengths in `unit`."""
        return (
            f"driving on gains too little: for {FAILED_MAX * self.window_s:.0f} s, the robots have "
            f"not come {'to rest ' if self.has_rested else ''}nearer than {self.least_before:.3g} "
            f"{unit}, all together. They do not move as the controller's model predicts"
        )


NOTHING_YET = Gain()
"""The gain when a leg begins."""
