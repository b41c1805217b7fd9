"""The interfaces of a motion, which planner, compiled planner and simulated plant share.

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
"""dx, dy, dheading of one step; the derivatives of the new x, y, heading by the heading, by the
direction u (that of the heading is 1 minus the one by the heading), and by each of PARAMETERS."""


PARAMETERS = "a", "speed"
"""The parameters of all motions, in the order in which functions take them: a [rad/s] and the speed
v [length unit/s]. Both are above 0: derivatives are taken by their logarithms."""


def in_rows(robots: Any) -> Floats:
    """Return the PARAMETERS (N, K) in the fields of a problem or a prior."""
    return np.column_stack([robots.a, robots.speed])


LOWER = -math.pi
"""Least direction u of a search, lb of (12) [rad]; directions beyond the bounds are wrapped."""
UPPER = math.pi
"""Greatest direction u of a search, ub of (12) [rad]."""


@dataclass(slots=True)
class Held:
    """The commands that N robots hold, (N,) each; before the first they stand still."""

    direction: Floats  # u [rad]
    turning: Floats  # a sin(u - heading) when the command was received [rad/s], (3)
    course: Floats  # heading when the command was received [rad]
    moving: Floats  # 1 if the robot moves, 0 if it stands


class StepFunction(Protocol):
    """Poses after a time t [s] under a held direction u [rad].

    Arguments broadcast against each other: typically x, y [length unit] and heading [rad] of shape
    (..., N), u of shape (..., 1), turning rates a [rad/s] and speeds v [length unit/s] of shape
    (N,). Headings are not wrapped.
    """

    def __call__(
        self, x: Floats, y: Floats, heading: Floats, u: Floats, a: Floats, v: Floats, t: Time
    ) -> XYHeading:
        """Return x, y and heading after the step."""
        ...


class Hold(Protocol):
    """Poses of simulated robots a time t [s] later, in closed form, while no new command arrives.

    Arguments are as for `StepFunction`, with the held command in place of u; t (M, N) gives poses
    (M, N).
    """

    def __call__(
        self, x: Floats, y: Floats, heading: Floats, held: Held, a: Floats, v: Floats, t: Floats
    ) -> XYHeading:
        """Return x, y and heading a time t later."""
        ...


class Lanes(Protocol):
    """Constants of N robots for steps of one duration, and the step of one robot in scalars.

    It is a `NamedTuple` with the fields `rows` and `pieces`. Each class gets its own compiled
    kernel. The functions, and the plain functions that they call, are compiled together with the
    kernel; they may use arithmetic, `math` and `tetractl.model.motion.polynomials`. `advance` runs
    in a loop over particles, `differentiate` in a loop over signals. To make these loops vector
    code, use conditional values rather than branches, and polynomials rather than calls to `math`.
    """

    size: int

    @property
    def rows(self) -> Floats:
        """The constants of each robot (N, size); `k` of the functions is one row."""
        ...

    @property
    def pieces(self) -> int:
        """Number of equal pieces that a step is divided into."""
        ...

    @classmethod
    def of(cls, parameters: Floats, t: float) -> Self:
        """Return the constants of robots with PARAMETERS (N, K) for steps of t [s]."""
        ...

    @staticmethod
    def advance(x: Any, y: Any, c: Any, s: Any, cu: Any, su: Any, k: Any) -> Any:
        """Return x, y, c, s after a piece; c, s and cu, su are cos and sin of heading and u."""
        ...

    @staticmethod
    def differentiate(
        c: float, s: float, cu: float, su: float, robot: Any, t: float
    ) -> Derivatives:
        """Return a whole step of t [s] and its derivatives; `robot` are one robot's PARAMETERS."""
        ...


class PlainLanes(NamedTuple):
    """`Lanes` of a motion that computes nothing beforehand: PARAMETERS and t of each robot. Its
    subclass has `differentiate` and `advance`; the latter may be that and `onwards`."""

    rows: Floats  # (N, K + 1)
    pieces: int = 1
    size = len(PARAMETERS) + 1

    @classmethod
    def of(cls, parameters: Floats, t: float) -> Self:
        """Return the constants of robots with PARAMETERS (N, K) for steps of t [s]."""
        times = np.full(len(parameters), t)
        return cls(np.column_stack([parameters, times]))


@dataclass(frozen=True, slots=True)
class Motion:
    """A motion, defined by its NumPy step, the plant's step and the compiled step."""

    name: str
    step: StepFunction
    hold: Hold
    lanes: type[Lanes]
