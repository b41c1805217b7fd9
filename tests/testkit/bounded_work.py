"""Runs a function on any input with limits on executed Python lines and memory."""

import random
import sys
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager

from testkit.targets import Target, mutant

LINES = 3_000_000
MEGABYTES = 40
AGAIN = [b"{a: ", b"a: &a [*a]\n", b"a\n", b"~\0\5", b"\1", b"\xff"]
"""Repeated, a count that is trusted or a quadratic search would show."""


class TooMuchWorkError(BaseException):
    """Nothing that the code under test catches."""


@contextmanager
def bounded(lines: int = LINES, megabytes: float = MEGABYTES) -> Iterator[None]:
    """Fail where more lines of Python than these run, or more memory than this is taken at once."""
    lines_left = lines

    def count(frame, event, arg):
        nonlocal lines_left
        if event == "line":
            lines_left -= 1
        if lines_left < 0:
            raise TooMuchWorkError
        return count

    before = sys.gettrace()
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
    assert peak <= megabytes, f"takes {peak:.0f} MB"


def withstands(target: Target) -> None:
    """Give a target any bytes, mutants of good ones, and the same again and again."""
    seeds = target.seeds()
    rng = random.Random(1)
    for seed in seeds:  # what is made once is no work of an input's
        target.run(seed)
    random_bytes = [rng.randbytes(rng.randrange(400)) for _ in range(5)]
    mutants = [mutant(seeds, rng) for _ in range(5)]
    repeated = [(piece * 4096)[:4096] for piece in AGAIN]
    for data in (*random_bytes, *mutants, *repeated):
        try:
            with bounded():
                target.run(data)
        except Exception as error:
            error.add_note(f"with {data[:500]!r}")
            raise
