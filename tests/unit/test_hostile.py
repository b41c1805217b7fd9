"""Whatever comes from outside, its parser keeps its promises; longer in benchmarks/fuzz.py."""

import subprocess
import sys
import tracemalloc
from collections import Counter
from contextlib import contextmanager
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import hostile, targets
from support.seeds import datagrams, mutant
from support.targets import TARGETS

pytestmark = pytest.mark.slow

LINES, MEGABYTES = 3_000_000, 40
every_target = pytest.mark.parametrize("name", TARGETS)


class TooMuchWorkError(BaseException):
    """Nothing that the code under test catches."""


@contextmanager
def bounded(lines, megabytes=None):
    """Fail where more lines of Python than these run, or more memory than this is taken at once."""
    left = lines

    def count(frame, event, arg):
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


@pytest.fixture(autouse=True, scope="module")
def caches():
    """What is made once is no work of an input's."""
    for target in TARGETS.values():
        for seed in target.seeds():
            target.run(seed)


@every_target
@given(data=st.binary(max_size=400))
@settings(max_examples=5)
def test_any_bytes(name, data):
    with bounded(LINES, MEGABYTES):
        TARGETS[name].run(data)


@every_target
@given(rng=st.randoms(use_true_random=False))
@settings(max_examples=5)
def test_anything_like_what_is_right(name, rng):
    data = mutant(TARGETS[name].seeds(), rng)
    with bounded(LINES, MEGABYTES):
        TARGETS[name].run(data)


@every_target
@pytest.mark.parametrize("pattern", [b"{a: ", b"a: &a [*a]\n", b"a\n", b"~\0\5", b"\1", b"\xff"])
def test_the_same_again_and_again_is_bounded_too(name, pattern):
    """A count that is trusted or a quadratic search would show."""
    with bounded(LINES, MEGABYTES):
        TARGETS[name].run((pattern * 4096)[:4096])


LAUGHS = "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in pairwise("abcdefghijklmnopqrstuvwxyz"))


def test_aliases_cannot_multiply():
    with bounded(4_000_000):
        TARGETS["calibration"].run(("a: &a [x, x]\n" + LAUGHS).encode())


def test_good_conversations_come_through():
    """Else mutants of them would be refused at the door."""
    fed = []
    before = targets.stream
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(targets, "stream", lambda: fed.append(before()) or fed[-1])
        for seed in datagrams():
            targets.natnet_datagrams(seed)
    whole = [stream for stream in fed if stream.newest and stream.newest.poses[0]]
    assert len(whole) == len(targets.VERSIONS)
    assert sum(stream.sync is not None and stream.sync.synced for stream in fed) == 4
    assert all(stream.unit_mm == 1000 for stream in whole)


@pytest.mark.system
def test_the_long_run_prints_what_it_found(tmp_path):
    script = targets.ROOT / "benchmarks" / "fuzz.py"
    words = [sys.executable, str(script), "--target", "serial", "--seconds", "0.2"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    *_, row = done.stdout.splitlines()
    name, runs, crashes = row.strip("| ").split(" | ")[:3]
    assert (name, crashes) == ("serial", "0")
    assert int(runs) > 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", hostile.KINDS)
def test_hostile_files_are_read_or_told_in_a_line(kind):
    """Twenty thousand of each in benchmarks/hostile.py, with bounds on memory and time."""
    read = Counter()
    for number in range(25):
        command, run = hostile.case(kind, 1, number)
        run()
        read[command] += 1
    assert len(read) > 5
