"""A connected lab: a camera and an actuator, with the guard and the inner loop between them."""

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pkgutil import resolve_name
from typing import Self

from tetractl.core.clock import Clock, wait_for
from tetractl.core.errors import AbortError
from tetractl.core.protocols import Actuator, Camera, Health
from tetractl.core.setup import MILLIMETRE_M, Setup
from tetractl.lab.guard_checks import ChecksOf, robot_checks
from tetractl.lab.guard_observer import build_guard
from tetractl.lab.guard_rules import GuardRules
from tetractl.lab.inner_loop import InnerLoop
from tetractl.spec.lab_section import LabLimits, LabSection


class Rig:
    """A connected lab: camera, actuator, guard and inner loop, used as a context manager.

    It can be opened once. Opening it opens the actuator and the camera, and starts the inner loop.

    Args:
        camera: The camera.
        actuator: The actuator.
        limits: The limits of the lab.
        setup: The constants of the experiment.
        clock: The clock for times [ns].
        emergency: Set by the operator for an emergency stop. None for a new event.
        wake: The camera's own event, set after each frame. None for a new event.
        threaded: Whether the inner loop runs in a thread. Otherwise, the caller calls `loop.step`.
        emulated: Names of the devices that the plant emulates, whether or not they report it.
        checks_of: Creates the guard's checks from its rules.
    """

    def __init__(
        self,
        camera: Camera,
        actuator: Actuator,
        limits: LabLimits,
        setup: Setup,
        clock: Clock,
        emergency: threading.Event | None = None,
        wake: threading.Event | None = None,
        threaded: bool = True,
        emulated: Sequence[str] = (),
        checks_of: ChecksOf = robot_checks,
    ) -> None:
        self.camera = camera
        self.actuator = actuator
        self.limits = limits
        self.setup = setup
        self.clock = clock
        self.loop = InnerLoop(
            camera,
            actuator,
            build_guard(GuardRules.from_setup(setup, limits), checks_of),
            clock,
            wake or threading.Event(),
            emergency or threading.Event(),
        )
        self._threaded = threaded
        self._emulated = frozenset(emulated)
        self._open_devices = set[str]()  # the names of the devices that are open
        self._exit_stack = ExitStack()
        self._was_opened = False

    @property
    def mm_per_unit(self) -> float:
        """Number of millimetres in one length unit of the spec."""
        return self.setup.metres / MILLIMETRE_M

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self) -> None:
        """Open the devices that are not open yet, and start the inner loop.

        A second call does nothing.

        Raises:
            AbortError: If a device fails. The error names all failures.
        """
        if self._was_opened:
            return
        self._was_opened = True
        try:
            failures = self.open_devices()
            if failures:
                messages = [failure.message for failure in failures.values()]
                hints = [failure.hint for failure in failures.values() if failure.hint]
                raise AbortError("; ".join(messages), "; ".join(hints) or None)
            if self._threaded:
                self.loop.start()
                wait_for(self.clock, lambda: self.loop.frames.count > 0, 0.5)
        except BaseException:
            self.close()
            raise

    def open_devices(self) -> dict[str, AbortError]:
        """Open the camera and the actuator, unless they are open already.

        Returns:
            The error of each device that cannot be opened, by its name: "actuator" or "camera".
        """
        failures = dict[str, AbortError]()
        for name, device in (("actuator", self.actuator), ("camera", self.camera)):
            if name in self._open_devices:
                continue
            try:
                self._exit_stack.enter_context(device)
                self._open_devices.add(name)
            except AbortError as failure:
                failures[name] = failure
        return failures

    def call_after_close(self, callback: Callable[[], object]) -> None:
        """Register a function that is called after the devices are released."""
        self._exit_stack.callback(callback)

    def list_emulated(self, camera: Health, actuator: Health) -> tuple[str, ...]:
        """Return which devices are emulated: a tuple with "camera", "actuator", both or neither.

        A device counts as emulated if its health check reports this, or if it was named as emulated
        when this object was created.
        """
        reported = {"camera": camera.emulated, "actuator": actuator.emulated}
        return tuple(name for name in reported if reported[name] or name in self._emulated)

    def settle(self, setup: Setup) -> None:
        """Continue with the robots of a new setup, for example robots just found in the image.

        The devices must be prepared for these robots. The robots' present poses become their
        starts, and the guard begins again.
        """
        self.setup = setup
        self.start_anywhere()
        self.loop.restart(GuardRules.from_setup(setup, self.limits))
        wait_for(self.clock, lambda: self.loop.frames.count > 0, 0.5)

    def start_anywhere(self) -> None:
        """Accept the robots' present poses as their starts, however far from the setup's."""
        unlimited = {"start_mm": math.inf, "start_heading": math.inf}
        self.limits = self.limits.model_copy(update=unlimited)

    @property
    def remaining_robots(self) -> list[int]:
        """The indices of the robots that are not lost."""
        return [i for i in range(len(self.setup.names)) if i not in self.loop.guard.lost_robots]

    def describe_untracked(self, robot: int) -> str:
        """Create a message that a robot (given by its index) is not tracked and, if known, why."""
        reason = self.loop.guard.refusal_reasons[robot]
        return f"{self.setup.names[robot]} is not tracked" + (f": {reason}" if reason else "")

    def close(self) -> None:
        """End the inner loop and release the devices.

        This method can be called twice, and never raises.
        """
        self.loop.close()
        self._exit_stack.close()

    def measure_silence_ns(self) -> int:
        """Measure how long ago the last accepted camera frame was received [ns].

        Before the first frame, the result is the time since the run's clock started.
        """
        newest = self.loop.frames.newest
        return self.clock.now() - (0 if newest is None else newest.frame.received_ns)


def build_rig(
    lab: LabSection, setup: Setup, clock: Clock, emergency: threading.Event | None = None
) -> Rig:
    """Build the connected lab of a spec, without opening any device.

    Args:
        lab: The section of the lab.
        setup: The constants of the experiment.
        clock: The clock of the run.
        emergency: The operator sets this event for an emergency stop. None if nobody can.
    """
    wake = threading.Event()
    camera = lab.camera.build(setup, clock, wake.set)
    actuator = lab.actuator.build(setup, clock)
    checks_of = resolve_name(lab.actuator.checks)
    return Rig(camera, actuator, lab.limits, setup, clock, emergency, wake, checks_of=checks_of)
