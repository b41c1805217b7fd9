"""The camera of a simulation: what its frames show, and when they arrive at the host."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from tetractl.core.clock import NEVER_NS, SECOND
from tetractl.core.errors import WrongValueError
from tetractl.core.poses import POSE_MAX, Bools, Floats, Observation, Poses, Sample, Times
from tetractl.plant.sim_section import MeasurementNoise
from tetractl.spec.disturbance import Disturbance, overriding


class SimCamera:
    """A simulated camera of N robots. Disturbances change, delay and lose its frames.

    A frame passes through `expose` when it is taken, through `receive` when it reaches the host,
    and through `samples` when the host reads it.

    Args:
        robots: Number of robots.
        noise: The measurement noise.
        disturbances: The disturbances of the trial.
        random: Generator of the noise.
    """

    def __init__(
        self,
        robots: int,
        noise: MeasurementNoise,
        disturbances: Sequence[Disturbance],
        random: np.random.Generator,
    ) -> None:
        self.newest: Observation | None = None
        """The newest frame that the host has received. None before the first."""
        # frames on their way to the host, in the order of arrival
        self._in_transit: deque[Sample] = deque()
        self._unread: list[Sample] = []  # received, oldest first
        self._noise = np.array([[noise.position], [noise.position], [noise.heading]])
        self._random = random
        self._measuring = overriding(disturbances, Disturbance.measured)
        self._delaying = overriding(disturbances, Disturbance.received)
        self._all_tracked = np.ones(robots, dtype=np.bool_)
        self._all_tracked.setflags(write=False)  # shared by all frames
        self._exposed = 0  # number of frames so far, lost ones too
        self._last_shown: Poses | None = None  # in the last frame that is not lost
        self._last_arrival_ns = 0  # when that frame arrives [ns]

    def expose(self, times_ns: Times, truth: Floats) -> None:
        """Take the next F frames with the simulated camera, with its noise and losses.

        Args:
            times_ns: Times of exposure [ns], shape (F,).
            truth: x, y and heading of the robots at these times, shape (F, 3, N).
        """
        measured = truth
        if self._noise.any():
            measured = truth + self._noise * self._random.standard_normal(truth.shape)
        exposed_ns = times_ns.tolist()
        # all arrivals first: disturbances draw in this order, which is part of the result
        arrivals_ns = [self._arrival_ns(time_ns) for time_ns in exposed_ns]
        for k, arrival_ns in enumerate(arrivals_ns):
            true_poses = Poses(*truth[k])
            poses = true_poses if measured is truth else Poses(*measured[k])
            tracked = self._all_tracked
            if self._measuring:
                poses, tracked = self._measured(poses, exposed_ns[k])
            if arrival_ns < NEVER_NS:
                frame = Observation(self._exposed, exposed_ns[k], arrival_ns, poses, tracked)
                self._in_transit.append(Sample(frame, true_poses))
                self._last_shown = poses
            self._exposed += 1

    @property
    def arriving_ns(self) -> int | None:
        """The time at which the next frame reaches the host [ns]. None if there is none."""
        return self._in_transit[0].observation.received_ns if self._in_transit else None

    def receive(self, until_ns: int) -> None:
        """Pass to the host every frame that arrives up to and including `until_ns`."""
        while self._in_transit and self._in_transit[0].observation.received_ns <= until_ns:
            sample = self._in_transit.popleft()
            self.newest = sample.observation
            self._unread.append(sample)

    def samples(self) -> list[Sample]:
        """Return every frame received since the last call, oldest first."""
        samples = self._unread
        self._unread = []
        return samples

    def _arrival_ns(self, exposed_ns: int) -> int:
        """Compute when the next frame reaches the host [ns]. NEVER if the frame is lost.

        Frames arrive in order. The frame at time 0 arrives at once: the camera has seen the
        standing robots long before the trial.
        """
        arrival_ns = exposed_ns
        delaying = self._delaying if exposed_ns > 0 else []
        for disturbance in delaying:
            delayed_ns = disturbance.received(exposed_ns, arrival_ns)
            if delayed_ns is None:
                return NEVER_NS
            if not delayed_ns >= exposed_ns:  # NaN, too
                value_text = f"the arrival of a frame before its exposure: {delayed_ns} ns"
                raise WrongValueError("a disturbance", value_text)
            arrival_ns = delayed_ns
        self._last_arrival_ns = max(self._last_arrival_ns, arrival_ns)
        return self._last_arrival_ns

    def _measured(self, poses: Poses, exposed_ns: int) -> tuple[Poses, Bools]:
        """Apply disturbances to the poses in a frame, and decide which robots are tracked in it.

        A robot that is not tracked keeps the pose of the last frame that was not lost.
        """
        tracked = self._all_tracked.copy()
        for disturbance in self._measuring:
            poses, tracked = disturbance.measured(poses, tracked, exposed_ns / SECOND)
        if not (np.abs(poses.array()[tracked]) <= POSE_MAX).all():
            raise WrongValueError(
                "a disturbance",
                "a measured pose that cannot be logged: it is not finite or too large",
            )
        if self._last_shown is not None and not tracked.all():
            shown_array = np.where(tracked[:, None], poses.array(), self._last_shown.array())
            poses = Poses.from_array(shown_array)
        return poses, tracked
