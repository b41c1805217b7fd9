"""The plants and layouts of benchmarks/unmodelled.py: specs of experiments/ with disturbances.

Unless a world says otherwise, robots are those of three_m3pi.yaml at 20 Hz in the plant `HURT` of
disturbed.py (dead time 0.11 s, a +-20 %, speed +-10 %, heading walk 0.03 rad/sqrt(s), 8 % of the
commands lost, camera 0.3 mm and 4 mrad at 120 Hz), to which a world adds one thing; "-5hz" behind
its name is the same at 5 Hz. Numbers without another source are assumed: no lab has measured them.
Places and times are drawn for each trial.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from anywhere import CONTROLLER, EDGE_MM, robots, scattered
from disturbed import HURT, HURTING, RATES, WORLD
from solverbench.problems import OURS, experiment

from tetractl.core.commands import Steer
from tetractl.core.poses import Floats, Poses, wrap
from tetractl.core.setup import Setup
from tetractl.experiment.disturbance import DelayedCommand, Disturbance, DisturbanceSection
from tetractl.experiment.experiment import Experiment
from tetractl.plant.disturbances.camera import FrozenCameraSection

HURTS = "silent", "sticking", "stale", "repeating", "no-frames", "marker", "battery", "wander"
BENCH = "three_m3pi_bench.yaml"
CELLS = "tetrahymena_disturbed.yaml"
BENCHMARK = "near-equal", "five-robots", "paper-disturbed", "one-cell"
Random = np.random.Generator
Truth = dict[str, Floats]
"""What holds at a trial's end: a, speed, `side` (N,), dead_time (1,), and who `lives` (N,)."""


class Unmodelled(Disturbance):
    """One of the disturbances below, of a `size` whose meaning each of them says."""

    def __init__(self, size: float, setup: Setup, random: Random) -> None:
        self.size = size
        self.random = random
        self.count = len(setup.names)
        arena = setup.arena
        self.middle = np.array([[arena.left + arena.right], [arena.bottom + arena.top]]) / 2
        self.reach = float(np.hypot(arena.width, arena.height)) / 2  # from the middle to a corner
        self.xy = np.tile(self.middle, self.count)
        self.heading = np.zeros(self.count)
        self.draw()

    def draw(self) -> None:
        """Draw what is constant in a trial."""

    def truth(self, truth_known: Truth) -> Truth:
        """Return what holds at the trial's end, given what holds without this disturbance."""
        return truth_known

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        self.xy = poses.xy.T
        self.heading = poses.heading
        return poses


class Later(Unmodelled):
    """From some time between 3 and 8 s on, commands act later by `size` [s]."""

    def draw(self) -> None:
        self.since_ns = 1e9 * self.random.uniform(3, 8)
        self.began = False

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        if command.sent_ns < self.since_ns:
            return command
        self.began = True
        return replace(command, due_ns=command.due_ns + round(1e9 * self.size))

    def truth(self, truth_known: Truth) -> Truth:
        return truth_known | {"dead_time": truth_known["dead_time"] + self.size * self.began}


class SparseRadio(Unmodelled):
    """Of the directions only one in `size` [s] gets out; stops and turns all do."""

    def draw(self) -> None:
        self.next_ns = 0

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        if not isinstance(command.action, Steer):
            return command
        if command.sent_ns < self.next_ns:
            return replace(command, reached=np.zeros_like(command.reached))
        self.next_ns = command.sent_ns + round(1e9 * self.size)
        return command


class SlowPictures(Unmodelled):
    """Twice for 4 s only 10 pictures a second arrive, later by `size` [s], from 1 to 14 s on."""

    def draw(self) -> None:
        section = FrozenCameraSection(type="frozen-camera", times=2, duration=4)
        self.spells = section.draw(self.random)
        self.shown = -1

    def received(self, exposed_ns: int, received_ns: int) -> int | None:
        if not self.spells.include(exposed_ns / 1e9):
            return received_ns
        before = self.shown
        self.shown = exposed_ns // 100_000_000
        return received_ns + round(1e9 * self.size) if self.shown > before else None


class Turning(Unmodelled):
    """Changes how far robots have turned since the last call."""

    before: Floats | None = None

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        before = poses.heading if self.before is None else self.before
        self.before = before + self.turned(wrap(poses.heading - before), seconds)
        return Poses(poses.x, poses.y, self.before)

    def turned(self, by: Floats, seconds: float) -> Floats:
        """Return how far (N,) they really turn in a time; without this, `by` [rad]."""
        return by


class Sides(Turning):
    """a is 1 + `size` of the spec's to one side, drawn for each robot, and 1 - `size` to the other:
    a exp(+-k) with the sign of the turn."""

    def draw(self) -> None:
        self.more = self.size * self.random.choice([-1.0, 1.0], self.count)

    def turned(self, by: Floats, seconds: float) -> Floats:
        return by + self.more * np.abs(by)

    def truth(self, truth_known: Truth) -> Truth:
        changed = {"a": truth_known["a"] * np.sqrt(1 - self.size**2), "side": np.arctanh(self.more)}
        return truth_known | changed


class Saturated(Turning):
    """No robot turns faster than `size` [rad/s]."""

    def turned(self, by: Floats, seconds: float) -> Floats:
        return np.clip(by, -self.size * seconds, self.size * seconds)


class Slide(Unmodelled):
    """Moving robots slide downhill by `size` [mm/s], and turn there at 0.1 rad/s at most."""

    def draw(self) -> None:
        self.down = self.random.uniform(-np.pi, np.pi)

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        way = self.size * seconds * moving
        turned = 0.1 * seconds * moving
        x = poses.x + way * np.cos(self.down)
        y = poses.y + way * np.sin(self.down)
        return Poses(x, y, poses.heading + turned * np.sin(self.down - poses.heading))


class Strip(Unmodelled):
    """On a strip `size` [mm] wide across the arena, speed is 70 % and a is 85 %."""

    def draw(self) -> None:
        self.at = self.middle[0, 0] + self.random.uniform(-300, 300)

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        on = np.abs(self.xy[0] - self.at) < self.size / 2
        return a * np.where(on, 0.85, 1.0), speed * np.where(on, 0.7, 1.0)


class Lens(Unmodelled):
    """The camera shows what is `size` of its distance too far out at the corners, and less within
    by the square of the distance from the middle; headings are those of the picture."""

    def measured(self, poses: Poses, valid: Any, time_s: float) -> tuple[Poses, Any]:
        ahead = np.array([np.cos(poses.heading), np.sin(poses.heading)])
        x, y = self._shown(poses.xy.T)
        x_ahead, y_ahead = self._shown(poses.xy.T + ahead)
        turned = np.arctan2(y_ahead - y, x_ahead - x)
        return Poses(x, y, poses.heading + wrap(turned - poses.heading)), valid

    def _shown(self, xy: Floats) -> Floats:
        off = (xy - self.middle) / self.reach
        return xy + self.size * self.reach * (off**2).sum(axis=0) * off


class Dead(Unmodelled):
    """One robot's battery ends between 2 and `size` [s]; the camera sees it standing."""

    def draw(self) -> None:
        self.lives = np.arange(self.count) != self.random.integers(self.count)
        self.at_s = self.random.uniform(2, self.size)

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        works = self.lives | (time_s < self.at_s)
        return a * works, speed * works

    def truth(self, truth_known: Truth) -> Truth:
        return truth_known | {"lives": self.lives}


class Avoid(Unmodelled):
    """Each cell now and then, after `size` [s] on average, swims backwards for 0.5 s and turns for
    0.5 s by up to 90 degrees, as ciliates do that meet something."""

    def draw(self) -> None:
        self.next_s = self.random.exponential(self.size, self.count)
        self.by = np.zeros(self.count)

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        ended = time_s >= self.next_s + 1
        drawn = self.random.exponential(self.size, self.count)
        by = self.random.uniform(-np.pi, np.pi, self.count)  # [rad/s]
        self.next_s = np.where(ended, time_s + drawn, self.next_s)
        self.by = np.where(ended, by, self.by)
        self.since_s = time_s - self.next_s
        turns = np.where(self.since_s >= 0.5, moving, 0.0)
        return Poses(poses.x, poses.y, poses.heading + self.by * seconds * turns)

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        back = self.since_s >= 0
        turns = self.since_s >= 0.5
        return a, speed * np.where(turns, 0.0, np.where(back, -1.0, 1.0))


class Shear(Unmodelled):
    """A flow along a drawn direction that grows by `size` [1/s] across it from the middle on; it
    turns cells by half of that."""

    def draw(self) -> None:
        self.along = self.random.uniform(-np.pi, np.pi)

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        x, y = poses.xy.T - self.middle
        cos = np.cos(self.along)
        sin = np.sin(self.along)
        way = self.size * (y * cos - x * sin) * seconds * moving
        turned = poses.heading - self.size / 2 * seconds * moving
        return Poses(poses.x + way * cos, poses.y + way * sin, turned)


class Light(Unmodelled):
    """Speed grows along a drawn direction, by `size` of it from the middle to a corner."""

    def draw(self) -> None:
        angle = self.random.uniform(-np.pi, np.pi)
        self.towards = np.array([[np.cos(angle)], [np.sin(angle)]]) / self.reach

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        return a, speed * (1 + self.size * (self.towards * (self.xy - self.middle)).sum(axis=0))


KINDS: dict[str, type[Unmodelled]] = {
    "later": Later,
    "sparse-radio": SparseRadio,
    "slow-pictures": SlowPictures,
    "sides": Sides,
    "saturated": Saturated,
    "slide": Slide,
    "strip": Strip,
    "lens": Lens,
    "dead": Dead,
    "avoid": Avoid,
    "shear": Shear,
    "light": Light,
}


class UnmodelledSection(DisturbanceSection):
    """One of these disturbances."""

    type: str
    size: float

    def build(self, setup: Setup, rng: Random) -> Unmodelled:
        return KINDS[self.type](self.size, setup, rng)


def near_a_wall(random: Random, spec: Experiment) -> dict[str, Any]:
    """Start three robots in a row 60 mm from a wall and 105 mm apart, with any headings."""
    arena = spec.setup.arena
    upright = bool(random.integers(2))
    size = np.array([arena.width, arena.height])
    off = 60.0 if random.integers(2) else size[int(not upright)] - 60
    along = random.uniform(60, size[int(upright)] - 60 - 2 * 105) + 105 * random.permutation(3)
    xy = [np.full(3, off), along] if upright else [along, np.full(3, off)]
    return {"robots": _robots(random, spec, np.add(np.transpose(xy), (arena.left, arena.bottom)))}


def through_a_gap(random: Random, spec: Experiment) -> dict[str, Any]:
    """A wall 100 mm thick with one gap of 260 mm, from starts on its left to targets on its right,
    150 mm from walls and 250 mm from each other, with any headings."""
    arena = spec.setup.arena
    first_x = arena.left + random.uniform(600, 900)
    low = random.uniform(150, arena.height - 260 - 150)
    wall = {"type": "rectangle", "left": first_x, "width": 100.0}
    below = {**wall, "bottom": arena.bottom, "height": low}
    above = {**wall, "bottom": arena.bottom + low + 260, "height": arena.height - low - 260}
    y = arena.bottom + 150, arena.top - 150
    starts = scattered(random, 3, (arena.left + 150, first_x - 150), y)
    targets = scattered(random, 3, (first_x + 250, arena.right - 150), y)
    return {"robots": _robots(random, spec, starts, targets), "obstacles": (below, above)}


def _robots(
    random: Random, spec: Experiment, starts: Floats, targets: Floats | None = None
) -> tuple[dict[str, Any], ...]:
    robots = [robot.model_dump(mode="json") for robot in spec.robots]
    for i, robot_fields in enumerate(robots):
        robot_fields |= {"start": tuple(starts[i]), "heading": float(random.uniform(-np.pi, np.pi))}
        robot_fields |= {} if targets is None else {"target": tuple(targets[i])}
    return tuple(robots)


def eight(random: Random, spec: Experiment) -> dict[str, Any]:
    """Robots as in anywhere.py, but eight in 3 x 3 m without obstacles."""
    inside = EDGE_MM, 3000 - EDGE_MM
    starts, targets = (scattered(random, 8, inside, inside) for _ in range(2))
    arena = {"left": 0, "bottom": 0, "width": 3000, "height": 3000}
    return {"arena": arena, "robots": robots(random, starts, targets), "obstacles": ()}


@dataclass(frozen=True)
class World:
    """Settings of a spec of experiments/, `more` disturbances, each as name and size in KINDS, and
    what is drawn of each trial's spec."""

    settings: tuple[str, ...] = HURT
    more: tuple[tuple[str, float], ...] = ()
    layout: Callable[[Random, Experiment], dict[str, Any]] | None = None
    base: str = OURS

    def spec(self, rate_hz: int, seed: int, trial: int, settings: Sequence[str] = ()) -> Experiment:
        """Return the spec of a trial."""
        rate = RATES[rate_hz] if self.base == OURS else ()
        settings_given = (*rate, *self.settings, f"trials.seed={seed}", *settings)
        spec = experiment(self.base, *settings_given)
        if self.layout:
            data = spec.model_dump(mode="json", exclude={"lab", "scale", "reference"})
            drawn = self.layout(np.random.default_rng([seed, trial]), spec)
            spec = Experiment.model_validate(data | drawn)
        sections = tuple(UnmodelledSection(type=kind, size=size) for kind, size in self.more)
        plant = spec.plant.model_copy(
            update={"disturbances": (*spec.plant.disturbances, *sections)}
        )
        return spec.model_copy(update={"plant": plant})


def _hurt(kind: str, size: float) -> World:
    return World(more=((kind, size),))


def _radio(text: str) -> tuple[str, ...]:
    return (*HURT, f"plant.disturbances=[{{type: radio, {text}}}]")


def _cells(disturbance: dict[str, Any], *settings: str) -> World:
    """The disturbed cells with one more of the shipped disturbances."""
    shipped = [
        disturbance.model_dump(mode="json") for disturbance in experiment(CELLS).plant.disturbances
    ]
    parts = json.dumps([*shipped, disturbance])
    return World((f"plant.disturbances={parts}", *settings), base=CELLS)


ANY_CELL = "plant.cells=null", "plant.a_error=0.5", "plant.disturbances.6.heading=3.1416"
BODY = {"type": "wobble", "radius": 8, "frequency": 1.5}  # um, Hz
PLAIN = World()
WORLDS = {
    "base": PLAIN,
    # of the pages: the world W of disturbed.py, the bench, and the rows of its part `hurting`
    "pages": World(WORLD),
    "bench": World((), base=BENCH),
    **{name: World((*HURT, *more)) for name, (_, more) in zip(HURTS, HURTING[1:], strict=True)},
    # one thing each that the model lacks, or that few plans allow
    "sides": _hurt("sides", 0.2),
    "later": _hurt("later", 0.1),
    # at 20 Hz one direction of four gets out; 30 % of the commands lost, by each robot on its own
    "sparse-radio": _hurt("sparse-radio", 0.2),
    "lossy-radio": World((*HURT, "plant.lost_commands=0.3")),
    "slow-pictures": _hurt("slow-pictures", 0.06),
    # the same with a dead time from sending; `plant.dead_time` counts from the exposure, so that
    # late pictures shorten what is left of it
    "slow-pictures-radio": World(
        (*_radio("delay: 0.11"), "plant.dead_time=0"), (("slow-pictures", 0.06),)
    ),
    "saturated-2": _hurt("saturated", 2.0),
    "saturated-4": _hurt("saturated", 4.0),
    "near-walls": World(layout=near_a_wall),
    "dead": World((*HURT, "on_lost=drop"), (("dead", 8.0),)),
    "gap": World((*CONTROLLER, *HURT), layout=through_a_gap),
    "eight": World((*CONTROLLER, *HURT, "controller.accept_error=40"), layout=eight),
    # each robot late by its own, a floor that slopes, a strip of another floor, a lens
    "late": World(_radio("spread: 0.12")),
    "slide": _hurt("slide", 12.0),
    "strip": _hurt("strip", 300.0),
    "lens": _hurt("lens", 0.01),
    # of experiments/benchmark
    **{name: World((), base=f"benchmark/{name}.yaml") for name in BENCHMARK},
    # cells
    "cells": World((), base=CELLS),
    "cells-body": _cells(BODY, *ANY_CELL),
    "cells-pause": _cells({"type": "sticking", "every": 6, "duration": 1}),
    "cells-avoid": World((), (("avoid", 10.0),), base=CELLS),
    "cells-shear": World((), (("shear", 0.01),), base=CELLS),
    "cells-later": World((), (("later", 0.15),), base=CELLS),
    "cells-sides": World((), (("sides", 0.2),), base=CELLS),
    "cells-saturated": World((), (("saturated", 1.5),), base=CELLS),
    "cells-light": World((), (("light", 0.2),), base=CELLS),
}
"""Each world by its name."""
