"""The plant of the lab: real robots with a camera and an actuator.

`LabFrames` converts the frames that the guard has accepted to observations and samples.
"""

import math
from collections import deque
from dataclasses import replace
from functools import cached_property
from typing import Literal

import numpy as np

from tetractl.core.clock import SECOND, Clock, MonotonicClock
from tetractl.core.commands import Action, Command, FieldOff, Steer, Stop
from tetractl.core.errors import AbortError
from tetractl.core.poses import FrameAddition, Observation, Poses, Sample
from tetractl.core.protocols import LabSupervision
from tetractl.core.setup import Setup
from tetractl.core.trial import HALTS_FACT, Note, PlantInfo, Verdict
from tetractl.lab.abort_cause import CAMERA_MOVED
from tetractl.lab.device_abilities import AddsToFrames, RobotWatch, WatchesRobots
from tetractl.lab.frames import AcceptedFrame
from tetractl.lab.guard import GuardState
from tetractl.lab.preflight import Preflight, describe_dropped_frames, wait_until_ready
from tetractl.lab.rest_check import (
    STANDSTILL_NS,
    WINDOW_MULTIPLES,
    Standstill,
    describe_drifting_robots,
    join_messages,
    wait_for_rest,
)
from tetractl.lab.rig import Rig, build_rig
from tetractl.model.path_check import PathCheck
from tetractl.spec.lab_section import LabSection
from tetractl.tools.worker import QUEUE_MAX


class RigSection(LabSection):
    """Base class of the fields of a lab, real or emulated, whose devices form one `Rig`."""

    def clock(self) -> Clock:
        """Return the clock of the trials: the host's monotonic clock."""
        return MonotonicClock()

    def rig(
        self,
        setup: Setup,
        clock: Clock,
        seed: np.random.SeedSequence,
        supervision: LabSupervision | None = None,
        chosen: bool = False,
    ) -> Rig:
        """Create the connected lab of one trial or command. No device is opened yet.

        Args:
            setup: The constants of the experiment.
            clock: The clock of the run.
            seed: Seed of an emulated lab. Real labs ignore it.
            supervision: How people supervise the run. None if nobody does.
            chosen: Whether the robots of the trial still have to be found. Only an emulated lab
                uses this.

        Raises:
            AbortError: If the devices of an emulated lab cannot be real and emulated one by one.
        """
        return build_rig(self, setup, clock, supervision.emergency if supervision else None)

    def require_calibratable(self) -> None:
        """Raise UsageError if no calibration is possible with the devices of this lab.

        A calibration needs a camera that shows the robots that the actuator drives. This base
        class allows it.
        """

    def plant(self, rig: Rig, supervision: LabSupervision) -> "LabPlant":
        """Create the plant of a trial for the connected lab `rig`."""
        return LabPlant(rig, supervision, self.type)

    def build(
        self, setup: Setup, clock: Clock, seed: np.random.SeedSequence, supervision: LabSupervision
    ) -> "LabPlant":
        """Create the plant of one trial, without opening it; see `PlantSection.build`."""
        return self.plant(self.rig(setup, clock, seed, supervision), supervision)


class LabPlantSection(RigSection):
    """The fields of a plant with real robots: a camera, an actuator and limits."""

    type: Literal["lab"] = "lab"


RECENT_MAX = 600
"""Maximum number of recent observations kept: a few seconds.

If robots cannot stand still, the observation nearest to the stop gives the final poses.
"""


class LabFrames:
    """Reads the camera frames of a connected lab for a trial.

    `newest` is the last frame that was read. It is None before the first frame. The robots' paths
    are checked frame by frame. The paths of lost robots are left out.
    """

    def __init__(self, rig: Rig) -> None:
        self.newest: Observation | None = None
        self._rig = rig
        self._frame_adder = rig.camera if isinstance(rig.camera, AddsToFrames) else None
        self._heading = rig.setup.starts.heading  # not wrapped, of the last poses
        self.path_check = PathCheck.for_setup(rig.setup)
        self._read_count = 0  # of the rig's accepted frames
        self._additions: dict[int, FrameAddition] = {}  # by the time of exposure [ns]
        self._recent: deque[Observation] = deque(maxlen=RECENT_MAX)

    def begin(self) -> None:
        """Start with the newest frame, so that `read` returns it first.

        Earlier frames are ignored.
        """
        self._read_count = self._rig.loop.frames.count - 1

    def read(self) -> list[Sample]:
        """Return the frames that the guard accepted since the last call, oldest first.

        The path of the robots is checked at the same time.
        """
        frames, self._read_count = self._rig.loop.frames.since(self._read_count)
        if self._frame_adder is not None:
            for addition in self._frame_adder.additions():
                self._additions[addition.sampled_ns] = addition
        observations = [self._observation(frame) for frame in frames]
        samples: list[Sample] = []
        for observation in observations:
            addition = self._additions.get(observation.sampled_ns)
            messages = addition.messages if addition else ()
            self._recent.append(observation)
            samples.append(Sample(observation, None, messages))
        if observations:
            self.newest = observations[-1]
            xy = np.array([observation.poses.xy for observation in observations])
            x, y = xy.transpose(2, 0, 1)
            x[:, list(self._rig.loop.guard.lost_robots)] = np.nan
            valid = np.array([observation.valid for observation in observations])
            self.path_check.add(x, y, valid)
        if self.newest is not None:  # frames that the guard rejected give no sample
            for sampled_ns in list(self._additions):
                if sampled_ns <= self.newest.sampled_ns:
                    del self._additions[sampled_ns]
        return samples

    def nearest(self, t_ns: int) -> Observation:
        """Return the recent observation whose exposure is nearest to a time of the run [ns]."""
        return min(self._recent, key=lambda frame: abs(frame.sampled_ns - t_ns))

    def _observation(self, accepted: AcceptedFrame) -> Observation:
        """Convert the next frame to an observation, with headings unwrapped relative to the last.

        A robot that has had no pose so far counts as being at its start.
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
            np.array(accepted.is_fresh),
            accepted.exposed_ns,
        )


class LabPlant:
    """The real robots of a lab, used as the `Plant` of a trial.

    After a fault, every call raises AbortError with the reason.

    Args:
        rig: The connected lab.
        supervision: How people supervise the trial.
        kind: The type of the plant's section.
    """

    def __init__(self, rig: Rig, supervision: LabSupervision, kind: str = "lab") -> None:
        self.rig = rig
        self.clock = rig.clock
        self._kind = kind
        self._supervision = supervision
        self._frames = LabFrames(rig)
        self._samples: list[Sample] = []  # not yet returned, oldest first
        self._notes: deque[Note] = deque(maxlen=QUEUE_MAX)  # not yet read
        self._returned: set[int] = set()  # send times of commands that a call has returned
        self._observed_ns: int | None = None  # when the frame of this control step was observed
        self._stop: Command | None = None
        self._stopped_ns = 0  # when the robots were stopped last, 0 before
        self._settled = False  # whether the frames up to the verdict are still to be returned

    @property
    def setup(self) -> Setup:
        """The constants of the experiment, such as robots, targets and arena."""
        return self.rig.setup

    # ---- the protocol `Plant`, in the order of its calls ----

    def open(self) -> PlantInfo:
        """Connect, run the preflight check, and wait until the robots are on their starts.

        Raises:
            AbortError: If the run cannot start. Robots that move are stopped first.
        """
        rig = self.rig
        rig.open()
        try:
            findings = wait_until_ready(rig, self._supervision)
        except AbortError as error:
            raise self._start_error(error) from None
        now_ns = self.clock.now()
        for warning in findings.all_warnings:
            self._notes.append(Note(now_ns, "warning", warning))
        rig.loop.guard.pass_preflight()
        self._frames.begin()
        if rig.loop.frames.newest is None:
            raise AbortError("no camera frame has arrived")
        rate_hz = findings.camera_rate_hz or 0.0
        facts = {**_facts(findings), HALTS_FACT: "yes" if rig.actuator.halts else "no"}
        return PlantInfo(self._kind, False, round(rate_hz, 3), facts)

    def observe(self) -> Observation:
        """Return the newest camera frame. An untracked robot keeps its last pose.

        Raises:
            AbortError: If the guard has aborted the run.
        """
        self._raise_abort()
        self._observed_ns = self.clock.now()
        self._take_frames()
        newest = self._frames.newest
        assert newest is not None, "there is no frame: call open() first"
        return newest

    def send(self, action: Action) -> Command:
        """Send an action repeatedly, starting now, and return its first transmission.

        A stop is sent ten times. If the guard holds all robots still at present, the returned
        command was delivered to none.

        Raises:
            AbortError: If the guard has ended the run, or for `FieldOff`.
        """
        if isinstance(action, FieldOff):
            raise AbortError("this lab cannot switch off its field while the robots drive")
        if isinstance(action, Stop):
            return self._halt()
        guard = self.rig.loop.guard
        if isinstance(action, Steer) and self._observed_ns is not None:
            begins = guard.state is GuardState.READY  # a step that begins a run is never late
            period_ns = round(self.setup.period_s * SECOND)
            guard.record_step(not begins and self.clock.now() - self._observed_ns > period_ns)
        self._observed_ns = None
        self._check_pause("in a pause")
        self._raise_abort()
        sent = self.rig.loop.hold(action)
        self._returned.add(sent.sent_ns)
        if isinstance(sent.action, Stop):  # the guard holds all robots still at present
            return replace(sent, action=action, delivered=(False,) * len(sent.delivered))
        return sent

    def samples(self) -> list[Sample]:
        """Return every camera frame since the last call, oldest first.

        The first call after `settle` returns frames up to the frame with the verdict's final poses.
        """
        if not self._settled:
            self._take_frames()
        self._settled = False
        samples = self._samples
        self._samples = []
        return samples

    def events(self) -> list[Command | Note]:
        """Return warnings, and every transmission that `send` did not return, oldest first.

        Only what is new since the last call is returned.
        """
        warnings = [Note(t_ns, "warning", text) for t_ns, text in self.rig.loop.take_warnings()]
        events: list[Command | Note] = [
            *self._notes,
            *(
                sent
                for sent in self.rig.loop.take_transmissions()
                if sent.sent_ns not in self._returned
            ),
            *warnings,
        ]
        self._notes.clear()
        return sorted(events, key=lambda it: it.t_ns if isinstance(it, Note) else it.sent_ns)

    def stop(self) -> Command:
        """Send ten stops to every robot within 200 ms, and return the first of them.

        Only the first call sends stops. Later calls return the same command, even if no stop could
        be sent; `delivered` is then False for every robot.
        """
        if self._stop is None:
            self._stop = self._halt()
        return self._stop

    def settle(self) -> Verdict:
        """Wait until every robot is tracked and, if possible, stands still.

        Then check the path.

        If there was a fault since the last step, such as a stop that could not be sent, the robots
        do not count as standing still.

        Returns:
            The verdict. Its `can_restart` is False if a person has to look at robots or devices
            first.
        """
        guard = self.rig.loop.guard
        standstill = self._come_to_rest()
        if self._check_pause("after the stop") and not standstill.fault:
            standstill = self._come_to_rest()  # as after every abort
        not_at_rest_reason = standstill.reason
        if not_at_rest_reason:
            self._note("error", not_at_rest_reason)
        if guard.dropped_frame_count:
            self._note("warning", describe_dropped_frames(guard.dropped_frame_count))
        turning_note = guard.drift.describe_turning()
        if turning_note:
            self._note("info", turning_note)
        if guard.state is GuardState.ABORT:
            not_at_rest_reason = not_at_rest_reason or guard.reason
        self._take_frames()
        self._settled = True
        turn, turn_std = guard.drift.estimate_turning()
        verdict = self._frames.path_check.verdict(self._final_poses(), not_at_rest_reason)
        return replace(
            verdict,
            unrest=standstill.unrest,
            turn=turn,
            turn_std=turn_std,
            can_restart=standstill == Standstill()
            and not guard.emergency
            and self.rig.actuator.failure is None,
        )

    def close(self) -> None:
        """Release the camera and the actuator."""
        self.rig.close()

    # ---- frames ----

    def _take_frames(self) -> None:
        """Read the frames that the guard has newly accepted, and report lost robots."""
        samples = self._frames.read()
        self._samples += samples
        watch = self._watch
        newest = self._frames.newest
        if watch is None or newest is None:
            return
        for sample in samples:
            self._notes.extend(watch.see(sample.observation.sampled_ns))
        self._take_losses(watch, newest.sampled_ns)

    @cached_property
    def _watch(self) -> RobotWatch | None:
        """The camera's watch for lost robots. None if the camera has none.

        It is cached, because looking for a protocol's members takes as long as checking a frame.
        """
        camera = self.rig.camera
        watches = isinstance(camera, WatchesRobots)
        return camera.watch(self.setup, self.rig.limits) if watches else None

    def _take_losses(self, watch: RobotWatch, now_ns: int) -> None:
        """Report the robots that the camera's watch counts as lost to the guard.

        If the spec allows it, another body replaces a robot that has been lost for long enough.
        """
        losses = tuple(watch.lost())
        if losses:
            with self.rig.loop.between_steps() as guard:
                for lost in losses:
                    guard.lose_robot(lost.robot, lost.text)
        loss = self.setup.loss
        if loss is None or not loss.replaces_lost:
            return
        for i, seen_ns in self.rig.loop.guard.lost_robots.items():
            if now_ns - seen_ns < loss.after_s * SECOND:
                continue
            replacement = watch.replace(i)
            if replacement:
                with self.rig.loop.between_steps() as guard:
                    guard.replace_robot(i)
                self._notes.append(Note(now_ns, "warning", f"{self.setup.names[i]} {replacement}"))

    def _final_poses(self) -> Poses:
        """Return the final poses of the robots.

        The poses are those at standstill. If the robots swim on, the frame whose exposure is
        nearest to the time of the stop gives the poses. Without any frame, they are the starts.
        """
        newest = self._frames.newest
        if newest is None:
            return self.setup.starts
        if self.rig.actuator.halts:
            return newest.poses
        return self._frames.nearest(self._stopped_ns).poses

    # ---- commands ----

    def _halt(self) -> Command:
        """Stop every robot until another action is sent, and return the first of the stops."""
        self._stopped_ns = self.clock.now()
        first = self.rig.loop.stop()
        self._observed_ns = None
        robots = len(self.setup.names)
        if first is None:
            return Command(Stop(), self._stopped_ns, delivered=(False,) * robots)
        self._returned.add(first.sent_ns)
        return replace(first, delivered=(self.rig.actuator.failure is None,) * robots)

    def _come_to_rest(self) -> Standstill:
        """Stop the robots until the camera shows all of them standing still."""
        if self.rig.loop.frames.newest is None:
            return Standstill()
        return wait_for_rest(self.rig, self._supervision.cancelled)

    def _start_error(self, error: AbortError) -> AbortError:
        """Return the error for a run that does not start, after stopping robots that move.

        The error's message then also names robots that may still be driving.
        """
        if not (self.rig.actuator.halts and describe_drifting_robots(self.rig)):
            return error
        self._halt()
        self.rig.loop.guard.abort(error.message)
        return AbortError(join_messages(error.message, self._come_to_rest().unrest), error.hint)

    def _check_pause(self, when: str) -> bool:
        """Abort if a robot moved while none was commanded to, and return whether it did.

        Only motion after all robots had stood still for a while counts. `when` starts the message.
        """
        guard = self.rig.loop.guard
        if not (self._stopped_ns and self.rig.actuator.halts and guard.state is GuardState.READY):
            return False
        lines: list[str] = []
        if self.clock.now() - self._stopped_ns > STANDSTILL_NS:
            lines += describe_drifting_robots(self.rig, WINDOW_MULTIPLES[:1])
        moved = guard.pause_motions
        if len(moved) == len(self.setup.names) > 1:
            lines.append(CAMERA_MOVED)
        else:
            lines += [f"{self.setup.names[i]} {how}" for i, how in moved.items()]
        if lines:  # the first reason stays
            guard.abort(f"{when} {lines[0]}")
        return bool(lines)

    def _raise_abort(self) -> None:
        """Raise AbortError with the guard's reason if the guard has aborted the run."""
        if self.rig.loop.guard.state is GuardState.ABORT:
            raise AbortError(self.rig.loop.guard.reason)

    def _note(self, level: str, text: str) -> None:
        """Add a note to the operator, with the present time."""
        self._notes.append(Note(self.clock.now(), level, text))


def _facts(findings: Preflight) -> dict[str, str]:
    """Collect the facts of the preflight check for the log, such as latency and batteries."""
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
