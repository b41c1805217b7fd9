"""What is planned in one control step, in the order of the file: a `Problem`; within `Limits`, one
`Search` of the optimiser for each horizon; and the controller's `Decision`, which is a `Plan`, made
of the best search, or the `Outcome` of the trial.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from tetractl.core import elementwise
from tetractl.core.commands import Action, FieldOff, Steer, Stop, Turn
from tetractl.core.motion_estimate import Estimate
from tetractl.core.obstacles import Obstacles
from tetractl.core.poses import Bools, Floats, Poses


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """The problem of one control step for N robots; lengths in the spec's unit.

    Problems are compared by identity, so that a problem can be the key of a cache.
    """

    poses: Poses
    targets: Floats  # (N, 2)
    a: Floats  # (N,) [rad/s]
    speed: Floats  # (N,) [length unit/s]
    motion: str  # name of the model of the prediction
    period: float  # for which each signal is held but the first [s]
    first_period: float  # for which the first one is held [s]
    obstacles: Obstacles
    obstacle_weight: float  # omega_p of the paper's equation (7)
    swept: bool  # whether segments between predicted positions are tested, not only positions
    # distance that two robots are to keep between their centres at the predicted positions
    separation: float = 0.0
    bias: Floats | None = None  # (N,) added to the direction that a robot turns towards [rad]
    flow: Floats | None = None  # (N, 2) the drift that carries it [length unit/s]
    within: float | None = None  # distance of their targets within which robots are to stay
    # (N,) how robots turn (`tetractl.model.motion.turn_rate`); None for those that turn by (3)
    side: Floats | None = None
    saturation: Floats | None = None

    def only(self, chosen: Bools) -> "Problem":
        """Return the problem of the robots for which `chosen` (N,) is true."""
        if chosen.all():
            return self

        def of_chosen(values: Floats | None) -> Floats | None:
            return None if values is None else values[chosen]

        return replace(
            self,
            poses=Poses.of(self.poses.array()[chosen]),
            targets=self.targets[chosen],
            a=self.a[chosen],
            speed=self.speed[chosen],
            bias=of_chosen(self.bias),
            flow=of_chosen(self.flow),
            side=of_chosen(self.side),
            saturation=of_chosen(self.saturation),
        )

    @property
    def drift(self) -> Floats:
        """Return cos(bias), sin(bias) and x and y of the flow, as rows (4, N) for compiled code."""
        none = np.zeros(len(self.a))
        bias = none if self.bias is None else self.bias
        flow = (none, none) if self.flow is None else self.flow.T
        return np.array([elementwise.cos(bias), elementwise.sin(bias), *flow])

    def seconds(self, length: int) -> float:
        """Return the duration of a sequence of `length` signals [s]."""
        return self.first_period + (length - 1) * self.period


def never(evaluations: int) -> bool:
    """Return False: the default of `Limits.expired`, for no deadline."""
    return False


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits of one search.

    `evaluations` bounds the cost evaluations, None for no bound. Once `expired(spent)`, given the
    evaluations spent so far, is true, a search returns the best sequence so far.
    """

    evaluations: int | None = None
    expired: Callable[[int], bool] = never

    @property
    def timed(self) -> bool:
        """Whether there is a deadline."""
        return self.expired is not never

    def allow(self, evaluations: int) -> bool:
        """Return whether a search may use this many evaluations in total."""
        return self.evaluations is None or evaluations <= self.evaluations


class StopReason(StrEnum):
    """Why a search ended; the value is the text in a log."""

    CRITERION = "criterion"  # the stop criterion of the optimiser, such as (20)
    ITERATIONS = "iterations"  # the optimiser's limit of iterations was reached
    TARGET = "target"  # a cost that is good enough was found
    EVALUATIONS = "evaluations"  # the limit allows no further evaluation
    DEADLINE = "deadline"  # the deadline passed
    FIXED = "given"  # there was no search: the spec gives the sequence


@dataclass(frozen=True, slots=True)
class Search:
    """One search of the optimiser: one horizon in one control step.

    `length` counts signals; the paper's horizon is h = length - 1. `history[z]` is J(u_gb) after
    iteration z, and `history[0]` is J(u_gb) before the first (the paper's Figure 3). `stopped` is
    the reason why the search ended, or a text if a log of another version of tetractl gives a
    reason that is not a StopReason.
    """

    length: int
    signals: Floats = field(repr=False)  # (length,) rad
    cost: float  # J, (7)
    history: Floats = field(repr=False)  # (iterations + 1,)
    evaluations: int
    stopped: StopReason | str


class State(StrEnum):
    """What the robots do in a control step; the value is the text in a log."""

    DRIVING = "driving"  # they follow the plan
    RESTING = "resting"  # they stand; the next plan is for standing robots
    PASSING = "passing"  # they follow a plan that leads them through a passage one by one
    TURNING = "turning"  # they stand and turn on the spot
    HOLDING = "holding"  # they cannot stand, and stay near their targets
    STUCK = "stuck"  # they stand, and the trial ends: no candidate helps


PAUSE_S = 0.5
"""Time for which robots stand by a plan that pauses, in addition to one control period [s]."""


@dataclass(frozen=True, slots=True)
class Plan:
    """The decision by which a trial goes on: what is sent in a control step, and how it was found.

    What is sent is the direction signals[0], unless there is another action `instead`: a stop or a
    turn on the spot, for which robots pause, or a field that is off.
    """

    signals: Floats = field(repr=False)  # (L,) rad, the sequence chosen
    path: Floats = field(repr=False)  # (L + 1, N, 3), poses predicted, from where the plan starts
    cost: float  # target_cost + obstacle_weight * obstacle_cost, the paper's equation (7)
    target_cost: float
    obstacle_cost: float
    searches: tuple[Search, ...] = field(repr=False)  # of all horizons tried, in order
    chosen: int  # index of the best search, which found the signals
    generator: int  # the key of all random numbers of the step
    # that the plan was made with; None if the controller estimates nothing
    estimate: Estimate | None = field(default=None, repr=False)
    instead: Turn | Stop | FieldOff | None = None
    state: State = State.DRIVING
    delay_ns: int = 0  # from the decision until a pause begins
    leg: int = 0  # number of way-points passed; while robots hold, one more than there are
    # whatever else a controller says of the step, by a name that ends in its unit: "margin_mm"
    numbers: Mapping[str, float] = field(default_factory=dict, repr=False)

    @property
    def action(self) -> Action:
        """What is to be sent in this step."""
        return self.instead or Steer(float(self.signals[0]))

    @property
    def direction(self) -> float | None:
        """The direction to be sent in this step [rad], None if none is sent."""
        return float(self.signals[0]) if self.instead is None else None

    @property
    def pauses(self) -> bool:
        """Whether all robots stand for PAUSE_S, in place of driving; they may turn on the spot."""
        return isinstance(self.instead, Stop | Turn)

    @property
    def search(self) -> Search:
        """The search that found the chosen sequence."""
        return self.searches[self.chosen]

    @property
    def evaluations(self) -> int:
        """Number of cost evaluations of the whole control step."""
        return sum(search.evaluations for search in self.searches)

    def of_all(self, present: Bools, poses: Poses) -> "Plan":
        """Return the plan of the robots whose `present` (N,) is true as one of all N robots: in its
        path, those that are lost stay at their poses in `poses`."""
        if present.all():
            return self
        path = np.repeat(poses.array()[None], len(self.path), axis=0)
        path[:, present] = self.path
        return replace(self, path=path)


class Outcome(StrEnum):
    """How a trial ended."""

    ARRIVED = "arrived"  # at their targets
    SEQUENCE_COMPLETED = "sequence completed"  # every signal was sent
    NO_BETTER_PLAN = "no better plan"  # driving on would gain too little
    STEPS_MAX = "steps max"
    TIME_LIMIT = "time limit"
    INTERRUPTED = "interrupted"  # by a signal, such as Ctrl-C, or `tetractl lab stop`
    ABORTED = "aborted"  # by a fault or an error

    @property
    def complete(self) -> bool:
        """Whether the controller ended the trial, so that the trial's error counts."""
        return self not in (Outcome.INTERRUPTED, Outcome.ABORTED)


@dataclass(frozen=True, slots=True)
class End:
    """The decision to end a trial by a stop that is sent `delay_ns` after the decision."""

    outcome: Outcome
    delay_ns: int


Decision = Plan | Outcome | End
"""What a controller decides in a control step: a plan, or the end of the trial, at once by an
Outcome or later by an End."""
