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
from tetractl.plant.disturbances.spells import ByTurns, Spells, SpellsSection
from tetractl.spec.base import Fraction, NonNegativeAngle, Positive
from tetractl.spec.disturbance import Disturbance, DisturbanceSection

DEVIATIONS_MAX = 4.0
"""Maximum deviation of a frame's latency from the mean, in standard deviations."""


class TrackingLossSection(DisturbanceSection):
    """A disturbance of the camera: it sometimes loses a robot, each independently of the others."""

    type: Literal["tracking-loss"]
    every: Positive
    """Mean time for which a robot is tracked between two losses [s], exponentially distributed."""
    duration: Positive = 0.2
    """Mean time for which a robot stays lost [s], exponentially distributed."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "TrackingLoss":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return TrackingLoss(self, len(setup.names), rng)


class TrackingLoss(Disturbance):
    """A disturbance by which the camera sometimes loses track of each robot.

    At first, all robots are tracked.

    Args:
        section: The fields of the disturbance in the spec.
        robots: Number of robots.
        rng: Generator of the random times.
    """

    def __init__(self, section: TrackingLossSection, robots: int, rng: np.random.Generator) -> None:
        self._tracked = ByTurns(
            robots,
            lambda: rng.exponential(section.every),
            lambda: rng.exponential(section.duration),
        )

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Return the poses unchanged, and which robots are tracked; see `Disturbance.measured`."""
        return poses, valid & self._tracked.well(time_s)


class CameraLatencySection(DisturbanceSection):
    """A disturbance of the camera: every frame reaches the host after a random latency."""

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
        deviations = self._rng.standard_normal()
        if abs(deviations) > DEVIATIONS_MAX:
            deviations = math.copysign(DEVIATIONS_MAX, deviations)
        latency_s = section.mean + section.deviation * deviations
        if self._rng.random() < section.late_share:
            latency_s += section.late_by * self._rng.random()
        return received_ns + round(max(latency_s, 0.0) * SECOND)


class FrameLossSection(DisturbanceSection):
    """A disturbance of the camera: frames are lost in bursts of random length.

    The length is geometrically distributed (Gilbert's model).
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
    """A disturbance that loses frames. A Markov chain changes between received and lost.

    The first frame is not lost. A burst with the mean length b ends with the probability 1 / b. The
    probability that a burst begins is such that the fraction `share` of the frames is lost in the
    long run.
    """

    def __init__(self, section: FrameLossSection, rng: np.random.Generator) -> None:
        self._burst_begins = section.share / (1 - section.share) / section.burst
        self._burst_ends = 1 / section.burst
        self._rng = rng
        self._losing = False  # whether the next frame is lost

    def received(self, exposed_ns: int, received_ns: int) -> int | None:
        """Decide by chance whether a frame is lost.

        The result is None for a lost frame, and otherwise the unchanged time of arrival [ns].
        """
        lost = self._losing
        chance = self._rng.random()
        if lost:
            self._losing = chance >= self._burst_ends
        else:
            self._losing = chance < self._burst_begins
        return None if lost else received_ns


class FrozenCameraSection(SpellsSection):
    """A disturbance of the camera: in some intervals, all frames are lost or repeat the last."""

    type: Literal["frozen-camera"]
    repeats: bool = True
    """Whether new frames show the last poses before the interval; otherwise no frame arrives."""

    @property
    def loses_frames(self) -> bool:
        """Whether camera frames are lost in the intervals of this disturbance."""
        return not self.repeats

    def build(self, setup: Setup, rng: np.random.Generator) -> "FrozenCamera":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return FrozenCamera(self.repeats, self.draw(rng))


class FrozenCamera(Disturbance):
    """A disturbance that repeats the last frame, or loses all frames, during some intervals."""

    def __init__(self, repeats: bool, spells: Spells) -> None:
        self._repeats = repeats
        self._spells = spells
        self._last: tuple[Poses, Bools] | None = None  # measurement before the interval

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Return the poses or, in an interval, those before it; see `Disturbance.measured`."""
        frozen = self._repeats and self._spells.include(time_s)
        if self._last is None or not frozen:
            self._last = (poses, valid)
        return self._last

    def received(self, exposed_ns: int, received_ns: int) -> int | None:
        """Return the unchanged time of arrival. None for a frame lost in an interval."""
        lost = not self._repeats and self._spells.include(exposed_ns / SECOND)
        return None if lost else received_ns


class MarkerOffSection(DisturbanceSection):
    """A disturbance of the camera: each robot's measured heading has a constant offset.

    Its sign is random, and sampled once per trial.
    """

    type: Literal["marker-off"]
    heading: NonNegativeAngle
    """Size of the offset of the measured heading [rad]."""

    def build(self, setup: Setup, rng: np.random.Generator) -> "MarkerOff":
        """Create the disturbance that this section of the spec describes, for one trial."""
        return MarkerOff(self.heading * rng.choice([-1.0, 1.0], len(setup.names)))


class MarkerOff(Disturbance):
    """A disturbance that adds an offset (N,) [rad] to each robot's measured heading."""

    def __init__(self, offsets: Floats) -> None:
        self.offsets = offsets

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Return the poses with the offsets added to the headings; see `Disturbance.measured`."""
        return Poses(poses.x, poses.y, poses.heading + self.offsets), valid


class StaleCameraSection(SpellsSection):
    """A disturbance of the camera: in some intervals, the frames show old poses."""

    type: Literal["stale-camera"]
    age: Positive = 0.1
    """Age of the poses shown [s].

    Before this time of the trial, frames show the first poses.
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
    """A disturbance that shows the poses of `age_s` [s] earlier during some intervals."""

    def __init__(self, age_s: float, spells: Spells) -> None:
        self._age_s = age_s
        self._spells = spells
        self._recent: deque[Measurement] = deque()  # those of the last `age_s` and one before

    def measured(self, poses: Poses, valid: Bools, time_s: float) -> tuple[Poses, Bools]:
        """Return the poses or, during an interval, earlier poses; see `Disturbance.measured`."""
        self._recent.append(Measurement(time_s, poses, valid))
        while len(self._recent) > 1 and self._recent[1].time_s <= time_s - self._age_s:
            self._recent.popleft()
        if not self._spells.include(time_s):
            return poses, valid
        return self._recent[0].poses, self._recent[0].valid
