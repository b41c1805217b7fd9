"""Disturbances of the camera: frames that are late, are lost or show wrong poses."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from tetractl.core.clock import SECOND
from tetractl.core.poses import Bools, Floats, Poses
from tetractl.core.setup import Setup
from tetractl.plant.disturbances.spells import ActiveIntervals, AlternatingStates, IntervalsSection
from tetractl.spec.base import Fraction, NonNegativeAngle, Positive
from tetractl.spec.disturbance import Disturbance, DisturbanceSection

LATENCY_DEVIATIONS_MAX = 4.0
"""Maximum deviation of a frame's latency from the mean latency [standard deviations]."""


class TrackingLossSection(DisturbanceSection):
    """A disturbance: the camera sometimes loses track of a robot, independently of the others."""

    type: Literal["tracking-loss"]
    every: Positive
    """Mean time for which a robot is tracked between two losses [s], exponentially distributed."""
    duration: Positive = 0.2
    """Mean time for which a robot stays lost [s], exponentially distributed."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "TrackingLoss":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return TrackingLoss(self, len(setup.names), rng)


class TrackingLoss(Disturbance):
    """A disturbance that makes the camera lose track of each robot at random times.

    All robots are tracked at the start of a trial.

    Args:
        section: The fields of the disturbance in the spec.
        n_robots: Number of robots.
        rng: Generator of the random times.
    """

    def __init__(
        self, section: TrackingLossSection, n_robots: int, rng: np.random.Generator
    ) -> None:
        self._tracking = AlternatingStates(
            n_robots,
            lambda: rng.exponential(section.every),
            lambda: rng.exponential(section.duration),
        )

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Mark lost robots as untracked; see `Disturbance.measured`."""
        return poses, valid & self._tracking.advance(time_s)


class CameraLatencySection(DisturbanceSection):
    """A disturbance: every camera frame reaches the host after a random latency."""

    type: Literal["camera-latency"]
    mean: float = Field(ge=0, le=10, allow_inf_nan=False)
    """Mean time from exposure to arrival [s]."""
    deviation: float = Field(default=0.0, ge=0, le=1, allow_inf_nan=False)
    """Standard deviation of a frame's latency [s].

    The latency is normally distributed, truncated at 4 standard deviations.
    """
    late_share: Fraction = 0.0
    """Fraction of the frames that are late."""
    late_by: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """Maximum additional latency of a late frame [s]. The addition is uniformly distributed."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "CameraLatency":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return CameraLatency(self, rng)


class CameraLatency(Disturbance):
    """A disturbance that delays each camera frame by a random latency."""

    def __init__(self, section: CameraLatencySection, rng: np.random.Generator) -> None:
        self._section = section
        self._rng = rng

    def received(self, exposed_ns: int, received_ns: int) -> int:
        """Add the random latency to a frame's time of arrival.

        A frame never arrives before its exposure.
        """
        section = self._section
        n_deviations = self._rng.standard_normal()
        if abs(n_deviations) > LATENCY_DEVIATIONS_MAX:
            n_deviations = math.copysign(LATENCY_DEVIATIONS_MAX, n_deviations)
        latency_s = section.mean + section.deviation * n_deviations
        if self._rng.random() < section.late_share:
            latency_s += section.late_by * self._rng.random()
        return received_ns + round(max(latency_s, 0.0) * SECOND)


class FrameLossSection(DisturbanceSection):
    """A disturbance: camera frames are lost in bursts of random length.

    The length of a burst is geometrically distributed (Gilbert's model).
    """

    type: Literal["frame-loss"]
    share: Annotated[float, Field(ge=0, le=0.5, allow_inf_nan=False)]
    """Fraction of all frames that are lost."""
    burst: Annotated[float, Field(ge=1, le=1000, allow_inf_nan=False)] = 1.0
    """Mean number of frames lost in a row."""

    @property
    def loses_frames(self) -> bool:
        """Whether this disturbance loses any camera frames."""
        return self.share > 0

    def build(self, setup: Setup, rng: np.random.Generator) -> "FrameLoss":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return FrameLoss(self, rng)


class FrameLoss(Disturbance):
    """A disturbance that loses camera frames. A Markov chain decides which frames are lost.

    The first frame is not lost. While frames are lost, the burst ends with the probability 1 / b at
    each frame, where b is the mean length of a burst. The probability that a burst starts is chosen
    such that the fraction `share` of all frames is lost in the long run.
    """

    def __init__(self, section: FrameLossSection, rng: np.random.Generator) -> None:
        self._burst_start_probability = section.share / (1 - section.share) / section.burst
        self._burst_end_probability = 1 / section.burst
        self._rng = rng
        self._is_next_lost = False

    def received(self, exposed_ns: int, received_ns: int) -> int | None:
        """Decide by chance whether a frame is lost.

        The result is None for a lost frame, and otherwise the unchanged time of arrival [ns].
        """
        is_lost = self._is_next_lost
        chance = self._rng.random()
        if is_lost:
            self._is_next_lost = chance >= self._burst_end_probability
        else:
            self._is_next_lost = chance < self._burst_start_probability
        return None if is_lost else received_ns


class FrozenCameraSection(IntervalsSection):
    """A disturbance: during some intervals, camera frames are lost, or all show the same poses."""

    type: Literal["frozen-camera"]
    repeats: bool = True
    """Whether frames repeat the last poses before the interval. If not, no frame arrives."""

    @property
    def loses_frames(self) -> bool:
        """Whether camera frames are lost in the intervals of this disturbance."""
        return not self.repeats

    def build(self, setup: Setup, rng: np.random.Generator) -> "FrozenCamera":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return FrozenCamera(self.repeats, self.draw(rng))


class FrozenCamera(Disturbance):
    """A disturbance that repeats the last frame or loses all frames during some intervals."""

    def __init__(self, repeats: bool, intervals: ActiveIntervals) -> None:
        self._repeats = repeats
        self._intervals = intervals
        self._last_measurement: tuple[Poses, Bools] | None = None  # measurement before the interval

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Replace the poses by the poses before the interval; see `Disturbance.measured`.

        Outside the intervals, the poses stay unchanged.
        """
        is_frozen = self._repeats and self._intervals.include(time_s)
        if self._last_measurement is None or not is_frozen:
            self._last_measurement = (poses, valid)
        return self._last_measurement

    def received(self, exposed_ns: int, received_ns: int) -> int | None:
        """Return the unchanged time of arrival [ns], or None if the frame is lost."""
        is_lost = not self._repeats and self._intervals.include(exposed_ns / SECOND)
        return None if is_lost else received_ns


class MarkerOffSection(DisturbanceSection):
    """A disturbance: the camera measures each robot's heading with a constant offset.

    The sign of each robot's offset is sampled once per trial.
    """

    type: Literal["marker-off"]
    heading: NonNegativeAngle
    """Size of the offset of the measured heading [rad]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "MarkerOff":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return MarkerOff(self.heading * rng.choice([-1.0, 1.0], len(setup.names)))


class MarkerOff(Disturbance):
    """A disturbance that adds a constant offset to each robot's measured heading.

    Args:
        offsets_rad: Offsets of the measured headings [rad], shape (N,).
    """

    def __init__(self, offsets_rad: Floats) -> None:
        self.offsets_rad = offsets_rad

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Add the offsets to the measured headings; see `Disturbance.measured`."""
        return Poses(poses.x, poses.y, poses.heading + self.offsets_rad), valid


class StaleCameraSection(IntervalsSection):
    """A disturbance: during some intervals, camera frames show old poses."""

    type: Literal["stale-camera"]
    age: Positive = 0.1
    """Age of the poses that a frame shows [s].

    While the trial is younger than this, frames show the first poses of the trial.
    """

    def build(self, setup: Setup, rng: np.random.Generator) -> "StaleCamera":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return StaleCamera(self.age, self.draw(rng))


@dataclass(frozen=True, slots=True)
class Measurement:
    """The poses that a simulated camera measures in a frame, with the time of exposure.

    Attributes:
        time_s: Time of the exposure since the start of the trial [s].
        poses: Measured poses.
        valid: Whether each robot is tracked, shape (N,).
    """

    time_s: float
    poses: Poses
    valid: Bools


class StaleCamera(Disturbance):
    """A disturbance that makes camera frames show old poses during some intervals.

    Args:
        age_s: Age of the poses that a frame shows [s].
        intervals: The intervals in which the disturbance acts.
    """

    def __init__(self, age_s: float, intervals: ActiveIntervals) -> None:
        self._age_s = age_s
        self._intervals = intervals
        self._recent_measurements: deque[Measurement] = (
            deque()
        )  # those of the last `age_s` and one before

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Replace the poses by earlier poses during the intervals; see `Disturbance.measured`."""
        self._recent_measurements.append(Measurement(time_s, poses, valid))
        while (
            len(self._recent_measurements) > 1
            and self._recent_measurements[1].time_s <= time_s - self._age_s
        ):
            self._recent_measurements.popleft()
        if not self._intervals.include(time_s):
            return poses, valid
        return self._recent_measurements[0].poses, self._recent_measurements[0].valid
