"""The constants of an experiment, the bounds of its arena, and the length units.

Only `Experiment.setup` creates a `Setup`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tetractl.core import elementwise
from tetractl.core.losses import LossRule
from tetractl.core.poses import UNKNOWN_SIGHT, Floats, Poses, Sight
from tetractl.core.route_measure import HoldTask
from tetractl.core.shape import Shape

METRES = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0}
"""The length of each unit that a spec can declare [m]."""
MILLIMETRE_M = METRES["mm"]
"""A millimetre [m]."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """An axis-aligned rectangle, such as the arena, including its edge.

    Attributes:
        left: Minimum x [length unit].
        bottom: Minimum y [length unit].
        right: Maximum x [length unit].
        top: Maximum y [length unit].
    """

    left: float
    bottom: float
    right: float
    top: float

    @property
    def width(self) -> float:
        """The extent of the rectangle in x [length unit]."""
        return self.right - self.left

    @property
    def height(self) -> float:
        """The extent of the rectangle in y [length unit]."""
        return self.top - self.bottom

    @property
    def longer_side(self) -> float:
        """The larger of the rectangle's width and height [length unit]."""
        return max(self.width, self.height)

    def contains(self, x: float, y: float) -> bool:
        """Check whether a point lies in the rectangle or on its edge."""
        return self.left <= x <= self.right and self.bottom <= y <= self.top

    def depth_inside(self, x: Floats, y: Floats) -> Floats:
        """Compute how far each point is inside the rectangle [length unit].

        This is the distance to the nearest edge, extended to a line. It is negative for points
        outside.
        """
        across = np.minimum(x - self.left, self.right - x)
        return np.minimum(across, np.minimum(y - self.bottom, self.top - y))


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """The constants of an experiment with N robots, as the numbers and arrays of its spec.

    Attributes:
        name: Name of the experiment.
        unit: Unit of all lengths.
        metres: Length of one unit [m].
        names: Names of the robots.
        colors: Colour of each robot (#rrggbb). None if the spec gives none.
        starts: Poses at the start.
        targets: Final targets, shape (N, 2).
        a: Turning rates [rad/s], shape (N,).
        speed: Speeds [length unit/s], shape (N,).
        arena: Bounds of the arena.
        obstacles: Shapes that robots have to avoid.
        period_s: Control period [s].
        time_limit_s: Maximum time from the first command to the end [s].
        iterations_max: Maximum number of iterations of one search.
        wheel_radius: Distance from a wheel to the robot's centre [length unit]. None for robots
            without wheels.
        way_points: Points that all robots pass together before the targets, shape (M, N, 2).
        hold: The task at the targets. None if the trial ends there.
        loss: The rule by which a robot counts as lost, and whether the trial then goes on without
            it. If None, the plant ends the trial when a robot is untracked, and nothing else makes
            a robot lost.
        watchdog_s: Time without a command after which a robot stops [s]. inf if it never stops.
        lag_s: Time constant with which wheels follow a command [s].
        body_radius: Radius of every robot [length unit]. 0 if robots are points.
        sight: Precision and frame rate of the plant's camera.
        strength: Strength of the field at which robots turn at the rates `a`, in `strength_unit`.
            None if it is not stated.
    """

    name: str
    unit: str
    metres: float
    names: tuple[str, ...]
    colors: tuple[str | None, ...]
    starts: Poses
    targets: Floats
    a: Floats
    speed: Floats
    arena: Bounds
    obstacles: Sequence[Shape]
    period_s: float
    time_limit_s: float
    iterations_max: int
    wheel_radius: float | None
    way_points: Floats = field(default_factory=lambda: np.zeros((0, 0, 2)))
    hold: HoldTask | None = None
    loss: LossRule | None = None
    watchdog_s: float = math.inf
    lag_s: float = 0.0
    body_radius: float = 0.0
    sight: Sight = UNKNOWN_SIGHT
    strength: float | None = None
    strength_unit: str = "mT"

    @property
    def on_wheels(self) -> bool:
        """Whether the robots drive on wheels, so that they can stand still. False for cells."""
        return self.wheel_radius is not None

    @property
    def legs(self) -> Floats:
        """The way-points of each robot, then its target [length unit], shape (M + 1, N, 2)."""
        return np.concatenate(
            [self.way_points.reshape(-1, *self.targets.shape), self.targets[None]]
        )

    def select_robots(self, robots: Sequence[int]) -> "Setup":
        """Return the setup for some of the robots.

        Args:
            robots: Indices of the robots to keep.
        """
        rows = list(robots)
        return replace(
            self,
            names=tuple(self.names[i] for i in rows),
            colors=tuple(self.colors[i] for i in rows),
            starts=Poses.from_array(self.starts.array()[rows]),
            targets=self.targets[rows],
            way_points=self.legs[:-1, rows],
            a=self.a[rows],
            speed=self.speed[rows],
        )

    def distances(self, xy: Floats) -> Floats:
        """Compute the distances of robots to their targets [length unit], shape (..., N).

        Args:
            xy: Positions of the robots [length unit], shape (..., N, 2).
        """
        offsets = xy - self.targets
        return elementwise.hypot(offsets[..., 0], offsets[..., 1])
