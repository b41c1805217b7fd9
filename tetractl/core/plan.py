"""The records of planning in one control step, from the problem to the decision.

The optimiser solves a `Problem` within the `Limits` of a search. It leaves a record, a `Search`,
for each horizon. The controller's `Decision` is a `Plan` made from the best search, or the
`Outcome` of the trial.
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
    """The planning problem that the optimiser solves in one control step, for N robots.

    Lengths are in the spec's unit. Problems are compared by identity, so that a problem can be the
    key of a cache.

    Attributes:
        poses: Poses from which the prediction starts.
        targets: Positions to which the robots are to go, shape (N, 2).
        a: Turning rate of each robot [rad/s], shape (N,).
        speed: Speed of each robot [length unit/s], shape (N,).
        motion: Name of the motion model used for the prediction.
        period: How long each signal except the first is held [s].
        first_period: How long the first signal is held [s].
        obstacles: Obstacles to avoid.
        obstacle_weight: Weight omega_p in the paper's equation (7).
        swept: Whether the segments between predicted positions are tested, not only the positions.
        separation: Minimum distance between the centres of two robots at the predicted positions.
        bias: Angle added to the direction that each robot turns towards [rad], shape (N,). None if
            all are 0.
        flow: Drift that carries each robot [length unit/s], shape (N, 2). None if there is none.
        within: Distance from their targets within which robots are to stay. None if they need not.
        side: How unequally each robot turns left and right, shape (N,), as in
            `tetractl.model.motion.turn_rate`. None for robots that turn by equation (3).
        saturation: At which rate each robot's turning saturates, shape (N,), as in the same module.
            None for robots that turn by equation (3).
    """

    poses: Poses
    targets: Floats
    a: Floats
    speed: Floats
    motion: str
    period: float
    first_period: float
    obstacles: Obstacles
    obstacle_weight: float
    swept: bool
    separation: float = 0.0
    bias: Floats | None = None
    flow: Floats | None = None
    within: float | None = None
    side: Floats | None = None
    saturation: Floats | None = None

    def select_robots(self, chosen: Bools) -> "Problem":
        """Return the planning problem for some of the robots.

        Args:
            chosen: Which robots to keep, shape (N,).
        """
        if chosen.all():
            return self

        def select(values: Floats | None) -> Floats | None:
            return None if values is None else values[chosen]

        return replace(
            self,
            poses=Poses.from_array(self.poses.array()[chosen]),
            targets=self.targets[chosen],
            a=self.a[chosen],
            speed=self.speed[chosen],
            bias=select(self.bias),
            flow=select(self.flow),
            side=select(self.side),
            saturation=select(self.saturation),
        )

    @property
    def drift(self) -> Floats:
        """The bias and the flow of each robot in one array, for compiled code, shape (4, N).

        The rows are cos(bias), sin(bias), x of the flow and y of the flow.
        """
        zeros = np.zeros(len(self.a))
        bias = zeros if self.bias is None else self.bias
        flow = (zeros, zeros) if self.flow is None else self.flow.T
        return np.array([elementwise.cos(bias), elementwise.sin(bias), *flow])

    def seconds(self, length: int) -> float:
        """Compute the duration of a sequence with `length` signals, at least one [s]."""
        return self.first_period + (length - 1) * self.period


def never_expires(evaluations: int) -> bool:
    """Return False, because by default a search has no deadline. See `Limits.expired`."""
    return False


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits at which a search has to end early.

    Attributes:
        evaluations: Maximum number of cost evaluations. None for no limit.
        expired: Called with the number of evaluations so far. Once it returns True, the search
            returns the best sequence found so far.
    """

    evaluations: int | None = None
    expired: Callable[[int], bool] = never_expires

    @property
    def timed(self) -> bool:
        """Whether the search has a deadline.

        A maximum number of evaluations is not a deadline.
        """
        return self.expired is not never_expires

    def allow(self, evaluations: int) -> bool:
        """Decide whether a search may use this many evaluations in total."""
        return self.evaluations is None or evaluations <= self.evaluations


class StopReason(StrEnum):
    """The reasons why an optimiser's search ends. The value is the string in a log."""

    CRITERION = "criterion"  # the stop criterion of the optimiser, such as (20)
    ITERATIONS = "iterations"  # the optimiser's limit of iterations was reached
    TARGET = "target"  # a cost that is good enough was found
    EVALUATIONS = "evaluations"  # the limit allows no further evaluation
    DEADLINE = "deadline"  # the deadline passed
    FIXED = "given"  # there was no search: the spec gives the sequence


@dataclass(frozen=True, slots=True)
class Search:
    """The record of one search of the optimiser: one horizon in one control step.

    Attributes:
        length: Number of signals. The paper's horizon is h = length - 1.
        signals: The best sequence found [rad], shape (length,).
        cost: Its cost J, equation (7).
        history: Cost J(u_gb) of the best sequence after each iteration, shape (iterations + 1,).
            `history[0]` is the cost before the first iteration. See the paper's Figure 3.
        evaluations: Number of cost evaluations.
        stopped: Why the search ended. It is a plain string if a log of another version of tetractl
            gives a reason that StopReason lacks.
    """

    length: int
    signals: Floats = field(repr=False)
    cost: float
    history: Floats = field(repr=False)
    evaluations: int
    stopped: StopReason | str


class State(StrEnum):
    """The states of robots in a control step, such as driving or standing still (`RESTING`).

    The value is the string in a log.
    """

    DRIVING = "driving"
    RESTING = "resting"
    PASSING = "passing"
    TURNING = "turning"
    HOLDING = "holding"
    STUCK = "stuck"


PAUSE_S = 0.5
"""How long robots stand still in a pause, in addition to one control period [s]."""


@dataclass(frozen=True, slots=True)
class Plan:
    """A decision to continue the trial: what to send in this control step, and how it was found.

    The plan sends the direction `signals[0]`, unless `instead` holds another action.

    Attributes:
        signals: The chosen sequence of directions [rad], shape (L,).
        path: Predicted poses, shape (L + 1, N, 3), beginning where the plan starts.
        cost: target_cost + obstacle_weight * obstacle_cost, the paper's equation (7).
        target_cost: The part of the cost that measures the distances to the targets.
        obstacle_cost: The part of the cost that measures contacts with obstacles.
        searches: The searches of all horizons tried, in order.
        chosen: Index of the search that found the chosen sequence.
        generator: Key of all random numbers in this step.
        estimate: The estimate that the plan was made with. None if the controller estimates
            nothing.
        instead: An action to send instead of a direction: a stop or a turn on the spot, during
            which robots pause, or a field that is off. None to send the direction.
        state: What the robots do.
        delay_ns: Time from the decision until a pause begins [ns].
        leg: Number of way-points passed. While robots hold, one more than there are way-points.
        numbers: Anything else that a controller reports about the step. Each name ends with its
            unit, such as "margin_mm".
    """

    signals: Floats = field(repr=False)
    path: Floats = field(repr=False)
    cost: float
    target_cost: float
    obstacle_cost: float
    searches: tuple[Search, ...] = field(repr=False)
    chosen: int
    generator: int
    estimate: Estimate | None = field(default=None, repr=False)
    instead: Turn | Stop | FieldOff | None = None
    state: State = State.DRIVING
    delay_ns: int = 0
    leg: int = 0
    numbers: Mapping[str, float] = field(default_factory=dict, repr=False)

    @property
    def action(self) -> Action:
        """The action of this control step: `instead`, or else the direction `signals[0]`."""
        lag_s = None if self.estimate is None else self.estimate.common_lag
        return self.instead or Steer(float(self.signals[0]), lag_s)

    @property
    def direction(self) -> float | None:
        """The direction to send in this step [rad]. None if no direction is sent."""
        return float(self.signals[0]) if self.instead is None else None

    @property
    def pauses(self) -> bool:
        """Whether all robots pause for PAUSE_S instead of driving. They may turn on the spot."""
        return isinstance(self.instead, Stop | Turn)

    @property
    def search(self) -> Search:
        """The search whose sequence of signals the plan follows."""
        return self.searches[self.chosen]

    @property
    def evaluations(self) -> int:
        """Number of cost evaluations in all searches of this control step."""
        return sum(search.evaluations for search in self.searches)

    def extend_to_all(self, present: Bools, poses: Poses) -> "Plan":
        """Return the plan with a path for all N robots, instead of only those that are present.

        Args:
            present: Which robots the plan was made for, shape (N,).
            poses: Poses of all robots. In the plan's path, lost robots stay at these poses.
        """
        if present.all():
            return self
        path = np.repeat(poses.array()[None], len(self.path), axis=0)
        path[:, present] = self.path
        return replace(self, path=path)


class Outcome(StrEnum):
    """The outcomes of a trial, such as arrival, the time limit or an abort."""

    ARRIVED = "arrived"  # at their targets
    SEQUENCE_COMPLETED = "sequence completed"  # every signal was sent
    NO_BETTER_PLAN = "no better plan"  # driving on would gain too little
    STEPS_MAX = "steps max"
    TIME_LIMIT = "time limit"
    INTERRUPTED = "interrupted"  # by a signal, such as Ctrl-C, or `tetractl lab stop`
    ABORTED = "aborted"  # by a fault or an error

    @property
    def complete(self) -> bool:
        """Whether the controller ended the trial, so that the trial's error counts.

        False after an interruption or an abort.
        """
        return self not in (Outcome.INTERRUPTED, Outcome.ABORTED)


@dataclass(frozen=True, slots=True)
class End:
    """A decision to end the trial with a stop that is sent `delay_ns` after the decision."""

    outcome: Outcome
    delay_ns: int


Decision = Plan | Outcome | End
"""The decision of a controller in a control step: a plan, or the end of the trial.

An Outcome ends the trial at once. An End ends it after a delay.
"""
