"""The emulated microscope and our camera of cells on one virtual clock, and trials with them.

Pictures are synthetic. Command line, plant, guard, inner loop, actuator, driver, coils, cells,
pictures, JPEG parts and tracking are the real ones; threads, sockets and the clock are not.
"""

import contextlib
import threading
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from unittest import mock

from support.needs_opencv import cv2
from support.paths import ROOT
from support.virtual_wires import LabClock, Network, VirtualLoop, virtual_wires

from tetractl.core.clock import SECOND, wait_for
from tetractl.core.errors import AbortError
from tetractl.emulate.emulated_lab import EmulatedLab
from tetractl.emulate.script import NOTHING, parse_script
from tetractl.emulate.sides import Options
from tetractl.emulate.stream_side import BOUNDARY, coded, part
from tetractl.experiment.load import LoadedSpec, load_spec
from tetractl.experiment.plants import lab_of, on_plant
from tetractl.lab.cameras.cells.camera import CellCamera
from tetractl.lab.cameras.cells.section import CellsSection
from tetractl.lab.cameras.pictures.feed import Picture
from tetractl.lab.cameras.pictures.multipart import Multipart

cv2.setNumThreads(1)
DISH = ROOT / "experiments" / "tetrahymena_dish.yaml"
BEFORE_NS = SECOND // 2  # the lab is up that long before anything connects


class MemoryNetworkCamera:
    """The emulated network camera without threads and sockets: JPEG parts by their address.

    Turned by the clock; what the emulation draws and sends is what travels over HTTP.
    """

    streams: ClassVar[dict] = {}
    base: LabClock

    def __init__(
        self, draw, clock, rate_hz, exposure_s, latency_s, quality=90, port=0, drips=False
    ):
        self.url = f"http://127.0.0.1:{port}/"
        self.mangle, self.frozen, self.every = lambda part: part, threading.Event(), 1
        self.watched = False
        self._draw, self._clock, self._quality = draw, clock, quality
        self._period, self._half = SECOND / rate_hz, round(exposure_s * SECOND / 2)
        self._latency, self._count = round(latency_s * SECOND), 0
        self._sent = deque()

    def __enter__(self):
        self._start = self._clock.now()
        self.streams[self.url] = self
        self.base.steps.append(self._turn)
        return self

    def __exit__(self, *_):
        self.streams.pop(self.url, None)
        if self._turn in self.base.steps:
            self.base.steps.remove(self._turn)

    def take(self):
        """Return, once, the bytes that have left."""
        gone = b""
        while self._sent and self._sent[0][0] <= self._clock.now():
            gone += self.mangle(part(self._sent.popleft()[1]))
        return gone

    def _turn(self):
        exposed = self._start + round(self._count * self._period)
        if self._clock.now() < exposed + self._half:
            return
        self._count += 1
        if self.watched and not self.frozen.is_set() and self._count % self.every == 0:
            jpeg = coded(self._draw(exposed), self._quality)
            self._sent.append((exposed + self._latency, jpeg))


class VirtualCellCamera(CellCamera):
    """Our camera of cells, turned by the clock in the place of its threads."""

    base: LabClock

    def __enter__(self):
        stream = MemoryNetworkCamera.streams.get(self.section.source.url)
        if stream is None:
            raise AbortError(f"{self.section.source.url} does not answer: connection refused")
        stream.watched, self._stream = True, stream
        self._parts, self._number = Multipart(BOUNDARY), 0
        self.base.steps.append(self._look_now)
        if not self._wait(lambda: self._newest is not None, self.section.connect):
            self.__exit__()
            raise AbortError(f"no picture comes from {self.section.source.url}")
        return self

    def __exit__(self, *_):
        if self._look_now in self.base.steps:
            self.base.steps.remove(self._look_now)
            self._stream.watched = False

    @property
    def damaged(self):
        return self._unread + self._parts.damaged

    @property
    def emulated(self):
        return True

    def _wait(self, done, timeout_s):
        return wait_for(self.base, done, timeout_s)

    def _look_now(self):
        for body in self._parts.feed(self._stream.take()):
            self._number += 1
            self._search(self._number, Picture(body, self._clock.now()))


@dataclass
class VirtualDish:
    """An emulated dish; `spec` leads to it."""

    emulation: EmulatedLab
    clock: LabClock
    spec: LoadedSpec
    sets: tuple

    @property
    def cells(self):
        """The cells as they truly are."""
        return self.emulation.actuator.bodies[0].dish.cells


@contextlib.contextmanager
def virtual_dish(folder, seed=1, sets=(), script="", spec=DISH):
    """An emulated dish with a microscope in virtual time; `script` is YAML."""
    coils = Path(folder) / "coils"
    sets = (f"trials.seed={seed}", f"lab.actuator.port={coils}", *sets)
    loaded = load_spec(spec, sets)
    lab = lab_of(loaded.experiment, loaded.name)
    play = parse_script("about: a test\n" + script, "script", "cells", "field")
    options = Options(link=coils, seed=seed, chosen=loaded.experiment.open)
    clock = LabClock()
    VirtualCellCamera.base = MemoryNetworkCamera.base = clock
    MemoryNetworkCamera.streams.clear()
    stream = "tetractl.emulate.stream_side"
    device = f"{__name__}:VirtualCellCamera"
    with (
        virtual_wires(Network(), clock),
        mock.patch(f"{stream}.EmulatedNetworkCamera", MemoryNetworkCamera),
        mock.patch(f"{stream}.MonotonicClock", lambda: clock),
        mock.patch.object(CellsSection, "device", device),
    ):
        setup = loaded.experiment.setup
        emulation = EmulatedLab(lab, setup, play or NOTHING, options, make_loop=VirtualLoop)
        clock.timeline = emulation.timeline
        with emulation:
            clock.steps.insert(0, emulation.loop.poll)
            clock.sleep_until(BEFORE_NS)
            yield VirtualDish(emulation, clock, on_plant(loaded, "lab"), sets)
