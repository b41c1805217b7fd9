"""The plant of a lab: real robots, a camera that measures their poses, and an actuator.

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
    """Base class of the fields of a real or emulated lab whose devices form a connected `Rig`."""

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
            chosen: Whether the robots of the trial still have to be found among all robots. Only an
                emulated lab uses this value.

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


RECENT_OBSERVATIONS_MAX = 600
"""Maximum number of recent observations that are kept, for a few seconds.

If robots cannot stand still, the observation nearest to the stop gives the final poses.
"""


class LabFrames:
    """Reads the camera frames of a connected lab for a trial, and checks the robots' paths.

    The paths of lost robots are not checked.

    Attributes:
        newest: The last frame that was read. None before the first frame.
        path_check: The check of the paths so far.
    """

    def __init__(self, rig: Rig) -> None:
        self.newest: Observation | None = None
        self._rig = rig
        self._frame_adder = rig.camera if isinstance(rig.camera, AddsToFrames) else None
        self._last_headings = rig.setup.starts.heading  # not wrapped
        self.path_check = PathCheck.for_setup(rig.setup)
        self._read_count = 0  # number of accepted frames that were read
        self._addition_by_exposure_ns: dict[int, FrameAddition] = {}
        self._recent_observations: deque[Observation] = deque(maxlen=RECENT_OBSERVATIONS_MAX)

    def skip_to_newest(self) -> None:
        """Ignore all frames before the newest frame, which `read` then returns first."""
        self._read_count = self._rig.loop.frames.count - 1

    def read(self) -> list[Sample]:
        """Return the frames that the guard accepted since the last call, oldest first.

        The path of the robots is checked at the same time.
        """
        frames, self._read_count = self._rig.loop.frames.since(self._read_count)
        if self._frame_adder is not None:
            for addition in self._frame_adder.additions():
                self._addition_by_exposure_ns[addition.sampled_ns] = addition
        observations = [self._to_observation(frame) for frame in frames]
        samples: list[Sample] = []
        for observation in observations:
            addition = self._addition_by_exposure_ns.get(observation.sampled_ns)
            messages = addition.messages if addition else ()
            self._recent_observations.append(observation)
            samples.append(Sample(observation, None, messages))
        if observations:
            self.newest = observations[-1]
            xy = np.array([observation.poses.xy for observation in observations])
            x, y = xy.transpose(2, 0, 1)
            x[:, list(self._rig.loop.guard.lost_robots)] = np.nan
            valid = np.array([observation.valid for observation in observations])
            self.path_check.add(x, y, valid)
        if self.newest is not None:  # frames that the guard rejected give no sample
            for sampled_ns in list(self._addition_by_exposure_ns):
                if sampled_ns <= self.newest.sampled_ns:
                    del self._addition_by_exposure_ns[sampled_ns]
        return samples

    def find_nearest(self, time_ns: int) -> Observation:
        """Return the recent observation whose exposure is nearest to a time of the run [ns]."""
        return min(
            self._recent_observations,
            key=lambda observation: abs(observation.sampled_ns - time_ns),
        )

    def _to_observation(self, accepted: AcceptedFrame) -> Observation:
        """Convert the next frame to an observation whose headings continue the last without jumps.

        A robot that has had no pose so far counts as being at its start.
        """
        starts = self._rig.setup.starts
        x = starts.x.copy()
        y = starts.y.copy()
        heading = self._last_headings.copy()
        for i, pose in enumerate(accepted.poses):
            if pose is not None:
                x[i] = pose.x
                y[i] = pose.y
                heading[i] += math.remainder(pose.heading - heading[i], math.tau)
        self._last_headings = heading
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
        self._unread_samples: list[Sample] = []  # not yet returned, oldest first
        self._unread_notes: deque[Note] = deque(maxlen=QUEUE_MAX)
        # of the commands that `send` or `stop` has returned
        self._returned_send_times_ns: set[int] = set()
        self._observed_ns: int | None = None  # when the frame of this control step was observed
        self._first_stop: Command | None = None
        self._stopped_ns = 0  # when the robots were stopped last, 0 before
        # whether `samples` has yet to return the frames up to the verdict
        self._has_final_frames = False

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
            raise self._handle_failed_start(error) from None
        now_ns = self.clock.now()
        for warning in findings.all_warnings:
            self._unread_notes.append(Note(now_ns, "warning", warning))
        rig.loop.guard.pass_preflight()
        self._frames.skip_to_newest()
        if rig.loop.frames.newest is None:
            raise AbortError("no camera frame has arrived")
        rate_hz = findings.camera_rate_hz or 0.0
        facts = {**_collect_facts(findings), HALTS_FACT: "yes" if rig.actuator.halts else "no"}
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

        A stop is sent ten times. If the guard holds all robots still at present, `delivered` of the
        returned command is False for every robot.

        Raises:
            AbortError: If the guard has ended the run, or if the action is `FieldOff`.
        """
        if isinstance(action, FieldOff):
            raise AbortError("this lab cannot switch off its field while the robots drive")
        if isinstance(action, Stop):
            return self._send_stops()
        guard = self.rig.loop.guard
        if isinstance(action, Steer) and self._observed_ns is not None:
            is_first_step = guard.state is GuardState.READY  # the first step is never late
            period_ns = round(self.setup.period_s * SECOND)
            guard.record_step(
                not is_first_step and self.clock.now() - self._observed_ns > period_ns
            )
        self._observed_ns = None
        self._abort_if_moved("in a pause")
        self._raise_abort()
        sent = self.rig.loop.hold(action)
        self._returned_send_times_ns.add(sent.sent_ns)
        if isinstance(sent.action, Stop):  # the guard holds all robots still at present
            return replace(sent, action=action, delivered=(False,) * len(sent.delivered))
        return sent

    def samples(self) -> list[Sample]:
        """Return every camera frame since the last call, oldest first.

        The first call after `settle` returns frames up to the frame with the verdict's final poses.
        """
        if not self._has_final_frames:
            self._take_frames()
        self._has_final_frames = False
        samples = self._unread_samples
        self._unread_samples = []
        return samples

    def events(self) -> list[Command | Note]:
        """Return new notes, and new transmissions that `send` did not return, oldest first.

        The result contains only what happened since the last call.
        """
        warnings = [Note(t_ns, "warning", text) for t_ns, text in self.rig.loop.take_warnings()]
        events: list[Command | Note] = [
            *self._unread_notes,
            *(
                sent
                for sent in self.rig.loop.take_transmissions()
                if sent.sent_ns not in self._returned_send_times_ns
            ),
            *warnings,
        ]
        self._unread_notes.clear()
        return sorted(
            events, key=lambda event: event.t_ns if isinstance(event, Note) else event.sent_ns
        )

    def stop(self) -> Command:
        """Send ten stops to every robot within 200 ms, and return the first of them.

        Only the first call sends stops. Later calls return the same command, even if no stop could
        be sent; `delivered` is then False for every robot.
        """
        if self._first_stop is None:
            self._first_stop = self._send_stops()
        return self._first_stop

    def settle(self) -> Verdict:
        """Wait until every robot is tracked and, if possible, stands still, and check the path.

        After a fault since the last step, such as a stop that could not be sent, the robots do not
        count as standing still.

        Returns:
            The verdict. Its `can_restart` is False if a person has to look at robots or devices
            first.
        """
        guard = self.rig.loop.guard
        standstill = self._wait_for_standstill()
        if self._abort_if_moved("after the stop") and not standstill.fault:
            standstill = self._wait_for_standstill()  # as after every abort
        not_at_rest_reason = standstill.reason
        if not_at_rest_reason:
            self._add_note("error", not_at_rest_reason)
        if guard.dropped_frame_count:
            self._add_note("warning", describe_dropped_frames(guard.dropped_frame_count))
        turning_note = guard.drift.describe_turning()
        if turning_note:
            self._add_note("info", turning_note)
        if guard.state is GuardState.ABORT:
            not_at_rest_reason = not_at_rest_reason or guard.reason
        self._take_frames()
        self._has_final_frames = True
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
        self._unread_samples += samples
        watch = self._watch
        newest = self._frames.newest
        if watch is None or newest is None:
            return
        for sample in samples:
            self._unread_notes.extend(watch.see(sample.observation.sampled_ns))
        self._report_losses(watch, newest.sampled_ns)

    @cached_property
    def _watch(self) -> RobotWatch | None:
        """The camera's watch for lost robots. None if the camera has no such watch.

        The result is cached, because a check of the protocol takes as long as a check of a frame.
        """
        camera = self.rig.camera
        watches = isinstance(camera, WatchesRobots)
        return camera.watch(self.setup, self.rig.limits) if watches else None

    def _report_losses(self, watch: RobotWatch, now_ns: int) -> None:
        """Tell the guard which robots the camera has lost, and replace robots lost for too long.

        A robot is replaced by another body only if the spec allows replacements.
        """
        losses = tuple(watch.lost())
        if losses:
            with self.rig.loop.between_steps() as guard:
                for loss_report in losses:
                    guard.lose_robot(loss_report.robot, loss_report.text)
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
                self._unread_notes.append(
                    Note(now_ns, "warning", f"{self.setup.names[i]} {replacement}")
                )

    def _final_poses(self) -> Poses:
        """Return the final poses of the robots: usually the poses at standstill.

        If the robots swim on after a stop, the final poses come from the frame whose exposure is
        nearest to the time of the stop. Without any frame, they are the start poses.
        """
        newest = self._frames.newest
        if newest is None:
            return self.setup.starts
        if self.rig.actuator.halts:
            return newest.poses
        return self._frames.find_nearest(self._stopped_ns).poses

    # ---- commands ----

    def _send_stops(self) -> Command:
        """Send stops to every robot, and return the first stop.

        The robots stand still until another action is sent.
        """
        self._stopped_ns = self.clock.now()
        first_stop = self.rig.loop.stop()
        self._observed_ns = None
        n_robots = len(self.setup.names)
        if first_stop is None:
            return Command(Stop(), self._stopped_ns, delivered=(False,) * n_robots)
        self._returned_send_times_ns.add(first_stop.sent_ns)
        return replace(first_stop, delivered=(self.rig.actuator.failure is None,) * n_robots)

    def _wait_for_standstill(self) -> Standstill:
        """Wait until the camera shows all robots standing still, and describe their standstill."""
        if self.rig.loop.frames.newest is None:
            return Standstill()
        return wait_for_rest(self.rig, self._supervision.cancelled)

    def _handle_failed_start(self, error: AbortError) -> AbortError:
        """Stop robots that move although the run does not start, and return the error to raise.

        The message of this error also names robots that may still be driving.
        """
        if not (self.rig.actuator.halts and describe_drifting_robots(self.rig)):
            return error
        self._send_stops()
        self.rig.loop.guard.abort(error.message)
        return AbortError(
            join_messages(error.message, self._wait_for_standstill().unrest), error.hint
        )

    def _abort_if_moved(self, message_start: str) -> bool:
        """Abort if a robot moved in a pause, and return whether a robot moved.

        In a pause, no robot is commanded to move. Only motion after all robots had stood still for
        a while counts.

        Args:
            message_start: Start of the message, such as "in a pause".
        """
        guard = self.rig.loop.guard
        if not (self._stopped_ns and self.rig.actuator.halts and guard.state is GuardState.READY):
            return False
        motion_texts: list[str] = []
        if self.clock.now() - self._stopped_ns > STANDSTILL_NS:
            motion_texts += describe_drifting_robots(self.rig, WINDOW_MULTIPLES[:1])
        motion_by_robot = guard.pause_motions
        if len(motion_by_robot) == len(self.setup.names) > 1:
            motion_texts.append(CAMERA_MOVED)
        else:
            motion_texts += [
                f"{self.setup.names[i]} {motion_text}" for i, motion_text in motion_by_robot.items()
            ]
        if motion_texts:  # the first reason stays
            guard.abort(f"{message_start} {motion_texts[0]}")
        return bool(motion_texts)

    def _raise_abort(self) -> None:
        """Raise AbortError with the guard's reason if the guard has aborted the run."""
        if self.rig.loop.guard.state is GuardState.ABORT:
            raise AbortError(self.rig.loop.guard.reason)

    def _add_note(self, level: str, text: str) -> None:
        """Add a note for the operator, with the present time."""
        self._unread_notes.append(Note(self.clock.now(), level, text))


def _collect_facts(findings: Preflight) -> dict[str, str]:
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
