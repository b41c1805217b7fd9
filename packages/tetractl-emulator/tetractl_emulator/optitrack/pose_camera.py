"""Base class of emulated cameras that send the poses of all robots in one frame: its timing.

Frame k is exposed k / rate after the start. It shows the robots where they are at that time, as
faults displace them. It is sent after a latency that varies a little from frame to frame. Faults
can delay it further, send it twice, replace it by another frame, or drop it. A subclass packs the
frames.
"""

import random
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

from tetractl.core.clock import SECOND
from tetractl.lab.cameras.optitrack.natnet import RigidBody
from tetractl_emulator.optitrack.tracked_body import TrackedBody, View, has_a_pose
from tetractl_emulator.sides import Stage

JITTER_S = 0.00025  # standard deviation of the time from exposure to transmission
DELAYED_SHARE = 1 / 250  # of the frames are delayed further
DELAYED_PERIODS = 0.45  # greatest delay of those [frame periods]


@dataclass(frozen=True, slots=True)
class Exposure:
    """A frame that an emulated camera exposed, and the time of its exposure `at_ns` [ns]."""

    frame: Any
    at_ns: int


class PoseCamera(ABC):
    """Base class of emulated cameras that expose all robots at a fixed rate.

    Exposures are numbered from 1, without gaps.

    Args:
        stage: The data and functions that the emulated devices share.
        tracked: The rigid bodies on the robots.
        rate: Exposures per second [Hz].
        latency_s: Mean time from an exposure until its frame is sent [s].
        view: The camera's axes.

    Attributes:
        shown_ns: For each robot, the exposure time of the newest frame sent in which it is tracked
            [ns].
    """

    numbered: ClassVar[bool] = True
    """Whether frames contain their numbers.

    If not, the receiver counts the frames that arrive.
    """

    def __init__(
        self, stage: Stage, tracked: list[TrackedBody], rate: float, latency_s: float, view: View
    ) -> None:
        self.tracked = tracked
        self.view = view
        self.acting = stage.acting
        self.shown_ns = [0] * len(tracked)
        self.timeline = stage.timeline
        self._stage = stage
        self._rate = rate
        self._planned = 0  # exposures
        self._start_ns = 0
        self._left_ns = 0  # exposure of the last frame sent
        self._last: Exposure | None = None  # what was last to be sent
        self._latency_s = latency_s
        self._random = random.Random(stage.options.seed)

    @abstractmethod
    def _shot(self, number: int, exposed_ns: int, bodies: tuple[RigidBody, ...]) -> Any:
        """Create the frame of an exposure.

        Args:
            number: Number of the frame.
            exposed_ns: Time of the exposure [ns].
            bodies: The rigid bodies that the frame contains.
        """

    @abstractmethod
    def _stream(self, frame: Any, now_ns: int) -> None:
        """Pack a frame, and send it to the clients."""

    def begin(self) -> None:
        """Expose the first frame now, and all later frames at the frame rate."""
        self._start_ns = self.timeline.now_ns
        self._plan()

    def _plan(self) -> None:
        """Schedule the next exposure."""
        due_ns = self._start_ns + round(self._planned * SECOND / self._rate)
        self._planned += 1
        self.timeline.at(due_ns, self._take)

    def _take(self) -> None:
        """Expose one frame, schedule its sending after the latency, and plan the next exposure.

        Faults may change the frame's number and time of exposure, and send it twice.
        """
        now = self.timeline.now_ns
        exposed = now
        exposure_number = self._planned
        acting = self.acting
        frame_number = exposure_number - sum(
            fault.frames for fault in acting.of_kind("counter_back")
        )
        self._stage.exposed(exposure_number, frame_number if self.numbered else 0)
        delay = self._delay_s()
        outdated = acting.newest("outdated")
        if outdated is not None:
            exposed = max(0, now - round(outdated.by * SECOND))
        frame = self._shot(frame_number, exposed, self._expose())
        leaves = now + round(delay * SECOND)
        times = 2 if acting.of_kind("doubled_frames") else 1
        for _ in range(times):
            self.timeline.at(leaves, partial(self._leave, exposure_number, Exposure(frame, now)))
        self._plan()

    def _delay_s(self) -> float:
        """Sample the time from an exposure until its frame is sent [s].

        It consists of the latency, a random jitter, and the delays of acting faults.
        """
        jitter = self._random
        normal_s = jitter.gauss(0, JITTER_S)
        delay_s = self._latency_s + min(max(normal_s, -4 * JITTER_S), 4 * JITTER_S)
        if jitter.random() < DELAYED_SHARE:
            delay_s += jitter.uniform(0, DELAYED_PERIODS / self._rate)
        delay_s += self.acting.total_by("late_frames")
        for fault in self.acting.of_kind("reordered"):
            delay_s += jitter.uniform(0, fault.by)
        return delay_s

    def _leave(self, exposure_number: int, exposure: Exposure) -> None:
        """Send the frame of an exposure, or the last frame again, unless a fault prevents it.

        The times at which robots were last shown as tracked are updated.
        """
        acting = self.acting
        periods_ns = (SECOND / fault.rate for fault in acting.of_kind("slow_frames"))
        next_ns = self._left_ns + max(periods_ns, default=0)
        is_slow = self._left_ns < exposure.at_ns < next_ns
        if not acting.of_kind("freeze") or self._last is None:
            self._last = exposure
        if not (is_slow or acting.of_kind("no_server") or acting.of_kind("no_frames")):
            self._left_ns = exposure.at_ns
            self._stream(self._last.frame, self.timeline.now_ns)
            bodies = self._last.frame.bodies
            shown_ids = {body.id for body in bodies if body.tracking_valid and has_a_pose(body)}
            for i, body in enumerate(self.tracked):
                if body.asset.number in shown_ids:
                    self.shown_ns[i] = max(self.shown_ns[i], self._last.at_ns)
        self._stage.sent(exposure_number)

    def _expose(self) -> tuple[RigidBody, ...]:
        """Return the rigid bodies as the camera reports them now.

        Bodies that are not streamed are left out.
        """
        view = self.view.exposed(self.acting.of_kind("picture"))
        numbers = {body.robot.name: body.asset.number for body in self.tracked}
        bodies = {body.robot.name: body.expose(view) for body in self.tracked}
        for fault in self.acting.of_kind("twin_id"):
            bodies[fault.robot] = replace(bodies[fault.robot], id=numbers[fault.other])
        for fault in self.acting.of_kind("swap"):
            first = bodies[fault.robot]
            second = bodies[fault.other]
            bodies[fault.robot] = replace(second, id=first.id)
            bodies[fault.other] = replace(first, id=second.id)
        streamed = {body.asset.number for body in self.tracked if body.asset.streamed}
        return tuple(body for body in bodies.values() if body.id in streamed)


def noise_of_day(chance: random.Random, scale: float) -> dict[str, Any]:
    """Sample noise and latency of a camera for a randomised test run.

    Args:
        chance: The random generator.
        scale: Factor for lengths; see `scale_of`.

    Returns:
        The settings "noise_mm", "noise_rad" and "latency".
    """
    return {
        "noise_mm": float(f"{scale * round(chance.uniform(0.1, 0.5), 3):.3g}"),
        "noise_rad": round(chance.uniform(0.001, 0.005), 4),
        "latency": round(chance.uniform(0.003, 0.012), 4),
    }
