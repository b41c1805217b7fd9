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
from tetractl.core.errors import AbortError, printable, text_of
from tetractl.core.poses import CameraFrame, Pose
from tetractl.core.protocols import Health
from tetractl.core.setup import Setup
from tetractl.lab.cameras.optitrack.natnet import Placement, UpAxis
from tetractl.lab.cameras.stamp_clock import StampClock
from tetractl.lab.serial_port import UNREADABLE, PortFactory
from tetractl.spec.lab_section import entry
from tetractl.tools.worker import drained
from tetractl_ros2.body_readings import BodySighting, sightings, without_slash
from tetractl_ros2.frame_group import FrameGroup, Readings, RobotReading
from tetractl_ros2.ros2_messages import Bool
from tetractl_ros2.section import Ros2CameraSection
from tetractl_ros2.topic_port import TopicPort, ports_of
from tetractl_ros2.topics import POSES, emulated_topic, pose_topics

FIRST_S = 5.0
"""Maximum time until every robot has a pose [s]. The nodes have to find each other first."""
FRAMES_WAITING_MAX = 1000
"""Maximum number of frames that wait to be read."""
SAME_CLOCK_NS = SECOND // 2
"""Maximum age of a quick message's stamp on this computer's clock, if the clocks agree [ns]."""
LATENCY_OFF_NS = SECOND // 50
"""Difference between this age and `latency` above which `check` warns [ns]."""
UNSEEN_NS = SECOND // 10
"""Age from which on a robot's last pose no longer counts, relative to the newest pose [ns].

No message says that a body is hidden: the node sends no more poses of this body.
"""
BODIES_MAX = 20
"""Maximum number of streamed bodies that a message lists."""
NAME_MAX = 60
"""Maximum number of characters shown of a name that any node may choose."""
HINT = "is the ROS node running, in the same ROS domain, and does it publish this topic?"


class Ros2Camera:
    """Tracks the setup's robots by their poses in a ROS 2 graph.

    The class implements `tetractl.core.protocols.Camera`. Each topic has a thread that receives
    messages. The threads process messages while they hold `_lock`, and `check` reads the results in
    the same way.

    Args:
        section: The camera's section of the spec.
        setup: The robots.
        clock: The run's clock.
        wake: Called after each frame.
        ports: Creates ports instead of the default ones, for example ports in memory.
        unix_ns: Returns the time since 1970 [ns], to compare stamps with.
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
        self._rows = {without_slash(robot.body): row for row, robot in enumerate(robots)}
        self._offsets = [robot.heading_offset for robot in robots]
        self._placement = Placement(*section.origin, section.rotation, 1.0 / setup.metres)
        self._message = POSES[section.message]
        self._is_one_message = section.message == "NamedPoseArray"
        self._untracked: dict[int, Pose | None] = {}
        """Readings of the robots that a message does not contain: they are not tracked.

        It is empty if each robot has its own messages.
        """
        if self._is_one_message:
            self._untracked = dict.fromkeys(range(len(robots)))
        self._group = FrameGroup(len(robots))
        self._bodies = set[str]()  # names that were streamed
        self._frames_seen: dict[int, str] = {}  # other frames in which robots were shown, by row
        self._first_damaged = ""
        self._has_unstamped = False
        self._is_emulated = False
        self._number = 0
        self._newest_ns = -1
        self._waiting = deque[CameraFrame](maxlen=FRAMES_WAITING_MAX)
        topics = pose_topics(section, setup)
        self._clocks = [StampClock() for _ in topics]
        marker = emulated_topic()
        make_port = ports or ports_of([*topics, marker])
        self._ports = [
            make_port(
                topic.address(section.domain), 0, topic.name, clock, partial(self._receive, i), HINT
            )
            for i, topic in enumerate(topics)
        ]
        self._marker = make_port(
            marker.address(section.domain), 0, marker.name, clock, self._receive_marker, ""
        )

    def __enter__(self) -> Self:
        """Subscribe to the topics, and wait until every robot has a pose.

        If only some robots have a pose after FIRST_S, the method returns anyway.

        Raises:
            AbortError: If no pose at all has arrived by then, or if a topic cannot be opened.
        """
        try:
            for port in (*self._ports, self._marker):
                port.open()
            wait_for(self._clock, self._has_all, FIRST_S)
            if self._number == 0:
                raise self._explain_silence()
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def check(self) -> Health:
        """Report robots without poses, crowded topics, wrong time stamps and an emulated tracker.

        The first two are problems, and wrong time stamps are warnings.
        """
        with self._lock:
            problems = (*self._describe_missing(), *self._describe_crowded())
            warnings = tuple(self._stamp_warnings())
            age_ns = self._quickest_age_ns()
            facts = {} if age_ns is None else {"ros2_stamp_age_s": f"{age_ns / SECOND:.4f}"}
            return Health(problems, warnings, facts, emulated=self._is_emulated)

    def frames(self) -> list[CameraFrame]:
        """Return every frame since the last call, oldest first."""
        return drained(self._waiting)

    def _has_all(self) -> bool:
        return all(reading.pose is not None for reading in self._group.last)

    def _explain_silence(self) -> AbortError:
        """Create the error for a tracker that has sent no usable pose.

        The error names the first cause that applies: a failed port, messages that could not be
        read, or a robot without poses.
        """
        failure = next((port.failure for port in self._ports if port.failure), None)
        if failure is not None:
            return AbortError(failure, HINT)
        if self._first_damaged:
            summary = (
                f"{self.damaged} messages came on {self.section.address}, but none could be read"
            )
            return AbortError(
                f"{summary}; error of the first: {self._first_damaged}", "is `message` right?"
            )
        missing = self._describe_missing()
        if self._frames_seen:
            return AbortError("; ".join(missing), "is `frame` of the camera right?")
        return AbortError(missing[0] if missing else "no pose came", HINT)

    def _describe_missing(self) -> tuple[str, ...]:
        """Describe each robot that has no pose yet, in the setup's order, with the likely cause."""
        lines: list[str] = []
        for row, (name, reading) in enumerate(
            zip(self._setup.names, self._group.last, strict=True)
        ):
            if reading.pose is not None:
                continue
            body = entry(self.section.robots, name).body
            other_frame = self._frames_seen.get(row)
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
        names = sorted(self._bodies)
        listed = ", ".join(printable(name, NAME_MAX) for name in names[:BODIES_MAX]) or "none"
        unlisted = len(names) - BODIES_MAX
        return f"{listed} and {unlisted} more" if unlisted > 0 else listed

    def _describe_crowded(self) -> tuple[str, ...]:
        """Describe each topic on which several nodes publish poses, except /tf.

        On /tf, several nodes are normal.
        """
        if self.section.message == "TFMessage":
            return ()
        return tuple(
            f"{port.end.partners} ROS nodes publish {port.end.topic.name}: stop all but one"
            for port in self._ports
            if isinstance(port, TopicPort) and port.end.partners > 1
        )

    def _quickest_age_ns(self) -> int | None:
        """Compute how old the stamp of the quickest message was on arrival, by our clock [ns].

        The result is None if no stamp has come, if a message had no stamp, or if the tracker is
        emulated.
        """
        gaps_ns = [clock.quickest_ns for clock in self._clocks]
        known_gaps = [gap for gap in gaps_ns if gap is not None]
        if not known_gaps or self._is_emulated or self._has_unstamped:
            return None
        return max(known_gaps) + self._unix_ns() - self._clock.now()

    def _stamp_warnings(self) -> Iterator[str]:
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
        if not 0 <= age_ns <= SAME_CLOCK_NS:
            yield (
                f"time stamps are {age_s:.3f} s old on arrival, so the sender's clock "
                f"differs from this computer's clock, and `latency`, {latency_s:g} s, cannot "
                "be checked"
            )
        elif abs(age_ns - latency_s * SECOND) > LATENCY_OFF_NS:
            yield (
                f"time stamps are {age_s:.3f} s old on arrival, but `latency` says "
                f"{latency_s:g} s: if the clocks of both computers are synchronised, set "
                "`latency` to the first value"
            )

    def _receive_marker(self, data: bytes, _at_ns: int) -> None:
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
        fault = self._ports[topic].failure or f"reading the topic {self.section.address} failed"
        self._number += 1
        no_poses = (None,) * len(self._setup.names)
        self._waiting.append(CameraFrame(self._number, at_ns, at_ns, no_poses, fault=fault))

    def _read_message(self, topic: int, data: bytes, at_ns: int) -> None:
        try:
            bodies = sightings(self.section.message, self._message.deserialize(data))
        except UNREADABLE as error:
            self.damaged += 1
            self._first_damaged = self._first_damaged or f"{text_of(error)}, in {data[:60]!r}"
            return
        by_stamp: dict[int, dict[int, Pose | None]] = {}
        for sighting in bodies:
            row = self._find_row(topic, sighting)
            if row is not None:
                pose = self._placement.pose(sighting.rigid, UpAxis.Z, self._offsets[row])
                by_stamp.setdefault(max(0, sighting.stamp_ns), {})[row] = pose
        complete: list[Readings] = []
        for stamp_ns in sorted(by_stamp):
            exposed_ns = self._exposed_ns(topic, stamp_ns, at_ns)
            poses_by_row = self._untracked | by_stamp[stamp_ns]
            readings = {row: RobotReading(pose, exposed_ns) for row, pose in poses_by_row.items()}
            complete += self._group.add(stamp_ns or at_ns, readings)
        if complete:  # what came in one message is one frame, also with several stamps
            self._queue_frame(complete[-1], at_ns)

    def _find_row(self, topic: int, sighting: BodySighting) -> int | None:
        """Find the index of the robot that a sighting belongs to.

        The result is None for an unknown body, and for a pose in another coordinate frame than the
        section's.
        """
        if sighting.body is not None:
            self._bodies.add(sighting.body)
        row = topic if sighting.body is None else self._rows.get(sighting.body)
        if row is not None and sighting.frame != without_slash(self.section.frame):
            self._frames_seen[row] = sighting.frame
            return None
        return row

    def _exposed_ns(self, topic: int, stamp_ns: int, at_ns: int) -> int:
        """Compute when the bodies in a message with this stamp were seen, by our clock [ns].

        A stamp is used only once, even if several bodies have it. A stamp of 0 means that there is
        none.
        """
        late_ns = 0
        if stamp_ns > 0:
            late_ns = self._clocks[topic].late_ns(stamp_ns, at_ns)
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
        self._number += 1
        since_ns = newest_ns - UNSEEN_NS
        poses = tuple(o.pose if o.exposed_ns >= since_ns else None for o in readings)
        exposure_times = (
            () if self._is_one_message else tuple(reading.exposed_ns for reading in readings)
        )
        self._waiting.append(
            CameraFrame(self._number, newest_ns, at_ns, poses, exposed_ns=exposure_times)
        )

    def _close(self) -> None:
        for port in (*self._ports, self._marker):
            port.close()
