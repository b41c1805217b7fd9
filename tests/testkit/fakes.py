"""A fake plant, controller and observer that record all calls in one list."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from testkit.recorder import Recorder
from testkit.trials import experiment
from tetractl.core.clock import SECOND, VirtualClock
from tetractl.core.commands import Command, Steer, Stop, Turn
from tetractl.core.plan import Outcome, Plan, Search
from tetractl.core.poses import Observation, Poses, Sample
from tetractl.core.trial import SIMULATED_START_NS, PlantInfo, Verdict
from tetractl.run.control_loop import Trial
from tetractl.run.interrupt import Interrupt
from tetractl.spec.loaded_spec import LoadedSpec, create_start

STARTS = np.array([[900.0, 800, 0], [900, 1200, 0], [900, 1600, 0]])
FINAL = np.array([[1700.0, 510, 0], [1703, 1504, 0], [1700, 2000, 0]])  # misses by 10, 5, 0 mm


@dataclass
class Happenings:
    """What was called, in order of the `names`, and what is `planned` for the n-th call of a name.

    The names are the methods of the plant and `plan`; those of an observer have its name before
    them, as `log.step`.
    """

    names: list[str] = field(default_factory=list)
    planned: dict[tuple[str, int], Callable[[], object]] = field(default_factory=dict)

    def note(self, name: str) -> None:
        self.names.append(name)
        action = self.planned.pop((name, self.names.count(name)), None)
        if action is not None:
            action()


class FakePlant:
    """Stands for a plant with a camera frame every 100 ms, whose robots jump to FINAL when they are
    stopped, and take a second to come to rest. `steered` are the directions sent, with their times.
    """

    def __init__(self, happenings, clock, simulated=True):
        self.happenings = happenings
        self.clock = clock
        self.simulated = simulated
        self.verdict = Verdict(Poses.from_array(FINAL), (False,) * 3, (40.0, 12.0, 300.0))
        self.frames = 0
        self.steered: list[tuple[int, float]] = []

    def open(self):
        self.happenings.note("open")
        return PlantInfo("fake", self.simulated, 10.0, {"bench": "left"})

    def observe(self):
        self.happenings.note("observe")
        return self._frame(self.clock.now() * 10 // SECOND)

    def send(self, action):
        self.happenings.note("send")
        if isinstance(action, Steer):
            self.steered.append((self.clock.now(), action.direction))
        return Command(action, self.clock.now(), (True,) * 3)

    def samples(self):
        first = self.frames
        self.frames = self.clock.now() * 10 // SECOND + 1
        return [Sample(self._frame(number), None) for number in range(first, self.frames)]

    def events(self):
        return []

    def stop(self):
        self.happenings.note("stop")
        return Command(Stop(), self.clock.now(), (True,) * 3)

    def settle(self):
        self.happenings.note("settle")
        self.clock.sleep_until(self.clock.now() + SECOND)
        return self.verdict

    def close(self):
        self.happenings.note("close")

    def _frame(self, number):
        when = number * SECOND // 10
        return Observation(number, when, when, Poses.from_array(STARTS), np.ones(3, np.bool_))


class FakeController:
    """Stands for a controller of as many steps as it is given, which then ends the trial.

    `instead` maps the number of a step to what it sends in place of a direction.
    """

    def __init__(self, happenings, steps=3, outcome=Outcome.SEQUENCE_COMPLETED):
        self.happenings = happenings
        self.steps_left = steps
        self.outcome = outcome
        self.seen: list[Observation] = []
        self.instead: dict[int, Turn | Stop] = {}

    def plan(self, observation, last_command=None, earlier=()):
        self.happenings.note("plan")
        self.seen.append(observation)
        if self.steps_left == 0:
            return self.outcome
        self.steps_left -= 1
        signals = np.array([self.steps_left / 10, 0.5])
        search = Search(2, signals, 1.0, np.array([1.0]), 5, "iterations")
        instead = self.instead.get(len(self.seen) - 1)
        return Plan(signals, np.zeros((3, 3, 3)), 1.0, 1.0, 0.0, (search,), 0, 7, instead=instead)


class FakeObserver(Recorder):
    """Stands for a log or a view: keeps what it is given, and writes down each call."""

    def __init__(self, happenings, name="log"):
        super().__init__()
        self.happenings = happenings
        self.name = name
        self.stops = []  # the stop and the result of each call of `on_stop`
        for event in ("start", "samples", "step", "command", "note", "stop"):
            setattr(self, f"on_{event}", partial(self._call, event))

    def _call(self, event, *what):
        getattr(super(), f"on_{event}")(*what)
        if event in ("step", "stop"):
            self.commands.pop()  # `commands` are those besides
        if event == "stop":
            self.stops.append(what)
        self.happenings.note(f"{self.name}.{event}")


@dataclass
class Bench:
    """A trial of fakes, ready to run."""

    trial: Trial
    happenings: Happenings
    plant: FakePlant
    controller: FakeController
    observers: list[FakeObserver]
    interrupt: Interrupt

    def do_at(self, name, nth, action):
        """Plan a call of `action` in the n-th call of a name (see `Happenings`)."""
        self.happenings.planned[name, nth] = action

    def fail_at(self, name, nth, error):
        """Plan that the n-th call of a name raises `error`."""

        def fail():
            raise error

        self.do_at(name, nth, fail)

    def run(self):
        """Run the trial; all that was planned must have happened by its end."""
        try:
            return self.trial.run()
        finally:
            assert self.happenings.planned == {}, "never called"


def bench(
    steps=3, outcome=Outcome.SEQUENCE_COMPLETED, simulated=True, observers=("log",), **fields
) -> Bench:
    """Make a trial; `fields` are the controller's part of the spec."""
    spec = experiment(controller=fields)
    happenings = Happenings()
    clock = VirtualClock()
    interrupt = Interrupt()
    plant = FakePlant(happenings, clock, simulated)
    controller = FakeController(happenings, steps, outcome)
    watchers = [FakeObserver(happenings, name) for name in observers]
    nothing_yet = PlantInfo("", simulated, 0.0, {})
    start = create_start(LoadedSpec(spec, "", "spec.yaml"), 4, nothing_yet, SIMULATED_START_NS)
    trial = Trial(start, plant, controller, clock, watchers, interrupt)
    return Bench(trial, happenings, plant, controller, watchers, interrupt)
