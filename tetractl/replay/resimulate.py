"""Repeats the simulation of a trial, with the plant rebuilt from the spec and the seed.

The controller of the repeated trial returns the logged plans. Commands, frames, true poses,
operator messages, verdict and the plant's facts must equal the logged ones. On the machine that
wrote the log, with the same versions, they must have the same bits; elsewhere they must agree
within `ROUGHLY`, since a sine may differ in its last bit.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import Command
from tetractl.core.errors import AbortError, TetractlError
from tetractl.core.plan import End, Outcome, Plan
from tetractl.core.poses import Observation
from tetractl.core.protocols import LabSupervision, Plant
from tetractl.core.trial import Result, Step, TrialRecords
from tetractl.log.read import limits
from tetractl.log.read.trial_log import TrialLog
from tetractl.log.write.recorder import Recorder
from tetractl.replay.difference import Difference, Tolerance, trial_difference
from tetractl.run.interrupt import Interrupt
from tetractl.run.run_trial import Trial
from tetractl.run.task import trial_seeds

ROUGHLY = Tolerance(1e-6, 1e-6)
"""Tolerance for the results of another processor."""


def resimulate(log: TrialLog, same_host: bool) -> Difference | None:
    """Return the first difference between the repeated trial and its log, None if they agree.

    If `same_host`, values must have the same bits. A trial in the lab cannot be repeated, nor can
    the simulation of a damaged log.
    """
    plant = log.experiment.plant
    if log.start.plant.simulated != plant.simulated:
        mode = "sim" if log.start.plant.simulated else "lab"
        return Difference(None, "run.mode", f"states {mode!r}, but the spec has another plant")
    if not plant.simulated or log.damage or log.stop is None:
        return None
    if _samples(log) > limits.simulation_limit():
        text = "not simulated again: the trial has too many samples of robots and obstacles"
        return Difference(None, "plant", f"{text}; {limits.FACTOR}=2 allows twice as many")
    try:
        recorder = _repeat(log, log.stop)
    except (TetractlError, ValueError, OverflowError) as error:
        return Difference(None, "plant", f"cannot be simulated again: {error}")
    again, failure = recorder.trial, recorder.failure
    found = trial_difference(again, log)
    if found and not same_host:
        found = trial_difference(_without_last_bits(again, log), log, ROUGHLY)
    if failure and (found is None or found.field.startswith("count")):
        return Difference(None, "plant", f"cannot be simulated again: {failure}")
    return found


def _samples(log: TrialLog) -> float:
    """Return the number of robot positions that the simulation evaluates, times (1 + number of
    obstacles).
    """
    last = max(log.stop.sent_ns if log.stop else 0, *(one.sent_ns for one in log.commands), 0)
    rate = max(getattr(log.experiment.plant, "truth_rate", 0.0), log.start.plant.camera_rate_hz)
    setup = log.start.setup
    return last / SECOND * rate * len(setup.names) * (1 + len(setup.obstacles))


def _repeat(log: TrialLog, stop: Command) -> "_Recorder":
    """Run the trial again; TetractlError if that fails."""
    section, setup = log.experiment.plant, log.start.setup
    _, seed = trial_seeds(log.start.seed, log.start.trial)
    clock = section.clock()
    plant = section.build(setup, clock, seed, LabSupervision())
    ending = _Ending(plant, clock, stop.sent_ns, section.planning_max_s > 0)
    recorder = _Recorder(log, ending)
    Trial(
        start=log.start,
        plant=plant,
        controller=_LoggedPlans(log, ending),
        first_plan=log.experiment.controller.first_plan,
        clock=clock,
        observers=[recorder],
        interrupt=Interrupt(),
    ).run()
    return recorder


def _without_last_bits(ours: TrialRecords, log: TrialLog) -> TrialRecords:
    """Return a repeated trial in which values that may differ because of rounding are replaced by
    the log's: the plant's facts, which are text, and whether a robot at an obstacle's edge entered.
    """
    assert ours.result
    assert log.result
    found, logged = ours.result.verdict, log.result.verdict
    touches = [abs(clearance) <= ROUGHLY.absolute for clearance in found.clearance]
    entered = zip(touches, found.entered, logged.entered, strict=True)
    verdict = replace(
        found,
        entered=tuple(theirs if touch else own for touch, own, theirs in entered),
        edge=found.edge if logged.edge else (),  # older logs lack some columns
        apart=found.apart if logged.apart else (),
    )
    return replace(ours, start=log.start, result=replace(ours.result, verdict=verdict))


ENDED = "the log ends here"


@dataclass
class _Ending:
    """Computes when to stop a repeated trial so that the stop is sent at the logged time."""

    plant: Plant
    clock: Clock
    sent_ns: int
    plans: bool  # whether the plant simulates the time of planning

    @property
    def delay_ns(self) -> int:
        """Time from now until the logged stop was decided [ns]."""
        now = self.clock.now()
        if self.plans:  # the delay of the stop is random: a copy of the plant draws it
            now = copy.deepcopy(self.plant).stop().sent_ns
        return self.sent_ns - now


class _LoggedPlans:
    """The controller of a repeated trial: the logged plans, then the end at the logged time."""

    def __init__(self, log: TrialLog, ending: _Ending) -> None:
        self._steps, self._ending, self._k = log.steps, ending, 0
        self._period_ns = round(log.start.setup.period_s * SECOND)
        self._outcome = log.result.outcome if log.result else Outcome.ABORTED

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome | End:
        """Return the logged plan of the next step; AbortError if its logged observation differs."""
        if self._k == len(self._steps):
            return End(self._outcome, max(0, self._ending.delay_ns))
        step = self._steps[self._k]
        self._k += 1
        if step.observation.frame != observation.frame:
            text = f"step {step.k} has frame {step.observation.frame}, not {observation.frame}"
            raise AbortError(text)
        if not 0 <= step.plan.delay_ns <= self._period_ns:
            raise AbortError(f"step {step.k}: a delay of {step.plan.delay_ns} ns is out of range")
        return step.plan


class _Recorder(Recorder):
    """Records a repeated trial. If the log ends between two control steps, the repeated trial ends
    at the same point.
    """

    failure = ""  # reason why the trial did not run to its end

    def __init__(self, log: TrialLog, ending: _Ending) -> None:
        self._log, self._ending = log, ending
        self._left = len(log.commands) - 1  # commands still to come, without the stop

    def on_step(self, step: Step) -> None:
        """Keep a control step."""
        super().on_step(step)
        self._sent()

    def on_command(self, command: Command) -> None:
        """Keep a command sent outside the control steps."""
        super().on_command(command)
        self._sent()

    def _sent(self) -> None:
        self._left -= 1
        if self._left < 0:
            raise AbortError(f"{len(self._log.commands)} commands are logged, but more were sent")
        if self._left == 0 and self._ending.delay_ns == 0:
            raise AbortError(ENDED)

    def on_stop(self, stop: Command, result: Result) -> None:
        """Keep the stop, and the result with the log's outcome and reason, which plans do not
        determine.
        """
        logged = self._log.result
        assert logged
        if result.reason not in ("", ENDED, logged.reason, result.verdict.stood):
            self.failure = result.reason
        super().on_stop(stop, replace(result, outcome=logged.outcome, reason=logged.reason))
