"""The interfaces of a motion, which planner, compiled planner and simulated plant share.

A motion is one file that defines a `Motion`, and one line in `tetractl.core.registries` that names
it. See docs/how-to/extend.md.
"""

from dataclasses import dataclass
from typing import Any, Protocol, Self

from tetractl.core.poses import Floats

Time = float | Floats
XYHeading = tuple[Floats, Floats, Floats]
Derivatives = tuple[float, float, float, float, float, float, float, float]
"""dx, dy, dheading of one step; d(dx)/dheading, d(dy)/dheading, d(dx)/du, d(dy)/du, and
d(heading')/dheading = 1 - d(heading')/du."""


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
    def of(cls, a: Floats, v: Floats, t: float) -> Self:
        """Return the constants of robots with a, v (N,) for steps of t [s]."""
        ...

    @staticmethod
    def advance(x: Any, y: Any, c: Any, s: Any, cu: Any, su: Any, k: Any) -> Any:
        """Return x, y, c, s after a piece; c, s and cu, su are cos and sin of heading and u."""
        ...

    @staticmethod
    def differentiate(
        c: float, s: float, cu: float, su: float, a: float, v: float, t: float
    ) -> Derivatives:
        """Return the displacement of a whole step of t [s] and its derivatives."""
        ...


@dataclass(frozen=True, slots=True)
class Motion:
    """A motion, defined by its NumPy step, the plant's step and the compiled step."""

    name: str
    step: StepFunction
    hold: Hold
    lanes: type[Lanes]
