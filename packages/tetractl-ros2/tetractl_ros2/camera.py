"""A camera that receives poses on topics of a ROS 2 graph.

Time stamps come from the sender's clock, which may differ from this computer's clock. Among the
last 600 messages of a topic, the quickest one is assumed to have taken the section's `latency`. The
age of any other message follows from how much later it arrived, relative to its stamp. If both
clocks agree, `check` compares `latency` with the true age of the stamps.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Self

from tetractl.core.clock import SECOND, Clock, wait_for
from tetractl.core.errors import AbortError, describe_error, printable
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.protocols import Health
from tetractl.core.setup import Setup
from tetractl.lab.cameras.optitrack.natnet import Placement, UpAxis
from tetractl.lab.cameras.stamp_clock import StampClock
from tetractl.lab.serial_port import UNREADABLE, PortFactory
from tetractl.spec.lab_section import entry
from tetractl.tools.worker import take_all
from tetractl_ros2.body_readings import BodySighting, read_sightings, without_slash
from tetractl_ros2.frame_group import FrameGroup, Readings, RobotReading
from tetractl_ros2.ros2_messages import Bool
from tetractl_ros2.section import Ros2CameraSection
from tetractl_ros2.topic_port import TopicPort, ports_of
from tetractl_ros2.topics import POSE_MESSAGES, emulated_topic, pose_topics

FIRST_POSES_S = 5.0
"""Maximum time until every robot has a pose [s]. The nodes have to find each other first."""
PENDING_FRAMES_MAX = 1000
"""Maximum number of frames that wait to be read."""
SAME_CLOCK_AGE_MAX_NS = SECOND // 2
"""Maximum age of a quick message's stamp on this computer's clock, if the clocks agree [ns]."""
LATENCY_ERROR_NS = SECOND // 50
"""Maximum difference between this age and `latency` [ns]. Above it, `check` warns."""
UNSEEN_NS = SECOND // 10
"""Maximum age of a robot's last pose in a frame, relative to the newest pose [ns].

No message says that a body is hidden: the node sends no more poses of this body.
"""
BODIES_MAX = 20
"""Maximum number of streamed bodies that a message lists."""
NAME_MAX = 60
"""Maximum number of characters of a node's name in a message."""
NODE_HINT = "is the ROS node running, in the same ROS domain, and does it publish this topic?"


class Ros2Camera:
    """The camera that tracks robots by their poses in a ROS 2 graph.

    The class implements `tetractl.core.protocols.Camera`. Each topic has a thread that receives and
    processes messages. The threads and `check` hold `_lock` while they use the results.

    Args:
        section: The camera's section of the spec.
        setup: The constants of the experiment.
        clock: The run's clock.
        wake: Called after each message.
        ports: Creates ports instead of the default ones, for example ports in memory.
        unix_ns: Returns the time since 1970 [ns], to compare stamps with.

    Attributes:
        section: The camera's section of the spec.
        damaged: Number of messages that could not be decoded.
    """

    def __init__(
        self,
        section: Ros2CameraSection,
        setup: Setup,
        clock: Clock,
        wake: Callable[[], None] = lambda: None,
        ports: PortFactory | None = None,
        unix_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.section = section
        self._setup = setup
        self.damaged = 0
        self._clock = clock
        self._wake = wake
        self._unix_ns = unix_ns
        self._lock = threading.Lock()
        robots = [entry(section.robots, name) for name in setup.names]
        self._row_by_body = {without_slash(robot.body): row for row, robot in enumerate(robots)}
        self._heading_offsets = [robot.heading_offset for robot in robots]
        self._placement = Placement(*section.origin, section.rotation, 1.0 / setup.metres)
        self._message = POSE_MESSAGES[section.message]
        self._is_one_message = section.message == "NamedPoseArray"
        self._untracked: dict[int, Pose | None] = {}
        """Readings of the robots that a message does not contain: they are not tracked.

        It is empty if each robot has its own messages.
        """
        if self._is_one_message:
            self._untracked = dict.fromkeys(range(len(robots)))
        self._frame_group = FrameGroup(len(robots))
        self._streamed_bodies = set[str]()  # names of the streamed bodies
        self._wrong_frame_by_row: dict[
            int, str
        ] = {}  # other frames in which robots were shown, by row
        self._first_damaged = ""
        self._has_unstamped = False
        self._is_emulated = False
        self._frame_count = 0
        self._newest_ns = -1
        self._waiting_frames = deque[CameraFrame](maxlen=PENDING_FRAMES_MAX)
        topics = pose_topics(section, setup)
        self._clocks = [StampClock() for _ in topics]
        marker = emulated_topic()
        make_port = ports or ports_of([*topics, marker])
        self._ports = [
            make_port(
                topic.address(section.domain),
                0,
                topic.name,
                clock,
                partial(self._receive, i),
                NODE_HINT,
            )
            for i, topic in enumerate(topics)
        ]
        self._marker = make_port(
            marker.address(section.domain), 0, marker.name, clock, self._receive_marker, ""
        )

    def __enter__(self) -> Self:
        """Subscribe to the topics, and wait until every robot has a pose.

        If only some robots have a pose after FIRST_POSES_S, the method returns anyway.

        Raises:
            AbortError: If no pose at all has arrived by then, or if a topic cannot be opened.
        """
        try:
            for port in (*self._ports, self._marker):
                port.open()
            wait_for(self._clock, self._has_all_poses, FIRST_POSES_S)
            if self._frame_count == 0:
                raise self._explain_silence()
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def check(self) -> Health:
        """Report robots without poses, crowded topics, wrong time stamps and an emulated tracker.

        Robots without poses and crowded topics are problems. Wrong time stamps are warnings.
        """
        with self._lock:
            problems = (*self._describe_missing(), *self._describe_crowded())
            warnings = tuple(self._stamp_warnings())
            age_ns = self._quickest_age_ns()
            facts = {} if age_ns is None else {"ros2_stamp_age_s": f"{age_ns / SECOND:.4f}"}
            return Health(problems, warnings, facts, emulated=self._is_emulated)

    def frames(self) -> list[CameraFrame]:
        """Return every frame since the last call, oldest first."""
        return take_all(self._waiting_frames)

    def _has_all_poses(self) -> bool:
        """Check whether each robot has a pose in its last reading."""
        return all(reading.pose is not None for reading in self._frame_group.last)

    def _explain_silence(self) -> AbortError:
        """Create the error for a tracker that has sent no usable pose.

        The error names the first cause that applies: a failed port, messages that could not be
        read, or a robot without poses.
        """
        failure = next((port.failure for port in self._ports if port.failure), None)
        if failure is not None:
            return AbortError(failure, NODE_HINT)
        if self._first_damaged:
            summary = (
                f"{self.damaged} messages came on {self.section.address}, but none could be read"
            )
            return AbortError(
                f"{summary}; error of the first: {self._first_damaged}", "is `message` right?"
            )
        missing = self._describe_missing()
        if self._wrong_frame_by_row:
            return AbortError("; ".join(missing), "is `frame` of the camera right?")
        return AbortError(missing[0] if missing else "no pose came", NODE_HINT)

    def _describe_missing(self) -> tuple[str, ...]:
        """Describe each robot that has no pose yet, in the setup's order, with the likely cause."""
        lines: list[str] = []
        for row, (name, reading) in enumerate(
            zip(self._setup.names, self._frame_group.last, strict=True)
        ):
            if reading.pose is not None:
                continue
            body = entry(self.section.robots, name).body
            other_frame = self._wrong_frame_by_row.get(row)
            if other_frame is not None:
                frame_text = printable(other_frame, NAME_MAX) or '""'
                lines.append(
                    f"{name}'s poses are in the frame {frame_text}, not {self.section.frame}"
                )
            elif len(self._ports) > 1:
                topic = self.section.topics(self._setup)[row]
                lines.append(f"{name} has no pose, because no message came on {topic}")
            else:
                place = f"{self.section.topic_pattern}; bodies there: {self._list_bodies()}"
                lines.append(f"there is no body {body} for {name} on {place}")
        return tuple(lines)

    def _list_bodies(self) -> str:
        """List the names of the streamed bodies, at most BODIES_MAX, for a message."""
        names = sorted(self._streamed_bodies)
        listed = ", ".join(printable(name, NAME_MAX) for name in names[:BODIES_MAX]) or "none"
        n_unlisted = len(names) - BODIES_MAX
        return f"{listed} and {n_unlisted} more" if n_unlisted > 0 else listed

    def _describe_crowded(self) -> tuple[str, ...]:
        """Describe each topic on which several nodes publish poses, except /tf.

        On /tf, several nodes are normal.
        """
        if self.section.message == "TFMessage":
            return ()
        return tuple(
            f"{port.end.n_partners} ROS nodes publish {port.end.topic.name}: stop all but one"
            for port in self._ports
            if isinstance(port, TopicPort) and port.end.n_partners > 1
        )

    def _quickest_age_ns(self) -> int | None:
        """Compute how old the stamp of the quickest message was on arrival, by our clock [ns].

        The result is None if no stamp has come, if a message had no stamp, or if the tracker is
        emulated.
        """
        offsets_ns = [clock.shortest_gap_ns for clock in self._clocks]
        known_offsets_ns = [offset_ns for offset_ns in offsets_ns if offset_ns is not None]
        if not known_offsets_ns or self._is_emulated or self._has_unstamped:
            return None
        return max(known_offsets_ns) + self._unix_ns() - self._clock.now()

    def _stamp_warnings(self) -> Iterator[str]:
        """Yield a warning about missing time stamps, and about stamps with a wrong age."""
        latency_s = self.section.latency
        if self._has_unstamped:
            yield (
                f"the poses have no time stamp: each is taken as {latency_s:g} s old when it "
                "arrives, even if it is late"
            )
        age_ns = self._quickest_age_ns()
        if age_ns is None:
            return
        age_s = age_ns / SECOND
        if not 0 <= age_ns <= SAME_CLOCK_AGE_MAX_NS:
            yield (
                f"time stamps are {age_s:.3f} s old on arrival, so the sender's clock "
                f"differs from this computer's clock, and `latency`, {latency_s:g} s, cannot "
                "be checked"
            )
        elif abs(age_ns - latency_s * SECOND) > LATENCY_ERROR_NS:
            yield (
                f"time stamps are {age_s:.3f} s old on arrival, but `latency` says "
                f"{latency_s:g} s: if the clocks of both computers are synchronised, set "
                "`latency` to the first value"
            )

    def _receive_marker(self, data: bytes, _at_ns: int) -> None:
        """Process the message with which an emulated tracker reports that it is not real."""
        if data:  # otherwise the port has failed
            with suppress(*UNREADABLE):
                self._is_emulated = self._is_emulated or Bool.deserialize(data).data

    def _receive(self, topic: int, data: bytes, at_ns: int) -> None:
        """Process a message of a topic. Empty `data` mean that the topic's port has failed."""
        with self._lock:
            if not data:
                self._queue_failure(topic, at_ns)
            else:
                self._read_message(topic, data, at_ns)
        self._wake()

    def _queue_failure(self, topic: int, at_ns: int) -> None:
        """Queue a frame without poses that reports the failure of a topic's port."""
        fault = self._ports[topic].failure or f"reading the topic {self.section.address} failed"
        self._frame_count += 1
        no_poses = (None,) * len(self._setup.names)
        self._waiting_frames.append(
            CameraFrame(self._frame_count, at_ns, at_ns, no_poses, fault=fault)
        )

    def _read_message(self, topic: int, data: bytes, at_ns: int) -> None:
        """Decode a message of a topic, and queue a frame once all its poses have arrived."""
        try:
            body_sightings = read_sightings(self.section.message, self._message.deserialize(data))
        except UNREADABLE as error:
            self.damaged += 1
            self._first_damaged = (
                self._first_damaged or f"{describe_error(error)}, in {data[:60]!r}"
            )
            return
        poses_by_stamp: dict[int, dict[int, Pose | None]] = {}
        for sighting in body_sightings:
            row = self._find_row(topic, sighting)
            if row is not None:
                pose = self._placement.pose(sighting.rigid, UpAxis.Z, self._heading_offsets[row])
                poses_by_stamp.setdefault(max(0, sighting.stamp_ns), {})[row] = pose
        complete: list[Readings] = []
        for stamp_ns in sorted(poses_by_stamp):
            exposed_ns = self._exposed_ns(topic, stamp_ns, at_ns)
            poses_by_row = self._untracked | poses_by_stamp[stamp_ns]
            readings = {row: RobotReading(pose, exposed_ns) for row, pose in poses_by_row.items()}
            complete += self._frame_group.add(stamp_ns or at_ns, readings)
        if complete:  # one message gives one frame, even if its poses have several stamps
            self._queue_frame(complete[-1], at_ns)

    def _find_row(self, topic: int, sighting: BodySighting) -> int | None:
        """Find the index of the robot that a sighting belongs to.

        The result is None for an unknown body, and for a pose in another coordinate frame than the
        section's.
        """
        if sighting.body is not None:
            self._streamed_bodies.add(sighting.body)
        row = topic if sighting.body is None else self._row_by_body.get(sighting.body)
        if row is not None and sighting.frame != without_slash(self.section.frame):
            self._wrong_frame_by_row[row] = sighting.frame
            return None
        return row

    def _exposed_ns(self, topic: int, stamp_ns: int, at_ns: int) -> int:
        """Compute when the tracker saw the bodies in a message, by our clock [ns].

        To be called once for each stamp of a message, even if several bodies have the stamp.

        Args:
            topic: Index of the message's topic.
            stamp_ns: Time stamp on the sender's clock [ns]. 0 if the message has no stamp.
            at_ns: When the message arrived, by our clock [ns].
        """
        late_ns = 0
        if stamp_ns > 0:
            late_ns = self._clocks[topic].measure_lateness_ns(stamp_ns, at_ns)
        else:
            self._has_unstamped = True
        return max(0, at_ns - round(self.section.latency * SECOND) - late_ns)

    def _queue_frame(self, readings: Readings, at_ns: int) -> None:
        """Queue the frame with these readings, if it is newer than the last one.

        In this frame, a robot has no pose if its reading is more than UNSEEN_NS older than the
        newest reading.
        """
        newest_ns = max(reading.exposed_ns for reading in readings)
        if newest_ns <= self._newest_ns:
            return
        self._newest_ns = newest_ns
        self._frame_count += 1
        oldest_ns = newest_ns - UNSEEN_NS
        poses = tuple(
            reading.pose if reading.exposed_ns >= oldest_ns else None for reading in readings
        )
        exposure_times = (
            () if self._is_one_message else tuple(reading.exposed_ns for reading in readings)
        )
        self._waiting_frames.append(
            CameraFrame(self._frame_count, newest_ns, at_ns, poses, exposed_ns=exposure_times)
        )

    def _close(self) -> None:
        for port in (*self._ports, self._marker):
            port.close()
