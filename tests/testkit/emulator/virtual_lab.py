"""Runs the emulated lab and the program that drives it in this process, in virtual time.

Command line, plant, guard, inner loop, camera, actuator, frames, radio module, firmware, cells and
images are the real ones. Only connections, threads and the clock are replaced, so that a busy
computer does not change the result.
"""

import contextlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from pkgutil import resolve_name
from typing import ClassVar
from unittest import mock

import numpy as np
import pytest
from tetractl_emulator.emulated_lab import EmulatedLab
from tetractl_emulator.script import NO_FAULTS
from tetractl_emulator.sides import Options
from tetractl_emulator.virtual_lab import LabClock, LiveClock, start_emulated_lab
from tetractl_microscope.cells.section import CellsSection

from testkit.cli import process, tetractl
from testkit.emulator.lab_processes import APRILTAG, SMALL, Played, camera_of, flags, script_of
from testkit.emulator.lab_processes import SPEC as THREE
from testkit.lab_specs import SPEC
from testkit.paths import EXAMPLES
from tetractl.core.clock import SECOND, wait_for
from tetractl.core.protocols import LabSupervision
from tetractl.lab.cameras.optitrack.section import OptitrackSection
from tetractl.lab.inner_loop import InnerLoop
from tetractl.plant.lab_plant import RigSection
from tetractl.spec.load import load_spec, parse_spec
from tetractl.spec.loaded_spec import LoadedSpec
from tetractl.spec.plants import get_lab, select_plant

DISH = EXAMPLES / "tetrahymena_dish.yaml"
PATIENCE_S = 10.0
CONTINUE_NS = SECOND  # a lab is watched for that long after a play


class PatientClock(LabClock):
    """A clock on which a test waits for what happens."""

    def wait(self, condition, patience_s=PATIENCE_S):
        """Let time pass until a condition holds; return whether it does."""
        return wait_for(self, condition, patience_s)


class TrialClock:
    """A clock that starts at 0 when it is made, as a trial's does; `base` goes on below it."""

    def __init__(self, base):
        self._base = base
        self._start = base.now()

    def now(self):
        return self._base.now() - self._start

    def sleep_until(self, when):
        self._base.sleep_until(self._start + when)


class Joined:
    """Our camera on the wires of the present emulation: the `device` of its section."""

    lab: EmulatedLab
    devices: ClassVar = {kind: kind.device for kind in (OptitrackSection, CellsSection)}

    def __new__(cls, section, setup, clock, wake, join=None):
        return resolve_name(cls.devices[type(section)])(
            section, setup, clock, wake, join or cls.lab.camera.join
        )


@contextlib.contextmanager
def joined(lab, clock):
    """Let the lab's code in this process find an emulation's wires and clock, not the host's."""
    Joined.lab = lab

    def close(loop):
        if loop.step_if_due in clock.steps:
            clock.steps.remove(loop.step_if_due)

    def start_live(live_clock):
        def step():
            live_clock._step_to(live_clock.now())

        clock.steps.append(step)
        return lambda: clock.steps.remove(step)

    with contextlib.ExitStack() as stack:
        for name, value in (
            ("tetractl.lab.actuators.xbee.link.SerialPort", lab.wires.ports),
            ("tetractl.lab.actuators.twist.line_ports.open_port", lab.wires.ports),
            ("tetractl_microscope.coils.driver.SerialPort", lab.wires.ports),
            ("tetractl.lab.serial_port.require_port", lambda name, device: None),
        ):
            stack.enter_context(mock.patch(name, value))
        of_rig = mock.patch.object(RigSection, "clock", lambda *_: TrialClock(clock))
        stack.enter_context(of_rig)
        start = mock.patch.object(
            InnerLoop, "start", lambda loop: clock.steps.append(loop.step_if_due)
        )
        stack.enter_context(start)
        host = mock.patch(f"{LiveClock.__module__}.MonotonicClock", lambda: TrialClock(clock))
        stack.enter_context(host)
        stack.enter_context(mock.patch.object(LiveClock, "start", start_live))
        stack.enter_context(mock.patch.object(InnerLoop, "close", close))
        for kind in Joined.devices:
            device = f"{__name__}:{Joined.__name__}"
            stack.enter_context(mock.patch.object(kind, "device", device))
        yield


@dataclass
class VirtualLab:
    """An emulated lab; `spec` leads to it, and `settings` lead commands of this process to it."""

    emulation: EmulatedLab
    clock: PatientClock
    spec: LoadedSpec
    settings: tuple
    record: Path

    @property
    def robots(self):
        """The robots or cells as they truly are."""
        return self.emulation.actuator.bodies

    @property
    def cells(self):
        """The cells of a dish as they truly are."""
        return self.robots[0].dish.cells

    @cached_property
    def plant(self):
        """Our plant of it."""
        section = self.spec.experiment.plant
        setup = self.spec.experiment.setup
        return section.build(setup, self.clock, np.random.SeedSequence(1), LabSupervision())

    def events(self, name=None):
        """Return what truly happened so far, of one kind or of all."""
        printed = [json.loads(line) for line in self.record.read_text().splitlines()]
        return [event for event in printed if name in (None, event["event"])]


@contextlib.contextmanager
def virtual_lab(folder, *sets, spec=SPEC, script=NO_FAULTS, seed=1, ahead_s=0.0, **options):
    """Enter an emulated lab that is up `ahead_s` before anything connects.

    A `spec` is a path or YAML, or loaded, a `script` may be YAML, and `options` are the
    emulation's. Without a `folder` nothing is recorded, and the addresses are the spec's.
    """
    if folder is None:
        options["address"] = None
    else:
        sets = (f"lab.actuator.port={Path(folder) / 'radio'}", *sets)
    loaded = spec
    if isinstance(spec, Path):
        loaded = load_spec(spec, sets)
    elif isinstance(spec, str):
        loaded = parse_spec(spec, "lab.yaml", sets)
    lab = get_lab(loaded.experiment, loaded.name)
    clock = PatientClock()
    record = None if folder is None else Path(folder) / "record.jsonl"
    chosen = Options(
        seed=seed,
        trials_choose_robots=loaded.experiment.must_choose_robots,
        record=record,
        **options,
    )
    emulation = start_emulated_lab(
        lab, loaded.experiment.setup, clock, chosen, script_of(script, lab)
    )
    with contextlib.closing(emulation), joined(emulation, clock):
        clock.sleep_until(round(ahead_s * SECOND))
        yield VirtualLab(emulation, clock, select_plant(loaded, "lab"), sets, record)


def virtual_dish(folder, seed=1, sets=(), script=""):
    """An emulated dish with a microscope, as `virtual_lab`; `script` is YAML."""
    pytest.importorskip("cv2").setNumThreads(1)
    how = {"spec": DISH, "script": script, "seed": seed, "ahead_s": 0.5}
    return virtual_lab(folder, f"trials.seed={seed}", *sets, **how)


class Busy:
    """A controller that takes virtual time: uniform from `least` to `least + spread` [s]."""

    def __init__(self, controller, clock, rng, least, spread):
        self._controller = controller
        self._clock = clock
        self._rng = rng
        self._least = least
        self._spread = spread
        self._planned = False

    def plan(self, observation, last_command=None, earlier=()):
        decided = self._controller.plan(observation, last_command, earlier)
        if self._planned:  # the first plan is computed while the robots stand
            seconds = self._least + self._spread * self._rng.random()
            self._clock.sleep_until(self._clock.now() + round(seconds * SECOND))
        self._planned = True
        return decided


def play(path, script, folder, *, replace_after=None, sets=()):
    """Play a script on the lab's plant; return what became of it, as `lab_processes.play` does."""
    sets = (*SMALL, *script.runner.sets, *sets)
    logs = folder / "first"
    how = {"spec": THREE, "script": script, "replace_after": replace_after, "ahead_s": 0.5}
    with virtual_lab(folder, *sets, **how) as lab:
        words = ["run", THREE, "--plant", "lab", "--yes", "--quiet", "--out", logs]
        done = tetractl(folder, *words, *flags(lab.settings))
        lab.clock.sleep_until(lab.clock.now() + CONTINUE_NS)
        said = done.stdout + done.stderr
        events = lab.events()
    link = folder / "radio"
    return Played([done.returncode], [said], 0, events, sorted(logs.glob("*.mcap*")), link)


def play_faults(path, script, folder):
    """Play a script as a user does, by plant `emulated`, in this process unless that is killed."""
    sets = APRILTAG if camera_of(path) == "apriltag" else SMALL
    sets = (*sets, *script.runner.sets, f"plant.faults={path}", f"plant.record={folder}")
    words = ["run", THREE, "--plant", "emulated", "--quiet", "--out", folder / "first"]
    killed = script.expect.outcome == "killed"
    done = (process if killed else tetractl)(folder, *words, *flags(sets))
    lines = (folder / "truth-000.jsonl").read_text().splitlines()
    logs = sorted((folder / "first").glob("*.mcap*"))
    said = [done.stdout + done.stderr]
    return Played([done.returncode], said, 0, [*map(json.loads, lines)], logs, None)
