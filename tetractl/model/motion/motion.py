"""The interfaces of a motion model, shared by the planner, its compiled code and the simulation.

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
"""The parameters of a robot in all motions, in the order of function arguments.

They are the turning rate a [rad/s] and the speed v [length unit/s]. Both are above 0, because
derivatives are taken with respect to their logarithms.
"""


def in_rows(robots: Any) -> Floats:
    """Collect the PARAMETERS of robots in one array (N, K), one row for each robot.

    Args:
        robots: A planning problem or a prior, with the attributes `a` and `speed`.
    """
    return np.column_stack([robots.a, robots.speed])


LOWER = -math.pi
"""Minimum direction u of a search [rad]: lb in the paper's (12)."""
UPPER = math.pi
"""Maximum direction u of a search [rad]: ub in the paper's (12)."""


@dataclass(slots=True)
class Held:
    """The commands that N robots follow at present, as arrays of shape (N,).

    Before its first command, a robot stands still.

    Attributes:
        direction: The direction u of the command [rad].
        turning: Turning rate when the robot received the command [rad/s]: a sin(u - heading), by
            the paper's (3).
        course: Heading when the robot received the command [rad].
        moving: 1 if the robot moves, 0 if it stands still.
    """

    direction: Floats
    turning: Floats
    course: Floats
    moving: Floats


class StepFunction(Protocol):
    """A function that computes poses after a time t [s] under a held direction u [rad].

    Arguments broadcast against each other: typically x, y [length unit] and heading [rad] of shape
    (..., N), u of shape (..., 1), turning rates a [rad/s] and speeds v [length unit/s] of shape
    (N,). Headings are not wrapped.
    """

    def __call__(
        self, x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time
    ) -> XYHeading:
        """Compute x, y and heading of robots after a step in a given direction."""
        ...


class Hold(Protocol):
    """A function that computes poses of simulated robots while no new command arrives.

    The poses are in closed form. The arguments are the same as those of `StepFunction`, but with
    the held commands instead of u. The times t and the poses have shape (M, N).
    """

    def __call__(
        self, x: Floats, y: Floats, heading: Floats, held: Held, a: Floats, v: Floats, t: Floats
    ) -> XYHeading:
        """Compute x, y and heading of robots after following their commands for a time t."""
        ...


class Lanes(Protocol):
    """The constants of N robots for steps of one duration, and compiled functions for one robot.

    An implementation is a `NamedTuple` with the fields `rows` and `pieces`. Each class gets its own
    compiled kernel. The functions, and the plain functions that they call, are compiled together
    with the kernel. They may use arithmetic, `math` and `tetractl.model.motion.polynomials`.
    `advance` runs in a loop over particles, and `differentiate` in a loop over signals. The
    compiler turns these loops into vector code if the functions use conditional values instead of
    branches, and polynomials instead of calls to `math`.
    """

    size: int

    @property
    def rows(self) -> Floats:
        """The constants of each robot, shape (N, size). The functions get one row as `k`."""
        ...

    @property
    def pieces(self) -> int:
        """Number of equal pieces of a step. `advance` computes a single piece."""
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

    The constants of a robot are its PARAMETERS and the duration t of a step.

    A subclass implements `differentiate` and `advance`. The method `advance` may combine
    `differentiate` with `onwards`.
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
