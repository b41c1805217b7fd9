"""One trial: the control loop of Algorithm 2, from opening the plant to the result."""

import itertools
import time
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace

from tetractl.core.clock import SECOND, Clock, seconds
from tetractl.core.commands import (
    Action,
    Command,
    Note,
    Sample,
    Steer,
    Stop,
    Turn,
    Verdict,
)
from tetractl.core.errors import TetractlError, text_of
from tetractl.core.plan import PAUSE_S, End, Outcome, Plan
from tetractl.core.plugin_fault import plugin_fault
from tetractl.core.poses import Observation
from tetractl.core.protocols import Controller, Observer, Plant
from tetractl.core.tour import TourMeasure, told_dead
from tetractl.core.trial import Result, Start, Step
from tetractl.experiment.controller import FirstPlan, Square
from tetractl.run.interrupt import Interrupt
from tetractl.run.model_news import ModelNews, StatedDelay
from tetractl.run.trial_limits import directions

AT_ONCE = "stopped at once by a second interruption"

Decision = Plan | Outcome | End

Timed = tuple[Decision, int]
"""A controller's decision, and the wall time that it needed [ns]."""


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked for the decision of one control step: the newest frame, the command before it,
    None at the first step, and the frames exposed between the two, oldest first."""

    observation: Observation
    last: Command | None
    earlier: Sequence[Observation]


Course = Generator[Question, Timed | BaseException, Result]
"""A trial that asks for each decision, is sent it, or what was raised instead, and returns the
result."""


class _Dropped(BaseException):
    """The course is closed: the result is not wanted."""


@dataclass(slots=True)
class Trial:
    """One trial; either `run` or `course` may be called, once.

    The plant's description is added to `start` when the plant is opened.
    """

    start: Start
    plant: Plant
    controller: Controller
    first_plan: FirstPlan
    clock: Clock
    observers: Sequence[Observer]
    interrupt: Interrupt
    delay: StatedDelay | None = None
    _solve_ns: list[int] = field(default_factory=list)
    _misses: int = 0
    _virtual: bool = False  # whether time passes only where the plant's clock is slept on
    _turning: bool = False  # whether robots turn on the spot
    _began_ns: int | None = None  # time at which the first direction was sent
    _samples: list[Sample] = field(default_factory=list)  # frames not yet passed to the observers
    _tour: TourMeasure = field(init=False)
    _dead: int = 0  # number of robots that do not move while others drive
    # frames newer than the frame of the last step
    _between: list[Observation] = field(default_factory=list)
    _model: ModelNews = field(init=False)

    def __post_init__(self) -> None:
        setup = self.start.setup
        self._model = ModelNews(self.delay)
        self._tour = TourMeasure(setup.legs, setup.hold, setup.loss, setup.speed)

    def run(self) -> Result:
        """Run the trial by the decisions of its controller, and return its result.

        After any end or error, the robots are stopped first. A TetractlError or an interruption
        becomes the outcome, and so does any exception of a plug-in, even one that would end Python;
        another exception is raised again after the observers were called with the result.
        """
        course = self.course()
        try:
            question = next(course)
            while True:
                question = course.send(self._answer(question))
        except StopIteration as end:
            result: Result = end.value
            return result

    def course(self) -> Course:
        """Run the trial, and ask for each decision.

        An exception that is sent ends the trial, like one of the controller. `close` stops the
        robots, and no observer is called any more.
        """
        bug: BaseException | None = None
        try:
            info = self.plant.open()
        except BaseException:
            with suppress(Exception, SystemExit):  # not every plant stops before it is open
                self.plant.stop()
            self.plant.close()
            raise
        opened_ns = self.clock.now()
        try:
            start = replace(self.start, plant=info)
            for observer in self.observers:
                observer.on_start(start)
            self._virtual = info.virtual
            outcome, reason = yield from self._steps()
        except _Dropped:
            self.plant.stop()
            self.plant.close()
            raise GeneratorExit from None
        except KeyboardInterrupt:
            reason = AT_ONCE if self.interrupt.count > 1 else "interrupted before the first step"
            outcome = Outcome.INTERRUPTED
        except BaseException as error:
            outcome = Outcome.ABORTED
            reason = error.message if isinstance(error, TetractlError) else text_of(error)
            bug = error
        return self._end(outcome, reason, bug, opened_ns)

    def _answer(self, question: Question) -> Timed | BaseException:
        """Return the controller's decision, or what it raised."""
        try:
            if question.last is None and not self._virtual:
                return self._first(question.observation)
            return self._plan(question.observation, question.last, question.earlier)
        except BaseException as error:  # the trial ends by it, robots first
            return error

    def _ask(self, question: Question) -> Generator[Question, Timed | BaseException, Timed]:
        """Return the answer to a question; raise what was raised instead."""
        try:
            answer = yield question
        except GeneratorExit:
            raise _Dropped from None
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def _steps(self) -> Generator[Question, Timed | BaseException, tuple[Outcome, str]]:
        """Run the control loop of Algorithm 2; return the outcome and its reason."""
        period_s = self.start.setup.period_s
        period = round(period_s * SECOND)
        observation = self.plant.observe()
        decision, solve_ns = yield from self._ask(Question(observation, None, ()))
        if self._virtual and isinstance(self.first_plan, Square):  # planning took no time
            self._drive_square(self.first_plan, observation)
        began, standing = self.clock.now(), True
        for k in itertools.count():
            if isinstance(decision, Outcome):
                return decision, ""
            if isinstance(decision, End):
                self._sleep_until(self.clock.now() + decision.delay_ns)
                return decision.outcome, ""
            begins = self._tour.step(decision.leg, observation)
            if decision.pauses:
                self._sleep_until(self.clock.now() + decision.delay_ns)
                began += decision.delay_ns
            command = self._send(decision.action)
            if decision.pauses:
                self._tell_pause(command, again=standing and k > 0)
            else:
                self._turning = False
            if begins:
                self._say(command, begins)
            self._solve_ns.append(solve_ns)
            missed = not standing and solve_ns > period
            standing = decision.pauses
            self._misses += missed
            self._pass_samples()
            self._tell_dead(command)
            step = Step(k, observation, decision, command, solve_ns, missed)
            for observer in self.observers:
                observer.on_step(step)
            if known := decision.estimate:
                for level, text in self._model.of(known, self.start.setup, command.sent_ns):
                    self._say(command, text, level)
            if self.interrupt.requested:
                return Outcome.INTERRUPTED, "interrupted; the step was finished"
            late = self.clock.now() - (began + round(k * period_s * SECOND))
            if late >= period:  # after an overrun, the following steps have the full period again
                began += late
            began += round(PAUSE_S * SECOND) if standing else 0
            self._sleep_until(began + round((k + 1) * period_s * SECOND))
            last, observation = observation, self.plant.observe()
            between = self._frames_between(last, observation)
            question = Question(observation, command, between)
            decision, solve_ns = yield from self._ask(question)
        raise AssertionError("unreachable: the loop ends by returning")

    def _frames_between(self, last: Observation, now: Observation) -> list[Observation]:
        """Return the frames exposed between two control steps, oldest first."""
        self._take_samples()
        frames = self._between
        self._between = [one for one in frames if one.sampled_ns > now.sampled_ns]
        return [one for one in frames if last.sampled_ns < one.sampled_ns < now.sampled_ns]

    def _plan(
        self, observation: Observation, last: Command | None, earlier: Sequence[Observation]
    ) -> Timed:
        with self.interrupt.breakable():
            return self._timed_plan(observation, last, earlier)

    def _timed_plan(
        self, observation: Observation, last: Command | None, earlier: Sequence[Observation]
    ) -> Timed:
        before = time.perf_counter_ns()
        decision = self.controller.plan(observation, last, earlier)
        return decision, time.perf_counter_ns() - before

    def _first(self, observation: Observation) -> Timed:
        """Compute the first plan in real time while the robots stand, and record frames, or while
        they drive squares (section IV-B.1 of the paper).
        """
        square = self.first_plan if isinstance(self.first_plan, Square) else None
        with self._planning(observation) as planning:
            driven = False
            while not planning.done() or (square and not driven):
                if square:
                    self._drive_square(square, observation)
                    driven = True
                else:
                    with self.interrupt.breakable():
                        wait([planning], timeout=self.start.setup.period_s)
                    self._pass_samples()
            return planning.result()

    def _drive_square(self, square: Square, observation: Observation) -> None:
        """Drive one square from the poses of `observation`."""
        for direction in directions(observation.poses.heading):
            self._drive_side(direction, self.clock.now() + round(square.side * SECOND))

    @contextmanager
    def _planning(self, observation: Observation) -> Iterator[Future[Timed]]:
        """Compute the first plan in a thread of its own."""
        pool = ThreadPoolExecutor(1)
        try:
            yield pool.submit(self._timed_plan, observation, None, ())
        finally:
            pool.shutdown(wait=False, cancel_futures=True)

    def _drive_side(self, direction: float, end: int) -> None:
        """Send a direction [rad] once per control period until `end` [ns]."""
        period = round(self.start.setup.period_s * SECOND)
        while (now := self.clock.now()) < end:
            command = self._send(Steer(direction))
            for observer in self.observers:
                observer.on_command(command)
            self._sleep_until(min(now + period, end))
            self._pass_samples()
            if self.interrupt.requested:
                raise KeyboardInterrupt

    def _tell_pause(self, command: Command, again: bool) -> None:
        """Say that robots turn on the spot, or pause, unless they do so already (`again`)."""
        turns = isinstance(command.action, Turn)
        if turns and not self._turning:
            self._say(command, "all robots turn on the spot: they have no safe way ahead")
        elif not turns and not again:
            self._say(
                command, "all robots pause: the next plan starts from rest, or the trial ends"
            )
        self._turning = turns

    def _say(self, command: Command, text: str, level: str = "info") -> None:
        for observer in self.observers:
            observer.on_note(Note(command.sent_ns, level, text))

    def _tell_dead(self, command: Command) -> None:
        """Say which robots do not move while others drive, and whether they are lost."""
        before = self._dead
        self._dead = int(self._tour.dead.sum())
        if self._dead == before:
            return
        text = told_dead(self.start.setup.names, self._tour.dead)
        goes_on = "" if self._tour.stood.any() else ": the trial goes on without"
        self._say(command, text + goes_on, "warning")

    def _send(self, action: Action) -> Command:
        command = self.plant.send(action)
        if self._began_ns is None and not command.stops:
            self._began_ns = command.sent_ns
        return command

    def _sleep_until(self, when: int) -> None:
        with self.interrupt.breakable():
            self.clock.sleep_until(when)

    def _take_samples(self) -> None:
        samples = self.plant.samples()
        self._samples += samples
        self._between += [sample.observation for sample in samples]

    def _pass_samples(self) -> None:
        self._take_samples()
        samples, self._samples = self._samples, []
        self._tour.add(samples)
        news = self.plant.news()
        for observer in self.observers:
            observer.on_samples(samples)
            _pass_news(observer, news)

    def _end(
        self, outcome: Outcome, reason: str, bug: BaseException | None, opened_ns: int
    ) -> Result:
        """Stop the robots, wait until they rest, and call every observer, even one that failed
        before. If an observer raises an exception, the others are still called; bugs are raised at
        the end.
        """
        setup, news, samples = self.start.setup, list[Command | Note](), self._samples
        stop = Command(Stop(), self.clock.now(), (False,) * len(setup.names))
        verdict = Verdict.unknown(len(setup.names))
        try:
            try:
                stop = self.plant.stop()
                verdict = self.plant.settle()
                samples = samples + self.plant.samples()
                self._tour.add(samples, stop.sent_ns)
                news = self.plant.news()
            finally:
                self.plant.close()
        except (Exception, SystemExit) as error:  # the log ends as one that says so
            bug = error if bug is None else bug
            if outcome is not Outcome.ABORTED:
                outcome = Outcome.ABORTED
                reason = error.message if isinstance(error, TetractlError) else text_of(error)
        if bug is not None and (fault := plugin_fault(bug, self.start.packages)):
            reason, bug = fault.message, None
            news = [*news, *(Note(stop.sent_ns, "debug", call) for call in fault.calls)]
        if verdict.not_at_rest and outcome is not Outcome.ABORTED:
            outcome, reason = Outcome.ABORTED, verdict.not_at_rest
        result = Result.of(
            self.start.setup,
            verdict,
            outcome=outcome,
            reason=reason or told_dead(self.start.setup.names, self._tour.stood),
            duration_s=seconds(
                stop.sent_ns - (opened_ns if self._began_ns is None else self._began_ns)
            ),
            solve_ns=tuple(self._solve_ns),
            deadline_misses=self._misses,
            tour=self._tour,
        )
        failures: list[TetractlError] = []
        bugs = [] if isinstance(bug, TetractlError | None) else [bug]
        for observer in self.observers:
            try:
                try:
                    observer.on_samples(samples)
                    _pass_news(observer, news)
                finally:
                    observer.on_stop(stop, result)
            except TetractlError as error:
                failures.append(error)
            except Exception as error:
                bugs.append(error)
        if bugs:
            raise bugs[0]
        if failures and outcome is not Outcome.ABORTED:
            result = replace(result, outcome=Outcome.ABORTED, reason=failures[0].message)
        return result


def _pass_news(observer: Observer, news: Sequence[Command | Note]) -> None:
    for item in news:
        if isinstance(item, Command):
            observer.on_command(item)
        else:
            observer.on_note(item)
