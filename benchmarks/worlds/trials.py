"""Runs and stores the trials of a world, and formats the lines of the tables on pages.

A place is the name of a world, with `-5hz` appended if it is controlled at 5 Hz, and with settings
of its spec, each after ` --set `. Trials with the same seed and index in two places, with two
controllers or in two versions are pairs: the same values of the plant are sampled in both. Bodies
are discs with the radius of the world's robots. Everything is simulated, in virtual time.
"""

import csv
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from solverbench.problems import played

from tetractl.core.poses import Floats
from tetractl.core.protocols import Observer
from tetractl.run.model_changes import model_monitor
from tetractl.statistics.estimate import distributions

from . import WORLDS
from .disturbances import Dead

RESAMPLES = 4000
FAR = 100.0  # a total error that no disturbance explains [mm] or [um]


class Task(NamedTuple):
    """A trial of a place."""

    seed: int
    place: str
    trial: int


@dataclass(frozen=True)
class Row:
    """The result of a trial, in the unit of its spec. If a robot dies, the errors of the others.

    `edge`, `obstacle` and `apart` are the minimum free distances of bodies, negative if they
    overlap. Steps that took longer than a control period are late. The first step is left out,
    because robots stand still during it.
    """

    error: float
    seconds: float
    complete: float
    edge: float
    obstacle: float
    apart: float
    late_steps: float
    step_ms: float

    @property
    def touches(self) -> bool:
        return min(self.edge, self.obstacle, self.apart) < 0


Rows = Mapping[Task, Row]


def run(task: Task, observers: Sequence[Observer] = ()) -> Row:
    """Run one trial.

    Args:
        task: The trial.
        observers: Objects that are notified of everything that happens. If there are none, the
            controller's estimates are not compared with the spec, which saves time.

    Returns:
        The result of the trial.
    """
    place, *settings = task.place.split(" --set ")
    name, slow, _ = place.partition("-5hz")
    world = WORLDS[name]
    spec = world.spec(task.seed, task.trial, settings, slow=bool(slow))
    model = model_monitor(spec) if observers else None
    result, plant = played(spec, task.trial, observers, model)
    verdict = result.verdict
    errors = np.array(result.robot_errors)
    for disturbance in plant.disturbances:
        if isinstance(disturbance, Dead):
            errors = errors[disturbance.lives]
    steps_ms = np.array(result.solve_ns[1:]) / 1e6
    return Row(
        error=float(errors.sum()),
        seconds=result.duration_s,
        complete=float(result.outcome.complete),
        edge=min(verdict.edge) - world.body,
        obstacle=min(verdict.clearance) - world.body,
        apart=min(verdict.apart) - 2 * world.body,
        late_steps=float((steps_ms > 1e3 * spec.setup.period_s).sum()),
        step_ms=float(steps_ms.max(initial=0.0)),
    )


def read(path: Path) -> dict[Task, Row]:
    """Read the trials in a CSV file. Empty if there is no file."""
    if not path.exists():
        return {}
    rows = {}
    with path.open(newline="") as file:
        for seed, place, trial, *numbers in csv.reader(file):
            task = Task(int(seed), place, int(trial))
            rows[task] = Row(*map(float, numbers))
    return rows


def extended(
    path: Path | None,
    tasks: Sequence[Task],
    jobs: int = 1,
    begin: Callable[..., object] | None = None,
    words: Sequence[Any] = (),
) -> dict[Task, Row]:
    """Run the trials of `tasks` that a CSV file lacks, and return all trials of the file.

    They run in `jobs` new processes, which first call `begin(*words)`.
    """
    rows = read(path) if path else {}
    lacking = [task for task in tasks if task not in rows]
    if not lacking:
        return rows
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
    with (
        get_context("spawn").Pool(jobs, begin, words) as pool,
        Path(path or os.devnull).open("a", newline="") as file,
    ):
        for task, row in zip(lacking, pool.imap(run, lacking), strict=True):
            rows[task] = row
            csv.writer(file).writerow([*task, *astuple(row)])
            file.flush()
    return rows


def columns(rows: Sequence[Row]) -> dict[str, Floats]:
    """Return the values of all rows, by the names of their fields."""
    return {
        field.name: np.array([getattr(row, field.name) for row in rows]) for field in fields(Row)
    }


HEAD = (
    "| | n | total error, mean and 95 % interval | median / worst | above 100 / not completed "
    "| trial [s], mean / longest | bodies in an obstacle / over the edge / touching (deepest) "
    "| steps over the period / longest [ms] |\n" + f"|{'---|' * 8}"
)


def line(name: str, rows: Sequence[Row]) -> str:
    """Format the line of a table for the trials of a place."""
    values = columns(rows)
    error = values["error"]
    seconds = values["seconds"]
    (described,) = distributions(error[None])
    rooms = [values[what] for what in ("obstacle", "edge", "apart")]
    touching = " / ".join(f"{(room < 0).sum()}" for room in rooms)
    cells = (
        name,
        f"{len(rows)}",
        f"{error.mean():.1f} [{described.ci95.low:.1f}, {described.ci95.high:.1f}]",
        f"{np.median(error):.1f} / {error.max():.1f}",
        f"{(error > FAR).sum()} / {(values['complete'] == 0).sum()}",
        f"{seconds.mean():.1f} / {seconds.max():.1f}",
        f"{touching} ({max(0.0, -np.min(rooms)):.1f})",
        f"{values['late_steps'].sum():.0f} / {values['step_ms'].max():.0f}",
    )
    return f"| {' | '.join(cells)} |"


PAIRS_HEAD = (
    "| changed | world | pairs, equal | error, more [mm] or [um] | trial [s], more "
    "| touching: before, now | above 100: before, now |\n" + f"|{'---|' * 7}"
)


def interval(differences: Floats) -> str:
    """Format the mean of differences and its 95 % bootstrap interval."""
    random = np.random.default_rng(1)
    means = random.choice(differences, (RESAMPLES, len(differences))).mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return f"{differences.mean():+.2f} [{low:.2f}, {high:.2f}]"


def pair_line(name: str, place: str, pairs: Sequence[tuple[Row, Row]]) -> str:
    """Format the line for the effect of a change in a place, from pairs before and after it."""
    rows_before, rows_now = zip(*pairs, strict=True)
    before = columns(rows_before)
    now = columns(rows_now)
    error = now["error"] - before["error"]
    seconds = now["seconds"] - before["seconds"]
    cells = (
        name,
        place,
        f"{len(pairs)}, {((error == 0) & (seconds == 0)).sum()}",
        interval(error),
        interval(seconds),
        f"{_touching(rows_before)}, {_touching(rows_now)}",
        f"{(before['error'] > FAR).sum()}, {(now['error'] > FAR).sum()}",
    )
    return f"| {' | '.join(cells)} |"


def _touching(rows: Sequence[Row]) -> int:
    return sum(row.touches for row in rows)


def pair_lines(name: str, before: Rows, now: Rows) -> list[str]:
    """Format the lines of a change: one for each place, and those of all robots and all cells."""
    pairs: dict[str, list[tuple[Row, Row]]] = {}
    for task in (task for task in now if task in before):
        total = "all cells" if task.place.startswith("cells") else "all robots"
        for place in (task.place, total):
            pairs.setdefault(place, []).append((before[task], now[task]))
    return [pair_line(name, place, pairs[place]) for place in sorted(pairs)]
