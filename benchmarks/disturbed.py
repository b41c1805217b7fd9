"""Measure the closed loop under disturbance: tables of docs/reference/measured.md.

    python benchmarks/disturbed.py --part ablation --seed 59301             what each part brings
    python benchmarks/disturbed.py --part knowledge --trials 40 --seed 60101    wrong assumptions
    python benchmarks/disturbed.py --part hurting --seed 60201              what hurts
    python benchmarks/disturbed.py --part floors --seed 60201               how near the floor
    python benchmarks/disturbed.py --part accept --trials 40 --seed 60101   time against error

All rows of a part have the same seeds; `benchmarks/worlds` has their plants. The floor is the same
controller with perfect knowledge of poses, a, speed, dead time and lost commands at each control
step. It is no bound: it ends its trials by the same rules.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from solverbench.problems import Build, as_specified
from solverbench.report import load, progress
from worlds.trials import HEAD, Task, line, run

from tetractl.control.filter import FilterBank
from tetractl.control.kernels.filter_state import Forecast
from tetractl.control.mpc import Mpc
from tetractl.control.mpc_section import RecommendedMpc
from tetractl.control.prior import nothing
from tetractl.control.reception import Reception
from tetractl.control.work_clock import WorkClock
from tetractl.core.commands import Command
from tetractl.core.plan import End, Outcome, Plan, Problem
from tetractl.core.poses import Observation, Poses
from tetractl.core.protocols import Controller, Plant
from tetractl.core.setup import Setup
from tetractl.experiment.controller import Host
from tetractl.experiment.experiment import Experiment
from tetractl.plant.simulation import SimPlant

M = TypeVar("M", bound=Mpc)


class Heard:
    """A bank of filters for each robot, which is given only the commands that the robot heard."""

    def __init__(self, problem: Problem, dead_time_s: float) -> None:
        problems = (problem.only(only) for only in np.eye(len(problem.a), dtype=np.bool_))
        self.banks = [
            FilterBank(nothing(problem_of_robot, dead_time_s)) for problem_of_robot in problems
        ]
        self.reception = Reception()  # as of a radio that works: what is missed is known

    def add_command(self, command: Command) -> None:
        for bank, heard in zip(self.banks, command.delivered, strict=True):
            if heard:
                bank.add_command(command)

    def add_frames(self, newest: Observation, earlier: Sequence[Observation] = ()) -> None:
        rows = zip(self.banks, newest.poses.array()[:, None], newest.valid[:, None], strict=True)
        for bank, pose, valid in rows:
            bank.add_frames(replace(newest, poses=Poses.of(pose), valid=valid))

    def restart(self, robots: Sequence[int]) -> None:
        pass

    def forecast(self, sent_ns: int) -> Forecast:
        forecasts = [bank.forecast(sent_ns) for bank in self.banks]
        return forecasts[0]._replace(
            x=np.concatenate([forecast.x for forecast in forecasts]),
            y=np.concatenate([forecast.y for forecast in forecasts]),
            heading=np.concatenate([forecast.heading for forecast in forecasts]),
            directions=np.concatenate([forecast.directions for forecast in forecasts]),
        )


class Knowing(Mpc):
    """The controller that knows which of its commands arrived."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.heard = Heard(self.estimator.problem, self.section.dead_time)
        self.estimator.filter = self.heard  # pyright: ignore[reportAttributeAccessIssue]


def knowing(spec: Experiment, key: int, plant: Plant) -> Controller:
    """The same controller with the true a, speed and dead time, given every lost command."""
    true = {"estimate": False}
    section = spec.controller.model_copy(update=true)
    setup = replace(spec.setup, a=plant.a, speed=plant.speed)
    return counted(Knowing, section, setup, key)


def counted(kind: type[M], section: RecommendedMpc, setup: Setup, key: int) -> M:
    """Return a controller whose deadline is kept by the work of its searches."""
    work = WorkClock()
    return kind(section, setup, key, Host(work.wrap, work))


class Seeing(Knowing):
    """A controller that knows the true poses, a and speed of a simulation at each control step."""

    plant: SimPlant

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome | End:
        a, speed = self.plant.rates
        stands = speed == 0  # and will go on as before
        rates = {
            "a": np.where(stands, self.plant.a, a),
            "speed": np.where(stands, self.plant.speed, speed),
        }
        self.estimator.problem = replace(self.estimator.problem, **rates)
        for i, bank in enumerate(self.heard.banks):
            bank.model.parameters[:] = np.column_stack([rates["a"][i], rates["speed"][i]])
        now = self.plant.clock.now()
        all_valid = np.ones_like(observation.valid)
        true = {
            "poses": self.plant.poses,
            "valid": all_valid,
            "sampled_ns": now,
            "received_ns": now,
        }
        return super().plan(replace(observation, **true), last_command, earlier)


def seeing(dead_time_s: float, spec: Experiment, key: int, plant: Plant) -> Controller:
    """The same controller, which knows the dead time and what `Seeing` does."""
    assert isinstance(plant, SimPlant)
    settings = {"estimate": False, "dead_time": dead_time_s}
    section = spec.controller.model_copy(update=settings)
    controller = counted(Seeing, section, spec.setup, key)
    controller.plant = plant
    return controller


@dataclass(frozen=True)
class Line:
    """A line of a table: the trials of a place by a controller."""

    name: str
    place: str
    build: Build = as_specified


TOLD = "controller.dead_time=0.06"  # of the bench [s]
NOT_IDENTIFIED = "controller.estimate=false"
NOT_KEPT = ("controller.collision.adaptive=false", "controller.collision.margin=20")
NOT_SAFE = (
    *NOT_KEPT,
    "controller.collision.stop_before_collision=false",
    "controller.collision.radius=0",
    "controller.collision.separation=0",
)


def _bench(name: str, *settings: str, build: Build = as_specified) -> Line:
    return Line(name, " --set ".join(["bench", *settings]), build)


GIVEN = _bench("given a, speed, dead time, losses", TOLD, build=knowing)
PARTS = {
    "ablation": [
        _bench("whole"),
        _bench("without identification, dead time given", NOT_IDENTIFIED, TOLD),
        _bench("without identification, dead time not given", NOT_IDENTIFIED),
        _bench("without margins that follow: 20 mm and the radius", *NOT_KEPT),
        _bench("without the wheels' lag, on a bench", "wheels.lag=0"),
        _bench(
            "without identification and safety, dead time given", NOT_IDENTIFIED, *NOT_SAFE, TOLD
        ),
        GIVEN,
        Line("the paper's, 5 Hz", "paper-on-bench"),
    ],
    "knowledge": [
        _bench("dead time given", TOLD),
        _bench("dead time assumed 0"),
        _bench("dead time assumed 50 ms less", "controller.dead_time=0.01"),
        _bench("dead time assumed 50 ms more", "controller.dead_time=0.11"),
        _bench("a up to 30 % off", "plant.a_error=0.3"),
        _bench("two a 5 % apart, heading walk 0.05", "robots.2.a=4.2", "plant.heading_noise=0.05"),
        GIVEN,
    ],
    "hurting": [
        Line("none of these", "base"),
        Line("radio silent 1 s three times, 2 % lost", "silent"),
        Line("each robot sticks 0.5 s every 5 s", "sticking"),
        Line("old poses (0.2 s) shown as new, 0.4 s twice", "stale"),
        Line("last picture shown as new, 0.4 s twice", "repeating"),
        Line("no frames, 0.4 s twice", "no-frames"),
        Line("markers 0.1 rad off", "marker"),
        Line("speed falls by 15 % in 20 s", "battery"),
        Line("a and speed wander by 10 %", "wander"),
    ],
    "floors": [
        Line(f"{world}, {who} {mm} mm", f"{world} --set controller.accept_error={mm}", build)
        for world, dead_time_s in (("bench", 0.06), ("base", 0.11))
        for mm in (24, 12, 6, 3)
        for who, build in (("accept", as_specified), ("floor", partial(seeing, dead_time_s)))
    ],
    "accept": [
        _bench(f"accept {mm} mm", f"controller.accept_error={mm}")
        for mm in (40, 30, 20, 15, 12, 10, 8)
    ],
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--part", choices=PARTS, default="ablation")
    parser.add_argument("--only", metavar="ROW", help="print this row alone")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    rows = [row for row in PARTS[chosen.part] if chosen.only in (None, row.name)]
    if not rows:
        parser.error(f"--only: no row {chosen.only!r} of the part {chosen.part}")
    print(f"Simulated, {chosen.trials} trials a row, seed {chosen.seed}. {load()}.\n\n{HEAD}")
    for row in rows:
        progress(row.name)
        tasks = [Task(chosen.seed, row.place, trial) for trial in range(chosen.trials)]
        print(line(row.name, [run(task, row.build) for task in tasks]), flush=True)


if __name__ == "__main__":
    main()
