"""The second renderer: films of `swim` and `optics` under `conditions`.

Nothing here is taken from tetractl.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from .conditions import RATE_HZ, SIDE_PX, UM_PX, Conditions
from .optics import Shape, bubble
from .swim import NEARBY_UM, STEPS_S, Fauna, Swum, swim
from .truth import LEVELS, FilmTruth

CELLS = 20
STRANGERS = 4
NOISE_SPARE_PX = 64
FOCUS_UM = 4.0  # step of the focus in which debris at rest is drawn
TRIES = 60  # attempts to let two neighbours cross in view


def second_film(
    seed: int, level: str, cell_count: int = CELLS
) -> tuple[FilmTruth, Iterator[np.ndarray], int]:
    """Return the truth of a film, its pictures and the quality at which they are to be coded."""
    random = np.random.default_rng([seed, 2, LEVELS.index(level)])
    conditions = Conditions.drawn(random, level)
    fauna = Fauna.drawn(random, cell_count, STRANGERS, conditions.pulse)
    times = [0.0]
    while times[-1] < conditions.seconds:
        times.append(times[-1] + random.uniform(0.3, 1.2))
    turns = np.column_stack([times, random.uniform(-np.pi, np.pi, len(times))])
    rest = (
        (cell_count - 1, 0.4 * conditions.seconds, 0.6 * conditions.seconds)
        if conditions.events
        else None
    )
    swum = swim(random, fauna, conditions.seconds, turns, rest, conditions.backs)
    world = _World.of(random, conditions, fauna, swum)
    count = round(conditions.seconds * RATE_HZ)
    moments = (np.arange(count) + 0.5) / RATE_HZ
    jitter = random.uniform(0, conditions.late_s / 2, len(turns))
    truth = world.truth(moments, turns, turns[:, 0] + conditions.late_s / 2 + jitter)
    return truth, world.pictures(random, moments), conditions.quality


@dataclass(slots=True)
class _World:
    """A film's individuals: `slot` of the swimmer, `shift` [um] and first and last step of each."""

    conditions: Conditions
    fauna: Fauna
    swum: Swum
    shapes: list[Shape]
    slot: np.ndarray
    shift: np.ndarray
    span: np.ndarray
    parent: np.ndarray

    @classmethod
    def of(cls, random, conditions: Conditions, fauna: Fauna, swum: Swum) -> "_World":
        """Place the cells so that neighbours cross in view; one that leaves on one side is
        followed by a new individual on the other.
        """
        side = SIDE_PX * UM_PX
        count = len(fauna.speed)
        wide = side + 2 * NEARBY_UM
        flat = swum.place[:, :, :2]
        steps = len(flat)
        shift = np.zeros((count, 2))
        for i in range(count):
            shift[i] = random.uniform(0, wide, 2) - flat[steps // 2, i]
            for _ in range(TRIES if i % 4 else 0):  # with the neighbour before it
                knock_step = random.integers(steps // 10, 95 * steps // 100)
                meet = (flat[knock_step, i - 1] + shift[i - 1]) % wide - NEARBY_UM
                if (meet > 60).all() and (meet < side - 60).all():
                    shift[i] = meet + NEARBY_UM - flat[knock_step, i] + random.normal(0, 6, 2)
                    break
        slots = []
        shifts = []
        spans = []
        parents = []
        shapes = []

        def add(i: int, by: np.ndarray, first: int, end: int, parent: int, shrink: float) -> None:
            slots.append(i)
            shifts.append(by)
            spans.append((first, end))
            parents.append(parent)
            size = shrink * random.normal(1, 0.0 if first == 0 else 0.08)
            long = fauna.length[i] * np.clip(size, 0.6, 1.2)
            wide = fauna.width[i]
            shapes.append(Shape.drawn(random, long, wide, conditions.texture, conditions.spread))

        for i in range(count):
            turns = np.floor((flat[:, i] + shift[i]) / wide)
            cuts = np.flatnonzero((np.diff(turns, axis=0) != 0).any(axis=1)) + 1
            for first, end in zip([0, *cuts], [*cuts, steps], strict=True):
                if end - first < 3:
                    continue
                add(i, shift[i] - turns[first] * wide - NEARBY_UM, int(first), int(end), -1, 1.0)
        world = cls(
            conditions, fauna, swum, shapes, *map(np.array, (slots, shifts, spans, parents))
        )
        if conditions.events:
            world._divide(random)
        return world

    def _divide(self, random) -> None:
        """Let an individual become two: itself, shorter, and one that swims like a stranger's."""
        half = len(self.swum.place) // 2
        side = SIDE_PX * UM_PX
        middle = self.swum.place[half, self.slot, :2] + self.shift
        may_divide = (self.span[:, 0] < half) & (self.span[:, 1] > half + 2 * STEPS_S)
        rests = len(self.fauna.speed) - STRANGERS - 1  # the last cell with a magnet
        may_divide &= ((middle > 250) & (middle < side - 250)).all(axis=1) & (self.slot < rests)
        if not may_divide.any():
            return
        mother = int(random.choice(np.flatnonzero(may_divide)))
        slot_of_mother = self.slot[mother]
        # the daughters swim on as the mother and as the swimmer with the likest heading
        turn = self.swum.heading[half] - self.swum.heading[half, slot_of_mother]
        off = np.abs(np.angle(np.exp(1j * turn)))
        off[slot_of_mother] += 10.0
        unlike = np.where(self.fauna.a > 0, np.abs(off - 0.6), 100.0)
        twin_species = int(np.argmin(unlike))
        ways = slot_of_mother, twin_species
        ends = int(self.span[mother, 1]), len(self.swum.place)
        slots = []
        shifts = []
        spans = []
        parents = []
        for way, end, apart in zip(ways, ends, (1.0, -1.0), strict=True):
            th = self.swum.heading[half, slot_of_mother] + math.pi / 2
            step = apart * 6.0 * np.array([math.cos(th), math.sin(th)])
            slots.append(way)
            shifts.append(middle[mother] - self.swum.place[half, way, :2] + step)
            spans.append((half, end))
            parents.append(mother)
            long = 0.8 * self.shapes[mother].length
            width = self.shapes[mother].width
            self.shapes.append(
                Shape.drawn(random, long, width, self.conditions.texture, self.conditions.spread)
            )
        self.span[mother, 1] = half
        self.slot = np.append(self.slot, slots)
        self.shift = np.vstack([self.shift, shifts])
        self.span = np.vstack([self.span, spans])
        self.parent = np.append(self.parent, parents)

    def truth(self, moments, turns, recorded) -> FilmTruth:
        step = np.round(moments * STEPS_S).astype(int)
        is_alive = (step[:, None] >= self.span[:, 0]) & (step[:, None] < self.span[:, 1])
        knocked = (moments > self.conditions.knock_s)[:, None, None] * np.array(
            self.conditions.knock_um
        )
        place = self.swum.place[step][:, self.slot, :2] + self.shift + knocked

        return FilmTruth(
            times=moments - moments[0],
            x=place[..., 0],
            y=place[..., 1],
            heading=self.swum.heading[step][:, self.slot],
            speed=self.swum.speed[step][:, self.slot],
            resting=self.swum.resting[step][:, self.slot],
            a=self.fauna.a[self.slot],
            parent=self.parent,
            turns=turns - [moments[0], 0.0],
            recorded=recorded - moments[0],
            um_px=UM_PX,
            side_px=SIDE_PX,
        ).only(is_alive)

    def pictures(self, random, moments: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the pictures at the given times [s]."""
        conditions = self.conditions
        side = SIDE_PX
        grain = (
            random.standard_normal((side + NOISE_SPARE_PX,) * 2).astype(np.float32)
            * conditions.noise
        )
        focus = 0.0
        flicker = 0.0
        debris = _Debris.drawn(random, conditions)
        stills = {}  # by the focus, to which a film comes back
        for t in moments.tolist():
            focus += (
                -focus / (2.0 * RATE_HZ)
                + conditions.wander / math.sqrt(RATE_HZ) * random.standard_normal()
            )
            flicker = conditions.flicker * math.sin(
                2 * math.pi * 99.3 * t
            ) + 0.2 * conditions.flicker * (random.standard_normal())
            is_knocked = t > conditions.knock_s
            knock = np.array(conditions.knock_um if is_knocked else (0.0, 0.0))
            key = is_knocked, round(focus / FOCUS_UM)
            if key not in stills:
                stills[key] = debris.still(conditions, knock, FOCUS_UM * key[1])
            field = stills[key].copy()
            debris.moving(field, conditions, t, knock, focus)
            step = round(t * STEPS_S)
            for i in np.flatnonzero((self.span[:, 0] <= step) & (step < self.span[:, 1])):
                self._stamp(field, int(i), step, knock, focus)
            light = conditions.light * (1 + conditions.drift * t) * (1 + flicker)
            down, across = random.integers(0, NOISE_SPARE_PX, 2)
            shades = field * np.float32(light)
            waves = grain[down : down + side, across : across + side]
            shades += waves * np.sqrt(np.maximum(field, 0.0))
            yield np.clip(shades + 0.5, 0, 255).astype(np.uint8)

    def _stamp(self, field, i: int, step: int, knock: np.ndarray, focus: float) -> None:
        slot = self.slot[i]
        place = self.swum.place[step, slot]
        along = self.swum.along[step, slot]
        side = self.swum.side[step, slot]
        ahead = self.swum.speed[step, slot] * self.conditions.exposure_s
        turn = math.atan2(along[1], along[0])
        level = np.array([-math.sin(turn), math.cos(turn), 0.0])
        roll = math.atan2(side @ level, side[2])
        x, y = place[:2] + self.shift[i] + knock
        pose = x, y, place[2], turn, math.hypot(along[0], along[1]), roll
        self.conditions.optics.stamp(field, self.shapes[i], pose, focus, ahead * along[:2])


@dataclass(slots=True)
class _Debris:
    """Specks (D): `shapes` and poses x, y, z [um], turn [rad]; `drift` x, y, turn a second."""

    shapes: list[Shape]
    pose: np.ndarray
    drift: np.ndarray
    bubbles: list[tuple[float, ...]]

    @classmethod
    def drawn(cls, random, conditions: Conditions) -> "_Debris":
        side = SIDE_PX * UM_PX
        count = conditions.specks + conditions.lookalikes
        shapes = []
        drift = np.zeros((count, 3))
        for i in range(count):
            alike = i < conditions.lookalikes
            long = random.normal(52, 8) if alike else random.uniform(5, 40)
            wide = long * (random.uniform(0.42, 0.6) if alike else random.uniform(0.4, 1.0))
            shapes.append(
                Shape.drawn(random, max(long, 5.0), max(wide, 4.0), conditions.texture, 0.3)
            )
            if conditions.speck_um_s and (
                random.random() < 0.5 if alike else random.random() < 0.3
            ):
                speed = random.uniform(5, conditions.speck_um_s)
                way = random.uniform(-np.pi, np.pi)
                turn = random.normal(0, 0.3)
                drift[i] = speed * math.cos(way), speed * math.sin(way), turn
        pose = np.column_stack(
            [
                random.uniform(0, side, (count, 2)),
                random.normal(0, 15, count),
                random.uniform(-np.pi, np.pi, count),
            ]
        )
        bubbles = [
            (
                *random.uniform(150, SIDE_PX - 150, 2),
                random.uniform(25, 60),
                random.uniform(0.3, 0.6),
            )
            for _ in range(conditions.bubbles)
        ]
        return cls(shapes, pose, drift, bubbles)

    def still(self, conditions: Conditions, knock: np.ndarray, focus: float) -> np.ndarray:
        """Return the field of the light with what does not move."""
        rows, columns = np.ogrid[-1 : 1 : SIDE_PX * 1j, -1 : 1 : SIDE_PX * 1j]
        field = (
            1 - conditions.vignetting * ((rows - 0.1) ** 2 + (columns + 0.15) ** 2) / 2
        ).astype(np.float32)
        for x, y, radius, strength in self.bubbles:
            bubble(field, x + knock[0] / UM_PX, y - knock[1] / UM_PX, radius, strength)
        self._stamp(field, ~self.drift.any(axis=1), conditions, 0.0, knock, focus)
        return field

    def moving(
        self, field, conditions: Conditions, t: float, knock: np.ndarray, focus: float
    ) -> None:
        """Add what drifts to a field, at a time [s]."""
        self._stamp(field, self.drift.any(axis=1), conditions, t, knock, focus)

    def _stamp(self, field, which, conditions: Conditions, t: float, knock, focus: float) -> None:
        strong = replace(conditions.optics, halo=0.5 * conditions.optics.halo)
        for i in np.flatnonzero(which):
            x, y, z, turn = self.pose[i]
            dx, dy, dturn = self.drift[i] * t
            pose = x + dx + knock[0], y + dy + knock[1], z, turn + dturn, 1.0, 0.0
            strong.stamp(field, self.shapes[i], pose, focus, np.zeros(2))
