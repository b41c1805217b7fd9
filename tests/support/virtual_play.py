"""Plays a fault script in virtual time: `tetractl run --plant lab` against the emulated lab.

Both are in this process and share one clock. Command line, plant, guard, inner loop, actuator,
frames, module, radio and firmware are the real ones; the wires are those of `virtual_wires`. A
loaded host changes nothing, so a failure is a failure.
"""

import contextlib
import io
import json
import sys
from unittest import mock

import numpy as np
from support.lab_processes import SMALL, SPEC, Played, flags
from support.virtual_lab import Busy
from support.virtual_wires import (
    LabClock,
    MemoryPort,
    MemorySerial,
    MemorySocket,
    Network,
    TrialClock,
    VirtualClient,
    VirtualLoop,
)

from tetractl.cli.app import run_app
from tetractl.control.build import build_controller
from tetractl.core.clock import SECOND
from tetractl.experiment.load import load_spec
from tetractl.experiment.plants import lab_of
from tetractl.lab.emulate.lab import EmulatedLab
from tetractl.lab.emulate.sides import Options
from tetractl.lab.rig import Rig
from tetractl.plant.lab import LabPlant, LabPlantSection

BEFORE_NS = SECOND // 2  # the lab is up that long before a run connects
AFTER_NS = SECOND  # and is watched for that long after it


def play(path, script, folder, *, replace_after=None, plan_s=0.0, sets=()):
    """Play a script; return what became of it, as `support.lab_processes.play` does.

    Each plan after the first takes `plan_s` of virtual time.
    """
    settings = (*SMALL, *script.runner.sets, *sets)
    record, link = folder / "emulator.jsonl", folder / "radio"
    loaded = load_spec(SPEC, settings)
    lab = lab_of(loaded.experiment, loaded.name)
    options = Options(
        command_port=0, data_port=0, link=link, record=record, replace_after=replace_after
    )
    network, clock = Network(), LabClock()
    with virtual_wires(network, clock, plan_s):
        emulation = EmulatedLab(
            lab, loaded.experiment.setup, script, options, make_loop=VirtualLoop
        )
        clock.timeline = emulation.timeline
        with emulation:
            clock.steps.insert(0, emulation.loop.poll)
            ready = next(e for e in events(record) if e["event"] == "ready")
            settings += (
                f"lab.camera.command_port={ready['command_port']}",
                f"lab.camera.data_port={ready['data_port']}",
                f"lab.actuator.port={ready['port']}",
            )
            clock.sleep_until(BEFORE_NS)
            logs = folder / "first"
            words = ["run", str(SPEC), "--plant", "lab", "--yes", "--quiet", "--out", str(logs)]
            code, said = command([*words, *flags(settings)])
            clock.sleep_until(clock.now() + AFTER_NS)
    return Played([code], [said], 0, events(record), sorted(logs.glob("*.mcap*")), link)


@contextlib.contextmanager
def virtual_wires(network, clock, plan_s=0.0):
    """Let the lab's code in this process find these wires and this clock in place of the host's."""
    VirtualClient.network, VirtualClient.base = network, clock
    MemoryPort.ports.clear()

    def build(lab, setup, trial_clock, seed, operators):
        camera = lab.camera.build(setup, trial_clock, operators.tap, lambda: None)
        actuator = lab.actuator.build(setup, trial_clock, operators.tap)
        rig = VirtualRig(
            camera,
            actuator,
            lab.limits,
            setup,
            trial_clock,
            operators.emergency,
            threaded=False,
        )
        rig.base = clock
        return LabPlant(rig, operators)

    def controller(experiment, key):
        rng = np.random.default_rng(1)
        return Busy(build_controller(experiment, key), clock, rng, plan_s, 0.0)

    with contextlib.ExitStack() as stack:
        for target, name, value in (
            (LabPlantSection, "clock", lambda self: TrialClock(clock)),
            (LabPlantSection, "build", build),
        ):
            stack.enter_context(mock.patch.object(target, name, value))
        for name, value in (
            ("tetractl.run.batch.build_controller", controller),
            ("tetractl.lab.cameras.optitrack.camera.NatNetClient", VirtualClient),
            (
                "tetractl.lab.cameras.optitrack.client.socket.socket",
                lambda *_: MemorySocket(network),
            ),
            ("tetractl.lab.emulate.optitrack.motive._bound", network.bound),
            ("tetractl.lab.emulate.m3pi.side.PseudoPort", MemoryPort),
            ("tetractl.lab.actuators.xbee.link.SerialPort", MemorySerial),
        ):
            stack.enter_context(mock.patch(name, value))
        yield


class VirtualRig(Rig):
    """A rig whose inner loop the clock steps."""

    base: LabClock

    def __enter__(self):
        self.base.steps.append(self.loop.step)
        return super().__enter__()

    def close(self):
        if self.loop.step in self.base.steps:
            self.base.steps.remove(self.loop.step)
        super().close()


def command(words):
    """Run a command in this process; return its exit code and what it said."""
    said = io.StringIO()
    with (
        mock.patch.object(sys, "argv", ["tetractl", *words]),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
    ):
        code = run_app()
    return int(code), said.getvalue()


def events(record):
    return [json.loads(line) for line in record.read_text().splitlines()]
