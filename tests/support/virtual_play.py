"""The emulated lab and our side in this process, on one virtual clock: commands and fault scripts.

Command line, plant, guard, inner loop, actuator, frames, module, radio and firmware are the real
ones; the wires are those of `virtual_wires`. A loaded host changes nothing, so a failure is a
failure.
"""

import contextlib
import json
from unittest import mock

import numpy as np
from support.cli import tetractl
from support.emulated_lab import in_virtual_time
from support.lab_processes import SMALL, SPEC, Played, flags
from support.virtual_lab import Busy

from tetractl.control.build import build_controller
from tetractl.core.clock import SECOND
from tetractl.emulate.script import NOTHING

BEFORE_NS = SECOND // 2  # the lab is up that long before anything connects
AFTER_NS = SECOND  # and is watched for that long after a play


class Lab:
    """An emulated lab in virtual time; `settings` lead the commands of this process to it."""

    def __init__(self, emulation, clock, record, settings):
        self.emulation, self.clock, self.record = emulation, clock, record
        self.settings = settings

    def events(self, name=None):
        """Return what truly happened so far, of one kind or of all."""
        self.emulation._record.flush()
        found = [json.loads(line) for line in self.record.read_text().splitlines()]
        return [event for event in found if name in (None, event["event"])]


def play(path, script, folder, *, replace_after=None, plan_s=0.0, sets=()):
    """Play a script; return what became of it, as `support.lab_processes.play` does.

    Each plan after the first takes `plan_s` of virtual time.
    """
    sets = (*script.runner.sets, *sets)
    logs = folder / "first"
    with virtual_lab(folder, script, sets, replace_after, plan_s) as lab:
        words = ["run", SPEC, "--plant", "lab", "--yes", "--quiet", "--out", logs]
        done = tetractl(folder, *words, *flags(lab.settings))
        lab.clock.sleep_until(lab.clock.now() + AFTER_NS)
    said = done.stdout + done.stderr
    link = folder / "radio"
    return Played([done.returncode], [said], 0, lab.events(), sorted(logs.glob("*.mcap*")), link)


@contextlib.contextmanager
def virtual_lab(folder, script=NOTHING, sets=(), replace_after=None, plan_s=0.0):
    """An emulated lab, with its faults counted from here on."""

    def controller(experiment, key):
        rng = np.random.default_rng(1)
        return Busy(build_controller(experiment, key), clock, rng, plan_s, 0.0)

    spec, sets = SPEC.read_text("utf-8"), (*SMALL, *sets)
    how = {"spec": spec, "script": script, "replace_after": replace_after}
    with (
        in_virtual_time(folder, *sets, **how) as (emulation, clock, settings),
        mock.patch("tetractl.run.task.build_controller", controller),
    ):
        clock.sleep_until(BEFORE_NS)
        yield Lab(emulation, clock, folder / "record.jsonl", settings)
