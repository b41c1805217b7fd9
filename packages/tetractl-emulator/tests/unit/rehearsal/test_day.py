"""When a day counts as one that hangs: by the time that its process uses, not by the clock."""

import os
from itertools import count

import pytest
from tetractl_emulator.rehearsal import day


@pytest.fixture
def child(monkeypatch):
    """A process that ends once a byte comes; its number, and the ends of both pipes."""
    monkeypatch.setattr(day, "STILL_S", 0.01)
    read, write = os.pipe()
    ended, ends = os.pipe()
    pid = os.fork()
    if not pid:
        os.read(read, 1)
        os._exit(0)
    os.close(ends)
    yield pid, ended, write
    for end in (read, write, ended):
        os.close(end)


def test_a_day_that_gets_little_time_of_a_busy_machine_does_not_hang(child, monkeypatch):
    pid, ended, write = child
    used = count()

    def ten_milliseconds_more(_):
        ticks = next(used)
        if ticks == 5:
            os.write(write, b"x")
        return ticks / 100

    monkeypatch.setattr(day, "_used_s", ten_milliseconds_more)
    assert day._wait(pid, ended)[0] == 0


def test_a_day_that_waits_for_ever_hangs(child):
    assert day._wait(*child[:2])[0] == -100


def test_a_day_that_never_ends_hangs(child, monkeypatch):
    used = count(start=day.HANGS_S - 2)
    monkeypatch.setattr(day, "_used_s", lambda _: next(used))
    assert day._wait(*child[:2])[0] == -100
