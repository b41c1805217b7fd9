"""Tests that a hanging day is recognised by the processor time it uses, not by the clock."""

import os
from dataclasses import dataclass
from itertools import count

import pytest
from tetractl_emulator.rehearsal.day import HANGS_S, HUNG, processor_time_s, wait_for_child


@dataclass(frozen=True)
class Child:
    """A process that ends once a byte comes; a pipe whose other end it closes as it ends."""

    pid: int
    ended: int
    write: int

    def end(self):
        os.write(self.write, b"x")

    def exit_code(self, used_s=processor_time_s):
        code, _ = wait_for_child(self.pid, self.ended, used_s, still_s=0.01)
        return code


@pytest.fixture
def child():
    read, write = os.pipe()
    ended, ends = os.pipe()
    pid = os.fork()
    if not pid:
        os.read(read, 1)
        os._exit(0)
    os.close(ends)
    yield Child(pid, ended, write)
    for end in (read, write, ended):
        os.close(end)


def test_a_day_that_waits_for_ever_hangs(child):
    assert child.exit_code() == HUNG


def test_a_day_that_never_ends_hangs(child):
    seconds = count(start=HANGS_S - 2)
    assert child.exit_code(lambda _: next(seconds)) == HUNG
