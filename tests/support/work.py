"""Bounds on what some code may do, in numbers that do not depend on how fast the machine is."""

import sys
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


class TooMuchWorkError(BaseException):
    """Nothing that the code under test catches."""


@contextmanager
def bounded(lines: int, megabytes: float | None = None) -> Iterator[None]:
    """Fail where more lines of Python than these run, or more memory than this is taken at once."""
    left = lines

    def count(frame: FrameType, event: str, arg: Any) -> Any:
        nonlocal left
        left -= event == "line"
        if left < 0:
            raise TooMuchWorkError
        return count

    before = sys.gettrace()
    if megabytes is not None:
        tracemalloc.start()
    sys.settrace(count)
    try:
        yield
    except TooMuchWorkError:
        raise AssertionError(f"runs more than {lines} lines") from None
    finally:
        sys.settrace(before)
        peak = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
    assert megabytes is None or peak <= megabytes, f"takes {peak:.0f} MB"
