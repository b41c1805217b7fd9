"""Base class of emulated cameras that send all poses in one frame: the timing of the frames.

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
from tetractl_emulator.optitrack.tracked_body import TrackedBody, View, has_valid_pose
from tetractl_emulator.sides import Stage

JITTER_S = 0.00025
"""Standard deviation of the time from an exposure until its frame is sent [s]."""
DELAYED_FRACTION = 1 / 250
"""Fraction of the frames that are delayed further."""
DELAY_MAX_PERIODS = 0.45
"""Maximum additional delay of such a frame [frame periods]."""


@dataclass(frozen=True, slots=True)
class Exposure:
    """A frame of an emulated camera.

    Attributes:
        frame: The frame.
        at_ns: When the frame was exposed [ns].
    """

    frame: Any
    at_ns: int


class PoseCamera(ABC):
    """Base class of emulated cameras that expose all robots at a fixed rate.

    Exposures are numbered from 1, without gaps.

    Args:
        stage: The data and functions that the emulated devices share.
        tracked: The rigid bodies on the robots.
        rate_hz: Exposures per second [Hz].
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
        self, stage: Stage, tracked: list[TrackedBody], rate_hz: float, latency_s: float, view: View
    ) -> None:
        self.tracked = tracked
        self.view = view
        self.acting = stage.acting
        self.shown_ns = [0] * len(tracked)
        self.timeline = stage.timeline
        self._stage = stage
        self._rate_hz = rate_hz
        self._planned_count = 0  # number of exposures that were scheduled
        self._start_ns = 0
        self._last_sent_ns = 0  # exposure time of the last frame sent
        self._last: Exposure | None = None  # the exposure that was last to be sent
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
        self._schedule_exposure()

    def _schedule_exposure(self) -> None:
        """Schedule the next exposure."""
        due_ns = self._start_ns + round(self._planned_count * SECOND / self._rate_hz)
        self._planned_count += 1
        self.timeline.at(due_ns, self._take_frame)

    def _take_frame(self) -> None:
        """Expose one frame, schedule its sending after the latency, and plan the next exposure.

        Faults may change the frame's number and time of exposure, and send it twice.
        """
        now_ns = self.timeline.now_ns
        stated_ns = now_ns
        exposure_number = self._planned_count
        acting = self.acting
        frame_number = exposure_number - sum(
            fault.frames for fault in acting.of_kind("counter_back")
        )
        self._stage.exposed(exposure_number, frame_number if self.numbered else 0)
        delay_s = self._sample_delay_s()
        outdated = acting.newest("outdated")
        if outdated is not None:
            stated_ns = max(0, now_ns - round(outdated.by * SECOND))
        frame = self._shot(frame_number, stated_ns, self._expose_bodies())
        sent_ns = now_ns + round(delay_s * SECOND)
        n_copies = 2 if acting.of_kind("doubled_frames") else 1
        for _ in range(n_copies):
            self.timeline.at(
                sent_ns, partial(self._send_frame, exposure_number, Exposure(frame, now_ns))
            )
        self._schedule_exposure()

    def _sample_delay_s(self) -> float:
        """Sample the time from an exposure until its frame is sent [s].

        It consists of the latency, a random jitter, and the delays of acting faults.
        """
        random_generator = self._random
        jitter_s = random_generator.gauss(0, JITTER_S)
        delay_s = self._latency_s + min(max(jitter_s, -4 * JITTER_S), 4 * JITTER_S)
        if random_generator.random() < DELAYED_FRACTION:
            delay_s += random_generator.uniform(0, DELAY_MAX_PERIODS / self._rate_hz)
        delay_s += self.acting.total_by("late_frames")
        for fault in self.acting.of_kind("reordered"):
            delay_s += random_generator.uniform(0, fault.by)
        return delay_s

    def _send_frame(self, exposure_number: int, exposure: Exposure) -> None:
        """Send the frame of an exposure, or the last frame again, unless a fault prevents it.

        The times at which robots were last shown as tracked are updated.
        """
        acting = self.acting
        periods_ns = (SECOND / fault.rate for fault in acting.of_kind("slow_frames"))
        next_ns = self._last_sent_ns + max(periods_ns, default=0)
        is_slow = self._last_sent_ns < exposure.at_ns < next_ns
        if not acting.of_kind("freeze") or self._last is None:
            self._last = exposure
        if not (is_slow or acting.of_kind("no_server") or acting.of_kind("no_frames")):
            self._last_sent_ns = exposure.at_ns
            self._stream(self._last.frame, self.timeline.now_ns)
            bodies = self._last.frame.bodies
            shown_ids = {body.id for body in bodies if body.tracking_valid and has_valid_pose(body)}
            for i, body in enumerate(self.tracked):
                if body.asset.number in shown_ids:
                    self.shown_ns[i] = max(self.shown_ns[i], self._last.at_ns)
        self._stage.sent(exposure_number)

    def _expose_bodies(self) -> tuple[RigidBody, ...]:
        """Expose all rigid bodies, and return the streamed bodies as the camera reports them."""
        view = self.view.at_exposure(self.acting.of_kind("picture"))
        id_by_robot = {body.robot.name: body.asset.number for body in self.tracked}
        bodies = {body.robot.name: body.expose(view) for body in self.tracked}
        for fault in self.acting.of_kind("twin_id"):
            bodies[fault.robot] = replace(bodies[fault.robot], id=id_by_robot[fault.other])
        for fault in self.acting.of_kind("swap"):
            first_body = bodies[fault.robot]
            second_body = bodies[fault.other]
            bodies[fault.robot] = replace(second_body, id=first_body.id)
            bodies[fault.other] = replace(first_body, id=second_body.id)
        streamed_ids = {body.asset.number for body in self.tracked if body.asset.is_streamed}
        return tuple(body for body in bodies.values() if body.id in streamed_ids)


def noise_of_day(random_generator: random.Random, scale: float) -> dict[str, Any]:
    """Sample noise and latency of a camera for a randomised test run.

    Args:
        random_generator: The random generator.
        scale: Factor for lengths; see `length_scale`.

    Returns:
        The settings "noise_mm", "noise_rad" and "latency".
    """
    return {
        "noise_mm": float(f"{scale * round(random_generator.uniform(0.1, 0.5), 3):.3g}"),
        "noise_rad": round(random_generator.uniform(0.001, 0.005), 4),
        "latency": round(random_generator.uniform(0.003, 0.012), 4),
    }
