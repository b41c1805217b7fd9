"""The plant of the lab: real robots with a camera and an actuator."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Literal

import numpy as np

from tetractl.core.clock import SECOND, Clock, MonotonicClock
from tetractl.core.commands import (
    HALTS,
    Action,
    Command,
    FieldOff,
    FrameAddition,
    Note,
    PlantInfo,
    Sample,
    Steer,
    Stop,
    Transmission,
    Verdict,
)
from tetractl.core.errors import AbortError
from tetractl.core.poses import Floats, Observation, Pose, Poses
from tetractl.core.protocols import LabSupervision
from tetractl.core.setup import Setup
from tetractl.core.worker import WAITING_MAX
from tetractl.experiment.lab_section import LabSection
from tetractl.lab.culprit import CAMERA
from tetractl.lab.device_abilities import AddsToFrames, RobotWatch, WatchesRobots
from tetractl.lab.guard_records import GuardState
from tetractl.lab.preflight import Preflight, dropped, wait_until_ready
from tetractl.lab.rest_check import LONGER, REST_NS, drifting_robots, wait_for_rest
from tetractl.lab.rig import Rig, build_rig
from tetractl.model.path_check import PathCheck

PAUSED_NS = 3 * REST_NS  # time after a stop after which robots have stood for REST_NS


class RigSection(LabSection):
    """A lab whose camera and actuator, real or emulated, work together in a rig."""

    def clock(self) -> Clock:
        """Return the host's monotonic clock."""
        return MonotonicClock()

    def rig(
        self,
        setup: Setup,
        clock: Clock,
        seed: np.random.SeedSequence,
        supervision: LabSupervision | None = None,
        chosen: bool = False,
    ) -> Rig:
        """Return the rig of one trial or command; no device is opened yet.

        An emulated lab needs `seed`, and `chosen`: whether the robots are still to be found.
        """
        return build_rig(self, setup, clock, supervision.emergency if supervision else None)

    def plant(self, rig: Rig, supervision: LabSupervision) -> "LabPlant":
        """Return the plant of a rig."""
        return LabPlant(rig, supervision, self.type)

    def build(
        self, setup: Setup, clock: Clock, seed: np.random.SeedSequence, supervision: LabSupervision
    ) -> "LabPlant":
        """Return the plant of one trial; nothing is opened yet."""
        return self.plant(self.rig(setup, clock, seed, supervision), supervision)


class LabPlantSection(RigSection):
    """A lab with real robots: a camera, an actuator and limits."""

    type: Literal["lab"] = "lab"


class LabPlant:
    """A `Plant` of the robots of a lab, `kind` is the type of its section; after a fault every call
    raises AbortError with the reason.
    """

    def __init__(self, rig: Rig, supervision: LabSupervision, kind: str = "lab") -> None:
        self._kind = kind
        self.rig, self.setup, self.clock = rig, rig.setup, rig.clock
        self._supervision = supervision
        self._heading = self.setup.starts.heading
        self._path_check = PathCheck.of(self.setup)
        self._read = 0  # number of accepted frames read from the rig so far
        self._newest: Observation | None = None
        self._fresh: list[Sample] = []
        self._added: dict[int, FrameAddition] = {}  # by the time of exposure [ns]
        self._news: deque[Command | Note] = deque(maxlen=WAITING_MAX)
        self._returned: set[int] = set()  # send times of transmissions that `send` has returned
        self._observed_ns: int | None = None
        self._stop: Command | None = None
        self._stopped_ns = 0
        self._recent: deque[Observation] = deque(maxlen=600)  # of some seconds
        self._settled = False  # whether the frames up to the verdict are still to be returned

    def open(self) -> PlantInfo:
        """Connect, run the preflight check, and wait until the robots are on their starts."""
        rig = self.rig
        rig.__enter__()
        findings = wait_until_ready(rig, self._supervision)
        now = self.clock.now()
        self._news.extend(Note(now, "warning", warning) for warning in findings.all_warnings)
        rig.guard.pass_preflight()
        self._read = (
            rig.frames.count - 1
        )  # the newest frame is read again, as `observe` may return it
        if rig.frames.newest is None:
            raise AbortError("no camera frame arrived")
        rate_hz = findings.camera_rate_hz or 0.0
        facts = {**_facts(findings), HALTS: "yes" if rig.actuator.halts else "no"}
        return PlantInfo(self._kind, False, round(rate_hz, 3), facts)

    def observe(self) -> Observation:
        """Return the newest camera frame; a robot that is not tracked in it keeps its last pose."""
        self._raise_abort()
        self._observed_ns = self.clock.now()
        self._take_frames()
        assert self._newest is not None, "there is no frame: call open() first"
        return self._newest

    def send(self, action: Action) -> Command:
        """Hold an action from now on; return its first transmission. A stop is sent ten times."""
        if isinstance(action, FieldOff):
            raise AbortError("this lab cannot switch its field off while robots drive")
        if isinstance(action, Stop):
            return self._halt()
        guard = self.rig.guard
        if self._observed_ns is not None and isinstance(action, Steer):
            period_ns = round(self.setup.period_s * SECOND)
            first = guard.state is GuardState.READY
            guard.note_step(not first and self.clock.now() - self._observed_ns > period_ns)
        self._observed_ns = None
        self._check_pause()
        self._raise_abort()
        sent = self.rig.loop.hold(action)
        self._returned.add(sent.sent_ns)
        if isinstance(sent.action, Stop):  # the guard holds all robots still at present
            unheard = (False,) * len(sent.moving)
            return Command(action, sent.sent_ns, unheard, sent.left, sent.right)
        return self._command(sent)

    def samples(self) -> list[Sample]:
        """Return every camera frame since the last call, oldest first; the first call after
        `settle` ends with the frame that its verdict's final poses are from.
        """
        if not self._settled:
            self._take_frames()
        self._settled = False
        fresh, self._fresh = self._fresh, []
        return fresh

    def news(self) -> list[Command | Note]:
        """Return every transmission not returned by `send`, and every warning, since the last
        call."""
        loop = self.rig.loop
        others = [sent for sent in loop.sent() if sent.sent_ns not in self._returned]
        self._news.extend(map(self._command, others))
        self._news.extend(Note(t_ns, "warning", text) for t_ns, text in loop.warnings())
        news, self._news = sorted(self._news, key=_time_ns), deque(maxlen=WAITING_MAX)
        return news

    def stop(self) -> Command:
        """Stop every robot, ten times over 200 ms."""
        if self._stop is None:
            self._stop = self._halt()
        return self._stop

    def _halt(self) -> Command:
        """Stop every robot until another action is sent; return the first of the stops."""
        self._stopped_ns = self.clock.now()
        first = self.rig.loop.stop()
        self._observed_ns = None
        reached = (self.rig.actuator.failure is None,) * len(self.setup.names)
        if first is None:
            return Command(Stop(), self._stopped_ns, reached)
        self._returned.add(first.sent_ns)
        return Command(Stop(), first.sent_ns, reached, first.left, first.right)

    def _check_pause(self, when: str = "in a pause") -> None:
        """Abort if a robot was seen to move in a pause as no command does, or once all have stood
        for `REST_NS`.
        """
        guard, lines = self.rig.guard, list[str]()
        if not (self._stopped_ns and self.rig.actuator.halts and guard.state is GuardState.READY):
            return
        if self.clock.now() - self._stopped_ns > PAUSED_NS:
            lines = drifting_robots(self.rig, LONGER[:1])
        moved = [f"{self.setup.names[i]} {how}" for i, how in guard.moved.items()]
        moved = [CAMERA] if len(moved) == len(self.setup.names) > 1 else moved
        for line in [*lines, *moved]:
            guard.abort(f"{when} {line}")

    def settle(self) -> Verdict:
        """Wait until every robot is tracked and, if robots can stand, at rest; check the path.

        After a fault since the last step, such as a stop that could not be sent, the robots count
        as not at rest.
        """
        not_at_rest = wait_for_rest(self.rig) if self.rig.frames.newest else ""
        self._check_pause("after the stop")
        if not_at_rest:
            self._news.append(Note(self.clock.now(), "error", not_at_rest))
        if outdated := self.rig.guard.dropped:
            self._news.append(Note(self.clock.now(), "warning", dropped(outdated)))
        if turns := self.rig.guard.drift.turns():
            self._news.append(Note(self.clock.now(), "info", turns))
        if self.rig.guard.state is GuardState.ABORT:
            not_at_rest = not_at_rest or self.rig.guard.reason
        self._take_frames()
        self._settled = True
        turn, error = self.rig.guard.drift.turning()
        verdict = self._path_check.verdict(self._final(), not_at_rest)
        return replace(verdict, turn=turn, turn_std=error)

    def _final(self) -> Poses:
        """Return the final poses: at rest or, if the robots swim on, the poses in the frame whose
        exposure is nearest to the time of the stop.
        """
        if self._newest is None:
            return self.setup.starts
        if self.rig.actuator.halts:
            return self._newest.poses
        at = self._stopped_ns
        return min(self._recent, key=lambda one: abs(one.sampled_ns - at)).poses

    def close(self) -> None:
        """Release camera and actuator."""
        self.rig.close()

    # asked once: to look for a protocol's members takes as long as to check a frame
    @cached_property
    def _adds(self) -> AddsToFrames | None:
        return self.rig.camera if isinstance(self.rig.camera, AddsToFrames) else None

    @cached_property
    def _watch(self) -> RobotWatch | None:
        camera = self.rig.camera
        watches = isinstance(camera, WatchesRobots)
        return camera.watch(self.setup, self.rig.limits) if watches else None

    def _raise_abort(self) -> None:
        if self.rig.guard.state is GuardState.ABORT:
            raise AbortError(self.rig.guard.reason)

    def _take_frames(self) -> None:
        """Store the frames that the guard has accepted since the last call."""
        frames, self._read = self.rig.frames.since(self._read)
        if self._adds is not None:
            self._added |= {added.sampled_ns: added for added in self._adds.additions()}
        paths: list[Floats] = []
        for accepted in frames:
            poses, frame = self._unwrapped(accepted.poses), accepted.frame
            self._heading = poses.heading
            paths.append(poses.xy)
            times = frame.sampled_ns, frame.received_ns
            fresh = np.array(accepted.fresh)
            self._newest = Observation(frame.number, *times, poses, fresh, accepted.exposed_ns)
            self._recent.append(self._newest)
            added = self._added.get(frame.sampled_ns)
            if self._watch is not None:
                self._news.extend(self._watch.see(frame.sampled_ns))
            self._fresh.append(Sample(self._newest, None, added.messages if added else ()))
        if paths:
            x, y = np.array(paths).transpose(2, 0, 1)
            x[:, list(self.rig.guard.lost)] = np.nan
            self._path_check.add(x, y, np.array([accepted.fresh for accepted in frames]))
        if self._newest is not None:  # frames that the guard rejected give no sample
            now = self._newest.sampled_ns
            self._added = {at: added for at, added in self._added.items() if at > now}
            if self._watch is not None:
                self._take_losses(self._watch, now)

    def _take_losses(self, watch: RobotWatch, now: int) -> None:
        """Report the robots that count as lost to the guard; if the spec requires that, another
        body replaces a robot that has been lost for long enough.
        """
        guard, loss = self.rig.guard, self.setup.loss
        for lost in watch.lost():
            guard.lose_robot(lost.robot, lost.text)
        if loss is None or not loss.replaced:
            return
        for i, seen_ns in list(guard.lost.items()):
            if now - seen_ns < loss.after_s * SECOND:
                continue
            if what := watch.replace(i):
                guard.replace_robot(i)
                self._news.append(Note(now, "warning", f"{self.setup.names[i]} {what}"))

    def _unwrapped(self, seen: Sequence[Pose | None]) -> Poses:
        """Return the poses with headings unwrapped relative to the last poses.

        A robot that has had no pose so far counts as being at its start.
        """
        starts = self.setup.starts
        x, y, heading = starts.x.copy(), starts.y.copy(), self._heading.copy()
        for i, pose in enumerate(seen):
            if pose is not None:
                x[i], y[i] = pose.x, pose.y
                heading[i] += math.remainder(pose.heading - heading[i], math.tau)
        return Poses(x, y, heading)

    def _command(self, sent: Transmission) -> Command:
        delivered = sent.moving  # assumed, since broadcasts are not acknowledged
        if isinstance(sent.action, Stop):
            delivered = (True,) * len(sent.moving)
        return Command(sent.action, sent.sent_ns, delivered, sent.left, sent.right)


def _time_ns(item: Command | Note) -> int:
    return item.t_ns if isinstance(item, Note) else item.sent_ns


def _facts(findings: Preflight) -> dict[str, str]:
    latency_ms = findings.latency_ms
    batteries = [
        f"{robot.name} {robot.status.battery}"
        for robot in findings.robots
        if robot.status.battery is not None
    ]
    facts = {"latency_ms": "unknown" if latency_ms is None else f"{latency_ms[0]:.2f}"}
    if batteries:
        facts["batteries"] = ", ".join(batteries)
    return {**facts, **findings.facts}
