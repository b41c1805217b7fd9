"""An emulated lab in this process: turned by hand, or in virtual time over wires in memory."""

import contextlib
import socket
from dataclasses import replace
from pathlib import Path

from support.virtual_wires import PatientClock, virtual_wires

from tetractl.emulate.emulated_lab import EmulatedLab
from tetractl.emulate.loop import Loop
from tetractl.emulate.script import NOTHING, parse_script
from tetractl.emulate.sides import Options
from tetractl.emulate.virtual_wires import VirtualLoop, memory_wires
from tetractl.experiment.load import parse_spec
from tetractl.experiment.plants import lab_of
from tetractl.lab.cameras.optitrack.wire import pack, parse

SPEC = """
name: emulated
units: {length: mm}
arena: {left: 0, bottom: 0, width: 2000, height: 2000}
robots:
  - {name: green, start: [500, 500], heading: 0.5, target: [1500, 500], a: 6, speed: 180}
  - {name: blue, start: [500, 1500], heading: -2, target: [1500, 1500], a: 4, speed: 200}
wheels: {radius: 40}
lab:
  camera:
    type: optitrack
    server: 127.0.0.1
    transport: unicast
    robots: [{name: green, body: Green}, {name: blue, body: 7}]
  actuator:
    type: m3pi-xbee
    port: nowhere
    robots: [{name: green, index: 0, address: 1}, {name: blue, index: 1, address: 2}]
"""


FIELD = """
  actuator:
    type: field
    port: nowhere
    strength_mt: 2.0
    coils:
      x: {gain_mt_a: 2.1, offset_mt: 0.02}
      y: {gain_mt_a: -1.8, offset_mt: -0.04}
      rotation: 0.3
    current_max_a: 2.0
    slew_max_a_s: 100
"""
FIELD_SPEC = SPEC[: SPEC.index("  actuator:")].replace("wheels: {radius: 40}\n", "") + FIELD[1:]
APRILTAG = """lab:
  camera:
    type: apriltag
    source: {type: mjpeg, url: 'http://127.0.0.1:8080/'}
    robots:
      - {name: green, tag: 1, size_mm: 100, height_mm: 60}
      - {name: blue, tag: 2, size_mm: 100, height_mm: 60, heading_offset: 0.5}
    floor:
      - {tag: 100, at: [0, 0], size_mm: 150}
      - {tag: 101, at: [2000, 0], size_mm: 150}
      - {tag: 102, at: [2000, 2000], size_mm: 150}
      - {tag: 103, at: [0, 2000], size_mm: 150}
"""
APRILTAG_SPEC = SPEC[: SPEC.index("lab:")] + APRILTAG + SPEC[SPEC.index("  actuator:") :]


def emulated(
    folder, *sets, script=NOTHING, tell=None, spec=SPEC, make_loop=Loop, wires=None, **options
):
    """Return an EmulatedLab, not yet entered; `script` may be YAML."""
    loaded = parse_spec(spec, "emulated.yaml", sets)
    lab = lab_of(loaded.experiment, loaded.name)
    if isinstance(script, str):
        types = lab.camera.type, lab.actuator.type
        script = parse_script("about: a test\n" + script, "script.yaml", *types)
    chosen = replace(
        Options(command_port=0, data_port=0, link=Path(folder) / "radio"),
        record=Path(folder) / "record.jsonl",
        **options,
    )
    extra = {} if tell is None else {"report": tell}
    extra |= {"make_loop": make_loop, "wires": wires}
    return EmulatedLab(lab, loaded.experiment.setup, script, chosen, **extra)


@contextlib.contextmanager
def in_virtual_time(folder, *sets, **how):
    """Enter an emulated lab in virtual time; return it, its clock, and the settings to reach it."""
    clock = PatientClock()
    wires = memory_wires(clock)
    with virtual_wires(wires, clock):
        lab = emulated(folder, *sets, make_loop=VirtualLoop, wires=wires, **how)
        clock.timeline = lab.timeline
        with lab:
            clock.steps.insert(0, lab.loop.poll)
            motive, port = lab.camera.motive, lab.actuator.port.link
            found = f"lab.camera.command_port={motive.command_port}", f"lab.actuator.port={port}"
            yield lab, clock, (*sets, *found, f"lab.camera.data_port={motive.data_port}")


def turn_until(lab, condition, turns=20_000):
    """Turn the emulation's loop until `condition()`; return what it returned."""
    for _ in range(turns):
        if found := condition():
            return found
        lab.loop.turn()
    raise AssertionError("it did not happen")


class Client:
    """A bare NatNet client on one socket."""

    def __init__(self, lab):
        self.lab = lab
        self.version = lab.camera.motive.own_version
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.bind(("127.0.0.1", 0))
        self.got = []

    def send(self, message):
        self.socket.sendto(pack(message), ("127.0.0.1", self.lab.camera.motive.command_port))

    def poll(self):
        try:
            while True:
                self.got.append(parse(self.socket.recv(65535), self.version))
        except BlockingIOError:
            return self.got

    def ask(self, message, kind):
        """Send and return the first answer of a kind; forget all others that came."""
        self.got.clear()
        self.send(message)
        return self.next(kind)

    def next(self, kind, count=1):
        found = turn_until(
            self.lab,
            lambda: (
                (of := [m for m in self.poll() if isinstance(m, kind)]) and len(of) >= count and of
            ),
        )
        return found[0] if count == 1 else found[:count]
