"""Labs in which one device is real and the other is emulated, in real time.

With a real camera, the real robots stand below it, switched off, and emulated robots drive instead.
Each pose from the camera is displaced by the distance that the emulated robot has driven. The rate,
latency, losses and noise are therefore those of the real camera.

With a real actuator, the real robots drive wherever they are, for example on blocks with their
wheels in the air. A second actuator sends the same commands to emulated robots, which the emulated
camera shows.
"""

from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from typing import Any, ClassVar, Self

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import Steer, Transmission, Turn
from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.protocols import Actuator, Camera, Health, RobotStatus
from tetractl.spec.base import Model
from tetractl_emulator.emulated_lab import EmulatedLab
from tetractl_emulator.faults import Fault
from tetractl_emulator.loop import Loop

HISTORY_NS = 2 * SECOND
"""Time for which emulated poses are kept [ns]. No frame is older."""


class Blind:
    """A stand-in for the emulated camera in a lab whose camera is real. It shows nothing."""

    Settings: ClassVar[type[Model]] = Model
    faults: ClassVar[Sequence[type[Fault]]] = ()
    shown_ns: Sequence[int] = ()
    join: Any = None

    def open(self, loop: Loop) -> dict[str, Any]:
        """Do nothing, and return the facts that the record states about the camera: it is real."""
        return {"camera": "real"}

    def close(self) -> dict[str, Any]:
        """Do nothing."""
        return {}


class MovedCamera:
    """A real camera above stationary robots, whose poses are displaced as emulated robots drive.

    The class implements `tetractl.core.protocols.Camera`. `look` must be called every millisecond.

    Args:
        camera: The real camera.
        emulation: The emulated lab, which moves the emulated robots.
        clock: The clock for times.
        mm: Millimetres per length unit of the spec.
    """

    def __init__(self, camera: Camera, emulation: EmulatedLab, clock: Clock, mm: float) -> None:
        self._camera = camera
        self._emulation = emulation
        self._clock = clock
        self._mm = mm
        bodies = emulation.actuator.bodies
        self._start_poses: list[Pose | None] = [None] * len(bodies)
        self._emulated_history = deque[tuple[int, list[tuple[float, float, float]]]]()
        self._has_driven = False

    def __enter__(self) -> Self:
        self._camera.__enter__()
        return self

    def __exit__(self, *reason: Any) -> None:
        self._camera.__exit__(*reason)

    @property
    def damaged(self) -> int:
        """Number of messages of the real camera that could not be decoded."""
        return self._camera.damaged

    def check(self) -> Health:
        """Return the health of the real camera."""
        return self._camera.check()

    def look(self) -> None:
        """Record the poses of the emulated robots.

        Until they first drive, the emulated robots are placed where the camera sees the real ones.
        """
        bodies = self._emulation.actuator.bodies
        now_ns = self._clock.now()
        self._has_driven = self._has_driven or self._emulation.actuator.driven
        if not self._has_driven:
            for body, start_pose in zip(bodies, self._start_poses, strict=True):
                if start_pose is not None:
                    body.place(start_pose.x * self._mm, start_pose.y * self._mm, start_pose.heading)
        self._emulated_history.append((now_ns, [(body.x, body.y, body.heading) for body in bodies]))
        while now_ns - self._emulated_history[0][0] > HISTORY_NS:
            self._emulated_history.popleft()

    def frames(self) -> list[CameraFrame]:
        """Return the frames since the last call, oldest first, with displaced poses."""
        return [self._displace_frame(frame) for frame in self._camera.frames()]

    def _displace_frame(self, frame: CameraFrame) -> CameraFrame:
        """Displace the poses of a frame.

        Until the emulated robots drive, the poses are returned unchanged, and stored as the start
        poses of the real robots.
        """
        if not self._has_driven:
            self._start_poses = [
                new_pose or old_pose
                for new_pose, old_pose in zip(frame.poses, self._start_poses, strict=True)
            ]
            return frame
        times = frame.exposed_ns or (frame.sampled_ns,) * len(frame.poses)
        poses = [
            self._displace_pose(i, exposed_ns, pose)
            for i, (exposed_ns, pose) in enumerate(zip(times, frame.poses, strict=True))
        ]
        return replace(frame, poses=tuple(poses))

    def _emulated_at(self, at_ns: int) -> Any:
        """Find the newest emulated poses up to a time [ns].

        If all kept poses are newer, the result is the oldest poses.
        """
        history = tuple(self._emulated_history)  # a copy, because another thread may add poses
        for t_ns, poses in reversed(history):
            if t_ns <= at_ns:
                return poses
        _, oldest = history[0]
        return oldest

    def _displace_pose(self, i: int, at_ns: int, pose: Pose | None) -> Pose | None:
        """Displace one pose by the distance that the emulated robot had driven at a time.

        Args:
            i: Index of the robot.
            at_ns: When the pose was exposed [ns].
            pose: The pose from the real camera. None if the robot is untracked.

        Returns:
            The displaced pose. None if the robot is untracked or was not seen before the motion.
        """
        start_pose = self._start_poses[i]
        if pose is None or start_pose is None:
            return None
        x, y, heading = self._emulated_at(at_ns)[i]
        return replace(
            pose,
            x=x / self._mm + pose.x - start_pose.x,
            y=y / self._mm + pose.y - start_pose.y,
            heading=heading + pose.heading - start_pose.heading,
        )


class TwinActuator:
    """A real actuator, together with an emulated actuator that sends the same commands.

    The class implements `tetractl.core.protocols.Actuator`. Failures and answers come from the real
    actuator.

    Args:
        real: The real actuator.
        twin: The actuator of the emulated robots.
    """

    def __init__(self, real: Actuator, twin: Actuator) -> None:
        self._real = real
        self._twin = twin
        self._opened = ExitStack()
        self.halts = real.halts
        self.period_ns = real.period_ns

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            opened.enter_context(self._real)
            opened.enter_context(self._twin)
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    @property
    def failure(self) -> str | None:
        """The reason why the real actuator cannot send. None if it can."""
        return self._real.failure

    def check(self) -> Health:
        """Return the health of the real actuator."""
        return self._real.check()

    def send(
        self,
        action: Steer | Turn,
        poses: Sequence[Pose | None],
        moving: Sequence[bool],
        exposed_ns: int,
    ) -> Transmission:
        """Send an action with both actuators; see `Actuator.send`.

        Returns:
            The transmission of the real actuator.
        """
        sent = self._real.send(action, poses, moving, exposed_ns)
        self._twin.send(action, poses, moving, exposed_ns)
        return sent

    def stop(self, emergency: bool = False) -> Transmission:
        """Stop the robots of both actuators; see `Actuator.stop`.

        The emulated robots are stopped even if the real ones cannot be reached. A failure of the
        emulated radio is ignored, because after an error the real robots would get no more stops.

        Returns:
            The transmission of the real actuator.
        """
        try:
            return self._real.stop(emergency)
        finally:
            with suppress(AbortError):
                self._twin.stop(emergency)

    def poll(self, timeout_s: float) -> list[RobotStatus]:
        """Return the status of the real robots, waiting at most `timeout_s` [s].

        Emulated robots are ignored.
        """
        return self._real.poll(timeout_s)
