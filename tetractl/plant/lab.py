"""The lab as a plant: real robots behind cameras and a radio."""

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import Command, Note, PlantInfo, Sample, Verdict
from tetractl.core.errors import AbortError
from tetractl.core.poses import CameraFrame, Observation, Poses
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab import LabSpec
from tetractl.lab import preflight
from tetractl.lab.guard import Guard, State
from tetractl.lab.inner_loop import Sent
from tetractl.lab.preflight import Findings
from tetractl.lab.rig import Session
from tetractl.lab.wire_tap import NO_TAP, Tap
from tetractl.model.obstacles import Obstacles
from tetractl.model.path_check import PathCheck

KEPT = 100_000
LOOK_NS = SECOND // 5  # how often placing is looked at
GRACE_S = 1.0  # at least this long, for frames that are missing now and then
REST_NS = SECOND // 4  # robots must stand still for this long


class Attendant(Protocol):
    """Somebody who puts robots on their starts."""

    def place(self, lines: list[str]) -> None:
        """Told again and again which robots are off, a line each; none: all are placed."""
        ...

    def go(self) -> bool:
        """Whether all placed robots may start."""
        ...


@dataclass(slots=True)
class Hands:
    """What people and files have to do with a lab run.

    `operator` set is the emergency stop. `attendant` None: nobody is asked, and robots that are not
    on their starts within the spec's `placing` time end the run. `cancelled` tells that a person
    wants to wait no longer.
    """

    operator: threading.Event = field(default_factory=threading.Event)
    attendant: Attendant | None = None
    tap: Tap = NO_TAP
    cancelled: Callable[[], bool] = lambda: False


class LabPlant:
    """A `Plant` of real robots; after a fault every call raises AbortError with the reason."""

    def __init__(self, experiment: Experiment, clock: Clock, hands: Hands) -> None:
        assert isinstance(experiment.plant, LabSpec), "build_plant chooses by the spec's plant"
        self.experiment, self.spec, self.clock = experiment, experiment.plant, clock
        self._hands = hands
        self.session = Session(
            experiment, experiment.plant, clock, hands.operator, hands.tap, self._see
        )
        count = len(experiment.robots)
        self._heading = np.array([robot.heading for robot in experiment.robots])
        self._path_check = PathCheck(Obstacles.of(experiment.obstacles), count)
        self._judging = False
        self._newest: Observation | None = None
        self._fresh: deque[Sample] = deque(maxlen=KEPT)
        self._news: deque[Command | Note] = deque(maxlen=KEPT)
        self._handed: set[int] = set()  # when what `steer` has told already was sent
        self._observed_ns: int | None = None
        self._stop: Command | None = None

    def open(self) -> PlantInfo:
        """Connect, look everything over, and wait until the robots stand on their starts."""
        session = self.session
        session.open()
        findings = self._make_ready()
        now = self.clock.now()
        for warning in findings.all_warnings:
            self._news.append(Note(now, "warning", warning))
        session.guard.ready()
        while len(self._fresh) > 1:  # the newest stays: it is what `observe` may return
            self._fresh.popleft()
        self._judging = True
        if self._newest is None:
            raise AbortError("no camera frame came")
        rate = findings.camera_rate_hz or 0.0
        return PlantInfo("lab", False, round(rate, 3), self._facts(findings))

    def observe(self) -> Observation:
        """Return the newest camera frame; a robot not tracked now keeps its last pose."""
        self._raise_abort()
        self._observed_ns = self.clock.now()
        assert self._newest is not None, "open() waits for the first frame"
        return self._newest

    def steer(self, direction: float) -> Command:
        """Hold u from now on and return the first transmission that carries it."""
        if self._observed_ns is not None:
            period_ns = round(self.experiment.controller.period * SECOND)
            first = self.session.guard.state is State.READY
            late = not first and self.clock.now() - self._observed_ns > period_ns
            self.session.guard.late(late)
            self._observed_ns = None
        self._raise_abort()
        sent = self.session.drive.steer(direction)
        self._handed.add(sent.t_ns)
        return self._command(sent)

    def samples(self) -> list[Sample]:
        """Return, once, every camera frame since the last call, oldest first."""
        fresh: list[Sample] = []
        while self._fresh:
            fresh.append(self._fresh.popleft())
        return fresh

    def news(self) -> list[Command | Note]:
        """Return, once, every other transmission and every warning."""
        drive = self.session.drive
        others = [sent for sent in drive.sent() if sent.t_ns not in self._handed]
        self._news.extend(map(self._command, others))
        self._news.extend(Note(t_ns, "warning", text) for t_ns, text in drive.warnings())
        news, self._news = list(self._news), deque(maxlen=KEPT)
        return news

    def stop(self) -> Command:
        """Stop every robot, ten times over 200 ms."""
        if self._stop is None:
            self.session.drive.stop()
            count = len(self.experiment.robots)
            still = np.zeros(count)
            reached = (self.session.link.failure is None,) * count
            self._stop = Command(None, self.clock.now(), reached, still, still)
        return self._stop

    def settle(self) -> Verdict:
        """Look by the cameras that the robots stand still, and judge their path."""
        unrest = self._unrest()
        if unrest:
            self._news.append(Note(self.clock.now(), "error", unrest))
        self._judging = False
        final = self._newest.poses if self._newest is not None else self._starts()
        entered = tuple(bool(e) for e in self._path_check.entered)
        return Verdict(final, entered, tuple(self._path_check.clearance.tolist()), unrest)

    def close(self) -> None:
        """Let go of cameras and radio."""
        self.session.close()

    def _raise_abort(self) -> None:
        if self.session.guard.state is State.ABORT:
            raise AbortError(self.session.guard.reason)

    def _see(self, snapshot: CameraFrame, guard: Guard) -> None:
        """Take one frame, in the drive's thread, after the guard judged it."""
        believed = guard.believed(snapshot)
        robots = self.experiment.robots
        x, y, valid = [], [], []
        heading = self._heading.copy()
        for i, (pose, here) in enumerate(believed):
            x.append(robots[i].start[0] if pose is None else pose.x)
            y.append(robots[i].start[1] if pose is None else pose.y)
            valid.append(here)
            if pose is not None:
                heading[i] += math.remainder(pose.heading - heading[i], math.tau)
        self._heading = heading
        poses = Poses(np.array(x, dtype=np.float64), np.array(y, dtype=np.float64), heading)
        self._newest = Observation(
            snapshot.number, snapshot.sampled_ns, snapshot.received_ns, poses, np.array(valid)
        )
        if self._judging:
            self._path_check.add(poses.x[None], poses.y[None])
        self._fresh.append(Sample(self._newest, None))

    def _command(self, sent: Sent) -> Command:
        mm = self.session.mm
        left, right = sent.left / mm, sent.right / mm
        delivered = (True,) * len(sent.counts)  # nobody acknowledges a broadcast
        if sent.direction is not None:
            delivered = sent.moving
        return Command(sent.direction, sent.t_ns, delivered, left, right)

    def _make_ready(self) -> Findings:
        """Wait until all is well, every robot stands still on its start and, where one is there, a
        person agrees; AbortError says what is wrong and who is how far off.

        Robots that are carried may be off and out of sight for a while: only time tells.
        """
        session, attendant = self.session, self._hands.attendant
        limit = round(max(self.spec.limits.placing, GRACE_S) * SECOND)
        began = self.clock.now()
        while True:
            findings: Findings | None = None
            lines = preflight.unplaced(session, session.client.newest) or self._moving()
            if not lines:
                findings = preflight.inspect(session, preflight.poll(session))
                again = preflight.unplaced(session, session.client.newest)
                lines = list(dict.fromkeys((*findings.all_problems, *again)))
            if attendant is not None:
                attendant.place(lines)
            if findings is not None and not lines and (attendant is None or attendant.go()):
                return findings
            if self._hands.operator.is_set():
                raise AbortError("emergency stop by the operator")
            if self._hands.cancelled():
                raise KeyboardInterrupt
            self._check_stream()
            if attendant is None and self.clock.now() - began >= limit:
                found = findings or preflight.inspect(session, preflight.poll(session))
                problems = dict.fromkeys((*found.all_problems, *lines))
                raise AbortError(
                    "; ".join(problems),
                    "see `tetractl lab check`; limits.placing waits for robots to be placed",
                )
            self.clock.sleep_until(self.clock.now() + LOOK_NS)

    def _check_stream(self) -> None:
        newest, limits = self.session.client.newest, self.spec.limits
        silent = self.clock.now() - (newest.received_ns if newest else 0)
        if silent > max(limits.stream_lost, 0.5) * SECOND:
            raise AbortError(f"no new camera frame for {silent / SECOND:.2f} s")

    def _moving(self) -> list[str]:
        """Return who moved within the last frames, a line each."""
        recent = [sample.observation for sample in tuple(self._fresh)]
        if not recent:
            return []
        newest = recent[-1]
        window = [o for o in recent if newest.sampled_ns - o.sampled_ns <= REST_NS]
        span = (newest.sampled_ns - window[0].sampled_ns) / SECOND
        names = [robot.name for robot in self.experiment.robots]
        if span < 0.6 * REST_NS / SECOND:
            return [f"{name} has not been watched long enough" for name in names]
        gone = np.hypot(*(newest.poses.xy - window[0].poses.xy).T) * self.session.mm
        limit = self.spec.limits.standstill_mm
        speeds = gone / span
        return [f"{name} still moves" for name, v in zip(names, speeds, strict=True) if v > limit]

    def _unrest(self) -> str:
        """Wait until the robots stand still; return who does not, "" where all do."""
        limit = round(self.spec.limits.standstill * SECOND)
        began = self.clock.now()
        if self._newest is None or self.session.client.newest is None:
            return ""
        while True:
            self.clock.sleep_until(self.clock.now() + SECOND // 20)
            now = self.clock.now()
            seen_ns = self._newest.received_ns
            blind = now - seen_ns > round(self.spec.limits.stream_lost * SECOND)
            moving = [] if blind else self._moving()
            watched = seen_ns - began >= REST_NS
            if watched and not moving and not blind:
                return ""
            if now - began >= limit:
                if blind:
                    return "the cameras could not show that the robots stand still"
                return "; ".join(moving) + f" {limit / SECOND:g} s after the stop"

    def _starts(self) -> Poses:
        robots = self.experiment.robots
        return Poses.of(np.array([(*robot.start, robot.heading) for robot in robots]))

    def _facts(self, findings: Findings) -> dict[str, str]:
        stream = self.session.client.stream
        latency = findings.latency_ms
        batteries = [
            f"{robot.name} {robot.battery_v:.2f} V" for robot in findings.robots if robot.battery_v
        ]
        return {
            "natnet": str(stream.version),
            "server": stream.info.name if stream.info else "",
            "latency_ms": "unknown" if latency is None else f"{latency[0]:.2f}",
            "clock_round_trip_ms": (
                "unknown" if findings.round_trip_ms is None else f"{findings.round_trip_ms:.3f}"
            ),
            "batteries": ", ".join(batteries),
        }
