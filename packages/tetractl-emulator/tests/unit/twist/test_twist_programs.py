"""Tests that robot programs in C and MicroPython pass the same test vectors."""

import importlib
import random
import subprocess
import sys
from contextlib import contextmanager
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from testkit.paths import FIRMWARE
from tetractl_emulator import firmware
from tetractl_emulator.firmware import CoreEvent, TwistCore

from tetractl.core.errors import WireError
from tetractl.lab.actuators.twist.lines import LineCommand, decode_command, encode_command
from tetractl.lab.cobs import Flag, crc16

pytestmark = pytest.mark.slow

VECTORS = FIRMWARE / "tests" / "twist_vectors.txt"
needs_compiler = pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found")


@contextmanager
def programs(**modules):
    """The folder of MicroPython programs on the path, with modules that only a robot has."""
    folder = str(FIRMWARE / "micropython")
    names = ["twist", "run_vectors", "main", *modules]
    before = {name: sys.modules.pop(name, None) for name in names}
    sys.modules.update(modules)
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)
        for name, module in before.items():
            sys.modules.pop(name, None)
            if module is not None:
                sys.modules[name] = module


def test_the_micropython_program_passes_the_vectors_in_python():
    with programs():
        import run_vectors

        assert run_vectors.run(VECTORS.read_text()) == (87, [])
        wrong = VECTORS.read_text().replace("wheels 10 236 64", "wheels 10 236 65")
        assert run_vectors.run(wrong) == (87, ["line 14: wheels 10 236 65 is wrong"])


@pytest.fixture(scope="module")
def everywhere(tmp_path_factory):
    """What `make everywhere` prints."""
    build = tmp_path_factory.mktemp("firmware")
    command = ["make", "-s", "everywhere", f"BUILD={build}"]
    compiled = subprocess.run(command, cwd=FIRMWARE, capture_output=True, text=True)
    assert compiled.returncode == 0, compiled.stdout + compiled.stderr
    return compiled.stdout


@pytest.mark.system
@needs_compiler
@pytest.mark.parametrize(
    ("target", "passed"),
    [
        ("mbed and QEMU", "cortex-m0plus: 5 test programs passed"),
        ("the sketch", "field_driver: 0 failures"),
        ("Uno", "Uno: the sketch is linked"),
        ("MicroPython", "micropython: 87 checks, 0 failures"),
    ],
)
def test_the_programs_pass_their_tests_on_other_processors(everywhere, target, passed):
    lines = everywhere.splitlines()
    for line in lines:
        if line.startswith(f"left out: {target}"):
            pytest.skip(line)
    assert any(line.startswith(passed) for line in lines)


def damaged(rng):
    """A line that is often a command, sometimes nearly one."""
    count = rng.randint(0, 4)
    kind = rng.choice("TWTWS")
    numbers = [rng.randint(0, 260), rng.randint(0, 8)]
    for _ in range(count):
        numbers += [rng.randint(0, 33), rng.randint(-5100, 5100), rng.randint(-51_000, 51_000)]
        if kind == "W" and rng.random() < 0.8:
            numbers[-1] //= 10
    words = [kind, *map(str, numbers)]
    if rng.random() < 0.3:
        place = rng.randrange(len(words))
        words[place] = rng.choice(["", "-", "+1", "1.0", "0001", "1" * 7, "x", "\u00b2"])
    head = " ".join(words).encode()
    line = head + b"*%04X" % crc16(head)
    if rng.random() < 0.2:
        place = rng.randrange(len(line))
        line = line[:place] + bytes([rng.randrange(256)]) + line[place + 1 :]
    return line.replace(b"\n", b"")


@pytest.mark.long
@needs_compiler
def test_core_program_and_codec_agree_on_what_a_command_is(tmp_path):
    rng = random.Random(3)
    library = firmware.load("twist", tmp_path)
    counts_of_event = dict.fromkeys(CoreEvent, 0)
    with programs():
        from twist import Twist

        for _ in range(3000):
            line = damaged(rng)
            robot = Twist(1, 43)
            core = TwistCore(1, 43, library)
            assert core.wheels(10_000) == robot.wheels(10_000)  # both are on for long
            events = core.push(line + b"\n", 0)
            robot.push(line + b"\n", 0)
            for event in events:
                counts_of_event[event] += 1
            assert core.wheels(0) == robot.wheels(0)
            assert core.status(0) == robot.status(0)
            assert robot.received == events.count(CoreEvent.ACCEPTED)
            assert robot.rejected == events.count(CoreEvent.REJECTED)
            try:
                decode_command(line)
            except WireError:
                assert CoreEvent.ACCEPTED not in events, line
            else:
                assert events == [CoreEvent.ACCEPTED], line
    assert all(counts_of_event[event] > 100 for event in (CoreEvent.ACCEPTED, CoreEvent.REJECTED))
    assert counts_of_event[CoreEvent.FOREIGN] > 20


COUNTS_PER_MM = 3.57  # of an encoder
DUTY_PER_MM_S = 4.0  # of a motor without load
WATCHDOG_RESET = 3
STANDING = (0.0, 0.0)


class Bench:
    """Stands for a 3pi+ 2040 without its hardware: what main.py writes and reads, for some
    milliseconds.

    Its wheels run at a share of the speed that their duty stands for. `lines` are what the radio
    receives, by the time [ms]; `speeds_by_ms` are those of the wheels [mm/s] after each step.
    """

    def __init__(self, duration_ms, lines, share=0.8, battery_mv=5000, reset_cause=0):
        self.duration_ms = duration_ms
        self.lines = dict(lines)
        self.share = share
        self.battery_mv = battery_mv
        self.reset_cause = reset_cause
        self.now = 0
        self.speeds = STANDING
        self.counts = [0.0, 0.0]
        self.sent = b""
        self.speeds_by_ms = []
        self.watchdog_fed = 0

    def sleep_ms(self, ms):
        self.now += ms
        for i in (0, 1):
            self.counts[i] += self.speeds[i] * ms / 1000 * COUNTS_PER_MM
        self.speeds_by_ms.append(self.speeds)
        if self.now >= self.duration_ms:
            raise StopIteration

    def drive(self, *duties):
        assert all(isinstance(duty, int) for duty in duties)
        duty_left, duty_right = duties
        speed_per_duty = self.share / DUTY_PER_MM_S
        self.speeds = (duty_left * speed_per_duty, duty_right * speed_per_duty)

    def send(self, data):
        self.sent += data

    def feed_watchdog(self):
        self.watchdog_fed += 1

    def machine(self):
        """The module `machine` of MicroPython."""
        radio = SimpleNamespace(
            any=lambda: self.now in self.lines,
            read=lambda: self.lines.pop(self.now),
            write=self.send,
        )
        module = ModuleType("machine")
        module.UART = lambda *_, **__: radio
        module.Pin = lambda number: number
        module.WDT = lambda timeout: SimpleNamespace(feed=self.feed_watchdog)
        module.WDT_RESET = WATCHDOG_RESET
        module.reset_cause = lambda: self.reset_cause
        return module

    def pololu_robot(self):
        """The module that Pololu's programs have of their robot."""
        module = ModuleType("pololu_3pi_2040_robot")
        module.robot = SimpleNamespace(
            Motors=lambda: SimpleNamespace(set_speeds=self.drive),
            Encoders=lambda: SimpleNamespace(get_counts=self.whole_counts),
            Battery=lambda: SimpleNamespace(get_level_millivolts=lambda: self.battery_mv),
        )
        return module

    def whole_counts(self):
        return tuple(int(count) for count in self.counts)


def play(bench):
    """Run main.py on a bench until its time is over; MicroPython's `time` has three more names."""
    import time

    added = {
        "sleep_ms": bench.sleep_ms,
        "ticks_ms": lambda: bench.now,
        "ticks_diff": lambda now, before: now - before,
    }
    modules = {"machine": bench.machine(), "pololu_3pi_2040_robot": bench.pololu_robot()}
    for name, function in added.items():
        setattr(time, name, function)
    try:
        with programs(**modules), pytest.raises(StopIteration):
            importlib.import_module("main")
    finally:
        for name in added:
            delattr(time, name)


def lines(*commands):
    """Lines with numbers from 1 on, by their times; `commands` are time [ms], flags, entries."""
    return {
        time_ms: encode_command(LineCommand("W", number % 256, flags, entries))
        for number, (time_ms, flags, entries) in enumerate(commands, 1)
    }


def runs(end_ms, *speeds):
    """Commands to run at these speeds of both wheels, every 25 ms."""
    return lines(*[(time_ms, Flag.RUN, ((0, *speeds),)) for time_ms in range(1020, end_ms, 25)])


def test_a_robot_drives_at_its_speed():
    bench = Bench(2600, runs(2000, 150, -75))
    play(bench)
    settled = bench.speeds_by_ms[1400:1990]  # single steps jitter by a count of the encoder
    mean_left, mean_right = np.mean(settled, axis=0)
    assert mean_left == pytest.approx(150, abs=4)
    assert mean_right == pytest.approx(-75, abs=4)
    assert bench.watchdog_fed == 2600


def test_a_robot_stops_by_its_watchdog():
    sent = runs(2000, 150, -75)
    bench = Bench(2600, sent)
    play(bench)
    last_ms = max(sent)
    stopped_ms = bench.speeds_by_ms.index(STANDING, last_ms + 1)
    assert 250 <= stopped_ms - last_ms <= 253
    assert bench.speeds_by_ms[-1] == STANDING


def test_a_robot_keeps_an_emergency_stop():
    run = ((0, 100, 100),)
    sent = lines((1060, Flag.RUN, run), (1080, Flag.EMERGENCY_STOP, ()), (1100, Flag.RUN, run))
    bench = Bench(1200, sent)
    play(bench)
    assert any(speeds != STANDING for speeds in bench.speeds_by_ms[1060:1080])
    assert set(bench.speeds_by_ms[1082:]) == {STANDING}
