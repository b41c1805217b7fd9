"""The simulation of a trial once more, by the plant rebuilt from the spec and the seed.

The controller of the repeated trial gives the logged plans. Commands, frames, true poses, verdict
and the plant's facts must come out as logged.

On the machine and versions that wrote the log they must come out with the same bits; elsewhere to
`ROOM`, since a sine may differ in its last bit.
"""

import copy
from collections.abc import Iterator, Sequence

import numpy as np

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import Command, Note, Sample, Verdict
from tetractl.core.errors import AbortError, TetractlError
from tetractl.core.operators import Operators
from tetractl.core.plan import End, Outcome, Plan
from tetractl.core.poses import Floats, Observation
from tetractl.core.protocols import Plant
from tetractl.core.trial import Result, Start, Step
from tetractl.log.read import bounds
from tetractl.log.read.trial_log import TrialLog
from tetractl.replay.recompute import Difference
from tetractl.run.interrupt import Interrupt
from tetractl.run.seeds import trial_seeds
from tetractl.run.trial import Trial

ROOM = 1e-6
"""Relative to a coordinate, or absolute below 1; of what another processor computes."""
COORDINATES = ("x", "y", "heading")


def resimulate(log: TrialLog, exact: bool) -> Difference | None:
    """Return the first thing that the plant does not do as logged, None for none.

    With `exact` bits are compared. A trial in the lab cannot be repeated, nor can the simulation of
    a log that lost a command.
    """
    plant = log.experiment.plant
    if log.start.plant.simulated != plant.simulated:
        mode = "sim" if log.start.plant.simulated else "lab"
        return Difference(None, "run.mode", f"states {mode!r}, but the spec's plant is another")
    if not plant.simulated or log.damage or log.stop is None:
        return None
    if _samples(log) > bounds.simulation_limit():
        text = "not simulated again: it has too many samples of robots and obstacles"
        return Difference(None, "plant", f"{text}; {bounds.FACTOR}=2 allows twice as many")
    try:
        return _repeat(log, log.stop, exact)
    except (TetractlError, ValueError, OverflowError) as error:
        return Difference(None, "plant", f"cannot be simulated again: {error}")


def _samples(log: TrialLog) -> float:
    """Return how many positions of robots the simulation judges, times obstacles."""
    last = max(log.stop.sent_ns if log.stop else 0, *(one.sent_ns for one in log.commands), 0)
    rate = max(getattr(log.experiment.plant, "truth_rate", 0.0), log.start.plant.camera_rate_hz)
    setup = log.start.setup
    return last / SECOND * rate * len(setup.names) * (1 + len(setup.obstacles))


def _repeat(log: TrialLog, stop: Command, exact: bool) -> Difference | None:
    """Run the trial again, up to the first difference."""
    section, setup = log.experiment.plant, log.start.setup
    _, seed = trial_seeds(log.start.seed, log.start.trial)
    clock = section.clock()
    plant = section.build(setup, clock, seed, Operators())
    ending = _Ending(plant, clock, stop.sent_ns, section.planning_max_s > 0)
    comparison = _Comparison(log, stop, ending, exact)
    result = Trial(
        start=log.start,
        plant=plant,
        controller=_LoggedPlans(log, ending),
        first_plan=log.experiment.controller.first_plan,
        clock=clock,
        observers=[comparison],
        interrupt=Interrupt(),
    ).run()
    if comparison.difference is None and result.reason not in ("", ENDED):
        return Difference(None, "plant", f"cannot be simulated again: {result.reason}")
    return comparison.difference


ENDED = "the log ends here"


class _Ending:
    """When to stop a trial again so that the stop is sent at the logged time."""

    def __init__(self, plant: Plant, clock: Clock, sent_ns: int, plans: bool) -> None:
        self._plant, self._clock, self._sent_ns, self._plans = plant, clock, sent_ns, plans

    @property
    def delay_ns(self) -> int:
        """How much later than now the stop was decided [ns]."""
        now = self._clock.now()
        if self._plans:  # the time until a stop is sent is drawn by the stop; a copy of it tells
            now = copy.deepcopy(self._plant).stop().sent_ns
        return self._sent_ns - now


class _LoggedPlans:
    """The controller of a repeated trial: the logged plans, then the end at the logged time."""

    def __init__(self, log: TrialLog, ending: _Ending) -> None:
        self._steps, self._ending, self._k = log.steps, ending, 0
        self._outcome = log.result.outcome if log.result else Outcome.ABORTED

    def plan(self, observation: Observation) -> Plan | Outcome | End:
        """Return the next logged plan; AbortError where the observation is not the logged one."""
        if self._k == len(self._steps):
            return End(self._outcome, max(0, self._ending.delay_ns))
        step = self._steps[self._k]
        self._k += 1
        if step.observation.frame != observation.frame:
            text = f"step {step.k} has frame {step.observation.frame}, not {observation.frame}"
            raise AbortError(text)
        return step.plan

    def sent(self, command: Command) -> None:
        """Take note of a command: nothing depends on it."""


class _Comparison:
    """Compares a trial that is simulated with its log; AbortError ends it at a difference."""

    def __init__(self, log: TrialLog, stop: Command, ending: _Ending, exact: bool) -> None:
        self.difference: Difference | None = None
        self._log, self._stop, self._ending, self._exact = log, stop, ending, exact
        ours = (one for one in log.commands if one is not stop)
        self._logged = sorted(ours, key=lambda one: one.sent_ns)
        self._commands = self._frames = 0

    def on_start(self, start: Start) -> None:
        """Compare the facts of the plant."""
        ours, theirs = start.plant, self._log.start.plant
        if self._exact and (ours.camera_rate_hz, ours.facts) != (
            theirs.camera_rate_hz,
            theirs.facts,
        ):
            text = "the facts of the plant are not those of this seed"
            self._end_with(Difference(None, "run.plant", text))

    def on_step(self, step: Step) -> None:
        """Compare the command of a control step."""
        self.on_command(step.command)

    def on_command(self, command: Command) -> None:
        """Compare a command; end the trial where the log was ended between two control steps."""
        number = self._commands
        self._commands += 1
        if number >= len(self._logged):
            text = f"{len(self._logged)} logged, more are sent"
            self._end_with(Difference(None, "commands", text))
        else:
            name = f"commands.{number}"
            self._judge(_command(name, command, self._logged[number], self._exact))
        if self._commands == len(self._logged) and self._ending.delay_ns == 0:
            raise AbortError(ENDED)

    def on_note(self, note: Note) -> None:
        """Notes are words about what is compared."""

    def on_samples(self, samples: Sequence[Sample]) -> None:
        """Compare camera frames and the true poses in them."""
        if self.difference is None:
            first, self._frames = self._frames, self._frames + len(samples)
            self._judge(_frames(self._log, samples, first, self._exact))

    def on_stop(self, stop: Command, result: Result) -> None:
        """Compare the stop, how many frames and commands there were, and the verdict."""
        if self.difference is None:
            self._judge(self._end(stop, result.verdict))

    def _end(self, stop: Command, verdict: Verdict) -> Iterator[Difference]:
        for name, ours, logged in (
            ("commands", self._commands, len(self._logged)),
            ("frames", self._frames, len(self._log.frames)),
        ):
            if ours != logged:
                yield Difference(None, name, f"{logged} logged, {ours} simulated")
        yield from _command("stop", stop, self._stop, self._exact)
        if self._log.result is not None:
            yield from _verdict(self._log.result.verdict, verdict, self._exact)

    def _judge(self, found: Iterator[Difference]) -> None:
        """End the trial with the first difference found, if any."""
        if (difference := next(found, None)) is not None:
            self._end_with(difference)

    def _end_with(self, difference: Difference) -> None:
        """Keep the trial's first difference, and end the trial."""
        self.difference = self.difference or difference
        raise AbortError(self.difference.message)


def _command(name: str, ours: Command, logged: Command, exact: bool) -> Iterator[Difference]:
    if ours.delivered != logged.delivered or ours.sent_ns != logged.sent_ns:
        yield Difference(None, name, "reaches other robots or at another time")
    if ours.direction != logged.direction:
        text = f"logged {logged.direction!r}, simulated {ours.direction!r}"
        yield Difference(None, f"{name}.direction", text)
    for side in ("left", "right"):
        one, two = getattr(ours, side), getattr(logged, side)
        if (one is None) != (two is None) or not (one is None or _same(one, two, exact)):
            yield Difference(None, f"{name}.{side}", "is not the wheels' speed")


def _frames(
    log: TrialLog, samples: Sequence[Sample], first: int, exact: bool
) -> Iterator[Difference]:
    for row, sample in enumerate(samples, start=first):
        seen = sample.observation
        if row >= len(log.frames):
            return
        number = int(log.frames[row])
        ours = (seen.frame, seen.sampled_ns, seen.received_ns)
        logged = (number, int(log.mocap_ns[row]), int(log.received_ns[row]))
        if ours != logged:
            yield Difference(None, f"mocap.{number}", f"logged {logged}, simulated {ours}")
        if seen.valid.tolist() != log.valid[row].tolist():
            yield Difference(None, f"mocap.{number}.valid", "other robots are tracked")
        yield from _poses(f"mocap.{number}", seen.poses.array(), log.mocap[row], exact)
        if log.truth is not None and sample.truth is not None:
            yield from _poses(f"truth.{number}", sample.truth.array(), log.truth[row], exact)


def _poses(name: str, ours: Floats, logged: Floats, exact: bool) -> Iterator[Difference]:
    """Compare poses (N, 3)."""
    wrong = ~_alike(ours, logged, exact)
    if wrong.any():
        robot, axis = np.argwhere(wrong)[0]
        text = f"logged {float(logged[robot, axis])!r}, simulated {float(ours[robot, axis])!r}"
        yield Difference(None, f"{name}.{COORDINATES[axis]}.{robot}", text)


def _verdict(logged: Verdict, ours: Verdict, exact: bool) -> Iterator[Difference]:
    yield from _poses("result.final", ours.final.array(), logged.final.array(), exact)
    for name in ("clearance", "edge", "apart"):
        found, stated = getattr(ours, name), getattr(logged, name)
        if exact and len(found) != len(stated):
            yield Difference(None, f"result.{name}", f"{len(stated)} numbers, not {len(found)}")
        for robot, (one, two) in enumerate(zip(found, stated, strict=False)):
            if not _same(np.array([one]), np.array([two]), exact):
                text = f"states {two}, the simulation gives {one}"
                yield Difference(None, f"result.{name}.{robot}", text)
    for robot, (one, two) in enumerate(zip(ours.entered, logged.entered, strict=True)):
        close = not exact and abs(ours.clearance[robot]) <= ROOM
        if one != two and not close:
            text = f"states {two}, the simulation gives {one}"
            yield Difference(None, f"result.entered.{robot}", text)


def _same(ours: Floats, logged: Floats, exact: bool) -> bool:
    return ours.shape == logged.shape and bool(_alike(ours, logged, exact).all())


def _alike(ours: Floats, logged: Floats, exact: bool) -> np.ndarray:
    if exact:
        return (ours == logged) | (np.isnan(ours) & np.isnan(logged))
    with np.errstate(invalid="ignore"):  # inf without obstacles
        near = np.abs(ours - logged) <= ROOM * np.maximum(1.0, np.abs(logged))
    return near | (ours == logged)
