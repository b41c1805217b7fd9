"""A synthetic film of swimming cells with its truth.

Cells start in such places that pairs of them cross in view. The field's direction is known.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from tetractl_emulator.pictures.dish.picture import SUB_EXPOSURES, DishPainter, PictureLook

from tetractl.core.poses import Bools, Floats, GreyImage
from tetractl.model.cell_numbers import DRIFT_UM_S
from tetractl.model.swimmers import Bodies, Swimmers, bodies

STEP_S = 1 / 240
MARGIN_UM = 30.0  # a cell nearer to the picture's edge than this counts as not seen
TRIES = 40  # attempts to place two cells so that they cross in view


@dataclass(frozen=True, slots=True)
class FilmScript:
    """The script of a film of `seconds` at `rate` pictures per second.

    `cells` are magnetised, `strangers` are not. The field's direction changes after a time drawn
    uniformly between the two values of `hold` [s]. `events`: one cell rests for a while, one
    divides. Each pair of cells is made to cross once, with the probability that its `crossings` per
    minute give.
    """

    seconds: float = 10.0
    rate: float = 30.0
    cells: int = 20
    strangers: int = 0
    hold: tuple[float, float] = (0.3, 1.2)
    events: bool = True
    crossings: float = 6.0


@dataclass(slots=True)
class SyntheticFilm:
    """A film: `len(film.times)` pictures from `pictures()`, and the truth behind each.

    `turns` (T, 2) are times [s] and directions [rad] of the field. The truth is that at the middle
    of each exposure: whether a cell is `in_view` (K, N), x, y [um] and axis [rad] of each `body`
    (K, N, 3), and the `heading` (K, N) of its helix [rad].
    """

    script: FilmScript
    look: PictureLook
    seed: int
    cells: Swimmers | None = None
    times: Floats = field(init=False)
    turns: Floats = field(init=False)
    in_view: Bools = field(init=False)
    body: Floats = field(init=False)
    heading: Floats = field(init=False)
    _past: list[Swimmers] = field(init=False)
    _shift: Floats = field(init=False)

    def __post_init__(self) -> None:
        script = self.script
        random = np.random.default_rng(self.seed)
        count = script.cells + script.strangers
        if self.cells is None:
            self.cells = Swimmers.drawn(random, count, script.strangers)
        self.turns = _turns(random, script)
        self._past = _swum(random, script, self.cells, self.turns)
        self.cells = self._past[-1]
        self._shift = np.zeros((len(self.cells), 2))
        self._set_out(random, count)
        self.times = np.arange(round(script.seconds * script.rate)) / script.rate
        moments = [self._bodies(t) for t in self.times]
        alive = np.array([self._alive(t) for t in self.times])
        self.body = np.array([np.column_stack([b.x, b.y, b.axis]) for b in moments])
        self.heading = np.array([self._at(t).heading for t in self.times])
        inside = (self.body[..., :2] > MARGIN_UM) & (self.body[..., :2] < self._span - MARGIN_UM)
        self.in_view = inside.all(axis=-1) & alive

    @property
    def _span(self) -> Floats:
        return np.array([self.look.width, self.look.height]) * self.look.um_px

    def pictures(self) -> Iterator[GreyImage]:
        """Yield the pictures in order of time."""
        painter = DishPainter(self.look, self.seed)
        spread = (np.arange(SUB_EXPOSURES) + 0.5) / SUB_EXPOSURES - 0.5
        for t in self.times:
            moments = [self._bodies(t + part * self.look.exposure_s) for part in spread]
            yield painter.picture(self.cells, moments, self._alive(t), float(t))

    def _at(self, t: float) -> Swimmers:
        step = max(round(t / STEP_S), 0)
        return self._past[min(step, len(self._past) - 1)]

    def _alive(self, t: float) -> Bools:
        return ~np.isnan(self._at(t).x)

    def _bodies(self, t: float) -> Bodies:
        """Return the bodies at a time, between two steps."""
        place = min(max(t / STEP_S, 0.0), len(self._past) - 1.001)
        first = int(place)
        part = place - int(place)
        a = bodies(self._past[first])
        b = bodies(self._past[first + 1])

        def mixed(name: str) -> Floats:
            return getattr(a, name) + part * (getattr(b, name) - getattr(a, name))

        return Bodies(
            mixed("x") + self._shift[:, 0],
            mixed("y") + self._shift[:, 1],
            *(mixed(name) for name in ("height", "axis", "tilt")),
        )

    def _set_out(self, random: np.random.Generator, count: int) -> None:
        """Shift each cell's path so that, of each pair of cells, the paths cross in view."""
        middle = len(self._past) // 2
        end = self.script.seconds
        for i in range(len(self.cells or ())):
            halfway = np.array([self._past[middle].x[i], self._past[middle].y[i]])
            if i >= count:  # a daughter starts where its mother is
                self._shift[i] = self._shift[self._mother]
                continue
            self._shift[i] = random.uniform(0.15, 0.85, 2) * self._span - halfway
            partner = i - 1
            share = self.script.crossings * end / 60 if i % 2 else 0.0
            crosses = share >= 1 or (share > 0 and random.random() < share)
            for _ in range(TRIES if crosses else 0):
                when = random.uniform(0.15 * end, 0.95 * end)
                then = self._at(when)
                place = np.array([then.x[partner], then.y[partner]]) + self._shift[partner]
                if ((place > 0.1 * self._span) & (place < 0.9 * self._span)).all():
                    unshifted = np.array([then.x[i], then.y[i]])
                    self._shift[i] = place - unshifted + random.normal(0, 5, 2)
                    break

    @property
    def _mother(self) -> int:
        return self.script.cells - 2


def _turns(random: np.random.Generator, script: FilmScript) -> Floats:
    """Return times and directions of the field, each drawn independently."""
    gathered = []
    t = 0.0
    while t < script.seconds:
        gathered.append((t, random.uniform(-math.pi, math.pi)))
        t += round(random.uniform(*script.hold) / STEP_S) * STEP_S
    return np.array(gathered)


def _swum(
    random: np.random.Generator, script: FilmScript, cells: Swimmers, turns: Floats
) -> list[Swimmers]:
    """Return the cells' poses every STEP_S, starting at the origin and without walls.

    The last but one magnetised cell divides halfway through; its daughter is at NaN before.
    """
    cells = cells.copy()
    angle = random.uniform(-math.pi, math.pi)
    drift = (DRIFT_UM_S * math.cos(angle), DRIFT_UM_S * math.sin(angle))
    steps = round(script.seconds / STEP_S) + 2
    divides = script.cells - 2 if script.events and script.cells > 3 else None
    past: list[Swimmers] = []
    for k in range(steps):
        t = k * STEP_S
        if script.events and script.cells > 3:
            cells.set_resting(script.cells - 1, 0.4 < t / script.seconds < 0.6)
        if divides is not None and k == steps // 2:
            cells = cells.divide(divides, random)
        past.append(cells.copy())
        direction = turns[max(np.searchsorted(turns[:, 0], t + STEP_S / 2, side="right") - 1, 0), 1]
        cells.swim((math.cos(direction), math.sin(direction)), STEP_S, random, drift)
    if divides is not None:
        is_daughter = np.arange(len(cells)) == len(cells) - 1
        absent = past[-1].select(is_daughter)
        absent.x[:] = absent.y[:] = np.nan
        past = [then if len(then) == len(cells) else then.joined(absent) for then in past]
    return past
