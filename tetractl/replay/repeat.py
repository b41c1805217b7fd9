"""Repeats the trial of a log, with the plans in the log, for a sink of records.

A simulation is run again, with the plant rebuilt from the spec and the seed. Of a trial in the lab,
the logged frames, commands and notes are given to the encoder again, from which everything else
follows. The sink receives the same records in both cases as the log writer received.
"""

import copy
from collections.abc import Sequence
from dataclasses import replace

from foxglove_schemas_protobuf.Log_pb2 import Log

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import Command, Note
from tetractl.core.errors import AbortError
from tetractl.core.plan import End, Outcome, Plan
from tetractl.core.poses import Observation
from tetractl.core.protocols import LabSupervision, Plant
from tetractl.core.trial import Result, Start, Step
from tetractl.experiment.load import resolved_yaml
from tetractl.experiment.registry_fields import packages
from tetractl.log.format import channels
from tetractl.log.format.scene import decode_note
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.trial_log import TrialLog
from tetractl.log.write.encoder import Encoder
from tetractl.replay.comparison import Comparison, first_difference
from tetractl.run.interrupt import Interrupt
from tetractl.run.run_trial import Trial
from tetractl.run.task import trial_seeds

ENDED = "the log ends here"
BATCH = 100  # number of frames that are encoded together, which is faster
CALLS = ("debug", "error")
"""Levels of the notes of an exception's calls: those of format 4, or earlier, are errors."""


class Repetition(Encoder):
    """An encoder of a repeated trial, which takes from the log the solve times and, since plans do
    not determine them, the outcome and its reason. If the log ends between two control steps, the
    repeated trial ends at the same point. `failure` is why it did not run to its end.
    """

    failure = ""

    def __init__(self, log: TrialLog, result: Result, sink: Comparison) -> None:
        super().__init__(sink, real_time=not log.start.plant.simulated)
        self._log, self.result = log, result  # as logged
        self._failed = log.start.plant.simulated and result.outcome is Outcome.ABORTED
        self._left = len(log.commands) - 1  # commands still to come, without the stop
        self._period_ns = round(log.experiment.controller.period * SECOND)
        self._standing, self._misses = True, 0
        self.ending: _LoggedPlans | None = None

    def on_step(self, step: Step) -> None:
        """Add a control step."""
        k = step.k
        solve_ns = self._log.steps[k].solve_ns if k < len(self._log.steps) else 0
        missed = not self._standing and solve_ns > self._period_ns
        self._standing = step.plan.pauses
        self._misses += missed
        super().on_step(replace(step, solve_ns=solve_ns, deadline_missed=missed))
        self._sent()

    def on_command(self, command: Command) -> None:
        """Add a command sent outside the control steps."""
        super().on_command(command)
        self._sent()

    def _sent(self) -> None:
        self._left -= 1
        if self._left < 0:
            raise AbortError(f"{len(self._log.commands)} commands are logged, but more were sent")
        if self._left == 0 and self.ending and self.ending.delay_ns == 0:
            raise AbortError(ENDED)

    def on_note(self, note: Note) -> None:
        """Add a message, but for the calls that led to an exception: those logged are added."""
        if not (self._failed and note.level in CALLS):
            super().on_note(note)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Add the stop and the result."""
        logged = self.result
        aborted = result.outcome is Outcome.ABORTED  # other reasons only say who stood
        if aborted and result.reason not in ("", ENDED, logged.reason):
            self.failure = result.reason
        if self._failed:
            for note in self._log.notes[:-1]:  # the calls that led to a plug-in's exception
                if note.level in CALLS:
                    super().on_note(note)
        super().on_stop(stop, replace(result, outcome=logged.outcome, reason=logged.reason))

    @property
    def timing(self) -> tuple[tuple[int, ...], int]:
        """The solve times of all control steps, and the number of deadlines missed."""
        return tuple(step.solve_ns for step in self._log.steps), self._misses


class _LoggedPlans:
    """The controller of a repeated trial: the logged plans, then an end such that the stop is sent
    at the logged time.
    """

    def __init__(
        self, log: TrialLog, outcome: Outcome, stop: Command, plant: Plant, clock: Clock
    ) -> None:
        self._steps, self._outcome, self._k = log.steps, outcome, 0
        self._plant, self._clock, self._sent_ns = plant, clock, stop.sent_ns
        self._period_ns = round(log.start.setup.period_s * SECOND)
        self._planned = log.experiment.plant.planning_max_s > 0  # planning takes simulated time

    @property
    def delay_ns(self) -> int:
        """Time from now until the logged stop was decided [ns]."""
        now = self._clock.now()
        if self._planned:  # the delay of the stop is random: a copy of the plant draws it
            now = copy.deepcopy(self._plant).stop().sent_ns
        return self._sent_ns - now

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | End:
        """Return the logged plan of the next step; AbortError for an impossible delay."""
        if self._k == len(self._steps):
            return End(self._outcome, max(0, self.delay_ns))
        step = self._steps[self._k]
        self._k += 1
        if not 0 <= step.plan.delay_ns <= self._period_ns:
            raise AbortError(f"step {step.k}: a delay of {step.plan.delay_ns} ns is out of range")
        return step.plan


def _start(log: TrialLog) -> Start:
    """Return the start that follows from the spec in a log."""
    experiment = log.experiment
    text, used = resolved_yaml(experiment), packages(experiment)
    return replace(log.start, seed=experiment.trials.seed, resolved=text, packages=used)


def simulate(log: TrialLog, stop: Command, encoder: Repetition) -> None:
    """Run a simulation again; TetractlError, ValueError or OverflowError if that fails."""
    section, setup = log.experiment.plant, log.start.setup
    _, seed = trial_seeds(log.start.seed, log.start.trial)
    clock = section.clock()
    plant = section.build(setup, clock, seed, LabSupervision())
    encoder.ending = plans = _LoggedPlans(log, encoder.result.outcome, stop, plant, clock)
    Trial(
        start=_start(log),
        plant=plant,
        controller=plans,
        first_plan=log.experiment.controller.first_plan,
        clock=clock,
        observers=[encoder],
        interrupt=Interrupt(),
    ).run()


def give_again(
    log: TrialLog, raw: RawLog, stop: Command, encoder: Repetition, sink: Comparison
) -> None:
    """Give the frames, commands and notes of a trial in the lab to the encoder again.

    A control step has the frame that it names, from the camera frames, and the command sent at its
    time, with the action of its plan.
    """
    encoder.on_start(_start(log))
    rows = range(len(log.frames))
    for begin in rows[::BATCH]:
        encoder.on_samples([log.sample(i) for i in rows[begin : begin + BATCH]])
    # numbers occur again only behind the last step, if a frame counter that goes back ends a trial
    numbered = [*enumerate(log.frames.tolist())]
    first, steps = {number: i for i, number in reversed(numbered)}, iter(log.steps)
    step = next(steps, None)
    for command in log.commands:
        if step and not first_difference(command, step.command):
            i = first.get(step.observation.frame)
            seen = step.observation if i is None else log.sample(i).observation
            sent = replace(command, action=step.plan.action)
            encoder.on_step(replace(step, observation=seen, command=sent))
            step = next(steps, None)
        elif command is not stop:
            encoder.on_command(command)
    start_ns = log.start.start_unix_ns
    said = raw.by_topic[channels.LOG]
    for entry in said:  # the last is on the end, and follows from the result
        if entry not in sink.notes and entry != said[-1]:
            encoder.on_note(decode_note(Log.FromString(entry.data), start_ns))
    logged = encoder.result
    encoder.on_stop(
        stop,
        Result.of(
            log.start.setup,
            logged.verdict,
            outcome=logged.outcome,
            reason=logged.reason,
            duration_s=logged.duration_s,
            solve_ns=logged.solve_ns,
            deadline_misses=logged.deadline_misses,
            tour=log.tour,
        ),
    )
