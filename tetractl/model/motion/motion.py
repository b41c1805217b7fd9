"""The interfaces of a motion model, which the planner, its compiled code and the simulation share.

A motion is one file that defines a `Motion`, and one line in `tetractl.core.registries` that names
it. See docs/how-to/extend.md.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, Self

import numpy as np

from tetractl.core.poses import Floats

Time = float | Floats
XYHeading = tuple[Floats, Floats, Floats]
XYTurn = tuple[float, float, float]
Derivatives = tuple[XYTurn, XYTurn, XYTurn, tuple[XYTurn, ...]]
"""A step dx, dy, dheading, and the derivatives of the new x, y and heading.

The derivatives are taken with respect to the heading, the direction u, and each of PARAMETERS. The
derivative of the heading with respect to u is 1 minus the one with respect to the heading.
"""


PARAMETERS = "a", "speed"
"""The parameters of all motions, in the order of function arguments.

They are a [rad/s] and the speed v [length unit/s]. Both are above 0, because derivatives are taken
with respect to their logarithms.
"""


def in_rows(robots: Any) -> Floats:
    """Collect the PARAMETERS of a problem's or a prior's robots in one array (N, K)."""
    return np.column_stack([robots.a, robots.speed])


LOWER = -math.pi
"""Minimum direction u of a search, lb of the paper's (12) [rad]."""
UPPER = math.pi
"""Maximum direction u of a search, ub of the paper's (12) [rad]."""


@dataclass(slots=True)
class Held:
    """The commands that N robots follow at present, shape (N,) each.

    Before its first command, a robot stands still.
    """

    direction: Floats  # u [rad]
    turning: Floats  # a sin(u - heading) when the command was received [rad/s], (3)
    course: Floats  # heading when the command was received [rad]
    moving: Floats  # 1 if the robot moves, 0 if it stands


class StepFunction(Protocol):
    """A function that computes poses after a time t [s] under a held direction u [rad].

    Arguments broadcast against each other: typically x, y [length unit] and heading [rad] of shape
    (..., N), u of shape (..., 1), turning rates a [rad/s] and speeds v [length unit/s] of shape
    (N,). Headings are not wrapped.
    """

    def __call__(
        self, x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time
    ) -> XYHeading:
        """Compute x, y and heading of robots after one step in a given direction."""
        ...


class Hold(Protocol):
    """A function that computes poses of simulated robots while no new command arrives.

    The poses are in closed form. Arguments are as for `StepFunction`, with the held command instead
    of u. t has shape (M, N), and so have the poses.
    """

    def __call__(
        self, x: Floats, y: Floats, heading: Floats, held: Held, a: Floats, v: Floats, t: Floats
    ) -> XYHeading:
        """Compute x, y and heading of robots after the time t in a given direction."""
        ...


class Lanes(Protocol):
    """The constants of N robots for steps of one duration, and compiled functions for one robot.

    It is a `NamedTuple` with the fields `rows` and `pieces`. Each class gets its own compiled
    kernel. The functions, and the plain functions that they call, are compiled together with the
    kernel; they may use arithmetic, `math` and `tetractl.model.motion.polynomials`. `advance` runs
    in a loop over particles, and `differentiate` in a loop over signals. The compiler turns these
    loops into vector code if the functions use conditional values instead of branches, and
    polynomials instead of calls to `math`.
    """

    size: int

    @property
    def rows(self) -> Floats:
        """The constants of each robot, shape (N, size). The functions get one row as `k`."""
        ...

    @property
    def pieces(self) -> int:
        """Number of equal pieces into which a step is divided. `advance` computes one piece."""
        ...

    @classmethod
    def of(cls, parameters: Floats, t: float) -> Self:
        """Compute the constants of robots with PARAMETERS (N, K) for steps of t [s]."""
        ...

    @staticmethod
    def advance(x: Any, y: Any, c: Any, s: Any, cu: Any, su: Any, k: Any) -> Any:
        """Compute the pose of a robot after a piece of a step.

        Args:
            x: x of the robot.
            y: y of the robot.
            c: Cosine of its heading.
            s: Sine of its heading.
            cu: Cosine of the direction.
            su: Sine of the direction.
            k: The robot's row of constants.

        Returns:
            x, y, and the cosine and sine of the heading.
        """
        ...

    @staticmethod
    def differentiate(
        c: float, s: float, cu: float, su: float, robot: Any, t: float
    ) -> Derivatives:
        """Compute a whole step of a robot, and its derivatives for the filter and the search.

        Args:
            c: Cosine of the heading.
            s: Sine of the heading.
            cu: Cosine of the direction.
            su: Sine of the direction.
            robot: The PARAMETERS of one robot.
            t: Duration of the step [s].
        """
        ...


class PlainLanes(NamedTuple):
    """The base class of `Lanes` for a motion that computes nothing in advance.

    Its constants are the PARAMETERS of each robot, and t.

    A subclass implements `differentiate` and `advance`. The latter may consist of `differentiate`
    and `onwards`.
    """

    rows: Floats  # (N, K + 1)
    pieces: int = 1
    size = len(PARAMETERS) + 1

    @classmethod
    def of(cls, parameters: Floats, t: float) -> Self:
        """Compute the constants of robots with PARAMETERS (N, K) for steps of t [s]."""
        times = np.full(len(parameters), t)
        return cls(np.column_stack([parameters, times]))


@dataclass(frozen=True, slots=True)
class Motion:
    """A motion model: its NumPy step, the step of the simulation, and the compiled step."""

    name: str
    step: StepFunction
    hold: Hold
    lanes: type[Lanes]
