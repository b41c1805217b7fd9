"""A current driver, a section of the spec for it, and time to run it in: real or virtual."""

import threading
import time
from collections import deque

from tetractl.emulate.field import CurrentDriver
from tetractl.emulate.loop import Loop, Timeline
from tetractl.emulate.port import PseudoPort
from tetractl.lab.actuators.field.core import DriverLimits
from tetractl.lab.actuators.field.protocol import FieldCommand, encode_command
from tetractl.lab.actuators.field.section import FieldSection

LIMITS = DriverLimits(current_max_ma=2000, slew_ma_s=100_000)
PATIENCE_S = 10.0


def section(**changes):
    """Return 2 mT from 2 mT/A and -4 mT/A in an ambient 0.05 mT, limited to 2 A and 100 A/s."""
    x, y = {"gain_mt_a": 2.0, "offset_mt": 0.03}, {"gain_mt_a": -4.0, "offset_mt": -0.04}
    basis = {
        "type": "field",
        "port": "/dev/none",
        "strength_mt": 2.0,
        "coils": {"x": x, "y": y, "rotation": 0.3},
        "current_max_a": 2.0,
        "slew_max_a_s": 100.0,
    }
    return FieldSection.model_validate(basis | changes)


def eventually(condition):
    """Wait until a condition holds, for a bounded time; return whether it does."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.001)
    return True


class Bench:
    """An emulated driver on a real pseudo-terminal, running in real time in a thread."""

    def __init__(self, folder, limits=LIMITS, baud=115_200):
        timeline = Timeline(lambda until: self.driver.advance(until), time.monotonic_ns())
        self.port = PseudoPort(folder / "coils")
        self.told = []
        self.driver = CurrentDriver(
            timeline,
            self.port,
            limits,
            baud,
            tell=lambda event, **facts: self.told.append((event, facts)),
        )
        self._loop = Loop(timeline, lambda lag: None)
        self._acts = deque()
        self._ended = threading.Event()
        self.port.plug()
        self._loop.watch(self.port.fd, self.driver.readable)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def do(self, act):
        """Call `act` in the emulation's thread and wait for it."""
        done = threading.Event()
        self._acts.append(lambda: (act(), done.set()))
        assert done.wait(PATIENCE_S)

    def unplug(self):
        def pull():
            self._loop.forget(self.port.fd)
            self.port.unplug()

        self.do(pull)

    def close(self):
        self._ended.set()
        self._thread.join(PATIENCE_S)
        self.port.unplug()

    def _run(self):
        while not self._ended.is_set():
            while self._acts:
                self._acts.popleft()()
            self._loop.turn()


class Wire:
    """What an actuator needs of `Driver`, in virtual time, straight into an emulated driver."""

    failure = None

    def __init__(self, clock, driver=None):
        self.sent = []
        self._clock, self._driver = clock, driver

    def send(self, flags, x_ma=0, y_ma=0):
        self.sent.append(FieldCommand((len(self.sent) + 1) % 256, flags, x_ma, y_ma))
        if self._driver is not None:
            self._driver.hear(encode_command(self.sent[-1]))
        return self._clock.now()
