"""An emulated lab: robots, an actuator that drives them, and a camera that shows them.

A program opens the lab's ports and addresses as it does with a real lab. An `EmulatedLab` creates
the two emulated devices for the types in the spec, applies the faults of a script to them, and
records the true events as JSON lines. As an option, it also plays the role of the person who puts
robots back on their starts after each run.

    with EmulatedLab(lab, setup, script, Options()) as emulation:
        emulation.run()                     until emulation.loop.end()
"""

import json
from collections.abc import Callable
from typing import Any, Self, TextIO

from tetractl.core.clock import MILLISECOND, SECOND
from tetractl.core.errors import SpecError, TetractlError
from tetractl.core.setup import Setup
from tetractl.spec.lab_section import LabSection
from tetractl_emulator.faults import Fault, Injector
from tetractl_emulator.loop import Loop, Timeline
from tetractl_emulator.port import PluggedDevices
from tetractl_emulator.process import PROCESS_FAULTS, Process
from tetractl_emulator.script import DeviceClasses, Script
from tetractl_emulator.sides import EmulatedActuator, EmulatedCamera, Facts, Options, Stage
from tetractl_emulator.wires import Wires

Report = Callable[[str, Facts], None]
TICK_NS = 2 * MILLISECOND
"""Time between two calls of the periodic work, such as the check of the robots' motion [ns]."""
CARRIED_NS = SECOND // 2
"""Time for which a person carries the robots to their starts [ns]."""
_as_json = json.JSONEncoder(separators=(",", ":")).encode


class EmulatedLab:
    """An emulated lab. As a context manager, it opens its ports on entry and releases them on exit.

    Args:
        lab: The lab's section of the spec.
        setup: The constants of the experiment.
        script: How the lab differs from the spec, and its faults.
        options: Options of the emulation.
        report: Called with an event and its facts, for display.
        make_loop: Class of the event loop.
        wires: Creates the connections. None for real sockets and ports.
        process_of: Creates the target of the faults that act on the driving process. None for the
            process that locks the actuator's port.
        stand_in_camera: Stands in for the emulated camera if the camera is real. None to emulate
            the camera.

    Raises:
        SpecError: If the script names a robot that the spec lacks.
    """

    def __init__(
        self,
        lab: LabSection,
        setup: Setup,
        script: Script,
        options: Options,
        report: Report = lambda event, facts: None,
        make_loop: type[Loop] = Loop,
        wires: Wires | None = None,
        process_of: Callable[["EmulatedLab"], Process] | None = None,
        stand_in_camera: EmulatedCamera | None = None,
    ) -> None:
        _check_names(script, setup)
        self._setup = setup
        self._script = script
        self._options = options
        self._record: TextIO | None = None
        self._report = report
        start_ns = make_loop.now()
        self.timeline = Timeline(lambda until_ns: self.actuator.advance(until_ns), start_ns)
        self.loop = make_loop(self.timeline, lambda lag: self.note("late", lag_ms=lag / 1e6))
        self.injector = Injector(self.timeline, script.faults, self._device_of, self._note_fault)
        acting = self.injector.acting
        note = None if options.record is None else self.note
        reports = note, self._note_exposure, self.injector.note_frame_sent, self._note_client
        self.wires = wires or Wires()
        self._guard_state = ("", "")
        stage = Stage(lab, setup, self.timeline, options, *reports, self.wires, acting)
        device_classes = DeviceClasses.of_types(lab.camera.type, lab.actuator.type)
        emulation_settings = script.emulation
        self.actuator: EmulatedActuator = device_classes.actuator(
            stage, emulation_settings.actuator or device_classes.actuator.Settings()
        )
        self.camera: EmulatedCamera = stand_in_camera or device_classes.camera(
            stage,
            emulation_settings.camera or device_classes.camera.Settings(),
            self.actuator.bodies,
        )
        self._process = process_of(self) if process_of else Process(self, self.wires.clock())
        self._is_moving = [False] * len(self.actuator.bodies)
        self._has_run = False  # whether robots were driven since they were put on their starts
        self._at_rest_since_ns: int | None = start_ns  # None while any robot moves
        self._put_on_starts()

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self) -> None:
        """Open the ports and start the emulation.

        If one port cannot be opened, all ports are released.

        Raises:
            TetractlError: If the record cannot be written, or if a port cannot be opened.
        """
        self.loop.catch_up()
        path = self._options.record
        try:
            self._record = path.open("w", buffering=1, encoding="utf-8") if path else None
        except OSError as error:
            raise TetractlError(
                f"{path}: cannot write the record of the emulation: {error.strerror}"
            ) from None
        try:
            facts = {
                "emulation": True,
                **self.actuator.open(self.loop),
                **self.camera.open(self.loop),
                "robots": list(self._setup.names),
            }
        except BaseException:
            self.close()
            raise
        self._tick()
        self.note("ready", **facts)
        self._report("ready", facts)
        self.injector.note_event("start")

    def run(self) -> None:
        """Run the emulated devices in real time until `loop.end()` is called."""
        self.loop.run()

    def close(self) -> None:
        """Release the ports, and close the record. This method can be called repeatedly."""
        counts = self.actuator.close() | self.camera.close()
        self.note("end", worst_lag_ms=self.loop.worst_lag_ns / 1e6, **counts)
        if self._record is not None:
            self._record.close()
            self._record = None

    @property
    def port(self) -> str:
        """The name of the actuator's first port. "" if the actuator has no port."""
        actuator = self.actuator
        return actuator.serial_devices[0].port.name if isinstance(actuator, PluggedDevices) else ""

    def note_guard_state(self, state: str, reason: str) -> None:
        """Record the state of the program's guard and its reason, if they have changed."""
        if (state, reason) != self._guard_state:
            self._guard_state = (state, reason)
            self.note("guard", state=str(state), reason=reason)

    def _device_of(self, fault: Fault) -> EmulatedCamera | EmulatedActuator | Process:
        """Find the target of a fault: the program's process, the camera or the actuator.

        If several of them can have this kind of fault, the first in this order is the target.
        """
        if type(fault) in PROCESS_FAULTS:
            return self._process
        return self.camera if type(fault) in self.camera.faults else self.actuator

    def note(self, event: str, **facts: Any) -> None:
        """Add an event with its facts and the present time to the record, if there is one.

        The fact "t_ns" is the time by `time.monotonic_ns`, or the virtual time. The events
        "command" and "truth" also get the fact "unseen_ms": for each robot, the time since the
        camera last showed the robot [ms].

        Args:
            event: Kind of the event.
            facts: The facts of the event, by name.
        """
        if self._record is None:
            return
        now_ns = self.timeline.now_ns
        if event in ("command", "truth"):
            facts["unseen_ms"] = [round((now_ns - t_ns) / 1e6, 1) for t_ns in self.camera.shown_ns]
        self._record.write(_as_json({"t_ns": now_ns, "event": event, **facts}) + "\n")

    def _note_exposure(self, exposure: int, frame: int) -> None:
        """Report an exposure to the injector, and record the true poses [mm, rad] at that time."""
        self.injector.note_exposure(exposure)
        if self._record is not None:
            bodies = self.actuator.bodies
            self.note(
                "truth",
                exposure=exposure,
                frame=frame,
                poses=[
                    [round(body.x, 3), round(body.y, 3), round(body.heading, 5)] for body in bodies
                ],
                **self.actuator.truth,
            )

    def _note_client(self, address: str) -> None:
        """Record and report a new client of the camera."""
        self.note("client", address=address)
        self._report("client", {"address": address})
        self.injector.note_event("client")

    def _note_fault(self, phase: str, fault: Fault) -> None:
        """Record and report that a fault begins or ends.

        Args:
            phase: "start" if the fault begins, "end" if it ends.
            fault: The fault.
        """
        fields = dict(fault)
        robot = fields.get("robot")
        mark = fields.get("name")
        facts = {"name": fault.fault, "phase": phase, "robot": robot, "mark": mark}
        facts["row"] = self._script.faults.index(fault)
        self.note("fault", **facts)
        self._report("fault", facts)

    def _tick(self) -> None:
        """Do the periodic work, and schedule the next call after TICK_NS."""
        now_ns = self.timeline.now_ns
        self.actuator.tick()
        self._note_run(now_ns)
        self._note_motion(now_ns)
        self._carry_if_done(now_ns)
        self.timeline.at(now_ns + TICK_NS, self._tick)

    def _note_run(self, now_ns: int) -> None:
        """Record the first command that drives robots, and notify the injector of a later stop.

        The injector is notified at each call without driven robots, but only counts the first stop.
        """
        is_driven = self.actuator.driven
        if is_driven and not self._has_run:
            self._has_run = True
            if self._at_rest_since_ns is not None:  # standstill before a run does not count
                self._at_rest_since_ns = now_ns
            self.note("run")
            self._report("run", {})
            self.injector.note_event("run")
        elif self._has_run and not is_driven:
            self.injector.note_event("stop")

    def _note_motion(self, now_ns: int) -> None:
        """Record each robot that starts or stops moving.

        Report "moving" when the first robot starts, and "rest" when the last robot has stopped.
        """
        for i, body in enumerate(self.actuator.bodies):
            if self._is_moving[i] == body.standing:
                self._is_moving[i] = not body.standing
                self.note("robot", name=body.name, moving=self._is_moving[i])
        was_at_rest = self._at_rest_since_ns is not None
        any_moves = any(self._is_moving)
        if any_moves and was_at_rest:
            self._at_rest_since_ns = None
            self._report("moving", {})
        elif not any_moves and not was_at_rest:
            self._at_rest_since_ns = now_ns
            self._report("rest", {})

    def _carry_if_done(self, now_ns: int) -> None:
        """Carry the robots to their starts if they have stood for `replace_after` [s] since a run.

        Nothing happens if the option is None, or before the first run. The robots are switched off
        and untracked until they are put down.
        """
        wait_s = self._options.replace_after
        if wait_s is None or not self._has_run or self._at_rest_since_ns is None:
            return
        if now_ns - self._at_rest_since_ns < round(wait_s * SECOND):
            return
        self._has_run = False
        self.injector.acting.robots_are_carried = True
        self.actuator.switch(False)
        self.timeline.at(now_ns + CARRIED_NS, self._put_down)

    def _put_down(self) -> None:
        """Put the carried robots on their starts, and switch them on."""
        self._put_on_starts()
        self.actuator.switch(True)
        self.injector.acting.robots_are_carried = False
        self.note("placed")
        self._report("placed", {})

    def _put_on_starts(self) -> None:
        """Put every robot on its start, from the script or else from the spec.

        If trials choose their cells, no cell is moved.
        """
        if self._options.trials_choose_robots:
            return
        unit_mm = self._setup.metres * 1000
        starts = self._setup.starts
        override_by_name = {robot.name: robot for robot in self._script.emulation.robots}
        for i, body in enumerate(self.actuator.bodies):
            x = float(starts.x[i])
            y = float(starts.y[i])
            heading = float(starts.heading[i])
            override = override_by_name.get(body.name)
            if override is not None:
                x, y = override.start or (x, y)
                heading = heading if override.heading is None else override.heading
            body.place(x * unit_mm, y * unit_mm, heading)


def _check_names(script: Script, setup: Setup) -> None:
    """Check that a script only names robots of the spec.

    Raises:
        SpecError: If a name is not in the spec. The error reports the first such name.
    """
    emulation = script.emulation
    device_settings = [
        dict(settings)
        for settings in (emulation.camera, emulation.actuator)
        if settings is not None
    ]
    robot_lists = [emulation.robots, *(settings.get("robots", ()) for settings in device_settings)]
    names = [robot.name for robots in robot_lists for robot in robots]
    names += [name for fault in script.faults for name in fault.names()]
    for name in names:
        if name not in setup.names:
            raise SpecError(
                f"the fault script names {name}, which is not a robot of the spec",
                f"the spec's robots are {', '.join(setup.names)}",
            )
