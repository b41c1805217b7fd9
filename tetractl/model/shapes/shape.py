"""The compiled part of a shape: the parameters of its obstacles in rows, and functions of scalars.

A shape is a file with two classes: its section of a spec, with the readable geometry in NumPy, and
a `NamedTuple` as described here, to which the section refers as `packed`. A line in
`tetractl.core.registries` adds the shape. See docs/how-to/extend.md.
"""

from typing import Any, Protocol

from tetractl.core.poses import Floats


class PackedShapes(Protocol):
    """M obstacles of one shape; the argument `p` of a function is the row of one obstacle.

    Each set of classes gets its own compiled kernel. The functions, and functions of the same file
    that they call, are compiled together with the kernel; they may use arithmetic, `math` and
    loops. A gap is 0 or negative if and only if the point touches or lies inside the obstacle.
    To compare two terms, compare their difference with 0, which is faster in vector code.
    """

    rows: Floats
    """The numbers of the obstacles (M, K), each row from the section's `row`."""
    size: int | None
    """K if all obstacles have the same K; `p` is then a tuple. None if rows differ in length; `p`
    is then an array, padded with zeros.
    """

    @staticmethod
    def gap(x: float, y: float, p: Any) -> float:
        """Return a number that is at most 0 exactly where (x, y) is in the obstacle."""
        ...

    @staticmethod
    def gap_between(x0: float, y0: float, x1: float, y1: float, p: Any) -> float:
        """Return a number that is at most 0 exactly where the segment meets the obstacle."""
        ...

    @staticmethod
    def depth(x: float, y: float, p: Any) -> float:
        """Return the depth of (x, y) inside the obstacle [length unit], at most 0 outside."""
        ...

    @staticmethod
    def outward(x: float, y: float, p: Any) -> tuple[float, float]:
        """Return the unit vector along which the depth falls by 1 per length unit."""
        ...
