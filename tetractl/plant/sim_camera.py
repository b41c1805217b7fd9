"""The simulated camera: the contents of its frames, and their times of arrival at the host."""

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
    and through `take_samples` when the host reads it.

    Args:
        n_robots: Number of robots.
        noise: The measurement noise.
        disturbances: The disturbances of the trial.
        random: Generator of the noise.
    """

    def __init__(
        self,
        n_robots: int,
        noise: MeasurementNoise,
        disturbances: Sequence[Disturbance],
        random: np.random.Generator,
    ) -> None:
        self.newest: Observation | None = None
        """The newest frame that the host has received. None before the first frame."""
        # frames on their way to the host, in the order of arrival
        self._in_transit: deque[Sample] = deque()
        self._unread_samples: list[Sample] = []  # received, oldest first
        self._noise_deviations = np.array([[noise.position], [noise.position], [noise.heading]])
        self._random = random
        self._measurement_disturbances = overriding(disturbances, Disturbance.measured)
        self._arrival_disturbances = overriding(disturbances, Disturbance.received)
        self._all_tracked = np.ones(n_robots, dtype=np.bool_)
        self._all_tracked.setflags(write=False)  # shared by all frames
        self._exposed_count = 0  # frames so far, including lost frames
        self._last_frame_poses: Poses | None = None  # in the last frame that was not lost
        self._last_arrival_ns = 0  # when that frame arrives [ns]

    def expose(self, times_ns: Times, truth: Floats) -> None:
        """Take the next F camera frames, with measurement noise and disturbances.

        Args:
            times_ns: Times of exposure [ns], shape (F,).
            truth: x, y and heading of the robots at these times, shape (F, 3, N).
        """
        measured = truth
        if self._noise_deviations.any():
            measured = truth + self._noise_deviations * self._random.standard_normal(truth.shape)
        exposed_ns = times_ns.tolist()
        # all arrivals first: disturbances draw in this order, which is part of the result
        arrivals_ns = [self._schedule_arrival(time_ns) for time_ns in exposed_ns]
        for k, arrival_ns in enumerate(arrivals_ns):
            true_poses = Poses(*truth[k])
            poses = true_poses if measured is truth else Poses(*measured[k])
            tracked = self._all_tracked
            if self._measurement_disturbances:
                poses, tracked = self._disturb_measurement(poses, exposed_ns[k])
            if arrival_ns < NEVER_NS:
                observation = Observation(
                    self._exposed_count, exposed_ns[k], arrival_ns, poses, tracked
                )
                self._in_transit.append(Sample(observation, true_poses))
                self._last_frame_poses = poses
            self._exposed_count += 1

    @property
    def next_arrival_ns(self) -> int | None:
        """The time at which the next frame reaches the host [ns]. None without such a frame."""
        return self._in_transit[0].observation.received_ns if self._in_transit else None

    def receive(self, until_ns: int) -> None:
        """Pass to the host every frame that arrives up to and including `until_ns`."""
        while self._in_transit and self._in_transit[0].observation.received_ns <= until_ns:
            sample = self._in_transit.popleft()
            self.newest = sample.observation
            self._unread_samples.append(sample)

    def take_samples(self) -> list[Sample]:
        """Take every frame received since the last call, oldest first."""
        samples = self._unread_samples
        self._unread_samples = []
        return samples

    def _schedule_arrival(self, exposed_ns: int) -> int:
        """Decide when the next frame will reach the host [ns]. NEVER_NS if the frame is lost.

        Frames arrive in order: a frame never arrives before an earlier frame. The frame at time 0
        arrives at once, because the camera has seen the standing robots long before the trial.
        """
        arrival_ns = exposed_ns
        disturbances = self._arrival_disturbances if exposed_ns > 0 else []
        for disturbance in disturbances:
            delayed_ns = disturbance.received(exposed_ns, arrival_ns)
            if delayed_ns is None:
                return NEVER_NS
            if not delayed_ns >= exposed_ns:  # NaN, too
                value_text = f"the arrival of a frame before its exposure: {delayed_ns} ns"
                raise WrongValueError("a disturbance", value_text)
            arrival_ns = delayed_ns
        self._last_arrival_ns = max(self._last_arrival_ns, arrival_ns)
        return self._last_arrival_ns

    def _disturb_measurement(self, poses: Poses, exposed_ns: int) -> tuple[Poses, Bools]:
        """Apply the disturbances to the poses in a frame, and decide which robots are tracked.

        A robot that is not tracked keeps the pose of the last frame that was not lost.
        """
        tracked = self._all_tracked.copy()
        for disturbance in self._measurement_disturbances:
            poses, tracked = disturbance.measured(poses, tracked, exposed_ns / SECOND)
        if not (np.abs(poses.array()[tracked]) <= POSE_MAX).all():
            raise WrongValueError(
                "a disturbance",
                "a measured pose that cannot be logged: it is not finite or too large",
            )
        if self._last_frame_poses is not None and not tracked.all():
            shown_array = np.where(tracked[:, None], poses.array(), self._last_frame_poses.array())
            poses = Poses.from_array(shown_array)
        return poses, tracked
