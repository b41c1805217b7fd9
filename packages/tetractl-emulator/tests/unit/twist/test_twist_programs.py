"""The programs of robots that take lines, in C and MicroPython, pass the same vectors."""

import importlib
import random
import re
import subprocess
import sys
from contextlib import contextmanager
from types import ModuleType, SimpleNamespace

import pytest
from support.paths import EMULATOR
from tetractl_emulator import firmware
from tetractl_emulator.firmware import CoreEvent, TwistCore

from tetractl.core.errors import WireError
from tetractl.lab.actuators.twist.lines import LineCommand, decode_command, encode_command
from tetractl.lab.cobs import Flag, crc16

pytestmark = pytest.mark.slow

FOLDER = EMULATOR / "firmware"
VECTORS = FOLDER / "tests" / "twist_vectors.txt"
needs_compiler = pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found")


@contextmanager
def programs(**modules):
    """The folder of MicroPython programs on the path, with modules that only a robot has."""
    folder = str(FOLDER / "micropython")
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

        assert run_vectors.run(VECTORS.read_text()) == (76, [])
        wrong = VECTORS.read_text().replace("wheels 10 236 64", "wheels 10 236 65")
        assert run_vectors.run(wrong) == (76, ["line 13: wheels 10 236 65 is wrong"])


@needs_compiler
@pytest.mark.parametrize("target", ["test", "sanitize"])
def test_the_core_passes_the_vectors_on_this_computer(tmp_path, target):
    compiled = subprocess.run(
        ["make", "-s", target, f"BUILD={tmp_path}"], cwd=FOLDER, capture_output=True, text=True
    )
    assert compiled.returncode == 0, compiled.stdout + compiled.stderr
    assert "76 checks, 0 failures" in compiled.stdout


@pytest.fixture(scope="module")
def everywhere(tmp_path_factory):
    """What `make everywhere` prints."""
    build = tmp_path_factory.mktemp("firmware")
    command = ["make", "-s", "everywhere", f"BUILD={build}"]
    compiled = subprocess.run(command, cwd=FOLDER, capture_output=True, text=True)
    assert compiled.returncode == 0, compiled.stdout + compiled.stderr
    return compiled.stdout


@pytest.mark.system
@needs_compiler
@pytest.mark.parametrize(
    ("target", "passed"),
    [
        ("Cortex-M0+", "Cortex-M0+: 4 programs passed"),
        ("the sketch", "field_driver: 0 failures"),
        ("Uno", "Uno: the sketch is linked"),
        ("MicroPython", "micropython: 76 checks, 0 failures"),
    ],
)
def test_the_programs_pass_their_tests_on_other_processors(everywhere, target, passed):
    lines = everywhere.splitlines()
    for line in lines:
        if line.startswith(f"left out: {target}"):
            pytest.skip(line)
    assert passed in lines


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
            events = core.push(line + b"\n", 0)
            robot.push(line + b"\n", 0)
            for event in events:
                counts_of_event[event] += 1
            assert core.wheels(0) == robot.wheels(0)
            assert core.status(0) == robot.status(0)
            assert (robot.received, robot.rejected) == (
                events.count(CoreEvent.ACCEPTED),
                events.count(CoreEvent.REJECTED),
            )
            try:
                decode_command(line)
            except WireError:
                assert CoreEvent.ACCEPTED not in events, line
            else:
                assert events == [CoreEvent.ACCEPTED], line
    assert all(counts_of_event[event] > 100 for event in (CoreEvent.ACCEPTED, CoreEvent.REJECTED))
    assert counts_of_event[CoreEvent.FOREIGN] > 20


class Bench:
    """A 3pi+ 2040 without its hardware: what main.py writes and reads, for `steps` of 1 ms; wheels
    run at a share of the speed that their duty stands for."""

    def __init__(self, steps, lines, share=0.8, battery_mv=5000, reset=0):
        self.steps = steps
        self.lines = dict(lines)
        self.share = share
        self.reset = reset
        self.now = 0
        self.speeds = (0.0, 0.0)
        self.counts = [0.0, 0.0]
        self.sent = b""
        self.path = []
        self.fed = 0
        self.battery_mv = battery_mv

    def sleep_ms(self, ms):
        self.now += ms
        for i in (0, 1):
            self.counts[i] += self.speeds[i] * ms / 1000 * 3.57
        self.path.append(self.speeds)
        if self.now >= self.steps:
            raise StopIteration

    def drive(self, left, right):
        assert all(isinstance(duty, int) for duty in (left, right))
        self.speeds = left / 4.0 * self.share, right / 4.0 * self.share

    def modules(self):
        def feed():
            self.fed += 1

        radio = SimpleNamespace(
            any=lambda: self.now in self.lines, read=lambda: self.lines.pop(self.now)
        )
        radio.write = lambda data: setattr(self, "sent", self.sent + data)
        machine, time, pololu = (
            ModuleType(n) for n in ("machine", "time", "pololu_3pi_2040_robot")
        )
        machine.UART = lambda *_, **__: radio
        machine.Pin = lambda number: number
        machine.WDT = lambda timeout: SimpleNamespace(feed=feed)
        machine.WDT_RESET = 3
        machine.reset_cause = lambda: self.reset
        time.sleep_ms = self.sleep_ms
        time.ticks_ms = lambda: self.now
        time.ticks_diff = lambda now, before: now - before
        pololu.robot = SimpleNamespace(
            Motors=lambda: SimpleNamespace(set_speeds=self.drive),
            Encoders=lambda: SimpleNamespace(get_counts=lambda: tuple(map(int, self.counts))),
            Battery=lambda: SimpleNamespace(get_level_millivolts=lambda: self.battery_mv),
        )
        return {"machine": machine, "time": time, "pololu_3pi_2040_robot": pololu}


def play(bench):
    import time

    modules = bench.modules()
    kept = modules.pop("time")
    names = {name: getattr(kept, name) for name in ("sleep_ms", "ticks_ms", "ticks_diff")}
    for name, value in names.items():
        setattr(time, name, value)
    try:
        with programs(**modules), pytest.raises(StopIteration):
            importlib.import_module("main")
    finally:
        for name in names:
            delattr(time, name)


def lines(*pairs):
    return {
        at: encode_command(LineCommand("W", i % 256, flags, entries))
        for i, (at, flags, entries) in enumerate(pairs, 1)
    }


def test_a_robot_drives_at_its_speed_and_stops_by_its_watchdog():
    sent = lines(*[(at, Flag.RUN, ((0, 150, -75),)) for at in range(20, 1000, 25)])
    bench = Bench(1600, sent)
    play(bench)
    # single steps jitter by a count of the encoder
    settled = bench.path[400:990]
    last = max(sent)
    left, right = (sum(side) / len(settled) for side in zip(*settled, strict=True))
    assert (left, right) == (pytest.approx(150, abs=4), pytest.approx(-75, abs=4))
    stopped = next(i for i, speeds in enumerate(bench.path) if i > last and speeds == (0, 0))
    assert 250 <= stopped - last <= 253
    assert bench.path[-1] == (0, 0)
    assert bench.fed == 1600


def test_a_robot_replies_with_its_battery_and_keeps_an_emergency_stop():
    sent = lines(
        (20, Flag.POLL, ()),
        (60, Flag.RUN, ((0, 100, 100),)),
        (80, Flag.EMERGENCY_STOP, ()),
        (100, Flag.RUN, ((0, 100, 100),)),
    )
    bench = Bench(200, sent, battery_mv=4321)
    play(bench)
    assert re.fullmatch(rb"S 0 1 0 4321 1 0\*[0-9A-F]{4}\n", bench.sent)
    assert any(left > 0 for left, _ in bench.path[60:80])
    assert set(bench.path[82:]) == {(0.0, 0.0)}


@pytest.mark.parametrize("wrong", [{"battery_mv": 3900}, {"reset": 3}])
def test_a_robot_with_an_empty_battery_or_after_its_watchdog_stands(wrong):
    bench = Bench(
        200, lines(*[(at, Flag.RUN, ((0, 99, 99),)) for at in range(20, 190, 25)]), **wrong
    )
    play(bench)
    assert set(bench.path) == {(0.0, 0.0)}
