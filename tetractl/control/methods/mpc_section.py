"""The fields of the recommended controller in a spec. They extend the fields of Algorithm 2."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, PositiveInt

from tetractl.control.estimation.prior import Prior, Sticks
from tetractl.control.methods.algorithm2_section import SearchFields
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Problem
from tetractl.core.poses import Poses
from tetractl.core.registries import OPTIMIZERS
from tetractl.core.setup import MILLIMETRE_M, Setup
from tetractl.model.cell_numbers import HELIX_HZ, HELIX_UM, REST_STRAY, REST_TURN, RESTS_S
from tetractl.spec.base import (
    Model,
    NonNegative,
    NonNegativeAngle,
    Positive,
    PositiveAngle,
    defaults,
)
from tetractl.spec.controller import ControllerSection, OptimizerSection
from tetractl.spec.registry_fields import KindSection
from tetractl.spec.yaml.problems import Loc

SIGNAL_S = 0.2
"""Time for which a plan holds each signal [s]: the paper's control period."""
_MULTISTART = KindSection(OPTIMIZERS, OptimizerSection, default="multistart")


class Collision(Model):
    """How the planner avoids obstacles, the arena's edge, and other robots.

    By default, robots without wheels do not stop.
    """

    margin: NonNegative = 0.0
    """Distance by which obstacles are grown for the planner [length unit]."""
    walls: bool = True
    """Whether leaving the arena counts as entering an obstacle."""
    radius: NonNegative = 0.0
    """Radius of a robot [length unit]. Obstacles are grown by it as well. 0 for points."""
    separation: NonNegative = Field(default_factory=lambda fields: 2 * fields.get("radius", 0.0))
    """Minimum distance between the centres of two robots in the plan [length unit].

    0 if robots may meet. The distance is tested at the predicted positions. Default: two radii.
    """
    adaptive: bool = True
    """Whether the margin grows by a robot's maximum deviation from its course before the next
    command acts, given the uncertainty of its motion. If a robot or target is within the margin,
    the margin is reduced to its distance.
    """
    stop_before_collision: bool = True
    """Whether all robots pause if the best plan found leads one of them into an obstacle, or if a
    new plan from standstill has a better value. If no plan from standstill keeps clear, the robots
    turn on the spot first. If that does not help either, the trial ends. Robots also stop at the
    end, and drive on if their total error is then too large. Only for robots that can stand still,
    which have `wheels`.
    """


class PriorSection(Model):
    """How uncertain the spec's values of the robots' motion are, as standard deviations."""

    a: Positive = 0.2
    """Relative standard deviation of each robot's turning rate a."""
    speed: Positive = 0.15
    """Relative standard deviation of each robot's speed."""
    dead_time: Positive = 0.1
    """Standard deviation of the dead time [s]."""
    heading_bias: PositiveAngle = 0.05
    """Standard deviation of the angle between the direction sent and the direction that a robot
    turns towards [rad].
    """
    flow: NonNegative | None = None
    """Standard deviation of each component of the flow that carries a robot, or of its slide
    [length unit/s]. Default: a twentieth of the robots' mean speed.
    """
    position_noise: NonNegative = 0.0
    """Standard deviation of a measured position [length unit]; 0 if unknown."""
    heading_noise: NonNegativeAngle = 0.0
    """Standard deviation of a measured heading [rad]; 0 if unknown."""

    helix: NonNegative | None = None
    """Radius of the helix on which a cell swims [length unit].

    Default: 8 um, as for *T. pyriformis*, and 0 for robots on wheels.
    """

    marker_bias: ClassVar[float] = 0.05
    """Standard deviation of the angle between the measured heading and the course [rad]."""
    side: ClassVar[float] = 0.1
    """Standard deviation of k, for robots that turn by a exp(k) to the left and a exp(-k) to the
    right.
    """

    def rests(self, setup: Setup) -> bool:
        """Check whether the filters of an experiment allow for cells that sometimes stop swimming.

        True for cells if the spec gives the noise of positions and of headings: only then can the
        small motion of a resting cell be distinguished from noise. False for robots on wheels.
        """
        is_noise_known = self.position_noise > 0 and self.heading_noise > 0
        return not setup.on_wheels and is_noise_known

    def of(self, problem: Problem, dead_time: float, setup: Setup) -> Prior:
        """Create the prior for the robots of a problem: means, and standard deviations.

        Args:
            problem: The robots' parameters.
            dead_time: The expected dead time [s].
            setup: The constants of the experiment. Robots without wheels are treated as cells.
        """
        is_cell = not setup.on_wheels
        mean_speed = float(problem.speed.mean())
        x, y, heading = setup.sight.pose_std
        mm = MILLIMETRE_M / setup.metres
        helix_of_cell = HELIX_UM[0] * 1e-6 / setup.metres
        helix_by_default = helix_of_cell if is_cell else 0.0
        return Prior(
            a=problem.a,
            speed=problem.speed,
            dead_time=dead_time,
            a_std=self.a,
            speed_std=self.speed,
            dead_time_std=self.dead_time,
            heading_bias_std=self.heading_bias,
            marker_bias_std=self.marker_bias,
            flow_std=0.05 * mean_speed if self.flow is None else self.flow,
            position_noise=self.position_noise,
            heading_noise=self.heading_noise,
            helix_frequency=HELIX_HZ[0],
            helix_radius=helix_by_default if self.helix is None else self.helix,
            lag=setup.lag_s,
            lag_is_learnt=setup.on_wheels,
            watchdog=setup.watchdog_s,
            side_std=0.0 if is_cell else self.side,
            sticks=Sticks(*RESTS_S, REST_STRAY * mean_speed, REST_TURN)
            if self.rests(setup)
            else Sticks(),
            pose_std=(x * mm, y * mm, heading),
            coarse=setup.sight.has_grid,
        )


@defaults(period=0.05, motion="exact")
class RecommendedMpc(SearchFields):
    """The recommended controller. Every default is what we recommend for robots on wheels.

    It extends Algorithm 2: the exact motion under a held direction, many polished starts instead of
    a particle swarm, identification while robots drive, paths that keep clear of obstacles, and one
    value that decides between a plan, a detour and a stop.
    """

    type: Literal["mpc"] = "mpc"
    signal_periods: PositiveInt = Field(
        default_factory=lambda fields: max(1, round(SIGNAL_S / fields.get("period", SIGNAL_S)))
    )
    """Number of control periods for which a plan holds each signal.

    The plan's time grid is coarser than the control's by this factor, but a signal can still be
    changed at each control step. Default: the number of periods that last about 0.2 s.
    """
    deadline: Positive = Field(default_factory=lambda fields: 0.8 * fields.get("period", SIGNAL_S))
    """Time after which the searches of a control step end and the best sequence so far is used [s].

    For robots that stand still, it is 1 s. Default: 80 % of the control period. In virtual time,
    the work of the searches is counted instead, so that a simulation depends only on its seed.
    """
    estimate: bool = True
    """Whether the turning rate a, the speed and the heading bias of each robot, the lag of its
    wheels, and the common dead time of all robots are identified while they drive, starting from
    the spec's values.
    """
    prior: PriorSection = PriorSection()
    """The prior uncertainty of the identified values."""
    accept_error: Positive = Field(default=1.0)
    """Total error to accept [length unit].

    It is the scale of the value by which the controller decides between a stop and a detour: a
    second costs 2 % of it. A smaller value makes trials longer. Default: 0.45 of the path that all
    robots together drive in a control period.
    """
    collision: Collision = Collision()
    """How the planner avoids obstacles, the arena's edge, and other robots.

    By default, robots without wheels do not pause.
    """
    optimizer: Annotated[OptimizerSection, _MULTISTART] = Field(default_factory=_MULTISTART.make)
    """The optimiser of each search."""

    tours: ClassVar[bool] = True
    controller: ClassVar[str] = "tetractl.control.methods.mpc:Mpc"
    model_monitor: ClassVar[str] = ControllerSection.model_monitor

    @property
    def body_radius(self) -> float:
        """Radius of every robot's body [length unit]. 0 if the spec gives none."""
        return self.collision.radius

    def fitted(self, stands: bool, speed: float) -> Self:
        """Return the section with defaults that suit the robots of the spec.

        Values that the spec gives are kept.

        Args:
            stands: Whether the robots can stand still. If not, they never pause before a
                collision.
            speed: Sum of the robots' speeds [length unit/s], which sets `accept_error`.
        """
        fitting: dict[str, Any] = {}
        if "accept_error" not in self.model_fields_set:
            fitting["accept_error"] = float(f"{0.45 * self.period * speed:.2g}")
        if not stands and "stop_before_collision" not in self.collision.model_fields_set:
            off = {"stop_before_collision": False}
            fitting["collision"] = self.collision.model_copy(update=off)
        return self.model_copy(update=fitting)

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield an error if robots that cannot stand still are to pause."""
        if self.collision.stop_before_collision and not setup.on_wheels:
            message = "is only for robots that can stand still; such robots have wheels"
            yield ("collision", "stop_before_collision"), message

    def problem(self, setup: Setup, poses: Poses | None = None) -> Problem:
        """Return the problem with the robots at `poses`, or at their starts if it is None.

        Obstacles and walls are grown by the spec's margin and the robot's radius, and paths are
        tested along their whole length.
        """
        collision = self.collision
        walls = setup.arena if self.collision.walls else None
        margin = collision.margin + collision.radius
        return replace(
            super().problem(setup, poses),
            period=self.signal_periods * self.period,
            first_period=self.signal_periods * self.period,
            obstacles=Obstacles.from_shapes(setup.obstacles, margin, walls),
            swept=True,
            separation=collision.separation,
        )

    def known(self, setup: Setup) -> Prior:
        """Return the prior of the robots' motion. It is certain if `estimate` is False."""
        if not self.estimate:
            return super().known(setup)
        return self.prior.of(self.problem(setup), self.dead_time, setup)

    def patience_s(self, setup: Setup) -> float:
        """Return the time in which the price of a new attempt doubles [s].

        The time is PATIENCE_S. For cells that rest, it is at most half the time limit, because they
        may make attempts until the time is over.
        """
        from tetractl.control.methods.value import (
            PATIENCE_S,  # late: reading a spec needs no controller
        )

        return min(PATIENCE_S, self.time_limit / 2) if self.prior.rests(setup) else PATIENCE_S

    def warm_up(self, setup: Setup) -> None:
        """Compile the functions of planner, filter, margins and tree by calling each once.

        This also loads what they import. Loading it during a run would delay frames.
        """
        from tetractl.control.estimation import filter as pose_filter
        from tetractl.control.methods.passage import find_sequences
        from tetractl.control.search.discs import Discs
        from tetractl.control.search.evaluate import compiled_branch_paths, compiled_drive
        from tetractl.control.search.margins import Margins

        super().warm_up(setup)
        if self.estimate:
            pose_filter.warm_up(self.known(setup), setup.starts)
        problem = self.problem(setup)
        zero = np.zeros(1)
        path = compiled_drive(problem, np.zeros(len(problem.a)), zero)
        compiled_branch_paths(problem, path, zero, zero, 0.0)
        if self.collision.walls:  # else no tree is searched, and its library is slow to load
            next(find_sequences(problem, setup.arena, 0, 0), None)
        Discs(self.collision.radius, setup.obstacles, setup.arena).collide(path)
        margins = Margins(self.collision, setup.obstacles, setup.arena, setup.targets)
        margins.grow_obstacles(problem.poses, 0.0)
