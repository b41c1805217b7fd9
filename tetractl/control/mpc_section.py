"""The fields of model predictive control in a spec; `tetractl.control.mpc` builds from them."""

from collections.abc import Iterator
from typing import Annotated, Literal, Self

from pydantic import Field, PositiveInt, model_validator

from tetractl.control.prior import Prior, nothing
from tetractl.core.plan import Problem
from tetractl.core.poses import Poses
from tetractl.core.registries import MOTIONS, OPTIMIZERS
from tetractl.core.setup import Setup
from tetractl.experiment.base import Model, NonNegative, Positive, inconsistent
from tetractl.experiment.controller import ControllerSection, OptimizerSection
from tetractl.experiment.registry_fields import KindName, KindSection
from tetractl.experiment.yaml.problems import Loc
from tetractl.model.obstacles import Obstacles
from tetractl.model.swimmers import HELIX_HZ, HELIX_UM

FLOW = 0.05  # default standard deviation of a component of the flow, over the mean speed
DEADLINE = 0.8  # default deadline of a control step's searches, as a fraction of its period
_OPTIMIZER = KindSection(OPTIMIZERS, default="pso")


class Collision(Model):
    """How the planner decides that a robot collides with an obstacle, a wall or another robot."""

    test: Literal["samples", "swept"] = "samples"
    """`samples` tests the predicted positions, as the paper's equation (13) does; `swept` tests the
    straight segments between them."""
    margin: NonNegative = 0.0
    """Distance by which obstacles are grown for the planner [length unit]."""
    walls: bool = False
    """Whether leaving the arena counts as entering an obstacle."""
    radius: NonNegative = 0.0
    """Radius of a robot, by which obstacles are grown as well [length unit]; 0 for points."""
    separation: NonNegative = 0.0
    """Least distance of the centres of two robots in the plan [length unit]; 0 for robots that may
    meet. The distance is tested at the predicted positions."""
    adaptive: bool = False
    """Whether the margin grows by a robot's greatest deviation from its course before the next
    command acts, given the uncertainty of its motion. If a robot or target is within the margin,
    the margin is reduced to its distance.
    """
    stop_before_collision: bool = False
    """Whether all robots pause if the best plan found touches an obstacle or its margin and a robot
    is about to enter one, or if no plan within `accept_error` keeps clear. When they stand, a new
    plan is searched. If they cannot drive ahead safely, they turn on the spot first; the trial ends
    if no turn helps. With an `accept_error`, robots also pause at the end, and drive on if their
    total error at rest is larger. Only for robots that can stand still, which have `wheels`."""
    silence: NonNegative = 0.0
    """Time for which robots may receive no command and keep their direction [s]. The planner
    prefers plans in which robots keep clear even if this happens after any one of the signals.
    """


class PriorSection(Model):
    """Prior standard deviations of the motion's values in the spec."""

    a: Positive = 0.2
    """Relative standard deviation of each robot's turning rate a."""
    speed: Positive = 0.15
    """Relative standard deviation of each robot's speed."""
    dead_time: Positive = 0.1
    """Standard deviation of the dead time [s]."""
    heading_bias: Positive = 0.05
    """Standard deviation of the angle between the direction sent and the direction that a robot
    turns towards [rad]."""
    marker_bias: NonNegative = 0.05
    """Standard deviation of the angle between the measured heading and the course [rad]."""
    flow: NonNegative | None = None
    """Standard deviation of each component of the flow that carries a robot, or of its slide
    [length unit/s]; by default a twentieth of the robots' mean speed."""
    position_noise: NonNegative = 0.0
    """Standard deviation of a measured position [length unit]; 0 if unknown."""
    heading_noise: NonNegative = 0.0
    """Standard deviation of a measured heading [rad]; 0 if unknown."""

    def of(self, problem: Problem, dead_time: float, setup: Setup) -> Prior:
        """Return the prior of a problem's robots; those without wheels are taken for cells."""
        return Prior(
            a=problem.a,
            speed=problem.speed,
            dead_time=dead_time,
            a_std=self.a,
            speed_std=self.speed,
            dead_time_std=self.dead_time,
            heading_bias_std=self.heading_bias,
            marker_bias_std=self.marker_bias,
            flow_std=FLOW * float(problem.speed.mean()) if self.flow is None else self.flow,
            position_noise=self.position_noise,
            heading_noise=self.heading_noise,
            helix_frequency=HELIX_HZ[0],
            helix_radius=HELIX_UM[0] * 1e-6 / setup.metres if setup.wheel_radius is None else 0.0,
            lag=setup.lag_s,
        )


class MpcFields(ControllerSection):
    """The fields of model predictive control, with the paper's defaults."""

    hold: PositiveInt = 1
    """Number of control periods for which a plan holds each signal. The plan's time grid is `hold`
    times coarser than the control's, and a signal can still be changed at each control step."""
    motion: Annotated[str, KindName(MOTIONS)] = "euler"
    """Predicted motion, by equations of the paper: `euler` is (4)-(6); `arc` holds the wheel speeds
    of (24)-(25) over a period; `exact` is the closed form of (1)-(3) under a held direction."""
    estimate: bool = False
    """Whether turning rate a, speed and heading bias of each robot, and their common dead time, are
    identified while they drive, starting from the spec's values.
    """
    prior: PriorSection = PriorSection()
    """The prior uncertainty of the identified values."""
    accept_error: NonNegative = 0.0
    """Total error to accept [length unit]. If no sequence about as long as the present plan ends
    within this error, longer ones (detours) are searched, and the trial ends if stopping leaves at
    most this error and is as good as any plan. A smaller value makes trials longer. Each detour
    near the end of a plan raises the accepted error by a tenth; after half of the steps the
    accepted error grows up to fourfold; when too few steps for a detour are left, any error is
    accepted. With 0, as in Algorithm 2, a trial ends only at the end of its sequence. The default
    of `mpc` is 0.45 of the path that all robots together drive in a control period."""
    stop_between: bool = False
    """Whether the stop may come between two control steps, at the moment that leaves the least
    error."""
    horizon_max: int = Field(default=51, ge=1, le=2000)
    """Longest sequence tried at step 0, in signals. A sequence of `length` signals is the paper's
    horizon h = length - 1."""
    initial_lengths: Literal["all", "geometric"] = "all"
    """Which lengths up to `horizon_max` are tried at step 0: `all`, as in Algorithm 2 (with an
    optimiser that has a tolerance, up to the first length that is good enough); or, only with such
    an optimiser, `geometric`: growing lengths from the shortest that could reach the targets until
    one is good enough, then bisection. If no length is good enough, three lengths are searched for
    some seconds each.
    """
    obstacle_weight: NonNegative = 1000.0
    """Weight omega_p of the obstacle potential in the paper's equation (7) [length unit]."""
    collision: Collision = Collision()
    """How the planner of `pso-mpc` tests for obstacles."""
    evaluations_max: int | None = Field(default=None, ge=1)
    """Largest number of cost evaluations in one control step, shared equally by its horizons; the
    best sequence found within the limit is used. No limit by default.
    """
    optimizer: Annotated[OptimizerSection, _OPTIMIZER] = Field(default_factory=_OPTIMIZER.make)
    """The optimiser of each search."""

    @model_validator(mode="after")
    def _a_limit_pays_for_a_search(self) -> Self:
        least = self.optimizer.evaluations_min
        if self.evaluations_max is not None and self.evaluations_max < least:
            message = f"must be at least {least}, the evaluations that one search needs"
            raise inconsistent("evaluations_max", message)
        return self

    @property
    def deadline_s(self) -> float | None:
        """`deadline`, or the default for an optimiser with a tolerance [s]."""
        if self.deadline is None and self.optimizer.good_enough is not None:
            return DEADLINE * self.period
        return self.deadline

    @property
    def iterations_max(self) -> int:
        """Largest number of iterations of one search."""
        return self.optimizer.iterations_max

    @property
    def body_radius(self) -> float:
        """Radius of every robot's body [length unit], 0 if the spec gives none."""
        return self.collision.radius

    def bounds(self) -> dict[str, str]:
        """Return the limits of horizons and evaluations as texts to display, {name: text}."""
        found = {"horizons at step 0": f"1 ... {self.horizon_max} signals"}
        if most := self.optimizer.evaluations_max:
            found["cost evaluations of a horizon"] = f"at most {most}"
        return found

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield an error if robots that cannot stand still are to pause."""
        if self.collision.stop_before_collision and setup.wheel_radius is None:
            message = "is only for robots that can stand still, which have wheels"
            yield ("collision", "stop_before_collision"), message

    def signals_within(self, steps: int) -> int:
        """Return the largest number of signals of a plan if `steps` control steps are left.
        Without `accept_error`, as in Algorithm 2, the steps left do not limit a plan."""
        left = max(1, steps // self.hold)
        return min(self.horizon_max, left if self.accept_error else self.horizon_max)

    def numbers_held(self, setup: Setup) -> int:
        """Return the number of floats that the longest search stores: positions, velocities, bests
        and poses of particles, and the Jacobian of a polish.
        """
        robots, length = len(setup.names), self.horizon_max
        swarm = 4 * self.optimizer.evaluations_min * (length + robots)
        residuals = robots * (2 + robots // 2 + len(setup.obstacles))
        return swarm + residuals * length

    def known(self, setup: Setup) -> Prior:
        """Return what is assumed of the robots' motion, without uncertainty unless `estimate`."""
        problem = self.problem(setup)
        given = self.prior.of(problem, self.dead_time, setup)
        return given if self.estimate else nothing(problem, self.dead_time)

    def problem(self, setup: Setup, poses: Poses | None = None) -> Problem:
        """Return the problem with the robots at `poses`, or at their starts."""
        collision, walls = self.collision, setup.arena if self.collision.walls else None
        margin = collision.margin + collision.radius
        return Problem(
            poses=setup.starts if poses is None else poses,
            targets=setup.targets,
            a=setup.a,
            speed=setup.speed,
            motion=self.motion,
            period=self.hold * self.period,
            first_period=self.hold * self.period,
            obstacles=Obstacles.of(setup.obstacles, margin, walls),
            obstacle_weight=self.obstacle_weight,
            swept=collision.test == "swept",
            separation=collision.separation,
        )
