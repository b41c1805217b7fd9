"""Run one trial: the control loop of the paper's Algorithm 2, from opening the plant to the result.

The *plant* is a simulation or a lab with real robots. The *controller* decides, in each control
step k, which direction is sent to the robots. *Observers*, such as the writer of the log, are
notified of everything that happens. These methods call each other:

    Trial.run                 opens the plant, runs the loop, ends the trial
      _loop                   asks the controller, carries out its plan, waits for the next step
        _carry_out            one control step k: sends, and notifies the observers
      _end
        _halt                 stops the robots, waits until they stand still, takes the last frames
        outcome_and_reason    outcome and reason, in the order below
        _notify_of_the_end    the observers' last calls

**What happens next, if**

    a pose jumps           the plant's guard refuses it. The controller's newest frame contains the
                           previous pose, marked as old (`tetractl.lab.guard`)
    a plan fails           the controller decides what robots do instead: pause, turn, or end the
                           trial (`tetractl.control.methods.mpc`). If it raises an error, the robots
                           stop, and the trial is aborted (row 1 below)
    a plan takes long      it is sent late. (In virtual time, planning takes no time.) If it takes
                           more than a period while robots drive, the step counts as missed.
                           Meanwhile, robots drive on in the last direction, until a lab's guard
                           aborts after the silence that its rules allow
    a step is late         if it is late by a period, the following steps are also due later. A
                           lab's guard aborts after `late_steps` steps in a row whose direction is
                           sent more than a period after their frame was read
    Ctrl-C                 the present step is finished: its plan is sent, or ends the trial. Then,
                           or after the wait for the next step, the robots stop, and the trial is
                           interrupted (row 4). A second Ctrl-C breaks off planning and waiting
    a robot does not move  it is reported. The trial continues, or the controller ends it
    a frame is missing,    the plant raises an AbortError: rows 1 and 2
    a device fails

**Threads.** The thread that runs the trial calls the plant and the observers. Observers that may be
slow have threads of their own. The same thread also calls the controller, with one exception: in
real time, the first plan has a thread of its own, so that frames are logged meanwhile.

**Interruptions.** Handlers of signals count them in `Interrupt`:

    count     meaning                      in the loop                       planning, waiting
    0                                      continues                         continue
    1         `requested`: end the trial   the step is finished first        continue
    2 or more end it at once               as for 1                          KeyboardInterrupt

Nothing else is broken off: code that sends, stops or writes is not `breakable`. A plan that is
broken off does not count as a step.

**How a trial ends.** The robots are stopped first, whatever happened. Then the first of these
counts:

    1  an error in the loop              aborted      its message, or which plug-in has raised it
    2  an error while robots stop        aborted      the same
    3  robots that do not stand still    aborted      which robots
    4  an interruption, unless the step  interrupted  whether the step was finished
       that was finished decided to end
    5  the controller's decision         its outcome  which robots do not move, if any

An error that is neither a TetractlError nor caused by a plug-in is a bug. It is raised again once
all observers were called. If an observer fails in its last call, the caller gets the result
`aborted`. The logs of the other observers are complete.
"""

import itertools
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Literal, Protocol

from tetractl.core.clock import SECOND, Clock, seconds
from tetractl.core.commands import Command, Stop, Turn
from tetractl.core.errors import TetractlError, describe_error
from tetractl.core.losses import describe_dead
from tetractl.core.motion_estimate import Estimate
from tetractl.core.plan import PAUSE_S, Decision, End, Outcome, Plan
from tetractl.core.poses import Observation, Sample
from tetractl.core.protocols import Controller, Observer, Plant
from tetractl.core.route_measure import RouteMeasure
from tetractl.core.setup import Setup
from tetractl.core.trial import Note, Result, Start, Step, Verdict
from tetractl.run.interrupt import Interrupt
from tetractl.run.motion_at_rest import RestMonitor
from tetractl.tools.plugin_fault import PluginTrialError, create_plugin_error

INTERRUPTED_AT_ONCE = "a second interruption stopped the trial at once"
INTERRUPTED_AFTER_STEP = "interrupted; the control step was finished first"
TURNING_TEXT = "all robots turn on the spot, because they have no safe path ahead"
PAUSING_TEXT = "all robots pause until the next plan starts, or until the trial ends"

TimedDecision = tuple[Decision, int]
"""A decision of the controller, and the wall time that it needed [ns]."""


class StepPacing:
    """The schedule of control steps: step k is due k periods after the first step, plus delays.

    A pause delays all later steps by PAUSE_S. A plan that is sent late on purpose delays them by
    the same time. A step that is late by a period or more delays them by its lateness, so that
    later steps have a full period again.
    """

    def __init__(self, clock: Clock, period_s: float) -> None:
        self._clock = clock
        self._period_s = period_s
        self.period_ns = round(period_s * SECOND)
        self._first_due_ns = 0

    def start(self) -> None:
        """Start the trial: control step 0 is due now."""
        self._first_due_ns = self._clock.now()

    def delay(self, delay_ns: int) -> None:
        """Delay all later control steps by `by_ns` [ns]."""
        self._first_due_ns += delay_ns

    def finish(self, k: int, pauses: bool) -> int:
        """Record the end of step k, and return when the next step is due [ns].

        Args:
            k: Index of the step that has ended.
            pauses: Whether the robots pause after this step. Then the next step is due later.
        """
        late_ns = self._clock.now() - self._due_ns(k)
        if late_ns >= self.period_ns:
            self.delay(late_ns)
        if pauses:
            self.delay(round(PAUSE_S * SECOND))
        return self._due_ns(k + 1)

    def _due_ns(self, k: int) -> int:
        return self._first_due_ns + round(k * self._period_s * SECOND)


class FrameIntake:
    """Takes camera frames from the plant, and passes them to the observers and the controller.

    Each frame goes to the observers once. It also goes to the controller once, unless it is the
    newest frame of a step.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self.unreported: list[Sample] = []  # not yet passed to the observers, oldest first
        self._unplanned: list[Observation] = []  # newer than the frame of the last step

    def collect(self) -> None:
        """Take the camera frames that have arrived since the last call."""
        samples = self._plant.samples()
        self.unreported += samples
        self._unplanned += [sample.observation for sample in samples]

    def pop_unreported(self) -> list[Sample]:
        """Return the frames that observers have not received, and mark them as reported."""
        samples = self.unreported
        self.unreported = []
        return samples

    def take_between(self, previous: Observation, current: Observation) -> list[Observation]:
        """Return the frames exposed between the frames of two control steps, oldest first.

        Frames up to `current` are forgotten afterwards. Newer frames are kept.

        Args:
            previous: The frame of the previous step.
            current: The frame of the present step.
        """
        self.collect()
        frames = self._unplanned
        self._unplanned = [frame for frame in frames if frame.sampled_ns > current.sampled_ns]
        return [
            frame for frame in frames if previous.sampled_ns < frame.sampled_ns < current.sampled_ns
        ]


@dataclass(slots=True)
class StepCounts:
    """Counters and measurements of a trial, which are updated at each control step.

    Attributes:
        solve_ns: Wall time of each plan [ns].
        drove: Whether robots drove while each plan was made.
        misses: Number of plans that took longer than a control period while robots drove.
        first_sent_ns: Time at which the first direction was sent [ns]. None before that.
        last_estimate: The controller's last estimate of the robots' motion. None if the controller
            makes no estimates.
    """

    solve_ns: list[int] = field(default_factory=list)
    drove: list[bool] = field(default_factory=list)
    misses: int = 0
    first_sent_ns: int | None = None
    last_estimate: Estimate | None = None


class RobotMotion(Enum):
    """The kind of motion that the last plan commands: drive, turn on the spot, or pause."""

    NOT_BEGUN = "not begun"
    DRIVE = "drive"
    TURN = "turn on the spot"
    STAND = "stand"

    @classmethod
    def from_plan(cls, plan: Plan) -> "RobotMotion":
        """Find out how the robots move if they follow a plan."""
        if not plan.pauses:
            return cls.DRIVE
        return cls.TURN if isinstance(plan.action, Turn) else cls.STAND


def describe_motion_change(previous: RobotMotion, current: RobotMotion) -> str:
    """Describe a change of the robots' motion: that they start to turn on the spot, or to pause.

    A pause directly after a turn is not described.

    Args:
        previous: How the robots moved before.
        current: How the robots move now.

    Returns:
        The message, or "" if there is nothing to report.
    """
    if current is RobotMotion.TURN and previous is not RobotMotion.TURN:
        return TURNING_TEXT
    if current is RobotMotion.STAND and previous in (RobotMotion.NOT_BEGUN, RobotMotion.DRIVE):
        return PAUSING_TEXT
    return ""


@dataclass(frozen=True, slots=True)
class LoopEnd:
    """How the control loop ended.

    Attributes:
        outcome: The outcome of the trial.
        reason: Why, as a sentence. Empty if the outcome says it all.
        error: The exception that ended the loop. None if there was none.
    """

    outcome: Outcome
    reason: str = ""
    error: BaseException | None = None


@dataclass(frozen=True, slots=True)
class Halt:
    """The record of how the robots were stopped at the end of a trial.

    Attributes:
        stop: The stop that was sent.
        verdict: Where the robots came to a standstill.
        samples: The last camera frames.
        events: The last commands and notes of the plant.
        error: The first error while the robots were stopped. None if there was none.
    """

    stop: Command
    verdict: Verdict
    samples: list[Sample]
    events: list[Command | Note]
    error: BaseException | None


def outcome_and_reason(
    loop: LoopEnd, halt: Halt, plugin_fault: PluginTrialError | None, dead_text: str
) -> tuple[Outcome, str]:
    """Determine the outcome and the reason of a trial, as the module's docstring lists.

    Args:
        loop: How the control loop ended.
        halt: How the robots were stopped.
        plugin_fault: The first error of a plug-in. None if there was none.
        dead_text: Which robots do not move. Empty if all do.
    """
    error = loop.error or halt.error
    if error is not None:
        message = plugin_fault.message if plugin_fault else message_of(error)
        unrest = halt.verdict.unrest
        return Outcome.ABORTED, f"{message}; {unrest}" if unrest else message
    if halt.verdict.not_at_rest:
        return Outcome.ABORTED, halt.verdict.not_at_rest
    return loop.outcome, loop.reason or dead_text


def message_of(error: BaseException) -> str:
    """Return the message of an error in one line.

    The name of its class comes first unless it is a TetractlError.
    """
    return error.message if isinstance(error, TetractlError) else describe_error(error)


class EstimateMonitor(Protocol):
    """Watches a controller's estimates of the robots' motion, and reports what has changed."""

    def notices(
        self, estimate: Estimate, setup: Setup, now_ns: int, frame: Observation
    ) -> Sequence[tuple[Literal["info", "warning"], str]]:
        """Return the messages that a new estimate gives rise to, each as its level and text.

        Args:
            estimate: The newest estimate of the robots' motion.
            setup: The constants of the experiment.
            now_ns: Time of the estimate [ns].
            frame: The newest camera frame.
        """
        ...


class Trial:
    """One trial of an experiment, which can be run once.

    Args:
        start: The start of the trial. The plant adds its description when it is opened.
        plant: The plant.
        controller: The controller.
        clock: The clock of the trial.
        observers: Objects that are notified of everything that happens.
        interrupt: Requests to end.
        model_monitor: Reports what is new in the controller's estimates. None to report nothing.
    """

    def __init__(
        self,
        start: Start,
        plant: Plant,
        controller: Controller,
        clock: Clock,
        observers: Sequence[Observer],
        interrupt: Interrupt,
        model_monitor: EstimateMonitor | None = None,
    ) -> None:
        setup = start.setup
        self._start = start
        self._plant = plant
        self._controller = controller
        self._clock = clock
        self._observers = observers
        self._interrupt = interrupt
        self._pacing = StepPacing(clock, setup.period_s)
        self._frame_intake = FrameIntake(plant)
        self._route_measure = RouteMeasure(setup.legs, setup.hold, setup.loss, setup.speed)
        self._model_monitor = model_monitor
        self._rest_monitor = RestMonitor(setup)
        self._counts = StepCounts()
        self._motion = RobotMotion.NOT_BEGUN
        self._dead_count = 0  # number of robots that do not move while others drive

    # ---- the trial ----

    def run(self) -> Result:
        """Run the trial under its controller, and return the result.

        After any end or error, the robots are stopped first. A TetractlError or an interruption
        becomes the outcome. So does any exception of a plug-in, even one that would end Python. Any
        other exception is raised again after the observers have received the result.
        """
        try:
            info = self._plant.open()
        except BaseException:
            abandon(self._plant)
            raise
        opened_ns = self._clock.now()
        try:
            start = replace(self._start, plant=info)
            for observer in self._observers:
                observer.on_start(start)
            loop = self._loop(virtual=info.virtual)
        except KeyboardInterrupt:  # by a second request
            loop = LoopEnd(Outcome.INTERRUPTED, INTERRUPTED_AT_ONCE)
        except BaseException as error:
            loop = LoopEnd(Outcome.ABORTED, error=error)
        return self._end(loop, opened_ns)

    def _loop(self, virtual: bool) -> LoopEnd:
        """Run the control loop of Algorithm 2. In `virtual` time, planning takes no time."""
        observation = self._plant.observe()
        if virtual:
            decision, solve_ns = self._plan(observation, None, ())
        else:
            decision, solve_ns = self._plan_meanwhile(observation)
        self._pacing.start()
        for k in itertools.count():
            if isinstance(decision, Outcome):
                return LoopEnd(decision)
            if isinstance(decision, End):
                self._sleep_until(self._clock.now() + decision.delay_ns)
                return LoopEnd(decision.outcome)
            command = self._carry_out(k, observation, decision, solve_ns)
            due_ns = self._pacing.finish(k, decision.pauses)
            if not self._interrupt.requested:
                self._sleep_until(due_ns)
            if self._interrupt.requested:
                return LoopEnd(Outcome.INTERRUPTED, INTERRUPTED_AFTER_STEP)
            previous = observation
            observation = self._plant.observe()
            earlier_frames = self._frame_intake.take_between(previous, observation)
            for text in self._rest_monitor.warnings(decision, [*earlier_frames, observation]):
                self._report(observation.sampled_ns, text, "warning")
            decision, solve_ns = self._plan(observation, command, earlier_frames)
        raise AssertionError("unreachable: the loop ends by returning")

    def _carry_out(self, k: int, observation: Observation, plan: Plan, solve_ns: int) -> Command:
        """Carry out step k: send the plan's command, notify the observers, and return the command.

        Nothing is reported before the command is sent, because observers take time. Then the
        observers are notified of the frames and messages before the step, and finally of
        contradictions between the step's estimate and the model.

        Args:
            k: Index of the step.
            observation: The frame for which the plan was made.
            plan: The controller's plan.
            solve_ns: Wall time that the plan needed [ns].
        """
        leg_text = self._route_measure.record_step(plan.leg, observation)
        if plan.pauses:
            self._sleep_until(self._clock.now() + plan.delay_ns)
            self._pacing.delay(plan.delay_ns)
        command = self._plant.send(plan.action)
        if self._counts.first_sent_ns is None and not command.stops:
            self._counts.first_sent_ns = command.sent_ns
        previous_motion = self._motion
        self._motion = RobotMotion.from_plan(plan)
        # the first plan, and one for robots that stand, may take as long as it needs
        missed = previous_motion is RobotMotion.DRIVE and solve_ns > self._pacing.period_ns
        self._report(command.sent_ns, describe_motion_change(previous_motion, self._motion))
        self._report(command.sent_ns, leg_text)
        self._counts.solve_ns.append(solve_ns)
        self._counts.drove.append(previous_motion is RobotMotion.DRIVE)
        self._counts.last_estimate = plan.estimate
        if missed:
            self._counts.misses += 1
        self._report_frames()
        self._report_dead(command.sent_ns)
        step = Step(k, observation, plan, command, solve_ns, missed)
        for observer in self._observers:
            observer.on_step(step)
        if plan.estimate is not None and self._model_monitor is not None:
            setup = self._start.setup
            notices = self._model_monitor.notices(
                plan.estimate, setup, command.sent_ns, observation
            )
            for level, text in notices:
                self._report(command.sent_ns, text, level)
        return command

    # ---- decisions ----

    def _plan(
        self,
        observation: Observation,
        last_command: Command | None,
        earlier_frames: Sequence[Observation],
    ) -> TimedDecision:
        """Let the controller decide in one control step.

        Args:
            observation: The newest frame.
            last_command: The command of the previous step. None at the first step.
            earlier_frames: Frames exposed between the previous observation and this one, the oldest
                first.
        """
        with self._interrupt.breakable():
            return self._timed_plan(observation, last_command, earlier_frames)

    def _plan_meanwhile(self, observation: Observation) -> TimedDecision:
        """Compute the first decision in its own thread, in real time.

        Meanwhile, the robots stand still, and frames are reported.
        """
        pool = ThreadPoolExecutor(1)
        try:
            planning = pool.submit(self._timed_plan, observation, None, ())
            while not planning.done():
                with self._interrupt.breakable():
                    wait([planning], timeout=self._start.setup.period_s)
                self._report_frames()
            return planning.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)

    def _timed_plan(
        self,
        observation: Observation,
        last_command: Command | None,
        earlier_frames: Sequence[Observation],
    ) -> TimedDecision:
        began_ns = time.perf_counter_ns()
        decision = self._controller.plan(observation, last_command, earlier_frames)
        return decision, time.perf_counter_ns() - began_ns

    # ---- plant and clock ----

    def _sleep_until(self, due_ns: int) -> None:
        with self._interrupt.breakable():
            self._clock.sleep_until(due_ns)

    # ---- notifying the observers ----

    def _report(self, t_ns: int, text: str, level: str = "info") -> None:
        """Report a text to the observers as a note at time `t_ns`, unless the text is empty."""
        if text:
            for observer in self._observers:
                observer.on_note(Note(t_ns, level, text))

    def _report_frames(self) -> None:
        """Report new frames to the observers, and the plant's own commands and notes."""
        self._frame_intake.collect()
        events = self._plant.events()
        samples = self._frame_intake.pop_unreported()
        self._route_measure.add_samples(samples)
        for observer in self._observers:
            observer.on_samples(samples)
            pass_events(observer, events)

    def _report_dead(self, t_ns: int) -> None:
        """Report which robots do not move while others drive, if their number has changed."""
        dead_count = int(self._route_measure.losses.dead.sum())
        if dead_count == self._dead_count:
            return
        self._dead_count = dead_count
        continuation = (
            "" if self._route_measure.dead_not_lost.any() else ": the trial goes on without them"
        )
        text = describe_dead(self._start.setup.names, self._route_measure.losses.dead)
        self._report(t_ns, text + continuation, "warning")

    # ---- the end ----

    def _end(self, loop: LoopEnd, opened_ns: int) -> Result:
        """Stop the robots, determine how the trial has ended, and notify the observers.

        An error that is a bug is raised again afterwards. If an observer fails, the result is
        `aborted`.
        """
        halt = self._halt()
        error = loop.error or halt.error
        plugin_fault = (
            create_plugin_error(error, self._start.packages) if error is not None else None
        )
        dead_text = describe_dead(self._start.setup.names, self._route_measure.dead_not_lost)
        outcome, reason = outcome_and_reason(loop, halt, plugin_fault, dead_text)
        result = self._create_result(outcome, reason, halt, opened_ns)
        plugin_calls = plugin_fault.calls if plugin_fault else ()
        failures = self._notify_of_the_end(halt, plugin_calls, result)
        bugs = [failure for failure in failures if not isinstance(failure, TetractlError)]
        if error is not None and plugin_fault is None and not isinstance(error, TetractlError):
            raise error
        if bugs:
            raise bugs[0]
        if failures and outcome is not Outcome.ABORTED:
            return replace(result, outcome=Outcome.ABORTED, reason=message_of(failures[0]))
        return result

    def _halt(self) -> Halt:
        """Stop the robots, wait until they stand still, take the last frames, and close the plant.

        If one of these fails, the others are still done and reported.
        """
        plant = self._plant
        n_robots = len(self._start.setup.names)
        stop = Command(Stop(), self._clock.now(), (False,) * n_robots)
        verdict = Verdict.unknown(n_robots)
        events: list[Command | Note] = []
        error: BaseException | None = None
        try:
            with closing(plant):
                stop = plant.stop()
                verdict = plant.settle()
                self._frame_intake.collect()
                self._route_measure.add_samples(self._frame_intake.unreported, stop.sent_ns)
                events = plant.events()
        except (Exception, SystemExit) as failure:
            error = failure
        return Halt(stop, verdict, self._frame_intake.pop_unreported(), events, error)

    def _create_result(self, outcome: Outcome, reason: str, halt: Halt, opened_ns: int) -> Result:
        """Create the result of the trial.

        A trial lasts from its first direction, or from its opening if none was sent.
        """
        began_ns = self._counts.first_sent_ns
        if began_ns is None:
            began_ns = opened_ns
        return Result.from_verdict(
            self._start.setup,
            halt.verdict,
            outcome=outcome,
            reason=reason,
            duration_s=seconds(halt.stop.sent_ns - began_ns),
            solve_ns=tuple(self._counts.solve_ns),
            deadline_misses=self._counts.misses,
            drove=tuple(self._counts.drove),
            route=self._route_measure,
            estimate=self._counts.last_estimate,
        )

    def _notify_of_the_end(
        self, halt: Halt, plugin_calls: Sequence[str], result: Result
    ) -> list[Exception]:
        """Notify every observer of the trial's end, and return the errors of the observers.

        Observers that failed before are also notified.

        Args:
            halt: How the robots were stopped.
            plugin_calls: The calls that led to a plug-in's error.
            result: The result of the trial.
        """
        traces = [Note(halt.stop.sent_ns, "debug", call) for call in plugin_calls]
        failures: list[Exception] = []
        for observer in self._observers:
            try:
                try:
                    observer.on_samples(halt.samples)
                    pass_events(observer, [*halt.events, *traces])
                finally:
                    observer.on_stop(halt.stop, result)
            except Exception as failure:
                failures.append(failure)
        return failures


def abandon(plant: Plant) -> None:
    """Stop the robots of a plant, and close it, whatever fails. The plant may not be open.

    This is for a trial that will have no result.
    """
    with closing(plant), suppress(Exception, SystemExit):  # not every plant stops before it is open
        plant.stop()


def pass_events(observer: Observer, events: Sequence[Command | Note]) -> None:
    """Pass the plant's own commands and notes to an observer, in their order."""
    for event in events:
        if isinstance(event, Command):
            observer.on_command(event)
        else:
            observer.on_note(event)
