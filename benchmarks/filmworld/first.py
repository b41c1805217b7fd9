"""The first renderer: the emulated dish of tetractl, widened by what its pictures do not show.

Cells pulse; a halo or an outline of the other sign; debris of the size and shape of cells; a focus
that wanders; a knock in the middle of the film; a field that is recorded late.
"""

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "packages/tetractl-microscope/tests"))
from support.synthetic_film import FilmScript, SyntheticFilm
from tetractl_emulator.pictures.dish.picture import (
    SUB_EXPOSURES,
    DishPainter,
    PictureLook,
    RenderedSpeck,
)

from tetractl.model.swimmers import Bodies, Swimmers

from .truth import LEVELS, FilmTruth

SIDE_PX = 1024
UM_PX = 2.3
CELLS = 20
STRANGERS = 4
BRIGHT_FIELD = 150.0  # grey level of the medium
RIM_UM = 6.0  # width of the halo around a cell, and of what is hollow within
LN_PULSE_HZ = math.log(0.15), math.log(3.0)  # least and greatest


@dataclass
class PulsingSwimmers(Swimmers):
    """Cells whose speed pulses about `base` by the share `pulse` (standard deviation)."""

    base: np.ndarray
    pulse: np.ndarray
    pulse_hz: np.ndarray
    age: np.ndarray

    def swim(self, field, seconds, random, drift=(0.0, 0.0), walls=None) -> None:
        beat = math.sqrt(2) * self.pulse * np.sin(2 * math.pi * self.pulse_hz * self.age)
        self.speed = self.base * (1 + beat)
        self.age = self.age + seconds
        super().swim(field, seconds, random, drift, walls)

    def joined(self, others: Swimmers) -> "PulsingSwimmers":
        theirs = vars(others)
        together = {name: np.append(ours, theirs[name]) for name, ours in vars(self).items()}
        return PulsingSwimmers(**together)

    def kept(self, which) -> "PulsingSwimmers":
        return PulsingSwimmers(**{name: array[which] for name, array in vars(self).items()})


class WidePainter(DishPainter):
    """A painter whose cells have the share `halo` of their contrast around them, over RIM_UM, and
    the share `hollow` of it missing within, both of which may be negative; `ink_shares` (N,)
    are each cell's share of the film's contrast.
    """

    def __init__(
        self, look: PictureLook, seed: int, halo: float, hollow: float, ink_shares: np.ndarray
    ) -> None:
        super().__init__(look, seed)
        self.halo = halo
        self.hollow = hollow
        self.ink_shares = ink_shares
        self._scratch = np.zeros((look.height, look.width), np.float32)

    def _draw_cell(self, ink, cells: Swimmers, moments: Sequence[Bodies], i: int) -> None:
        middle = moments[len(moments) // 2]
        reach = (cells.length[i] / 2 + 4 * RIM_UM + 30) / self.look.um_px
        patch = self._patch(middle.x[i], middle.y[i], reach)
        if patch is None:
            return
        where = patch[0]
        cover = self._covered(where, cells, moments, i, 0.0)
        total = cover.copy()
        if self.halo:
            total -= self.halo * (self._covered(where, cells, moments, i, RIM_UM) - cover)
        if self.hollow:
            total -= self.hollow * self._covered(where, cells, moments, i, -RIM_UM)
        ink[where] = ink[where] * (1 - 0.5 * cover) + self.ink_shares[i] * total

    def _covered(self, where, cells, moments, i: int, more: float) -> np.ndarray:
        """Return how far a body that is larger by `more` [um] on each side covers each pixel."""
        size = replace(cells, length=cells.length + 2 * more, width=cells.width + 2 * more)
        DishPainter._draw_cell(self, self._scratch, size, moments, i)
        picture = self._scratch[where].copy()
        self._scratch[where] = 0
        return picture


@dataclass(slots=True)
class WideFilm(SyntheticFilm):
    """A synthetic film of a level, drawn by its seed."""

    level: str = "easy"
    halo: float = 0.0
    hollow: float = 0.0
    wander_um: float = 0.0
    knock_um: tuple[float, float] = (0.0, 0.0)
    knock_s: float = math.inf
    late_s: float = 0.0

    @classmethod
    def drawn(cls, seed: int, level: str, cell_count: int = CELLS) -> "WideFilm":
        level_index = LEVELS.index(level)
        random = np.random.default_rng([seed, 1, level_index])
        hard = level == "hard"
        easy = level == "easy"
        seconds = 10.0 if easy else round(random.uniform(10, 12) * 30) / 30
        count = cell_count + STRANGERS
        cells = PulsingSwimmers(
            **vars(Swimmers.drawn(random, count, STRANGERS)),
            base=np.zeros(0),
            pulse=random.uniform(*((0.04, 0.06), (0.05, 0.07), (0.06, 0.1))[level_index], count),
            pulse_hz=np.exp(random.uniform(*LN_PULSE_HZ, count)),
            age=random.uniform(0, 10, count),
        )
        cells.base = cells.speed.copy()
        latest_s = 0.02 if hard else 0.01
        angle = random.uniform(-math.pi, math.pi)
        kinds = (0.0, 0.0), (random.uniform(0.2, 0.5), 0.0), (0.2, random.uniform(0.8, 1.3))
        halo, hollow = kinds[random.integers((1, 2, 3)[level_index])]
        look = _look(random, level)
        if hollow and look.bright:  # outlines are what a bright field shows
            brighter = BRIGHT_FIELD / look.light
            contrast = look.contrast * brighter
            look = replace(look, light=BRIGHT_FIELD, contrast=contrast)
        return cls(
            FilmScript(
                seconds=seconds,
                cells=cell_count,
                strangers=STRANGERS,
                events=not easy,
                crossings=6.0,
            ),
            look,
            seed,
            cells,
            level=level,
            halo=halo,
            hollow=hollow,
            wander_um=(0.0, 20.0, 70.0)[level_index],
            knock_um=(18 * math.cos(angle), 18 * math.sin(angle)) if hard else (0.0, 0.0),
            knock_s=seconds * random.uniform(0.35, 0.65) if hard else math.inf,
            late_s=0.0 if easy else random.uniform(0, latest_s),
        )

    def pictures(self) -> Iterator[np.ndarray]:
        random = np.random.default_rng([self.seed, 7])
        # the JPEG comes later, at the quality of the whole film
        look = replace(self.look, quality=None)
        ink_shares = np.exp(random.normal(0, 0.0 if self.level == "easy" else 0.15, 64))
        painter = WidePainter(look, self.seed, self.halo, self.hollow, ink_shares)
        spread = (np.arange(SUB_EXPOSURES) + 0.5) / SUB_EXPOSURES - 0.5
        focus = 0.0
        knocked = False
        for t in self.times:
            focus += -focus / 60 + self.wander_um * math.sqrt(2 / 60) * random.standard_normal()
            if t > self.knock_s and not knocked:
                knocked = True
                dx, dy = self.knock_um
                # everything seems to move by dx, dy
                painter.change(replace(painter.look, corner_um=(-dx, -dy)))
            painter.look = replace(painter.look, focus_um=focus)
            moments = [self._bodies(t + part * self.look.exposure_s) for part in spread]
            yield painter.picture(self.cells, moments, self._alive(t), float(t))

    def truth(self) -> FilmTruth:
        """Return what was drawn, in the coordinates of the pictures."""
        random = np.random.default_rng([self.seed, 8])
        is_alive = np.array([self._alive(t) for t in self.times])
        knocked = (self.times > self.knock_s)[:, None, None] * np.array(self.knock_um)
        place = self.body[..., :2] + knocked
        states = [self._at(t) for t in self.times]
        resting = np.array([state.resting for state in states])
        speed = np.array([state.speed for state in states]) * ~resting
        a = self.cells.a.copy()
        parent = np.full(len(self.cells), -1)
        if self.script.events:
            parent[-1] = self._mother
            a[self._mother] = math.nan  # it changes
        late = random.uniform(0.5 * self.late_s, self.late_s, len(self.turns))

        return FilmTruth(
            times=self.times,
            x=place[..., 0],
            y=place[..., 1],
            heading=self.heading,
            speed=speed,
            resting=resting,
            a=a,
            parent=parent,
            turns=self.turns,
            recorded=self.turns[:, 0] + late,
            um_px=UM_PX,
            side_px=SIDE_PX,
        ).only(is_alive)


def first_film(
    seed: int, level: str, cell_count: int = CELLS
) -> tuple[FilmTruth, Iterator[np.ndarray], int]:
    """Return the truth of a film, its pictures and the quality at which they are to be coded."""
    film = WideFilm.drawn(seed, level, cell_count)
    return film.truth(), film.pictures(), film.look.quality


def _look(random: np.random.Generator, level: str) -> PictureLook:
    level_index = LEVELS.index(level)
    span = SIDE_PX * UM_PX
    bright = bool(random.random() < 0.5)
    light = random.uniform(60, 110) if bright else random.uniform(120, 190)
    contrast = (random.uniform(40, 80), random.uniform(30, 70), random.uniform(0.17, 0.2) * light)
    noise = (random.uniform(2, 4), random.uniform(3, 6), random.uniform(7, 8))
    contrast = contrast[level_index]
    noise = noise[level_index]
    if level == "hard" and random.random() < 0.5:
        contrast = 0.17 * light
        noise = 8.0
    specks = [_speck(random, span, level_index) for _ in range((4, 30, 36)[level_index])]
    specks += [_lookalike(random, span, level_index) for _ in range((0, 3, 16)[level_index])]
    if level_index:
        x, y = random.uniform(0, span, 2).tolist()
        size = float(random.uniform(100, 250))
        wall = RenderedSpeck(x, y, size, 1.0, 0.0, 0.1, rim=True)
        specks += [wall] * (1, 3)[level_index - 1]  # a bubble's wall has a contrast of its own
    return PictureLook(
        width=SIDE_PX,
        height=SIDE_PX,
        um_px=UM_PX,
        exposure_s=float(random.uniform(0.004, 0.015)),
        bright=bright,
        light=light,
        contrast=contrast,
        vignetting=float(random.uniform(0.0, 0.1) if not level_index else random.uniform(0.1, 0.3)),
        light_drift=float(random.uniform(-0.01, 0.01)) if level_index else 0.0,
        flicker=float(random.uniform(0.005, 0.02)) * level_index,
        noise=noise,
        quality=(95, int(random.integers(75, 91)), 60)[level_index],
        specks=tuple(specks),
    )


def _speck(random: np.random.Generator, span: float, level: int) -> RenderedSpeck:
    drifts = level and random.random() < 0.3
    drift = random.uniform(-10, 10, 2) if drifts else np.zeros(2)
    return RenderedSpeck(
        *random.uniform(0, span, 2).tolist(),
        size_um=float(random.uniform(5, 30)),
        stretch=float(random.uniform(1, 2.5)),
        turn=float(random.uniform(0, math.pi)),
        shade=float(random.uniform(0.3, 1.2)),
        drift=tuple(drift.tolist()),
    )


def _lookalike(random: np.random.Generator, span: float, level: int) -> RenderedSpeck:
    """Return debris of the size and shape of a cell, which may drift."""
    speed = random.uniform(0, (0, 15, 40)[level]) if random.random() < 0.6 else 0.0
    way = random.uniform(-math.pi, math.pi)
    width = random.uniform(20, 32)
    return RenderedSpeck(
        *random.uniform(0, span, 2).tolist(),
        size_um=float(width),
        stretch=float(random.uniform(1.7, 2.3)),
        turn=float(random.uniform(0, math.pi)),
        shade=float(random.uniform(0.6, 1.2)),
        drift=(speed * math.cos(way), speed * math.sin(way)),
    )
