"""A controller that plans one robot's path with a rapidly-exploring random tree (RRT).

The paper by Ou and others names this method (section I, after Kim et al., 2011) as an earlier way
to steer one cell round obstacles. A tree finds a path, and feedback points the field at the next
corner of the path. To grow the tree in the plane, a random point of the arena, or sometimes the
target, is sampled. An edge from the nearest node towards this point is added, unless the edge would
touch an obstacle. The length of an
edge, and the distance from which a corner counts as passed, are in units of v/a, the radius of the
tightest bend that a robot can drive.

Source of the tree: LaValle, "Rapidly-exploring random trees: a new tool for path planning" (1998).
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np

from tetractl.control.methods.fixed_sequence import find_best_stop, given_plan
from tetractl.control.methods.plain import PlainController, PlainSection
from tetractl.control.search.cost import predict_with_costs
from tetractl.control.search.rng import uniform
from tetractl.core import elementwise
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Decision, End, Outcome, Problem
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Bounds, Setup
from tetractl.spec.base import NonNegative, Positive
from tetractl.spec.controller import ALONE, Host
from tetractl.spec.yaml.problems import Loc


class RrtSection(PlainSection):
    """A rapidly-exploring random tree (RRT) with feedback: a controller for one robot.

    The field points at the next corner of a path that keeps clear of obstacles and walls.
    """

    type: Literal["rrt"]
    edge: Positive = 8.0
    """Length of an edge of the tree, in units of the robot's v/a (speed over turning rate)."""
    reach: Positive = 2.5
    """Distance from which a corner of the path counts as passed, in units of the robot's v/a.

    It is at least the distance driven in a control period.
    """
    margin: NonNegative = 0.0
    """Obstacles and walls are grown by this much for the tree [length unit]."""

    goal_bias: ClassVar[float] = 0.1
    """Fraction of the samples that are the target instead of a random point."""
    points_max: ClassVar[int] = 5000
    """Maximum number of random points that grow one tree. If the tree does not reach the target,
    the robot drives straight to it.
    """
    ahead_cosine_min: ClassVar[float] = 0.7
    """Minimum cosine of the angle between heading and target at which a robot drives to it."""

    def bounds(self) -> dict[str, str]:
        """Describe the limit on the size of a tree, for display.

        Returns:
            One entry: "nodes of a tree" maps to the maximum number.
        """
        return {"nodes of a tree": f"at most {self.points_max}"}

    def contradictions(self, setup: Setup) -> Iterator[tuple[Loc, str]]:
        """Yield an error if there are several robots, or if the robot cannot move."""
        if len(setup.names) > 1:
            message = (
                f"can steer only one robot, but the spec has {len(setup.names)}; use "
                "mpc for several"
            )
            yield ("type",), message
        if not setup.speed.all():
            yield ("type",), "needs a robot that moves, but the robot's speed in the spec is 0"

    def problem(self, setup: Setup) -> Problem:
        """Return the problem for computing the logged cost, with the robot at its start."""
        obstacles = Obstacles.from_shapes(setup.obstacles, self.margin, setup.arena)
        return replace(super().problem(setup), obstacles=obstacles, swept=True)

    def build(self, setup: Setup, key: int, host: Host = ALONE) -> "Rrt":
        """Create the controller of one trial; see `ControllerSection.build`."""
        return Rrt(self, setup, key)


class Rrt(PlainController):
    """The controller of one trial that steers a robot along a path from a random tree (RRT).

    Args:
        section: The controller's section of the spec.
        setup: The constants of the experiment.
        key: Seed of all its random numbers.
    """

    def __init__(self, section: RrtSection, setup: Setup, key: int) -> None:
        super().__init__(section, setup, key)
        self.section = section
        turning_radius = float(setup.speed[0] / setup.a[0])
        self._edge_length = section.edge * turning_radius
        self._reach_distance = max(
            section.reach * turning_radius, float(setup.speed[0]) * section.period
        )
        self._arena = setup.arena
        self._corners = setup.targets  # corners still ahead of the robot (M, 2), the target last

    def decided(self, problem: Problem, observation: Observation, step_key: int) -> Decision:
        """Point the field at the next corner, or end the trial; see `PlainController.decided`."""
        signals = np.array([self._choose_direction(problem, step_key)])
        decision = self._end_if_passing(
            problem, signals, float(problem.poses.distances(problem.targets)[0])
        )
        return decision or given_plan(problem, signals, step_key)

    def _choose_direction(self, problem: Problem, key: int) -> float:
        """Choose the direction to send [rad], usually the direction of the path's next corner.

        A new path is planned if an obstacle blocks the way to the next corner. No path can begin
        inside an obstacle grown by the margin, so a robot inside one keeps its path. A robot that
        is too near its target to turn towards it would circle it for ever. It therefore drives
        straight on until it is far enough away.
        """
        position = problem.poses.xy[0]
        obstacles = problem.obstacles
        while (
            len(self._corners) > 1
            and elementwise.hypot(*(self._corners[0] - position)) <= self._reach_distance
        ):
            self._corners = self._corners[1:]
        is_blocked = bool(
            obstacles.meets_segments(
                position[0], position[1], self._corners[0, 0], self._corners[0, 1]
            )
        )
        if is_blocked and not obstacles.contains(position[0], position[1]):
            target = problem.targets[0]
            random_rows = uniform(key, 0, 3 * self.section.points_max).reshape(-1, 3)
            corners = grow_tree(
                obstacles, self._arena, position, target, self._edge_length, random_rows
            )
            self._corners = target[None] if corners is None else corners
        to_corner = self._corners[0] - position
        direction_rad = float(elementwise.atan2(to_corner[1], to_corner[0]))
        heading = float(problem.poses.heading[0])
        is_too_near = (
            len(self._corners) == 1 and elementwise.hypot(*to_corner) <= self._reach_distance
        )
        return (
            heading
            if is_too_near
            and elementwise.cos(direction_rad - heading) < self.section.ahead_cosine_min
            else direction_rad
        )

    def _end_if_passing(
        self, problem: Problem, signals: Floats, target_distance: float
    ) -> Outcome | End | None:
        """End the trial at the closest point if the robot passes its target in this control period.

        Returns:
            The outcome, or an `End` with the delay until the closest point. None if the robot does
            not pass its target in this period.
        """
        misalignment_rad = signals[0] - problem.poses.heading[0]
        if (
            len(self._corners) > 1
            or target_distance > self._reach_distance
            or elementwise.cos(misalignment_rad) < self.section.ahead_cosine_min
        ):
            return None
        delay_ns, stop_error = find_best_stop(
            problem, self.estimator.directions_at_action, self.section.period
        )
        if stop_error > predict_with_costs(problem, signals).target:
            return None
        outcome = Outcome.NO_BETTER_PLAN
        return End(outcome, delay_ns) if delay_ns else outcome


def grow_tree(
    obstacles: Obstacles,
    arena: Bounds,
    start: Floats,
    target: Floats,
    edge_length: float,
    random_rows: Floats,
) -> Floats | None:
    """Grow a random tree (RRT) from a start until it reaches a target, and return the path.

    Args:
        obstacles: The obstacles to avoid.
        arena: The arena.
        start: Where the tree starts, shape (2,).
        target: Where the path ends, shape (2,).
        edge_length: Length of an edge of the tree [length unit].
        random_rows: Random numbers in [0, 1), shape (D, 3). Each row gives one point: the first
            number decides whether the point is the target, the other two give a point in the arena.

    Returns:
        The corners of the path, shape (M, 2). None if the tree does not reach the target.
    """
    nodes = np.empty((len(random_rows) + 1, 2))
    parents = np.zeros(len(random_rows) + 1, dtype=np.int64)
    nodes[0] = start
    node_count = 1
    lower_left = np.array([arena.left, arena.bottom])
    size = np.array([arena.width, arena.height])
    for choice, *fractions in random_rows.tolist():
        point = target if choice < RrtSection.goal_bias else lower_left + size * fractions
        offsets = point - nodes[:node_count]
        distances = elementwise.hypot(offsets[:, 0], offsets[:, 1])
        nearest = int(np.argmin(distances))
        nearest_node = nodes[nearest]
        length = float(distances[nearest])
        node = (
            point
            if length <= edge_length
            else nearest_node + offsets[nearest] * (edge_length / length)
        )
        if length == 0 or obstacles.meets_segments(
            nearest_node[0], nearest_node[1], node[0], node[1]
        ):
            continue
        nodes[node_count] = node
        parents[node_count] = nearest
        node_count += 1
        distance = float(elementwise.hypot(*(target - node)))
        if distance <= edge_length and not obstacles.meets_segments(
            node[0], node[1], target[0], target[1]
        ):
            path = [target]
            i = node_count - 1
            while i > 0:
                path.append(nodes[i])
                i = int(parents[i])
            return np.array(path[::-1])
    return None
