"""Trials that find their robots on marks, as a plug-in could provide: `robots: {marks: ...}`."""

from typing import ClassVar

from tetractl.core.registries import TRIAL_ROBOTS
from tetractl.spec.experiment import Experiment, Robot
from tetractl.spec.plants import PreparedTrial
from tetractl.spec.trial_robots import StandIn, TrialRobots


class MarkedRobots(TrialRobots):
    """One robot on each mark, which swims 300 to the right."""

    key: ClassVar[str] = "marks"
    prepare: ClassVar[str] = "testkit.marked_robots:prepare"

    marks: tuple[tuple[float, float], ...]
    found: bool = False

    @property
    def are_found(self):
        return self.found

    def sought(self):
        return self.model_copy(update={"found": False})

    @property
    def stand_ins(self):
        marks = enumerate(self.marks, 1)
        return [StandIn(f"robot {i}", (x + 300, y), 4.0, 200.0) for i, (x, y) in marks]


def prepare(experiment, clock, seed, supervision):
    rule = experiment.chosen
    assert isinstance(rule, MarkedRobots)
    robots = tuple(
        Robot(
            name=planned.name, start=mark, target=planned.target, a=planned.a, speed=planned.speed
        )
        for mark, planned in zip(rule.marks, rule.stand_ins, strict=True)
    )
    chosen = rule.model_copy(update={"found": True})
    prepared: Experiment = experiment.model_copy(update={"robots": robots, "chosen": chosen})
    plant = prepared.plant.build(prepared.setup, clock, seed, supervision)
    return PreparedTrial(prepared, plant)


def install(monkeypatch):
    """Let a package that brings the rule be installed, and no other that brings one."""
    monkeypatch.setattr(TRIAL_ROBOTS, "_installed", {})
    monkeypatch.setitem(TRIAL_ROBOTS.builtin, "marks", "testkit.marked_robots:MarkedRobots")
