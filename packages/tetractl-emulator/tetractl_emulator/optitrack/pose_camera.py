"""What emulated cameras that send all robots' poses in one frame have in common: exposures."""

import random
from abc import ABC, abstractmethod
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, Protocol

from tetractl.core.clock import SECOND
from tetractl.lab.cameras.optitrack.natnet import RigidBody
from tetractl_emulator.optitrack.scripted import Trouble
from tetractl_emulator.optitrack.tracked_body import TrackedBody, View, is_somewhere
from tetractl_emulator.sides import Stage

JITTER_S = 0.00025  # standard deviation of the time from exposure to transmission


class BodyFrame(Protocol):
    """A frame: its bodies, those tracked and others."""

    @property
    def bodies(self) -> tuple[RigidBody, ...]:
        """The bodies that it shows."""
        ...


class PoseCamera(ABC):
    """Exposes bodies `rate` times a second, each frame to be sent `latency_s` [s] later.

    Exposures are numbered from 1, without gaps. `shown_ns` is when each robot was exposed in the
    newest frame sent in which it is tracked.
    """

    numbered: ClassVar[bool] = True
    """Whether a frame tells its number; otherwise the receiver counts what comes."""

    def __init__(
        self, stage: Stage, tracked: list[TrackedBody], rate: float, latency_s: float, view: View
    ) -> None:
        self.tracked, self.view, self.trouble = tracked, view, Trouble()
        self.swapped: set[int] = set()  # the indices of two bodies that exchange their ids
        self.shown_ns = [0] * len(tracked)
        self.timeline = stage.timeline
        self._stage, self._rate, self._latency_s = stage, rate, latency_s
        self._random = random.Random(stage.options.seed)
        self._left_ns = 0  # exposure of the last frame sent [ns]
        self._last: Any = None
        self._start_ns = self._exposures = 0

    @abstractmethod
    def _shot(self, number: int, exposed_ns: int, bodies: tuple[RigidBody, ...]) -> BodyFrame:
        """Return the frame of an exposure."""

    @abstractmethod
    def _stream(self, frame: Any, now_ns: int) -> None:
        """Send a frame."""

    def begin(self) -> None:
        """Expose the first frame now."""
        self._start_ns = self.timeline.now_ns
        self._plan()

    def hide(self, hidden: bool) -> None:
        """If `hidden`, track no body; otherwise track all bodies again."""
        for body in self.tracked:
            body.tracked = not hidden

    def tracked_body(self, name: str) -> TrackedBody:
        """Return the rigid body of the robot with this name."""
        return self.tracked[self.place_of(name)]

    def place_of(self, name: str) -> int:
        """Return the index of the robot with this name."""
        return next(i for i, body in enumerate(self.tracked) if body.robot.name == name)

    def _plan(self) -> None:
        due = self._start_ns + round(self._exposures * SECOND / self._rate)
        self._exposures += 1
        self.timeline.at(due, self._take)

    def _take(self) -> None:
        """Expose one frame, and schedule its sending after the latency."""
        exposed = now = self.timeline.now_ns
        number = self._exposures - self.trouble.counter
        self._stage.exposed(self._exposures, number if self.numbered else 0)
        jitter = self._random
        delay = self._latency_s + min(max(jitter.gauss(0, JITTER_S), -4 * JITTER_S), 4 * JITTER_S)
        if jitter.random() < 1 / 250:
            delay += jitter.uniform(0, 0.45 / self._rate)
        delay += self.trouble.late_s
        if self.trouble.jitter_s:
            delay += jitter.uniform(0, self.trouble.jitter_s)
        self.view.creep()
        if self.trouble.outdated:
            self.trouble.outdated -= 1
            exposed = max(0, now - round(self.trouble.outdated_s * SECOND))
        frame = self._shot(number, exposed, self._expose())
        leaves = now + round(delay * SECOND)
        for _ in range(1 + self.trouble.doubled):
            self.timeline.at(leaves, partial(self._leave, self._exposures, now, frame))
        self._plan()

    def _leave(self, exposure: int, exposed_ns: int, frame: BodyFrame) -> None:
        slow = exposed_ns != self._left_ns < exposed_ns < self._left_ns + SECOND / self.trouble.hz
        if self.trouble.frozen and self._last is not None:
            frame = self._last
        self._last = frame
        if not (self.trouble.silent or self.trouble.no_frames or slow):
            self._left_ns = exposed_ns
            self._stream(frame, self.timeline.now_ns)
            if not self.trouble.frozen:
                self._show(exposed_ns, frame)
        self._stage.sent(exposure)

    def _show(self, exposed_ns: int, frame: BodyFrame) -> None:
        """Remember when each robot was last shown as tracked."""
        seen = {body.id for body in frame.bodies if body.tracking_valid and is_somewhere(body)}
        for i, body in enumerate(self.tracked):
            if body.id in seen:
                self.shown_ns[i] = max(self.shown_ns[i], exposed_ns)

    def _expose(self) -> tuple[RigidBody, ...]:
        """Return the bodies as the cameras report them now."""
        bodies = [each.expose(self.view) for each in self.tracked]
        if len(self.swapped) == 2:
            i, j = self.swapped
            one, other = bodies[i], bodies[j]
            bodies[i], bodies[j] = replace(other, id=one.id), replace(one, id=other.id)
        streamed = {body.id for body in self.tracked if body.streamed}
        return tuple(body for body in bodies if body.id in streamed)


def world(chance: random.Random, _off: float, scale: float) -> dict[str, Any]:
    """Draw the noise, in the scale of lengths, and latency of a day's motion-capture system."""
    return {
        "noise_mm": float(f"{scale * round(chance.uniform(0.1, 0.5), 3):.3g}"),
        "noise_rad": round(chance.uniform(0.001, 0.005), 4),
        "latency": round(chance.uniform(0.003, 0.012), 4),
    }
