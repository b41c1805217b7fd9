"""The frames that a lab's guard has accepted, as observations and samples of a trial."""

import math
from collections import deque
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from tetractl.core.commands import FrameAddition, Sample, Verdict
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.lab.accepted_frame import AcceptedFrame
from tetractl.lab.device_abilities import AddsToFrames
from tetractl.lab.rig import Rig
from tetractl.model.path_check import PathCheck

RECENT = 600
"""Number of frames, of some seconds, of which one is the last of robots that cannot stand."""


class LabFrames:
    """Reads the frames of a rig: `newest` is the last one that was read, None before the first.

    The robots' paths are checked frame by frame; those of lost robots are left out.
    """

    def __init__(self, rig: Rig) -> None:
        self.newest: Observation | None = None
        self._rig = rig
        self._heading = rig.setup.starts.heading  # not wrapped, of the last poses
        self._path_check = PathCheck.of(rig.setup)
        self._read_count = 0  # of the rig's accepted frames
        self._samples: list[Sample] = []  # not yet handed over, oldest first
        self._additions: dict[int, FrameAddition] = {}  # by the time of exposure [ns]
        self._recent: deque[Observation] = deque(maxlen=RECENT)

    def begin(self) -> None:
        """Begin with the newest frame, which `observe` may return; leave out those before it."""
        self._read_count = self._rig.frames.count - 1

    def read(self) -> list[Observation]:
        """Read the frames since the last call, oldest first."""
        frames, self._read_count = self._rig.frames.since(self._read_count)
        if self._adds is not None:
            for addition in self._adds.additions():
                self._additions[addition.sampled_ns] = addition
        observations = [self._observation(frame) for frame in frames]
        for observation in observations:
            addition = self._additions.get(observation.sampled_ns)
            messages = addition.messages if addition else ()
            self._recent.append(observation)
            self._samples.append(Sample(observation, None, messages))
        if observations:
            self.newest = observations[-1]
            self._check_paths(observations)
        if self.newest is not None:  # frames that the guard rejected give no sample
            for sampled_ns in list(self._additions):
                if sampled_ns <= self.newest.sampled_ns:
                    del self._additions[sampled_ns]
        return observations

    def hand_over(self) -> list[Sample]:
        """Return the samples of the frames read since the last call, oldest first."""
        samples = self._samples
        self._samples = []
        return samples

    def nearest(self, t_ns: int) -> Observation:
        """Return the recent frame that was exposed nearest to a time."""
        return min(self._recent, key=lambda frame: abs(frame.sampled_ns - t_ns))

    def verdict(self, final: Poses, not_at_rest: str) -> Verdict:
        """Return the verdict on the paths so far."""
        return self._path_check.verdict(final, not_at_rest)

    # asked once: to look for a protocol's members takes as long as to check a frame
    @cached_property
    def _adds(self) -> AddsToFrames | None:
        camera = self._rig.camera
        return camera if isinstance(camera, AddsToFrames) else None

    def _observation(self, accepted: AcceptedFrame) -> Observation:
        """Return the observation of a frame, the next after all before, with headings unwrapped
        relative to the last ones. A robot that has had no pose so far counts as being at its start.
        """
        starts = self._rig.setup.starts
        x = starts.x.copy()
        y = starts.y.copy()
        heading = self._heading.copy()
        for i, pose in enumerate(accepted.poses):
            if pose is not None:
                x[i] = pose.x
                y[i] = pose.y
                heading[i] += math.remainder(pose.heading - heading[i], math.tau)
        self._heading = heading
        frame = accepted.frame
        return Observation(
            frame.number,
            frame.sampled_ns,
            frame.received_ns,
            Poses(x, y, heading),
            np.array(accepted.fresh),
            accepted.exposed_ns,
        )

    def _check_paths(self, observations: Sequence[Observation]) -> None:
        """Add frames to the check of the paths."""
        xy: Floats = np.array([observation.poses.xy for observation in observations])
        x, y = xy.transpose(2, 0, 1)
        x[:, list(self._rig.guard.lost)] = np.nan
        self._path_check.add(x, y, np.array([observation.valid for observation in observations]))
