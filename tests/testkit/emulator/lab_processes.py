"""Runs the emulated lab over real connections, in another process or step by step in this one.

`play` plays a fault script from start to end, with an emulator process and a runner process, and
returns what happened. Nothing sleeps: the emulator reports events, and the tests wait for them.
"""

import json
import math
import queue
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tetractl_emulator.emulated_lab import EmulatedLab
from tetractl_emulator.script import NO_FAULTS, parse_script
from tetractl_emulator.sides import Options

from testkit.lab_specs import SPEC as TWO
from testkit.paths import ROOT
from tetractl.spec.load import parse_spec
from tetractl.spec.plants import get_lab

SPEC = ROOT / "experiments" / "three_m3pi_lab.yaml"
TETRACTL = str(Path(sys.executable).with_name("tetractl"))
PATIENCE_S = 300  # until a step counts as hung: generous, for loaded machines
RUN = 1  # the flag of a command
SMALL = (  # a small swarm and under two seconds of driving
    "lab.camera.transport=unicast",
    "lab.camera.server=127.0.0.1",
    "lab.camera.interface=127.0.0.1",
    "controller.optimizer={type: pso, particles: 20, iterations: 10, stop: {type: budget}}",
    "controller.horizon_max=20",
    "controller.period=0.2",  # 5 Hz is enough to stop at, and light
    "controller.signal_periods=1",
    "controller.deadline=0.15",
    "controller.time_limit=1.8",
    "trials.count=1",
)
APRILTAG = (  # the same robots under a network camera
    "lab.camera={type: apriltag, source: {type: mjpeg, url: 'http://127.0.0.1:8080/'}, robots: ["
    "{name: green, tag: 0, size_mm: 80, height_mm: 90}, "
    "{name: blue, tag: 1, size_mm: 80, height_mm: 90}, "
    "{name: red, tag: 2, size_mm: 80, height_mm: 90}], floor: ["
    "{tag: 100, at: [400, 250], size_mm: 120}, {tag: 101, at: [2200, 250], size_mm: 120}, "
    "{tag: 102, at: [2200, 2250], size_mm: 120}, {tag: 103, at: [400, 2250], size_mm: 120}]}",
    *(setting for setting in SMALL if not setting.startswith("lab.camera")),
)


def camera_of(path):
    """The camera that a script is for, by its folder; OptiTrack's have none of their own."""
    return "apriltag" if path.parent.name == "apriltag" else "optitrack"


def flags(settings):
    return [word for setting in settings for word in ("--set", setting)]


class Emulator:
    """`tetractl lab emulate` in a process; `events` are what it says, as it says it."""

    def __init__(self, folder, settings, *options):
        self.record = folder / "emulator.jsonl"
        self.link = folder / "radio"
        command = [TETRACTL, "lab", "emulate", str(SPEC), "--json", *flags(settings)]
        command += ["--command-port", "0", "--data-port", "0", "--port-link", str(self.link)]
        command += ["--record", str(self.record), *options]
        self.errors = (folder / "emulator.err").open("w+")
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=self.errors, text=True, cwd=folder
        )
        self.events = queue.Queue()
        self.resting = True
        self.reader = threading.Thread(target=self._read)
        self.reader.start()

    def _read(self):
        for line in self.process.stdout:
            self.events.put(json.loads(line))
        self.events.put({"event": "gone"})

    def next(self, timeout=PATIENCE_S):
        """Return the next event; queue.Empty after the timeout."""
        event = self.events.get(timeout=timeout)
        if event["event"] == "gone":
            self.errors.seek(0)
            raise AssertionError(f"the emulator has ended: {self.errors.read()}")
        self.resting = {"rest": True, "moving": False}.get(event["event"], self.resting)
        return event

    def wait_for(self, name, meanwhile=lambda: None):
        """Wait for an event of this name; `meanwhile`, called all the time, may end the wait."""
        hung = time.monotonic() + PATIENCE_S
        while time.monotonic() < hung:
            with suppress(queue.Empty):
                event = self.next(timeout=0.05)
                if event["event"] == name:
                    return event
            meanwhile()
        raise AssertionError(f"no {name} came")

    def runs(self):
        """How many runs have begun, by its record."""
        lines = self.record.read_text().splitlines()
        return sum(json.loads(line)["event"] == "run" for line in lines)

    def end(self):
        """End it as Ctrl-C does; return its exit code and its record."""
        self.process.send_signal(signal.SIGINT)
        code = self.process.wait(PATIENCE_S)
        self.close()
        return code, [json.loads(line) for line in self.record.read_text().splitlines()]

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.reader.join()
        self.process.stdout.close()
        self.errors.close()


class Runner:
    """`tetractl run --plant lab` in a process, given only addresses and a port's name."""

    def __init__(self, folder, name, settings):
        self.folder = folder / name
        self.words = []
        command = [TETRACTL, "run", str(SPEC), "--plant", "lab", "--yes", "--quiet"]
        command += ["--out", str(self.folder), *flags(settings)]
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=folder,
        )
        self.reader = threading.Thread(target=lambda: self.words.extend(self.process.stdout))
        self.reader.start()  # a pipe: files may be limited

    def printed(self):
        """All it said; once it has ended."""
        self.reader.join()
        return "".join(self.words)

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.reader.join()
        self.process.stdout.close()


@dataclass
class Played:
    """What became of a script: `exits` and `said` of every runner, the first first."""

    exits: list
    said: list
    emulator_exit: int
    record: list
    logs: list
    link: Path

    def of(self, event, **facts):
        """The record's events of a kind."""
        return [e for e in self.record if e["event"] == event and facts.items() <= e.items()]

    def seen_ns(self):
        """When the first fault after the run's start became visible, None without one."""
        start = self.of("run")[0]["t_ns"]
        return next(
            (e["t_ns"] for e in self.of("fault", phase="start") if e["t_ns"] >= start), None
        )

    def lag_s(self, start_ns, end_ns):
        """The most the emulator itself was late between two moments: what the host's load cost."""
        late = [e for e in self.of("late") if e["t_ns"] <= end_ns]
        over = [e for e in late if e["t_ns"] + 1e6 * e["lag_ms"] >= start_ns]
        return max((e["lag_ms"] / 1e3 for e in over), default=0.0)

    def driven_late_s(self):
        """The most the emulator was late while robots were driven."""
        start = next((e["t_ns"] for e in self.of("run")), 0)
        return self.lag_s(start, self.record[-1]["t_ns"])

    def stop_after(self, name, since_ns):
        """Seconds from `since_ns` until a stop for a robot was on the wire."""
        place = self.of("ready")[0]["robots"].index(name)
        return next(
            (event["t_ns"] - since_ns) / 1e9
            for event in self.of("command")
            if event["t_ns"] >= since_ns and stops(event, place)
        )

    def rest_after(self, name, since_ns):
        """Seconds from `since_ns` until a robot stood still; 0 where it did already."""
        changes = self.of("robot", name=name)
        before = [e for e in changes if e["t_ns"] < since_ns]
        if not before or not before[-1]["moving"]:
            return 0.0
        return next(e["t_ns"] - since_ns for e in changes if e["t_ns"] >= since_ns) / 1e9

    def moved_until(self, name, since_ns):
        """Seconds from `since_ns` until a robot stood still for good, infinite if it drives."""
        change = self.of("robot", name=name)[-1]
        return math.inf if change["moving"] else (change["t_ns"] - since_ns) / 1e9

    def moves_after(self, name, since_ns):
        """Whether a robot, having come to rest after `since_ns`, moved again."""
        rest = since_ns + self.rest_after(name, since_ns) * 1e9
        return any(e["t_ns"] > rest for e in self.of("robot", name=name, moving=True))


def stops(command, place):
    """Whether a command stops the robot at a place in the frame."""
    wheels = command["wheels"]
    return not command["flags"] & RUN or place >= len(wheels) or wheels[place] == [0, 0]


def play(path, script, folder, *options, sets=()):
    """Play a script, with further options of the emulator and settings of both sides."""
    apriltag = camera_of(path) == "apriltag"
    settings = (*(APRILTAG if apriltag else SMALL), *script.runner.sets, *sets)
    runners = []
    emulator = Emulator(folder, settings, "--script", str(path), *options)
    try:
        ready = emulator.wait_for("ready")
        settings += (f"lab.actuator.port={ready['port']}",)
        if apriltag:
            settings += (f"lab.camera.source.url={ready['url']}",)
        else:
            ports = ("command_port", "data_port")
            settings += tuple(f"lab.camera.{port}={ready[port]}" for port in ports)
        runners.append(Runner(folder, "first", settings))
        _attend(emulator, runners[0].process)
        for runner in runners:
            runner.process.wait(PATIENCE_S)
        while not emulator.resting:
            emulator.next()
        code, record = emulator.end()
        logs = sorted(runners[0].folder.glob("*.mcap*"))
        return Played(
            [runner.process.returncode for runner in runners],
            [runner.printed() for runner in runners],
            code,
            record,
            logs,
            emulator.link,
        )
    finally:
        emulator.close()
        for runner in runners:
            runner.close()


def _attend(emulator, first):
    """Hear what the emulator says until the run ends."""
    hung = time.monotonic() + 2 * PATIENCE_S
    while first.poll() is None:
        assert time.monotonic() < hung, "the run does not end"
        with suppress(queue.Empty):
            emulator.next(timeout=0.05)


def script_of(script, lab):
    """A script for a lab, of one or of YAML."""
    if isinstance(script, str):
        types = lab.camera.type, lab.actuator.type
        return parse_script("about: a test\n" + script, "script.yaml", *types)
    return script


def emulated(folder, *sets, script=NO_FAULTS, tell=None, spec=TWO, **options):
    """Return an EmulatedLab on this computer's wires, not yet entered; `script` may be YAML."""
    loaded = parse_spec(spec, "emulated.yaml", sets)
    lab = get_lab(loaded.experiment, loaded.name)
    places = {"port_link": Path(folder) / "radio", "record": Path(folder) / "record.jsonl"}
    chosen = Options(command_port=0, data_port=0, **places, **options)
    extra = {} if tell is None else {"report": tell}
    return EmulatedLab(lab, loaded.experiment.setup, script_of(script, lab), chosen, **extra)


def turn_until(lab, condition):
    """Turn the emulation's loop until `condition()`; return what it returned."""
    for _ in range(20_000):
        result = condition()
        if result:
            return result
        lab.loop.turn()
    raise AssertionError("it did not happen")
