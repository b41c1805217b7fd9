"""The emulated lab put together: cameras, radio, robots, faults, and a helping hand."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab import LabSpec
from tetractl.experiment.lab import Slave as SlaveSpec
from tetractl.lab.emulate import build
from tetractl.lab.emulate.command_log import Witness
from tetractl.lab.emulate.faults import Injector
from tetractl.lab.emulate.loop import Loop, Timeline
from tetractl.lab.emulate.motive import Motive, Streaming
from tetractl.lab.emulate.port import PseudoPort
from tetractl.lab.emulate.radio import Radio
from tetractl.lab.emulate.record import Record
from tetractl.lab.emulate.robot import Robot
from tetractl.lab.emulate.script import Fault, Script
from tetractl.lab.emulate.tracked_body import Sight, expose

TICK_NS = 2_000_000  # how often robots are asked for answers and looked at
FLUSH_NS = 200_000_000
CARRY_NS = 500_000_000  # how long a robot is in the helper's hands
SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Options:
    """Where the emulation is to be found. Port 0 takes any; None what the spec says.

    `record` is a file for what truly happens. `replace_after` [s]: robots that have stood still
    that long after a run are switched off and on and put back on their starts.
    """

    address: str = "127.0.0.1"
    command_port: int | None = None
    data_port: int | None = None
    link: Path | None = None
    record: Path | None = None
    replace_after: float | None = None
    seed: int = 1


class EmulatedLab:
    """An emulated lab on real wires. `tell(event, facts)` hears what a person should.

    Use it as a context manager: leaving it takes ports and names away, whatever happened.
    """

    def __init__(
        self,
        experiment: Experiment,
        lab: LabSpec,
        script: Script,
        options: Options,
        tell: Callable[[str, dict[str, Any]], None] = lambda event, facts: None,
    ) -> None:
        self.sights = build.sights(experiment, lab, script)
        self.robots = [sight.robot for sight in self.sights]
        self.swapped: set[int] = set()
        self._experiment, self._script, self._options = experiment, script, options
        self._record, self._tell = Record(None), tell
        self._view = build.view(experiment, lab, script)
        start_ns = time.monotonic_ns()
        self.timeline = Timeline(self._advance, start_ns)
        self.loop = Loop(self.timeline, lambda lag: self._note("late", lag_ms=lag / 1e6))
        self.port = PseudoPort(options.link or Path(lab.radio.port))
        self.injector = Injector(self, script.faults, self._fault)
        settings = build.radio_settings(lab, script)
        self._witness = Witness(settings.mode, isinstance(lab.protocol, SlaveSpec), self._note)
        self.radio = Radio(
            self.timeline,
            self.port,
            settings,
            self.robots,
            build.addresses(lab),
            script.emulation.loss,
            options.seed,
            self._witness.read,
            lambda robot, data: self._note("heard", robot=robot.name, hex=data.hex()),
        )
        self.motive = Motive(
            self.timeline,
            self._streaming(lab),
            build.body_names(self.sights),
            lambda: expose(self.sights, self._view, self.swapped),
            self._exposed,
            self.injector.sent,
            self._client,
            options.seed,
        )
        self._moving = [False] * len(self.robots)
        self._ran = False  # since the robots were last put on their starts
        self._still_since: int | None = start_ns  # None while any robot moves
        for robot in self.robots:
            robot.now_ns = start_ns
            robot.place(*build.start_of(experiment, script, robot.name))

    def __enter__(self) -> "EmulatedLab":
        self.loop.catch_up()
        try:
            self._record = Record(self._options.record)
            self.plug()
            self.loop.watch(self.motive.open(), self.motive.readable)
        except BaseException:
            self.close()
            raise
        self._tick()
        self._flush()
        facts = {
            "emulation": True,
            "address": self.motive.streaming.address,
            "command_port": self.motive.command_port,
            "data_port": self.motive.data_port,
            "transport": self.motive.streaming.transport,
            "port": str(self.port.link),
            "robots": [robot.name for robot in self.robots],
        }
        self._note("ready", **facts)
        self._record.flush()
        self._tell("ready", facts)
        self.injector.happened("start")
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def run(self) -> None:
        """Run in real time until `loop.end()`."""
        self.loop.run()

    def close(self) -> None:
        """Take ports and names away, and close the record; idempotent."""
        self.unplug()
        self.motive.close()
        counts = self.motive.counts
        self._note(
            "end",
            worst_lag_ms=self.loop.worst_lag_ns / 1e6,
            frames=counts.frames,
            refused=counts.refused,
            timed_out=counts.timed_out,
            garbled=self.radio.garbled,
        )
        self._record.close()

    def plug(self) -> None:
        """Plug the radio in."""
        self.port.plug()
        self.loop.watch(self.port.fd, self.radio.readable)

    def unplug(self) -> None:
        """Pull the radio out."""
        self.loop.forget(self.port.fd)
        self.port.unplug()

    def robot(self, name: str | None) -> Robot:
        """Return a robot by name."""
        return self.robots[self.place_of(name)]

    def sight(self, name: str | None) -> Sight:
        """Return a robot's rigid body by the robot's name."""
        return self.sights[self.place_of(name)]

    def place_of(self, name: str | None) -> int:
        """Return a robot's place among the robots."""
        return next(i for i, robot in enumerate(self.robots) if robot.name == name)

    def _streaming(self, lab: LabSpec) -> Streaming:
        emulation, options, mocap = self._script.emulation, self._options, lab.mocap
        port, data = options.command_port, options.data_port
        return Streaming(
            options.address,
            mocap.command_port if port is None else port,
            mocap.data_port if data is None else data,
            mocap.transport,
            mocap.group,
            build.version_of(emulation.version),
            emulation.rate,
            emulation.latency,
            up=self._view.up,
            knows_up_axis=emulation.knows_up_axis,
        )

    def _advance(self, until_ns: int) -> None:
        for robot in self.robots:
            robot.advance(until_ns)

    def _note(self, event: str, **facts: Any) -> None:
        self._record.add(self.timeline.now_ns, event, **facts)

    def _exposed(self, exposure: int, number: int) -> None:
        self.injector.exposed(exposure)
        self._note(
            "truth",
            exposure=exposure,
            frame=number,
            poses=[[round(r.x, 3), round(r.y, 3), round(r.heading, 5)] for r in self.robots],
            wheels=[[round(r.left, 2), round(r.right, 2)] for r in self.robots],
        )

    def _client(self, address: str) -> None:
        self._note("client", address=address)
        self._tell("client", {"address": address})
        self.injector.happened("client")

    def _fault(self, phase: str, fault: Fault) -> None:
        facts = {"name": fault.fault, "phase": phase, "robot": fault.robot, "mark": fault.name}
        self._note("fault", **facts)
        self._record.flush()
        self._tell("fault", facts)

    def _tick(self) -> None:
        """Ask the robots for answers and look who moves."""
        now = self.timeline.now_ns
        self.radio.poll_answers()
        for i, robot in enumerate(self.robots):
            if any(robot.counts()) and not self._ran:
                self._ran = True
                if self._still_since is not None:  # what was before the run does not count
                    self._still_since = now
                self._note("run")
                self._tell("run", {})
                self.injector.happened("run")
            if self._moving[i] == robot.standing:
                self._moving[i] = not robot.standing
                self._note("robot", name=robot.name, moving=self._moving[i])
        if any(self._moving):
            if self._still_since is not None:
                self._tell("moving", {})
            self._still_since = None
        elif self._still_since is None:
            self._still_since = now
            self._tell("rest", {})
        self._help(now)
        self.timeline.at(now + TICK_NS, self._tick)

    def _help(self, now: int) -> None:
        """Carry the robots back to their starts once they have stood long enough."""
        wait = self._options.replace_after
        if wait is None or not self._ran or self._still_since is None:
            return
        if now - self._still_since < round(wait * SECOND):
            return
        self._ran = False
        for sight in self.sights:
            sight.tracked = False
            sight.robot.switch(False)
        self.timeline.at(now + CARRY_NS, self._put_down)

    def _put_down(self) -> None:
        for sight in self.sights:
            start = build.start_of(self._experiment, self._script, sight.robot.name)
            sight.robot.place(*start)
            sight.robot.switch(True)
            sight.tracked = True
        self._note("placed")
        self._tell("placed", {})

    def _flush(self) -> None:
        self._record.flush()
        self.timeline.at(self.timeline.now_ns + FLUSH_NS, self._flush)
