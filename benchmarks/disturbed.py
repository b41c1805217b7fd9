"""Measure the closed loop under disturbance: what each part of the controller brings.

    python benchmarks/disturbed.py                          the ablation, 20 trials a row
    python benchmarks/disturbed.py --trials 100 --rate 5    more trials, control at 5 Hz
    python benchmarks/disturbed.py --part knowledge         what wrong assumptions cost
    python benchmarks/disturbed.py --part accept --figure accept.svg    time against error
    python benchmarks/disturbed.py --part hurting --trials 100      realisations that hurt
    python benchmarks/disturbed.py --bench three_m3pi_bench.yaml    another world: this spec

All rows have the same seeds. Everything is simulated. The plant without --bench: dead time 0.14 s,
a and speed each +-10 %, heading walk 0.05 rad/sqrt(s), 5 % of the commands lost. That of `hurting`:
dead time 0.11 s, a +-20 %, speed +-10 %, heading walk 0.03 rad/sqrt(s), 8 % lost, camera 0.3 mm and
4 mrad at 120 Hz, with one more disturbance a row; benchmarks/floors.py compares these rows with
perfect knowledge.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from solverbench.problems import OURS, PAPER, Build, as_specified, played
from solverbench.problems import experiment as load_experiment
from solverbench.report import load, progress

from tetractl.control.filter import FilterBank
from tetractl.control.kernels.filter_state import Forecast
from tetractl.control.mpc import Mpc
from tetractl.control.mpc_section import RecommendedMpc
from tetractl.control.prior import nothing
from tetractl.control.reception import Reception
from tetractl.control.work_clock import WorkClock
from tetractl.core.commands import Command
from tetractl.core.plan import Problem
from tetractl.core.poses import Observation, Poses
from tetractl.core.protocols import Controller, Plant
from tetractl.core.setup import Setup
from tetractl.core.trial import Result, Verdict
from tetractl.experiment.controller import Host
from tetractl.experiment.experiment import Experiment
from tetractl.results.estimate import distributions, percent

WORLD = (
    "plant.dead_time=0.14",
    "plant.a_error=0.1",
    "plant.speed_error=0.1",
    "plant.heading_noise=0.05",
    "plant.lost_commands=0.05",
)
FAR_MM = 100.0
BODY_MM = 47.0  # radius of an m3pi, in every row, also of controllers that are not given it
RATES = {
    5: ("controller.period=0.2", "controller.signal_periods=1", "controller.time_limit=160"),
    20: ("controller.period=0.05", "controller.signal_periods=4", "controller.time_limit=160"),
}
"""Settings for each rate of the control [Hz]."""
PLAIN = (
    "controller.estimate=false",
    "controller.collision.stop_before_collision=false",
    "controller.collision.adaptive=false",
    "controller.collision.margin=20",
    "controller.collision.radius=0",
    "controller.collision.separation=0",
)
TOLD = "controller.dead_time={}"
NOT_KEPT = ("controller.collision.adaptive=false", "controller.collision.margin=20")
Row = tuple[str, Sequence[str]]


def _more(disturbance: str) -> str:
    return f"plant.disturbances=[{disturbance}]"


ABLATION: list[Row] = [
    ("whole", ()),
    ("without identification, dead time given", ("controller.estimate=false", TOLD)),
    ("without identification, dead time not given", ("controller.estimate=false",)),
    ("without margins that follow: 20 mm and the radius", NOT_KEPT),
    ("without the wheels' lag, on a bench", ("wheels.lag=0",)),
    ("without identification and safety, dead time given", (*PLAIN, TOLD)),
    ("without identification and safety, dead time not given", PLAIN),
]
KNOWLEDGE: list[Row] = [
    ("dead time given", (TOLD,)),
    ("dead time assumed 0", ()),
    ("dead time assumed 50 ms less", (f"{TOLD}-0.05",)),
    ("dead time assumed 50 ms more", (f"{TOLD}+0.05",)),
    ("a up to 30 % off", ("plant.a_error=0.3",)),
    ("two a 5 % apart, heading walk 0.05", ("robots.2.a=4.2", "plant.heading_noise=0.05")),
]
"""The dead time of the world, {}, is filled in."""
ACCEPT: list[Row] = [
    (f"accept {mm} mm", (f"controller.accept_error={mm}",)) for mm in (40, 30, 20, 15, 12, 10, 8)
]


HURT = (
    "plant.dead_time=0.11",
    "plant.a_error=0.2",
    "plant.speed_error=0.1",
    "plant.heading_noise=0.03",
    "plant.lost_commands=0.08",
    "plant.measurement_noise={position: 0.3, heading: 0.004}",
)
OFF = "markers 0.1 rad off"
HURTING: list[Row] = [
    ("none of these", ()),
    (
        "radio silent 1 s three times, 2 % lost",
        ("plant.lost_commands=0.02", _more("{type: silent-radio, times: 3, duration: 1}")),
    ),
    ("each robot sticks 0.5 s every 5 s", (_more("{type: sticking, every: 5, duration: 0.5}"),)),
    (
        "old poses (0.2 s) shown as new, 0.4 s twice",
        (_more("{type: stale-camera, times: 2, duration: 0.4, age: 0.2}"),),
    ),
    (
        "last picture shown as new, 0.4 s twice",
        (_more("{type: frozen-camera, times: 2, duration: 0.4}"),),
    ),
    (
        "no frames, 0.4 s twice",
        (_more("{type: frozen-camera, repeats: false, times: 2, duration: 0.4}"),),
    ),
    (OFF, (_more("{type: marker-off, heading: 0.1}"),)),
    ("speed falls by 15 % in 20 s", (_more("{type: battery, speed: 0.15, over: 20}"),)),
    ("a and speed wander by 10 %", (_more("{type: wander, a: 0.1, speed: 0.1, time: 5}"),)),
]
PARTS = {"ablation": ABLATION, "knowledge": KNOWLEDGE, "accept": ACCEPT, "hurting": HURTING}


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


def run(spec: Experiment, trials: int, build: Build = as_specified) -> list[Result]:
    """Run trials in virtual time without any log."""
    return [played(spec, trial, build)[0] for trial in range(trials)]


HEAD = (
    "controller",
    "total error [mm], mean and 95 % interval",
    "median",
    "p95",
    "worst",
    "above 100 mm",
    "centres in an obstacle / over the edge",
    f"bodies of {BODY_MM:g} mm in an obstacle / over the edge / touching",
    "trial [s]",
    "step p50 / p99 / max [ms]",
)


def unsafe(
    results: list[Result], *flags_of: Callable[[Verdict, float], list[bool]], radius: float = 0.0
) -> str:
    """In how many trials a robot of some radius did each of some things."""
    counts = []
    for flag_of in flags_of:
        flagged = [result for result in results if any(flag_of(result.verdict, radius))]
        counts.append(f"{len(flagged)}")
    return f"{' / '.join(counts)} of {len(results)}"


def row(name: str, results: list[Result]) -> str:
    """One line of a table in Markdown."""
    errors = np.array([result.total_error for result in results])
    (described,) = distributions(errors[None], FAR_MM)
    steps = np.concatenate([result.solve_ns[1:] for result in results]) / 1e6
    cells = (
        name,
        f"{errors.mean():.1f} [{described.ci95.low:.1f}, {described.ci95.high:.1f}]",
        f"{np.median(errors):.1f}",
        f"{np.quantile(errors, 0.95):.1f}",
        f"{errors.max():.1f}",
        f"{described.tail.above}{percent(described.tail.ci95)}",
        unsafe(results, Verdict.in_obstacle, Verdict.over_edge),
        unsafe(results, Verdict.in_obstacle, Verdict.over_edge, Verdict.touched, radius=BODY_MM),
        f"{np.mean([result.duration_s for result in results]):.1f}",
        " / ".join(f"{x:.1f}" for x in (*np.quantile(steps, [0.5, 0.99]), steps.max())),
    )
    return f"| {' | '.join(cells)} |"


def table(rows: list[Row], world: "World", trials: int) -> dict[str, list[Result]]:
    """Run every row, print the table, and return the results by name."""
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    results_of = {}
    for name, settings in rows:
        progress(name)
        results_of[name] = run(world.spec(OURS, settings), trials)
        print(row(name, results_of[name]), flush=True)
    return results_of


def references(world: "World", trials: int, published: bool) -> None:
    """Print the rows to compare others with: perfect knowledge and, if `published`, the paper's
    controller and a world without disturbances."""
    progress("given a, speed, dead time, losses")
    spec = world.spec(OURS, (TOLD,))
    print(row("given a, speed, dead time, losses", run(spec, trials, knowing)), flush=True)
    if published:
        paper = world.spec(PAPER, (), slow=True)
        print(row("the paper's, 5 Hz", run(paper, trials)))
        undisturbed = load_experiment(OURS, *world.rate)
        print(row("undisturbed", run(undisturbed, trials)), flush=True)


def draw(results_of: dict[str, list[Result]], title: str, path: Path) -> None:
    """Draw the mean total error of each row over its mean time, with 95 % intervals."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 3.6), layout="constrained")
    axes = figure.subplots()
    for name, results in results_of.items():
        points = np.array([(result.duration_s, result.total_error) for result in results])
        time_s, error = distributions(points.T)
        x = time_s.mean
        y = error.mean
        wide = [[x - time_s.ci95.low], [time_s.ci95.high - x]]
        high = [[y - error.ci95.low], [error.ci95.high - y]]
        axes.errorbar(x, y, high, wide, fmt="o", color="C0", capsize=2)
        axes.annotate(name, (x, y), textcoords="offset points", xytext=(5, 4), fontsize=8)
    axes.set(xlabel="time of a trial [s]", ylabel="total error [mm]", yscale="log", title=title)
    axes.title.set_fontsize(8)
    figure.savefig(path)


class World:
    """Where the trials take place: the disturbances above, or the plant of another spec."""

    def __init__(
        self, bench: str | None, rate_hz: int, dead_time_s: float, plain: Sequence[str] = WORLD
    ) -> None:
        self.plain = plain
        self.bench = bench
        self.rate = RATES[rate_hz]
        self.dead_time_s = dead_time_s

    def spec(self, file: str, settings: Sequence[str], slow: bool = False) -> Experiment:
        rate = () if slow else self.rate
        settings = [self._filled(setting) for setting in settings]
        if self.bench is None:
            return load_experiment(file, *self.plain, *rate, *settings)
        if file == OURS:
            return load_experiment(self.bench, *self.plain, *rate, *settings)
        plant = load_experiment(self.bench).plant
        return load_experiment(file, *self.plain).model_copy(update={"plant": plant})

    def _filled(self, setting: str) -> str:
        head, placeholder, more = setting.partition("{}")
        return f"{head}{self.dead_time_s + float(more or 0):.6g}" if placeholder else setting


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--part", choices=tuple(PARTS), default="ablation")
    parser.add_argument("--only", metavar="ROW", help="print this row alone")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--seed", type=int, help="root seed, in place of that of the spec")
    parser.add_argument(
        "--rate", type=int, choices=tuple(RATES), default=20, help="of the control [Hz]"
    )
    parser.add_argument("--bench", help="the spec in experiments/ whose plant is the world")
    parser.add_argument("--dead-time", type=float, default=0.14, help="of the world [s]")
    parser.add_argument("--figure", type=Path, help="of the rows: error over time")
    chosen = parser.parse_args()
    rows = [row for row in PARTS[chosen.part] if chosen.only in (None, row[0])]
    if not rows:
        parser.error(f"--only: no row {chosen.only!r} of the part {chosen.part}")
    plain = HURT if chosen.part == "hurting" else WORLD
    if chosen.bench:
        plain = ()
    if chosen.seed is not None:
        plain = (*plain, f"trials.seed={chosen.seed}")
    world = World(chosen.bench, chosen.rate, chosen.dead_time, plain)
    where = ", ".join(([chosen.bench] if chosen.bench else []) + [f"`{name}`" for name in plain])
    print(f"Simulated, {chosen.trials} trials a row, {chosen.rate} Hz, {where}. {load()}.\n")
    results_of = table(rows, world, chosen.trials)
    if chosen.part != "hurting" and not chosen.only:
        references(world, chosen.trials, published=chosen.part == "ablation")
    if chosen.figure:
        where = chosen.bench or "the world of benchmarks/disturbed.py"
        title = f"simulated, {where}, {chosen.rate} Hz, {chosen.trials} trials a point"
        draw(results_of, title, chosen.figure)


if __name__ == "__main__":
    main()
