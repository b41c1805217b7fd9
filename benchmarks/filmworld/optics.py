"""Pictures of the second renderer: bodies as polygons, thickness by a distance transform, a halo,
vacuoles, defocus by a disk. Light is transmitted: overlapping bodies multiply.

Nothing here is taken from tetractl. Rows run down, y up; lengths in um, patches in px.
"""

import math
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

FINE = 3  # subpixels a pixel side
REACH_UM = 24.0  # how far beyond the body its halo is drawn


@dataclass(frozen=True, slots=True)
class Shape:
    """A body: outline (P, 2) in body lengths from its middle, forwards along x, `length` [um];
    vacuoles (V, 5): place along, across and in depth [um], radius [um] and strength; `ink` its own
    share of the film's contrast, `head` how much darker the front is than the middle, `bend` how
    far it bends to and fro as it rolls.
    """

    outline: np.ndarray
    length: float
    width: float
    vacuoles: np.ndarray
    ink: float
    head: float
    bend: float

    @classmethod
    def drawn(
        cls, random: np.random.Generator, length: float, width: float, texture: float, spread: float
    ) -> "Shape":
        t = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        egg = random.uniform(0.02, 0.3)
        bend = random.normal(0, 0.04)
        x = 0.5 * np.cos(t)
        y = 0.5 * width / length * np.sin(t) * (1 - egg * np.cos(t)) + bend * (np.cos(t) ** 2 - 0.5)
        waves = np.zeros(len(t))
        for n in (2, 3):
            strength = random.normal(0, 0.008)
            waves += strength * np.cos(n * t + random.uniform(0, 6))
        outline = np.stack([x * (1 + waves), y * (1 + waves)], 1)
        outline -= _centroid(outline)
        count = random.integers(2, 8)
        vacuoles = np.column_stack(
            [
                random.uniform(-0.33, 0.33, count) * length,
                *(random.uniform(-0.3, 0.3, count) * width for _ in range(2)),
                random.uniform(2.0, 6.0, count),
                random.uniform(-1.0, 1.0, count) * texture,
            ]
        )
        ink = np.exp(random.normal(0, spread))
        head, rolling_bend = random.normal(0, (0.3, 0.04))
        return cls(outline, length, width, vacuoles, float(ink), texture * head, rolling_bend)


@dataclass(frozen=True, slots=True)
class Optics:
    """How a microscope shows bodies: `body` and `halo` are the changes of the transmitted light by
    the middle of a body and by its rim outside, as fractions of the medium's light; `halo_um` how
    far the halo reaches; `edge` the strength of a sharp line at the outline, of the halo's sign.
    `lens_px` is the blur in focus, `aperture` the radius of blur a um of defocus [um].
    """

    um_px: float
    side_px: int
    body: float
    halo: float
    halo_um: float
    edge: float
    lens_px: float
    aperture: float

    def stamp(
        self, field: np.ndarray, shape: Shape, pose: tuple, focus: float, travel: np.ndarray
    ) -> None:
        """Multiply a field of transmitted light (side, side) by a body at a `pose`: x, y, z [um],
        direction [rad], share of its length that is not foreshortened, and roll [rad]. `focus` is
        the height in focus [um], `travel` the way x, y during the exposure [um].
        """
        x, y, z, turn, flat, roll = pose
        half = math.ceil((shape.length / 2 + REACH_UM) / self.um_px)
        column = x / self.um_px
        row = self.side_px - y / self.um_px
        first_column = math.floor(column) - half
        top = math.floor(row) - half
        side = 2 * half + 1
        if (
            first_column >= self.side_px
            or top >= self.side_px
            or first_column + side <= 0
            or top + side <= 0
        ):
            return
        fine = FINE / self.um_px  # subpixels a um
        middle = np.array([(column - first_column) * FINE - 0.5, (row - top) * FINE - 0.5])
        cos = math.cos(turn)
        sin = math.sin(turn)
        basis = np.array([[cos, -sin], [-sin, -cos]])  # rows run down
        scale = np.array([max(flat, shape.width / shape.length), 1.0]) * shape.length * fine
        outline = shape.outline.copy()
        outline[:, 1] += shape.bend * math.sin(roll) * (4 * outline[:, 0] ** 2 - 0.25)
        corners = (outline * scale) @ basis.T + middle
        mask = np.zeros((side * FINE, side * FINE), np.uint8)
        cv2.fillPoly(mask, [np.round(corners * 16).astype(np.int32)], 255, cv2.LINE_8, 4)
        inside = cv2.distanceTransform(mask, cv2.DIST_L2, 3) / fine
        outside = cv2.distanceTransform(255 - mask, cv2.DIST_L2, 3) / fine
        thick = np.sqrt(np.minimum(inside / (0.32 * shape.width), 1.0))
        light = self.body * shape.ink * (np.where(mask > 0, 0.35, 0.0) + 0.65 * thick)
        light *= self._inner(shape, basis, middle, fine, flat, roll, mask.shape)
        rows, columns = np.ogrid[: len(mask), : len(mask)]
        ahead = (columns - middle[0]) * cos - (rows - middle[1]) * sin
        light *= 1 + shape.head * ahead / (shape.length / 2 * fine)
        if self.halo or self.edge:
            ring = np.exp(-outside / self.halo_um)
            ring[outside == 0] = 0.0
            light += self.halo * shape.ink * ring
            light += self.edge * shape.ink * np.exp(-(((inside + outside) / 1.8) ** 2))
        if np.hypot(*travel) * fine > 0.5:
            light = _smeared(light, travel * fine)
        patch = cv2.resize(light.astype(np.float32), (side, side), interpolation=cv2.INTER_AREA)
        patch = cv2.GaussianBlur(patch, (0, 0), self.lens_px)
        radius = self.aperture * abs(z - focus) / self.um_px
        if radius > 0.35:
            patch = cv2.filter2D(patch, -1, disk(round(4 * radius)), borderType=cv2.BORDER_CONSTANT)
        rows = slice(max(top, 0), min(top + side, self.side_px))
        columns = slice(max(first_column, 0), min(first_column + side, self.side_px))
        field[rows, columns] *= (
            1
            + patch[
                rows.start - top : rows.stop - top,
                columns.start - first_column : columns.stop - first_column,
            ]
        )

    @staticmethod
    def _inner(shape, basis, middle, fine, flat, roll, size) -> np.ndarray:
        """Return the factors of a body's own light, by its vacuoles, which roll with it."""
        inner = np.ones(size, np.float32)
        for along, across, deep, radius, strength in shape.vacuoles:
            aside = across * math.cos(roll) - deep * math.sin(roll)
            spot = basis @ np.array([along * flat, aside]) * fine + middle
            place = tuple(int(v) for v in np.round(spot * 16))
            cv2.circle(inner, place, round(radius * fine * 16), 1 + strength, -1, cv2.LINE_8, 4)
        return cv2.blur(inner, (3, 3))


def bubble(field: np.ndarray, x: float, y: float, radius: float, strength: float) -> None:
    """Multiply a field by a bubble at x, y [px] with a dark wall and a bright edge inside it."""
    rows, columns = np.ogrid[: field.shape[0], : field.shape[1]]
    away = np.hypot(columns - x, rows - y) - radius
    field *= 1 - strength * np.exp(-((away / 2.5) ** 2))
    field *= 1 + 0.8 * strength * np.exp(-(((away + 5.0) / 2.0) ** 2))
    field *= np.where(away < 0, 1.04, 1.0)


@cache
def disk(quarters: int) -> np.ndarray:
    """Return the kernel of a disk with a radius of so many quarters of a pixel; its sum is 1."""
    radius = quarters / 4
    half = math.ceil(radius)
    offsets = np.arange(-half, half + 1)
    kernel = np.clip(radius + 0.5 - np.hypot(offsets[:, None], offsets[None]), 0, 1)
    return (kernel / kernel.sum()).astype(np.float32)


def _smeared(light: np.ndarray, travel: np.ndarray) -> np.ndarray:
    """Return a patch averaged over a way x, y (up) [subpixels] about its middle."""
    total = np.zeros_like(light)
    parts = (-0.375, -0.125, 0.125, 0.375)
    for part in parts:
        across, up = np.round(part * travel).astype(int)
        total += np.roll(light, (-int(up), int(across)), (0, 1))
    return total / len(parts)


def _centroid(outline: np.ndarray) -> np.ndarray:
    x, y = outline.T
    u, v = np.roll(outline, -1, 0).T
    cross = x * v - u * y
    moments = np.array([((x + u) * cross).sum(), ((y + v) * cross).sum()])
    return moments / (3 * cross.sum())
